"""Objects of an XDD that leave type, access and values to parameters of the device profile."""

from __future__ import annotations

import pytest

from canopen_data.description import DeviceDescription, FileKind
from canopen_data.xdd.parameters import ELEMENTARY
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Constant
from tests.data.xdd_files import read, var


def of_parameter(inner: str, attributes: str = "", *, types: str = "", more: str = "", mapping: str = "no") -> DeviceDescription:
    """The description of one object with one parameter."""
    process = (
        f"<dataTypeList>{types}</dataTypeList>"
        f'<parameterList><parameter uniqueID="P" {attributes}>{inner}</parameter></parameterList>{more}'
    )
    return read(var(f'PDOmapping="{mapping}" uniqueIDRef="P"'), process)


@pytest.mark.parametrize(("name", "data_type"), [*ELEMENTARY.items()])
def test_elementary_types(name: str, data_type: DataType) -> None:
    description = of_parameter(f"<{name}/>")
    expected = DataType.DOMAIN if name == "BITSTRING" else data_type
    assert not description.findings
    assert description.dictionary.variable("thing").data_type is expected
    assert description.dictionary.objects[0x2000].data_type == expected


def test_bits_with_a_default_are_octets() -> None:
    thing = of_parameter('<BITSTRING/><defaultValue value="01 02"/>').dictionary.variable("thing")
    assert (thing.data_type, thing.default) == (DataType.OCTET_STRING, b"\x01\x02")


@pytest.mark.parametrize(
    ("text", "mapping", "access"),
    [
        ("", "no", Access.RO),
        ('access="const"', "no", Access.CONST),
        ('access="read"', "TPDO", Access.RO),
        ('access="write"', "no", Access.WO),
        ('access="readWrite"', "optional", Access.RW),
        ('access="readWrite"', "TPDO", Access.RWR),
        ('access="readWrite"', "RPDO", Access.RWW),
        ('access="readWriteInput"', "default", Access.RWR),
        ('access="readWriteOutput"', "no", Access.RWW),
    ],
)
def test_access(text: str, mapping: str, access: Access) -> None:
    description = of_parameter("<UINT/>", text, mapping=mapping)
    assert not description.findings
    thing = description.dictionary.variable("thing")
    assert (thing.access, thing.pdo_mappable) == (access, mapping != "no")


@pytest.mark.parametrize(("mapping", "access"), [("no", Access.RW), ("TPDO", Access.RWR)])
def test_no_access_is_told(mapping: str, access: Access) -> None:
    description = of_parameter("<UINT/>", 'access="noAccess"', mapping=mapping)
    assert [(each.code, each.severity) for each in description.findings] == [("access", "warning")]
    assert description.dictionary.variable("thing").access is access


def test_values_limits_texts_and_units() -> None:
    description = of_parameter(
        """<label lang="de">Ding</label><label lang="en-us">Thing</label><description>what it is</description><INT/>
        <denotation><label lang="en">left</label></denotation><actualValue value="-3"/><defaultValue value="0x7F"/>
        <allowedValues><range><minValue value="-100"/><maxValue value="100"/></range></allowedValues>
        <unit multiplier="0.5"><label lang="en">mm</label></unit>""",
        'multiplier="0.1"',
    )
    thing = description.dictionary.variable("thing")
    assert not description.findings
    assert (thing.default, thing.configured, thing.low_limit, thing.high_limit) == (127, -3, -100, 100)
    assert (thing.description, thing.denotation, thing.unit, thing.factor) == ("what it is", "left", "mm", 0.05)
    assert description.kind is FileKind.XDC
    assert description.place_of(0x2000, 0, "HighLimit")[0] == 4
    assert description.place_of(0x2000, 0, "AccessType") == (2, 129), "the parameter says none: where it begins"


def test_an_object_goes_before_its_parameter() -> None:
    process = (
        '<parameterList><parameter uniqueID="P"><label>other</label><UINT/><defaultValue value="1"/></parameter></parameterList>'
    )
    own = 'uniqueIDRef="P" dataType="0005" accessType="wo" defaultValue="2"'
    thing = read(var(own), process).dictionary.variable("thing")
    assert (thing.data_type, thing.access, thing.default) == (DataType.UNSIGNED8, Access.WO, 2)
    assert read(var(own, name=""), process).dictionary.variable(0x2000).name == "other"


@pytest.mark.parametrize(
    ("attributes", "code"),
    [('multiplier="x"', "number"), ('multiplier="0"', "number"), ('multiplier="inf"', "number"), ('offset="5"', "offset")],
)
def test_physical_values_that_cannot_be(attributes: str, code: str) -> None:
    description = of_parameter("<UINT/>", attributes)
    assert [each.code for each in description.findings] == [code]
    assert description.dictionary.variable("thing").factor == 1.0


