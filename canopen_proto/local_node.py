"""`LocalNode`: a device. It has a dictionary, its own values, and every service that the dictionary describes.

It is a group of machines: NMT slave, SDO servers and clients, heartbeat producer and consumers or guarding, SYNC, TIME, EMCY,
PDOs, and perhaps an `application` (such as a simulated drive). All of them share the memory `values`.

**A write is checked, stored, and takes effect.** The SDO servers call `check_write` and `write`. If type, access and limits are
right, the owner of the object checks the value, and may refuse it with an abort code. Each communication object has one `Owner`
(owner.py): the PDO parameters (pdo/parameters.py), the storage of parameters (parameter_storage.py), the records of SDO channels
(sdo/channels.py), or communication_objects.py for the rest. All other objects belong to the application. Then the value is
stored, and its owner acts on it before the client gets its answer. If the application cannot, the value from before is put back,
and the client gets the abort code, as after a refusal.

The reactions:

    NMT state changes          services start or stop (`nmt.SERVICES`); the heartbeat shows the new state; the application is told
    NMT reset                  values (all, or 0x1000 to 0x1FFF) as at power-on, errors (all, or those below) cleared; boot-up
    "save", "load" written     ObjectAccessPending; once the host has stored: other values at power-on (`storage`)
    SYNC received or sent      in this order: TPDOs are sent, held RPDOs take effect, the application makes its step
    PDO received               the application is told of each value
    heartbeat of 0x1016 lost   EMCY 0x8130 for that node; the application (0x6007); behaviour of 0x1029, by default
                               pre-operational
    life guarding lost         the same, without a node-ID
    PDO too short, or overdue  EMCY 0x8210, 0x8250, until a good one comes; 0x8230 for an MPDO whose object we lack; the
                               application is told of an overdue one
    PDO too long               it is used; EMCY 0x8220 if that is wanted (`optional_emcy`); likewise 0x8240 for a SYNC's length
    remote request of a TPDO   the application updates its values, and the TPDO is sent
    an error of the device     EMCY, 0x1001 and 0x1003; behaviour of 0x1029 if it has the class of the error
    CAN was off the bus        behaviour of 0x1029:01, and EMCY 0x8140 when it is back

**A device without a node-ID** (UNCONFIGURED, 255) has nothing but its LSS slave, and stays in INITIALISING until a master gives
it one. It then boots as after a reset of the communication; values that depend on the node-ID follow it, stored ones too.

Source: CiA 301 v4.2.0, 7.3.2 and 7.5.2.
"""

from __future__ import annotations

import datetime
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortCode, text_of
from canopen_proto.application import Application, PlainMemory
from canopen_proto.communication_errors import (
    COMMUNICATION_ERROR_BIT,
    EMCY_COMMUNICATION,
    EMCY_CONNECTION_LOST,
    EMCY_SYNC_LENGTH,
    CommunicationErrors,
)
from canopen_proto.communication_objects import COB_ID_TIME, ERROR_REGISTER, CommunicationObjects
from canopen_proto.compiling import mypyc_attr
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Direction, ObjectDictionary, Values, Variable
from canopen_proto.emcy import EmcySent
from canopen_proto.frame import KEY_REMOTE, MAX_NODE_ID, REMOTE, Frame, RoutingKey
from canopen_proto.group import Group
from canopen_proto.guarding import LifeGuardingLost, LifeGuardingRecovered
from canopen_proto.heartbeat import HeartbeatLost, HeartbeatRecovered
from canopen_proto.indices import COMMUNICATION_AREA
from canopen_proto.lss.messages import UNCONFIGURED, LssAddress, LssConfiguration
from canopen_proto.lss.slave import LssResetNeeded, LssSilenceBegan, LssSilenceEnded, LssSlave, address_of
from canopen_proto.machine import LocalProtocolError, Machine, Outbox, Time, check_node_id
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import SERVICES, NmtCommand, NmtResetRequested, NmtSlave, NmtState, NmtStateChanged, Service
from canopen_proto.owner import Owner
from canopen_proto.parameter_storage import ALL_INDICES, SIGNATURES, ParameterStorage
from canopen_proto.pdo.consumer import (
    EMCY_PDO_LENGTH_EXCEEDED,
    EMCY_PDO_NOT_PROCESSED,
    PdoLengthUnexpected,
    PdoOverdue,
    PdoReceived,
)
from canopen_proto.pdo.multiplexed import MpdoNotProcessed, MpdoReceived
from canopen_proto.pdo.parameters import DevicePdos
from canopen_proto.pdo.settings import place_of
from canopen_proto.sdo.channels import SdoChannels
from canopen_proto.sdo.client import SdoClient
from canopen_proto.sdo.server import PENDING, ObjectAccessPending, ObjectWritten, Pending, SdoServerAborted
from canopen_proto.sdo.store import ValuesStore
from canopen_proto.sync import SyncLengthUnexpected, SyncReceived, SyncSent

