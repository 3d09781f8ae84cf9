<?xml version="1.0" encoding="utf-8"?>
<!-- A device with eight digital inputs, eight digital outputs and two analogue inputs (CiA 401): one that is node 5 of a network, with its
     settings. Written for canopen-proto.
     Some objects say all by themselves, some leave type, access and value to a parameter: CiA 311 has both forms. -->
<ISO15745ProfileContainer xmlns="http://www.canopen.org/xml/1.1" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">
  <ISO15745Profile>
    <ProfileHeader>
      <ProfileIdentification>Sample I/O</ProfileIdentification>
      <ProfileRevision>1</ProfileRevision>
      <ProfileName/>
      <ProfileSource/>
      <ProfileClassID>Device</ProfileClassID>
      <ISO15745Reference>
        <ISO15745Part>1</ISO15745Part>
        <ISO15745Edition>1</ISO15745Edition>
        <ProfileTechnology>CANopen</ProfileTechnology>
      </ISO15745Reference>
    </ProfileHeader>
    <ProfileBody xsi:type="ProfileBody_Device_CANopen" fileName="sample_io.xdc" fileCreator="canopen-proto"
        fileCreationDate="2026-11-21" fileCreationTime="12:00:00" fileVersion="1.0" supportedLanguages="en">
      <DeviceIdentity>
        <vendorName>Sample Maker</vendorName>
        <vendorID>0xFFFFFF01</vendorID>
        <productName>Sample I/O</productName>
        <productID>0x00000401</productID>
        <productText>
          <description lang="en">Eight digital inputs and outputs, two analogue inputs</description>
        </productText>
        <orderNumber>S-IO-882</orderNumber>
      </DeviceIdentity>
      <ApplicationProcess>
        <dataTypeList>
          <array name="Channels" uniqueID="T_CHANNELS">
            <subrange lowerLimit="1" upperLimit="2"/>
            <INT/>
          </array>
          <enum name="Mode" uniqueID="T_MODE">
            <enumValue value="0"><label lang="en">off</label></enumValue>
            <enumValue value="1"><label lang="en">on change</label></enumValue>
            <enumValue value="2"><label lang="en">cyclic</label></enumValue>
            <USINT/>
          </enum>
        </dataTypeList>
        <parameterList>
          <parameter uniqueID="P_FILTER" access="readWrite" multiplier="0.1">
            <label lang="en">Filter time</label>
            <description lang="en">How long an input has to be stable before it counts</description>
            <UINT/>
            <denotation><label lang="en">debouncing</label></denotation>
            <actualValue value="100"/>
            <defaultValue value="50"/>
            <allowedValues>
              <range><minValue value="0"/><maxValue value="10000"/></range>
            </allowedValues>
            <unit><label lang="en">ms</label></unit>
          </parameter>
          <parameter uniqueID="P_MODE" access="readWrite">
            <label lang="en">Transmission mode</label>
            <dataTypeIDRef uniqueIDRef="T_MODE"/>
            <defaultValue value="1"/>
          </parameter>
          <parameter uniqueID="P_TEXT" access="readWrite">
            <label lang="en">Place of installation</label>
            <STRING/>
            <defaultValue value="cabinet 1"/>
          </parameter>
          <parameter uniqueID="P_KEY" access="write">
            <label lang="en">Calibration key</label>
            <BITSTRING/>
            <defaultValue value="00 00 00 00"/>
          </parameter>
          <parameter uniqueID="P_ANALOG">
            <label lang="en">Analogue inputs</label>
            <dataTypeIDRef uniqueIDRef="T_CHANNELS"/>
          </parameter>
        </parameterList>
      </ApplicationProcess>
    </ProfileBody>
  </ISO15745Profile>
  <ISO15745Profile>
    <ProfileHeader>
      <ProfileIdentification>Sample I/O on CANopen</ProfileIdentification>
      <ProfileRevision>1</ProfileRevision>
      <ProfileName/>
      <ProfileSource/>
      <ProfileClassID>CommunicationNetwork</ProfileClassID>
      <ISO15745Reference>
        <ISO15745Part>1</ISO15745Part>
        <ISO15745Edition>1</ISO15745Edition>
        <ProfileTechnology>CANopen</ProfileTechnology>
      </ISO15745Reference>
    </ProfileHeader>
    <ProfileBody xsi:type="ProfileBody_CommunicationNetwork_CANopen" fileName="sample_io.xdc" fileCreator="canopen-proto"
        fileCreationDate="2026-11-21" fileCreationTime="12:00:00" fileVersion="1.0" supportedLanguages="en">
      <ApplicationLayers>
        <CANopenObjectList>
          <CANopenObject index="1000" name="Device type" objectType="7" dataType="0007" accessType="ro" defaultValue="0x00070191"/>
          <CANopenObject index="1001" name="Error register" objectType="7" dataType="0005" accessType="ro" PDOmapping="optional"/>
          <CANopenObject index="1005" name="COB-ID SYNC" objectType="7" dataType="0007" accessType="rw" defaultValue="0x80"/>
          <CANopenObject index="1008" name="Manufacturer device name" objectType="7" dataType="0009" accessType="const" defaultValue="Sample I/O"/>
          <CANopenObject index="1014" name="COB-ID EMCY" objectType="7" dataType="0007" accessType="rw" defaultValue="$NODEID+0x80"/>
          <CANopenObject index="1017" name="Producer heartbeat time" objectType="7" dataType="0006" accessType="rw" defaultValue="500" actualValue="250"/>
          <CANopenObject index="1018" name="Identity object" objectType="9" subNumber="5">
            <CANopenSubObject subIndex="00" name="Highest sub-index supported" objectType="7" dataType="0005" accessType="const" defaultValue="4"/>
            <CANopenSubObject subIndex="01" name="Vendor-ID" objectType="7" dataType="0007" accessType="ro" defaultValue="0xFFFFFF01"/>
            <CANopenSubObject subIndex="02" name="Product code" objectType="7" dataType="0007" accessType="ro" defaultValue="0x00000401"/>
            <CANopenSubObject subIndex="03" name="Revision number" objectType="7" dataType="0007" accessType="ro" defaultValue="0x00010000"/>
            <CANopenSubObject subIndex="04" name="Serial number" objectType="7" dataType="0007" accessType="ro"/>
          </CANopenObject>
          <CANopenObject index="1400" name="RPDO communication parameter 1" objectType="9" subNumber="3">
            <CANopenSubObject subIndex="00" name="Highest sub-index supported" objectType="7" dataType="0005" accessType="const" defaultValue="2"/>
            <CANopenSubObject subIndex="01" name="COB-ID used by RPDO" objectType="7" dataType="0007" accessType="rw" defaultValue="$NODEID+0x200"/>
            <CANopenSubObject subIndex="02" name="Transmission type" objectType="7" dataType="0005" accessType="rw" defaultValue="255"/>
          </CANopenObject>
          <CANopenObject index="1600" name="RPDO mapping parameter 1" objectType="9" subNumber="2">
            <CANopenSubObject subIndex="00" name="Number of mapped objects" objectType="7" dataType="0005" accessType="rw" defaultValue="1"/>
            <CANopenSubObject subIndex="01" name="Mapped object 1" objectType="7" dataType="0007" accessType="rw" defaultValue="0x62000108"/>
          </CANopenObject>
          <CANopenObject index="1800" name="TPDO communication parameter 1" objectType="9" subNumber="5">
            <CANopenSubObject subIndex="00" name="Highest sub-index supported" objectType="7" dataType="0005" accessType="const" defaultValue="5"/>
            <CANopenSubObject subIndex="01" name="COB-ID used by TPDO" objectType="7" dataType="0007" accessType="rw" defaultValue="$NODEID+0x40000180" actualValue="$NODEID+0x40000180"/>
            <CANopenSubObject subIndex="02" name="Transmission type" objectType="7" dataType="0005" accessType="rw" defaultValue="255"/>
            <CANopenSubObject subIndex="03" name="Inhibit time" objectType="7" dataType="0006" accessType="rw" defaultValue="100"/>
            <CANopenSubObject subIndex="05" name="Event timer" objectType="7" dataType="0006" accessType="rw" defaultValue="200" actualValue="50"/>
          </CANopenObject>
          <CANopenObject index="1A00" name="TPDO mapping parameter 1" objectType="9" subNumber="4">
            <CANopenSubObject subIndex="00" name="Number of mapped objects" objectType="7" dataType="0005" accessType="rw" defaultValue="3"/>
            <CANopenSubObject subIndex="01" name="Mapped object 1" objectType="7" dataType="0007" accessType="rw" defaultValue="0x60000108"/>
            <CANopenSubObject subIndex="02" name="Mapped object 2" objectType="7" dataType="0007" accessType="rw" defaultValue="0x64010110"/>
            <CANopenSubObject subIndex="03" name="Mapped object 3" objectType="7" dataType="0007" accessType="rw" defaultValue="0x64010210"/>
          </CANopenObject>
          <CANopenObject index="2000" name="Filter time" objectType="7" PDOmapping="no" uniqueIDRef="P_FILTER"/>
          <CANopenObject index="2001" name="Transmission mode" objectType="7" PDOmapping="no" uniqueIDRef="P_MODE"/>
          <CANopenObject index="2002" name="Place of installation" objectType="7" PDOmapping="no" uniqueIDRef="P_TEXT"/>
          <CANopenObject index="2003" name="Calibration key" objectType="7" PDOmapping="no" objFlags="0003" uniqueIDRef="P_KEY"/>
          <CANopenObject index="6000" name="Read input 8-bit" objectType="8" dataType="0005" subNumber="2">
            <CANopenSubObject subIndex="00" name="Number of inputs 8-bit" objectType="7" dataType="0005" accessType="const" defaultValue="1"/>
            <CANopenSubObject subIndex="01" name="Input 1 to 8" denotation="light barriers" objectType="7" dataType="0005" accessType="ro" PDOmapping="default"/>
          </CANopenObject>
          <CANopenObject index="6200" name="Write output 8-bit" objectType="8" dataType="0005" subNumber="2">
            <CANopenSubObject subIndex="00" name="Number of outputs 8-bit" objectType="7" dataType="0005" accessType="const" defaultValue="1"/>
            <CANopenSubObject subIndex="01" name="Output 1 to 8" objectType="7" dataType="0005" accessType="rw" PDOmapping="RPDO"/>
          </CANopenObject>
          <CANopenObject index="6401" name="Read analogue input 16-bit" objectType="8" subNumber="3" uniqueIDRef="P_ANALOG">
            <CANopenSubObject subIndex="00" name="Number of analogue inputs" objectType="7" accessType="const" defaultValue="2"/>
            <CANopenSubObject subIndex="01" name="Analogue input 1" objectType="7" accessType="ro" PDOmapping="TPDO" lowLimit="-27648" highLimit="27648"/>
            <CANopenSubObject subIndex="02" name="Analogue input 2" objectType="7" accessType="ro" PDOmapping="TPDO" lowLimit="0x9400" highLimit="0x6C00"/>
          </CANopenObject>
        </CANopenObjectList>
        <dummyUsage>
          <dummy entry="Dummy0005=1"/>
          <dummy entry="Dummy0006=1"/>
          <dummy entry="Dummy0007=0"/>
        </dummyUsage>
      </ApplicationLayers>
      <TransportLayers>
        <PhysicalLayer>
          <baudRate>
            <supportedBaudRate value="125 Kbps"/>
            <supportedBaudRate value="250 Kbps"/>
            <supportedBaudRate value="500 Kbps"/>
            <supportedBaudRate value="1000 Kbps"/>
          </baudRate>
        </PhysicalLayer>
      </TransportLayers>
      <NetworkManagement>
        <CANopenGeneralFeatures granularity="8" nrOfRxPDO="1" nrOfTxPDO="1" bootUpSlave="true" layerSettingServiceSlave="false"/>
        <deviceCommissioning nodeID="5" nodeName="conveyor inputs" actualBaudRate="250 Kbps" networkNumber="1"
            networkName="conveyor" CANopenManager="false"/>
      </NetworkManagement>
    </ProfileBody>
  </ISO15745Profile>
</ISO15745ProfileContainer>