NAMED = '<value value="{}"><label lang="en">{}</label></value>'


def test_named_values_are_constants() -> None:
    values = NAMED.format("1", "on") + NAMED.format("0xFF", "fault") + NAMED.format("1", "on") + '<value value="3"/>'
    description = of_parameter(f"<SINT/><allowedValues>{values}</allowedValues>")
    assert not description.findings
    dictionary = description.dictionary
    assert dictionary.constants_of("thing") == (Constant("on", 0xFF, 1), Constant("fault", 0xFF, 0xFF))
    assert dictionary.constant_value("thing", "fault") == -1
    assert dictionary.variable("thing").low_limit is None
    wrong = of_parameter(f"<SINT/><allowedValues>{NAMED.format('x', 'on')}</allowedValues>")
    assert [each.code for each in wrong.findings] == ["value"]
    assert not of_parameter(f"<STRING/><allowedValues>{NAMED.format('x', 'on')}</allowedValues>").dictionary.constants_of("thing")


TYPES = """<enum uniqueID="E"><enumValue value="7"><label>seven</label></enumValue><dataTypeIDRef uniqueIDRef="D"/></enum>
<derived uniqueID="D"><USINT/></derived><derived uniqueID="C"><dataTypeIDRef uniqueIDRef="C"/></derived><derived uniqueID="N"/>"""


def test_types_by_reference() -> None:
    description = of_parameter('<dataTypeIDRef uniqueIDRef="E"/>', types=TYPES)
    assert not description.findings
    assert description.dictionary.variable("thing").data_type is DataType.UNSIGNED8
    assert description.dictionary.names_of("thing", 7) == ("seven",)


@pytest.mark.parametrize(
    ("reference", "codes"), [("C", ["reference", "data-type"]), ("Z", ["reference", "data-type"]), ("N", ["data-type"])]
)
def test_types_that_lead_nowhere(reference: str, codes: list[str]) -> None:
    description = of_parameter(f'<dataTypeIDRef uniqueIDRef="{reference}"/>', types=TYPES)
    assert [each.code for each in description.findings] == codes


def test_a_template_says_what_a_parameter_does_not() -> None:
    templates = """<templateList><parameterTemplate uniqueID="T" access="readWrite" multiplier="3" templateIDRef="T"><UINT/>
    <defaultValue value="5"/><unit><label>V</label></unit></parameterTemplate></templateList>"""
    description = of_parameter('<defaultValue value="6"/>', 'templateIDRef="T"', more=templates)
    assert not description.findings
    thing = description.dictionary.variable("thing")
    assert (thing.data_type, thing.access, thing.default, thing.unit, thing.factor) == (
        DataType.UNSIGNED16,
        Access.RW,
        6,
        "V",
        3.0,
    )
    own = of_parameter("<SINT/>", 'templateIDRef="T" multiplier="2"', more=templates).dictionary.variable("thing")
    assert (own.data_type, own.factor) == (DataType.INTEGER8, 2.0)


WHOLE = """<CANopenObject index="2001" name="many" objectType="{}" uniqueIDRef="W">
{}</CANopenObject>"""
SUB = '<CANopenSubObject subIndex="{0:02X}" name="s{0}" objectType="7" accessType="ro"/>\n'


def members(kind: str, object_type: int, subindices: tuple[int, ...]) -> tuple[DeviceDescription, list[DataType]]:
    """The types of sub-objects that only the type of the whole knows."""
    description = read(
        WHOLE.format(object_type, "".join(SUB.format(each) for each in subindices)),
        f'<dataTypeList>{kind}</dataTypeList><parameterList><parameter uniqueID="W"><dataTypeIDRef uniqueIDRef="A"/></parameter>'
        "</parameterList>",
    )
    return description, [each.data_type for each in description.dictionary]


def test_sub_objects_of_an_array() -> None:
    description, types = members('<array uniqueID="A"><subrange lowerLimit="0" upperLimit="2"/><REAL/></array>', 8, (0, 1, 5))
    assert not description.findings
    assert types == [DataType.UNSIGNED8, DataType.REAL32, DataType.REAL32]
    assert description.dictionary.objects[0x2001].data_type == DataType.REAL32


STRUCT = """<struct uniqueID="A"><varDeclaration><USINT/></varDeclaration><varDeclaration><INT/></varDeclaration></struct>"""


def test_sub_objects_of_a_structure() -> None:
    description, types = members(STRUCT, 9, (0, 5))
    assert not description.findings
    assert types == [DataType.UNSIGNED8, DataType.INTEGER16]
    description, types = members(STRUCT, 9, (0, 1, 5))
    assert [each.code for each in description.findings] == ["data-type"] * 3