COMMUNICATION_ERROR: Final = 1
"""Subindex of 0x1029 for CAN off the bus, a lost heartbeat and life guarding. The device profile defines the next ones: CiA 401
has output errors (2) and input errors (3). CiA 301 v4.2.0, 7.5.2.32"""
EMCY_BUS_OFF_RECOVERED: Final = 0x8140


@mypyc_attr(allow_interpreted_subclasses=True)
class LocalNode(Group):
    """A device on the bus; see this module's text. It sends nothing before `boot`."""

    def __init__(self, out: Outbox, node_id: int, dictionary: ObjectDictionary) -> None:
        """node_id: 1..127, or UNCONFIGURED. dictionary: the device's objects; its PDO and communication objects decide which
        services run."""
        super().__init__(out)
        self.node_id = node_id
        self.lss = LssSlave(self.inner, LssAddress(0, 0, 0, 0), LssConfiguration(node_id))
        if node_id == UNCONFIGURED:
            node_id = MAX_NODE_ID  # its parts are silent until it has one of its own
        self.values = Values(dictionary, check_node_id(node_id))
        self.lss.address = address_of(self.values)
        self.application: Application = PlainMemory()
        self.storage = ParameterStorage(self.values)
        self.nmt = NmtSlave(self.inner, node_id)
        self._store = ValuesStore(self.values)
        self.pdos = DevicePdos(self.inner, node_id, self.values)
        self.optional_emcy: set[int] = set()
        """The EMCY codes to send among those that the standard leaves open: 0x8220 (a PDO too long), 0x8240 (SYNC length)."""
        self.deferred: set[int] = set()
        """The indices that only the host can serve: ObjectAccessPending is reported, and the host answers by `complete`."""
        self.in_pieces: set[int] = set()
        """Those of `deferred` that the host takes piece by piece (`ObjectAccessPending.more`), such as a DOMAIN of firmware."""
        self._members.attach(self.nmt)
        self._members.attach(self.lss)
        self.channels = SdoChannels(self.inner, node_id, self.values, self, self._members)
        self.sdo = self.channels.servers[1]
        self.communication = CommunicationObjects(self.inner, node_id, self.values, self._members)
        self._errors = CommunicationErrors(self.communication.emcy)
        parts: tuple[Owner, ...] = (self.pdos, self.storage, self.channels, self.communication)
        indices = [index for index in dictionary.objects if index in COMMUNICATION_AREA]
        self._owners = {index: next(part for part in parts if part.owns(index)) for index in indices}
        for machine in self.pdos.machines:
            self._members.attach(machine)
        self._reactions.update(
            {
                NmtStateChanged: self._on_state,
                NmtResetRequested: self._on_reset,
                EmcySent: self._on_emcy_sent,
                ObjectAccessPending: self._on_pending,
                ObjectWritten: self._on_written,
                SdoServerAborted: self._on_aborted,
                SyncReceived: self._on_sync,
                SyncSent: self._on_sync,
                PdoReceived: self._on_pdo,
                PdoLengthUnexpected: self._on_length_error,
                PdoOverdue: self._on_pdo_overdue,
                MpdoReceived: self._on_mpdo,
                MpdoNotProcessed: self._on_pdo_error,
                SyncLengthUnexpected: self._on_sync_length,
                HeartbeatLost: self._on_heartbeat_lost,
                HeartbeatRecovered: self._on_heartbeat_recovered,
                LifeGuardingLost: self._on_life_guarding_lost,
                LifeGuardingRecovered: self._on_life_guarding_recovered,
                LssResetNeeded: self._on_lss_reset,
                LssSilenceBegan: self._on_silence,
                LssSilenceEnded: self._on_silence,
            }
        )

    @property
    def dictionary(self) -> ObjectDictionary:
        """The description of the device."""
        return self.values.dictionary

    def set_application(self, application: Application) -> None:
        """Let an application do the device's own work, before `boot`. It was made with `inner`; if it is a Machine, time drives
        it."""
        self.application = application
        if isinstance(application, Machine):
            self._members.attach(application)

    @property
    def state(self) -> NmtState:
        """The node's NMT state."""
        return self.nmt.state

    def boot(self, now: Time) -> None:
        """Power on: send the boot-up frame and enter pre-operational. Raises LocalProtocolError if the node is on already.

        The application starts first. CiA 301 v4.2.0, 7.3.2.2.1 and 7.2.8.3.3
        """
        with self._settling(now):
            if self.state is NmtState.INITIALISING:  # else boot does nothing, and the application goes on
                self.application.reset(now)
            self._start(now)

    def take_stored(self, stored: LssConfiguration) -> None:
        """Take the node-ID and bit rate that LSS has stored, before `boot`."""
        self.lss.load(stored)
        if stored.node_id != self.node_id:
            self._take_node_id(stored.node_id)

    def execute(self, command: NmtCommand, now: Time) -> None:
        """Execute an NMT command for a reason of the device's own: a device that starts itself (0x1F80)."""
        with self._settling(now):
            self.nmt.execute(command, now)

    def set_value(self, index: int, subindex: int, value: Value, now: Time) -> None:
        """Set a value as the device itself, whatever the access right. Triggers the event-driven TPDOs that carry it.

        A communication object takes effect as after a client's write. Raises ObjectNotFoundError, ValueRangeError if the object
        cannot hold the value, LocalProtocolError if a communication object refuses it. The object is named by index (0..0xFFFF)
        and subindex (0..0xFF).
        """
        variable = self.dictionary.variable((index, subindex))
        variable.encode(value)
        variable.check_limits(value)
        if index not in COMMUNICATION_AREA:
            self.values.store[variable.mux] = value
            self.pdos.trigger(variable.mux, now)
            return
        refusal = self._refusal(index, subindex, value)
        if refusal is not None:
            raise LocalProtocolError(f"node {self.node_id}: {variable.label} = {value!r}: {text_of(refusal)}")
        with self._settling(now):
            self.values.store[variable.mux] = value
            self._obey(index, subindex, now)
            self.pdos.trigger(variable.mux, now)

    def raise_error(
        self, code: int, register_bits: int, vendor_data: bytes, now: Time, *, error_class: int | None = None
    ) -> None:
        """Report an error of the device: EMCY, 0x1001, 0x1003. See EmcyProducer.raise_error. code: 0x0100..0xFFFF. register_bits:
        of 0x1001. vendor_data: up to 5 bytes.

        error_class: the subindex of 0x1029 with the NMT state that follows (1: communication error; 2 and on: of the device
        profile, such as an output error). Without that object, the node becomes pre-operational. None = the state stays.
        """
        with self._settling(now):
            self.communication.emcy.raise_error(code, register_bits, vendor_data, now)
            if error_class is not None:
                self._behave(error_class, now)

    def clear_error(self, code: int, now: Time) -> None:
        """Report that an error is gone. See EmcyProducer.clear. code: as it was raised."""
        with self._settling(now):
            self.communication.emcy.clear(code, now)

    def bus_off(self, now: Time) -> None:
        """Report that the CAN controller went off the bus: the application is told, and the node behaves as 0x1029:01 says."""
        with self._settling(now):
            self._on_connection_lost(now)

    def bus_recovered(self, now: Time) -> None:
        """Report that the CAN controller is back: sends EMCY 0x8140, then the EMCY that ends it. CiA 301 v4.2.0, 7.2.7.1"""
        with self._settling(now):
            self.communication.emcy.raise_error(EMCY_BUS_OFF_RECOVERED, COMMUNICATION_ERROR_BIT, b"", now)
            self.communication.emcy.clear(EMCY_BUS_OFF_RECOVERED, now)

    def send_mpdo(self, number: int, node_id: int, index: int, subindex: int, data: bytes, now: Time) -> bool:
        """Write an object of another node, or of all (0), by TPDO `number`, an MPDO. See MpdoProducer.send_to. index, subindex:
        of the consumer's object. data: 1 to 4 bytes."""
        return self.pdos.mpdo_producer.send_to(number, node_id, index, subindex, data, now)

    def send_time(self, time: datetime.datetime, now: Time) -> None:
        """Send the time of day to the bus. Event: TimeSent. See TimeProducer.send.

        Raises LocalProtocolError if the device is no TIME producer (bit 30 of 0x1012), or its NMT state forbids TIME.
        """
        if not self.communication.may_send_time:
            cob_id = self.values.store.get(COB_ID_TIME, "not there")
            raise LocalProtocolError(f"node {self.node_id} cannot send TIME: it is {self.state.name}, its 0x1012 is {cob_id!r}")
        self.communication.time_producer.send(time, now)

    def complete(
        self, access_id: int, result: bytes | AbortCode | None, now: Time, *, more: bool = False, size: int | None = None
    ) -> None:
        """Give the host's answer to ObjectAccessPending. See SdoServer.complete. access_id: the event's. result: the bytes that
        were read, None for a write that is done, or an abort code. more, size: for an answer in pieces."""
        with self._settling(now):
            self.channels.complete(access_id, result, now, more=more, size=size)

    def sdo_client(self, number: int) -> SdoClient:
        """Return the SDO client of record 0x1280 + number - 1, with which the device accesses another. See SdoChannels.client."""
        return self.channels.client(number)

    # ---- what the SDO servers ask: they serve this node ----

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        """Return an object's present bytes; an abort code if it cannot be read; PENDING if the host has to answer."""
        if index in self.deferred:
            variable = self._store.readable(index, subindex)
            return variable if isinstance(variable, AbortCode) else PENDING
        owner = self._owners.get(index)
        refusal = self.application.refresh(now, index, subindex) if owner is None else owner.refresh(index, subindex)
        return self._store.read(index, subindex, now) if refusal is None else refusal

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | Pending | None:
        """Return the abort code that forbids a download (access, announced length), PENDING if the host takes pieces, or None.
        size: bytes, None if the client has not announced them."""
        refusal = self._store.check_write(index, subindex, size)
        if refusal is not None or index not in self.in_pieces:
            return refusal
        return AbortCode.DEVICE_STATE if self.channels.host_takes(index, subindex) else PENDING  # the pieces of two would mix

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        """Check the value, store it and let it take effect; see this module's text. data: the bytes from the wire, little-endian.
        Returns None, the abort code of a refusal, or PENDING if the host takes the write."""
        variable = self._store.writable(index, subindex)
        if not isinstance(variable, Variable):  # of an enumeration `isinstance` takes four times as long
            return variable
        value = self._store.decode(variable, data)
        if type(value) is AbortCode:
            return value
        if index in self.deferred:
            is_taken = index in self.in_pieces and self.channels.host_takes(index, subindex)
            return AbortCode.DEVICE_STATE if is_taken else PENDING
        return self._take(variable, value, now)

    def take_write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | None:
        """Store a write to a `deferred` object and let it take effect, as for any other object.

        data: of ObjectAccessPending. Returns the argument for `complete`: None, or an abort code. Raises ObjectNotFoundError.
        """
        variable = self.dictionary.variable((index, subindex))
        value = self._store.decode(variable, data)
        if isinstance(value, AbortCode):
            return value
        with self._settling(now):
            refusal = self._take(variable, value, now)
        return AbortCode.CANNOT_TRANSFER if isinstance(refusal, Pending) else refusal  # storing is the host's own

    def _take(self, variable: Variable, value: Value, now: Time) -> AbortCode | Pending | None:
        """Let the owner of an object check the value, store it, and let the owner act on it."""
        index, subindex, which, store = variable.index, variable.subindex, variable.mux, self.values.store
        owner = self._owners.get(index)
        refusal = (self.application if owner is None else owner).check_write(index, subindex, value)
        if refusal is not None:
            return refusal
        if owner is self.storage:  # one at a time: each takes the values of its moment
            return AbortCode.DEVICE_STATE if any(map(self.channels.host_takes, SIGNATURES)) else PENDING
        before = store[which]
        store[which] = value
        if owner is None:
            failure = self.application.written(index, subindex, now)
            if failure is not None:
                store[which] = before
                return failure
        elif owner is not self.channels:  # else `_on_written` does: the write may close its own channel
            self._obey(index, subindex, now)
        if before != value:
            self.storage.changed(variable)
        self.pdos.trigger(which, now)
        return None

    def _refusal(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """Return the abort code with which the owner of an object refuses a value of the right type and limits, or None."""
        owner = self._owners.get(index)
        return (self.application if owner is None else owner).check_write(index, subindex, value)

    def _obey(self, index: int, subindex: int, now: Time) -> None:
        """Let the owner of an object act on the stored value."""
        owner = self._owners.get(index)
        if owner is None:
            self.application.written(index, subindex, now)
            return
        owner.apply(index, subindex, now)
        place = place_of(index)
        if place is not None and place.direction is Direction.RPDO:
            self._errors.rpdo_good(place.number, now)  # it is another PDO from now on
        for node_id in self._errors.lost_nodes.difference(self.communication.monitors):
            self._errors.node_back(node_id, now)  # the write ended its monitoring
        if not self.communication.guarding.lost:
            self._errors.life_guarding_back(now)

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.flags & REMOTE:
            self._refresh(now)  # a TPDO may be asked for
        super().receive(frame, now)

    def receiver_of(self, key: RoutingKey) -> Machine:
        """Return the entrance for a data frame: this class's own `receive` wants remote frames only. key: the frame's routing
        key."""
        return self if key & KEY_REMOTE or type(self).receive is not LocalNode.receive else self._entrance(key)

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        self._refresh(now)  # an event timer may send what the application shows
        super().handle_timeout(now)

    def _refresh(self, now: Time) -> None:
        with self._settling(now):
            self.application.refresh(now)

    def _start(self, now: Time) -> None:
        if not self.lss.is_configured:
            self.communication.stop_monitoring()
            return
        self.nmt.boot(now)
        self.pdos.reload(now)
        self.communication.reload(now)
        self.channels.reload(now)

    def _take_node_id(self, node_id: int) -> None:
        """Be another node: a reset with another pending node-ID."""
        self.node_id = node_id
        if node_id == UNCONFIGURED:
            return
        self.storage.follow(self.values.set_node_id(node_id))
        self.nmt.node_id = node_id
        for part in (self.pdos, self.channels, self.communication):
            part.set_node_id(node_id)

    def _on_lss_reset(self, request: LssResetNeeded, now: Time) -> None:
        self._on_reset(NmtResetRequested(self.lss.pending.node_id, NmtCommand.RESET_COMMUNICATION), now)

    def _on_silence(self, report: LssSilenceBegan | LssSilenceEnded, now: Time) -> None:
        """Have no services while the bit rate changes."""
        self._serve(NmtState.INITIALISING if self.lss.is_silent else self.state, now)

    def _on_reset(self, request: NmtResetRequested, now: Time) -> None:
        emcy = self.communication.emcy
        self.lss.reset(request.command, now)
        if self.lss.active.node_id != self.node_id:
            self._take_node_id(self.lss.active.node_id)
        if request.command is NmtCommand.RESET_NODE:
            self.values.reset()
            self.storage.put_back(ALL_INDICES)
            emcy.reset()
            self.application.reset(now)
        else:
            # A communication reset puts back this area only. CiA 301 v4.2.0, 7.3.2.2.1
            self.values.reset(COMMUNICATION_AREA.start, COMMUNICATION_AREA.stop - 1)
            self.storage.put_back(COMMUNICATION_AREA)
            emcy.clear_history()
        self._errors.clear(now)
        self._start(now)

    def _on_pending(self, report: ObjectAccessPending, now: Time) -> None:
        if report.index in SIGNATURES and report.index not in self.deferred:
            self.storage.begin(report.index, report.subindex)

    def _on_written(self, report: ObjectWritten, now: Time) -> None:
        owner = self._owners.get(report.index)
        if owner is self.storage:
            self.storage.commit(report.index, report.subindex)
        elif owner is self.channels:
            self._obey(report.index, report.subindex, now)

    def _on_aborted(self, report: SdoServerAborted, now: Time) -> None:
        if report.index in SIGNATURES and not self.channels.host_takes(report.index, report.subindex):
            self.storage.forget(report.index, report.subindex)

    def _on_state(self, change: NmtStateChanged, now: Time) -> None:
        self._serve(change.state, now)
        # In pre-operational a device may be commanded by SDO: in STOPPED nobody can, and a reset ends its watch over the master
        is_cut_off = change.previous is NmtState.PRE_OPERATIONAL and change.state is not NmtState.OPERATIONAL
        if is_cut_off or change.previous is NmtState.OPERATIONAL:
            self.application.connection_lost(now, EMCY_COMMUNICATION)

    def _serve(self, state: NmtState, now: Time) -> None:
        """Have the services of an NMT state, and no others."""
        services = SERVICES[state]
        self.channels.set_enabled(Service.SDO in services, now)
        self.communication.set_state(state, now)
        self.application.refresh(now)
        self.pdos.set_enabled(Service.PDO in services, now)

    def _on_sync(self, sync: SyncReceived | SyncSent, now: Time) -> None:
        if not self.nmt.allows(Service.SYNC):
            return
        if self._errors.sync_length:
            self._errors.sync_good(now)
        self.communication.refresh(indices.ERROR_REGISTER, 0)
        self.application.refresh(now)
        mark = len(self.inner.events)
        self.pdos.on_sync(sync.counter, now)
        # Before the application's step and not later by `_settle`: the PDOs for this SYNC take effect at this SYNC.
        for report in self.inner.events[mark:]:
            if isinstance(report, PdoReceived):
                self._on_values(report, now)
        self.application.on_sync(now)

    def _on_pdo(self, report: PdoReceived, now: Time) -> None:
        if not self.pdos.consumers[report.number].synchronous:
            self._on_values(report, now)

    def _on_values(self, report: PdoReceived, now: Time) -> None:
        if report.number in self._errors.rpdos:
            is_too_long = len(report.data) > report.mapping.byte_length
            self._errors.rpdo_good(report.number, now, but=EMCY_PDO_LENGTH_EXCEEDED if is_too_long else None)
        for entry in report.mapping.components:
            self.application.written(entry.index, entry.subindex, now)
            self.pdos.trigger(entry.mux, now)

    def _on_mpdo(self, report: MpdoReceived, now: Time) -> None:
        self._errors.rpdo_good(report.number, now)
        self.application.written(report.index, report.subindex, now)
        self.pdos.trigger(mux(report.index, report.subindex), now)

    def _on_emcy_sent(self, sent: EmcySent, now: Time) -> None:
        self.communication.refresh(indices.ERROR_REGISTER, 0)
        self.pdos.trigger(ERROR_REGISTER, now)

    def _on_length_error(self, report: PdoLengthUnexpected, now: Time) -> None:
        if report.emcy_code == EMCY_PDO_NOT_PROCESSED or report.emcy_code in self.optional_emcy:
            self._on_pdo_error(report, now)

    def _on_pdo_error(self, report: PdoLengthUnexpected | PdoOverdue | MpdoNotProcessed, now: Time) -> None:
        self._errors.rpdo_failed(report.number, report.emcy_code, now)

    def _on_pdo_overdue(self, report: PdoOverdue, now: Time) -> None:
        """Tell the application, too: "an indication to the local application". CiA 301 v4.2.0, 7.5.2.35, sub 5 (from memory)"""
        self._on_pdo_error(report, now)
        self.application.connection_lost(now, report.emcy_code)

    def _on_sync_length(self, report: SyncLengthUnexpected, now: Time) -> None:
        if EMCY_SYNC_LENGTH in self.optional_emcy and self.nmt.allows(Service.SYNC):
            self._errors.sync_failed(now)

    def _on_heartbeat_lost(self, report: HeartbeatLost, now: Time) -> None:
        self._errors.node_lost(report.node_id, now)
        self._on_connection_lost(now)

    def _on_heartbeat_recovered(self, report: HeartbeatRecovered, now: Time) -> None:
        self._errors.node_back(report.node_id, now)

    def _on_life_guarding_lost(self, report: LifeGuardingLost, now: Time) -> None:
        self._errors.life_guarding_lost(now)
        self._on_connection_lost(now)

    def _on_life_guarding_recovered(self, report: LifeGuardingRecovered, now: Time) -> None:
        self._errors.life_guarding_back(now)

    def _on_connection_lost(self, now: Time) -> None:
        self.application.connection_lost(now, EMCY_CONNECTION_LOST)
        self._behave(COMMUNICATION_ERROR, now)

    def _behave(self, error_class: int, now: Time) -> None:
        """Behave as 0x1029 says: 0 = pre-operational, from operational only; 1 = stay; 2 = stopped. CiA 301 v4.2.0, 7.5.2.32"""
        behaviour = self.values.store.get(mux(indices.ERROR_BEHAVIOR, error_class), 0)
        if behaviour == 0 and self.state is NmtState.OPERATIONAL:
            self.nmt.execute(NmtCommand.ENTER_PRE_OPERATIONAL, now)
        elif behaviour == 2:
            self.nmt.execute(NmtCommand.STOP, now)
