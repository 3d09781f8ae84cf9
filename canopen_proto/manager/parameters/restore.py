"""Set a node to given values: the restore of a backup, the download of a DCF.

Two procedures. `plan_restore` only reads: it compares the node's values with the wanted ones, and returns the writes that change
the one to the other, in the order of download_order.py (services off, PDOs first; communication; application; services on again).
`restore` carries a plan out:

    1. find out in which NMT state the node is, by its heartbeat
    2. command Pre-operational: no PDO is active while the settings change
    3. write one object after the other, each read back if asked for
    4. store (0x1010:01 = "save"), if asked for
    5. command the NMT state of 1. again, if all went well

**If a step fails**, or the procedure is cancelled, it stops there. Nothing half done becomes active: the node stays
Pre-operational, and the PDOs that were to be changed are still destroyed, since they are created last. (Pre-operational is
commanded once more: the first command may have been lost, or another master may have started the node meanwhile.) `Restoration`
says what was written, what was not, and which write is in doubt. A write without an answer may have been executed; it is not sent
again. The caller may plan and restore once more: values that are right by then are not written.

Only the node's heartbeat confirms an NMT command. If the node has one, it is awaited, and a command that the node does not follow
is repeated. If it has none, the state before is not known, and the node stays Pre-operational.

Only values that differ are written, unless asked otherwise: this means fewer writes and fewer refusals, and an object that a
device refuses although it already has the value does no harm. The mapping of a PDO is written as a whole, or not at all. An
object that is readable but could not be read is left alone, and so is all that depends on it (the records of a PDO whose COB-ID
could not be read): a failed read says nothing about what the object holds.

Source: CiA 302-3 (configuration of a device); CiA 301 v4.2.0, 7.5.2.13, 7.5.2.36, 7.3.2.2.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from canopen_proto import indices
from canopen_proto.datatypes import DataType, Value, ValueRangeError
from canopen_proto.dictionary.download_order import download_order, switches_of
from canopen_proto.dictionary.model import ObjectDictionary, Variable
from canopen_proto.dictionary.roles import Role, roles_in
from canopen_proto.heartbeat import HeartbeatReceived
from canopen_proto.machine import MILLISECOND, SECOND, Event, LocalProtocolError, Time
from canopen_proto.manager.parameters.backup import Backup, Reading, ReadResult, back_up, same_value, upload_again
from canopen_proto.multiplexer import Mux, index_of, mux, split_mux
from canopen_proto.nmt import NmtCommand, NmtMaster, NmtState
from canopen_proto.parameter_storage import ON_COMMAND, SIGNATURES, STORE
from canopen_proto.procedures.objects import ABSENT, unless_refused
from canopen_proto.procedures.steps import (
    Cancelled,
    Procedure,
    ProcedureError,
    SdoTransferError,
    StepTimeoutError,
    act,
    download,
    sleep,
    wait_for_event,
)
from canopen_proto.remote_node import NMT_REACTION_TIME, RemoteNode
from canopen_proto.sdo.client import Block

STORE_TIMEOUT: Final = 10 * SECOND
"""For the answer to "save": devices write flash memory before they answer, some for seconds."""
NMT_TRIES: Final = 3
"""How often an NMT command is sent, at most, until the heartbeat shows the state."""
HEARTBEAT_MARGIN: Final = 100 * MILLISECOND
"""A heartbeat counts as missing after one and a half heartbeat times plus this."""
MAX_HEARTBEAT_WAIT: Final = 10 * SECOND
"""For one heartbeat; 0x1017 allows 65 s, which nobody uses."""

_Match: TypeAlias = Callable[[HeartbeatReceived], bool]
_PDO_COB_IDS: Final = frozenset(
    mux(index, 1)
    for index in (
        *indices.RPDO_COMMUNICATION,
        *indices.TPDO_COMMUNICATION,
    )
)
_TO_MAPPING: Final = 0x200
NOT_READ: Final = "could not be read"
"""Why a plan leaves an object out: its present value is not known."""
_MAPPINGS: Final = (indices.RPDO_MAPPINGS, indices.TPDO_MAPPINGS)
_COMMAND_TO: Final = {
    NmtState.OPERATIONAL: NmtCommand.START,
    NmtState.STOPPED: NmtCommand.STOP,
    NmtState.PRE_OPERATIONAL: NmtCommand.ENTER_PRE_OPERATIONAL,
}
_FAILURES: Final = (ProcedureError, LocalProtocolError)
"""How a step can fail: the transfer fails, or the client refuses it because its queue is full."""


@dataclass(frozen=True, slots=True)
class PlannedWrite:
    """One write. data: the bytes to write; before: the object's bytes just before it, None if not known. An object may be written
    twice: a COB-ID first invalid, later valid."""

    variable: Variable
    data: bytes
    before: bytes | None

    @property
    def value(self) -> Value:
        return self.variable.decode(self.data)

    @property
    def value_before(self) -> Value | None:
        """The value before the write; None if it is not known."""
        return None if self.before is None else self.variable.decode(self.before)


@dataclass(frozen=True, slots=True)
class RestorePlan:
    """The writes for a node, in order. left_out: why a value is not written, by mux. equal: the number of objects that have their
    value already. standing: the node's values before, by mux. unread: muxes that should have been read and could not be. boots:
    how often the node had booted when it was read (`RemoteNode.boots`): a plan holds until it boots again; None: for ever."""

    node_id: int
    writes: tuple[PlannedWrite, ...]
    left_out: Mapping[Mux, str] = field(default_factory=dict)
    equal: int = 0
    standing: Mapping[Mux, Value] = field(default_factory=dict)
    unread: frozenset[Mux] = frozenset()
    boots: int | None = None


@dataclass(slots=True)
class Restoration:
    """The progress of a restore. It may be read while the restore runs, and after a failure or a cancel.

    written: the number of writes that were confirmed. in_doubt: the write that got no answer and may have been executed, or None.
    state_before: the node's NMT state at the start, None if it was not known. state: the state that was commanded last (None:
    none yet). stored: whether "save" was confirmed. store_in_doubt: it was not, but may have been executed. is_done: all is well.
    """

    plan: RestorePlan
    written: int = 0
    in_doubt: PlannedWrite | None = None
    state_before: NmtState | None = None
    state: NmtState | None = None
    stored: bool = False
    store_in_doubt: bool = False
    is_done: bool = False

    @property
    def done(self) -> tuple[PlannedWrite, ...]:
        """The writes that were confirmed."""
        return self.plan.writes[: self.written]

    @property
    def open(self) -> tuple[PlannedWrite, ...]:
        """The writes that were not confirmed: refused, in doubt, or not sent."""
        return self.plan.writes[self.written :]

    @property
    def pdos_off(self) -> tuple[Variable, ...]:
        """The COB-IDs of the PDOs that should be valid again, and are not."""
        off = {each.variable.mux for each in self.done if each.variable.mux in _PDO_COB_IDS}
        return tuple(each.variable for each in self.open if each.variable.mux in off)


class RestoreError(ProcedureError):
    """A restore did not come to its end. restoration: its progress. If a step failed, __cause__ is that error. message: for
    people."""

    def __init__(self, message: str, restoration: Restoration) -> None:
        super().__init__(message)
        self.restoration = restoration


class VerifyMismatchError(ProcedureError):
    """An object reads back as something else than was written. write: what was written. shown: the bytes that were read back."""

    def __init__(self, node_id: int, write: PlannedWrite, shown: bytes) -> None:
        super().__init__(f"node {node_id} took {write.data.hex()} for {write.variable.label}, but shows {shown.hex()}")
        self.write = write
        self.shown = shown


class ObjectRestored(Event):
    """One write of a restore was confirmed (and read back, if asked for). done, total: numbers of writes of the plan. data: the
    bytes that were written."""

    __match_args__ = ("node_id", "index", "subindex", "data", "done", "total")

    def __init__(self, node_id: int, index: int, subindex: int, data: bytes, done: int, total: int) -> None:
        self.node_id = node_id
        self.index = index
        self.subindex = subindex
        self.data = data
        self.done = done
        self.total = total


def plan_restore(
    node: RemoteNode,
    dictionary: ObjectDictionary,
    values: Mapping[Mux, Value],
    *,
    everything: bool = False,
    process_data: bool = False,
    skip: Collection[Mux] = (),
) -> Procedure[RestorePlan]:
    """Read the node and return the writes that give it these values, by mux of the dictionary. Nothing is written.

    everything: also write values that it has already, but not objects that could not be read. process_data: also write set-points
    and outputs (see dictionary/roles.py). skip: muxes to leave out. An ObjectRead event follows for each read. Raises
    ObjectNotFoundError or ValueRangeError, with nothing sent, for an object or a value that the dictionary does not allow;
    SdoTransferError if the device is gone.
    """
    boots = node.boots
    roles = roles_in(dictionary, values)
    left_out = dict(download_order(dictionary, values, node.node_id).left_out)
    left_out.update({key: "skipped" for key in skip if key in values})
    for key in values:
        if roles[key] is Role.PROCESS and not process_data:
            left_out.setdefault(key, "process data")
    wanted = {key: value for key, value in values.items() if key not in left_out}
    backup = yield from back_up(node, dictionary, only=_concerned(dictionary, wanted), domains=True)
    standing = backup.values
    for key in _absent(backup, wanted):
        del wanted[key]
        left_out[key] = "the device does not have it"
    unread = {each.variable.mux for each in backup.readings if _says_nothing(each)}
    for key in _blind(wanted, unread):
        del wanted[key]
        left_out[key] = NOT_READ if key in unread else "what it depends on could not be read"

    def same(key: Mux, value: Value) -> bool:
        return same_value(dictionary.variable(split_mux(key)), standing.get(key), value)

    different = {key for key, value in wanted.items() if everything or not same(key, value)}
    mappings = {index_of(key) for key in different if any(index_of(key) in each for each in _MAPPINGS)}
    different |= {key for key in wanted if index_of(key) in mappings}
    order = download_order(
        dictionary, {key: value for key, value in wanted.items() if key in different}, node.node_id, present=standing
    )
    left_out.update(order.left_out)
    held = {each.variable.mux: each.data for each in backup.readings if each.result is ReadResult.READ}
    writes: list[PlannedWrite] = []
    for index, subindex, data in order.writes:
        variable = dictionary.variable((index, subindex))
        writes.append(PlannedWrite(variable, data, held.get(variable.mux)))
        held[variable.mux] = data
    equal = len(wanted) - len(different)
    return RestorePlan(node.node_id, tuple(writes), left_out, equal, standing, frozenset(unread), boots)


def _concerned(dictionary: ObjectDictionary, wanted: Mapping[Mux, Value]) -> list[Variable]:
    """Return the objects to read: the wanted ones, and those that must be off while these are written."""
    muxes = set(wanted)
    for key in wanted:
        muxes.update(switches_of(key))
        if any(index_of(key) in each for each in _MAPPINGS):
            muxes.add(mux(index_of(key)))
    found = (dictionary.get(*split_mux(key)) for key in sorted(muxes))
    return [each for each in found if each is not None]


def _absent(backup: Backup, wanted: Mapping[Mux, Value]) -> list[Mux]:
    absent = (each.variable.mux for each in backup.readings if each.result is ReadResult.ABSENT)
    return [key for key in absent if key in wanted]


def _says_nothing(reading: Reading) -> bool:
    """Return whether an object could not be read. Bytes of the right length that are no value of its type count as read."""
    size = reading.variable.size
    return reading.result.is_missing and (reading.data is None or (size is not None and len(reading.data) != size))


def _blind(wanted: Mapping[Mux, Value], unread: Collection[Mux]) -> list[Mux]:
    """Return the wanted muxes whose present value is not known, or that depend on an unknown one. A PDO is one unit: its two
    records depend on each other."""

    def unit(key: Mux) -> int:
        index = index_of(key)
        return index & ~_TO_MAPPING if index in indices.PDO_RECORDS else key

    units = {unit(key) for key in unread}
    return [key for key in wanted if unit(key) in units or any(each in unread for each in switches_of(key))]


def restore(
    node: RemoteNode,
    nmt: NmtMaster,
    plan: RestorePlan,
    restoration: Restoration | None = None,
    *,
    verify: bool = False,
    store: bool = False,
) -> Procedure[Restoration]:
    """Carry a plan out. A plan without writes does nothing, unless `store` is set.

    nmt: the NMT master of the node's network. restoration: takes the progress; a caller that may cancel keeps it. verify: read
    each object back (except write-only ones). store: make the device store its parameters at the end.

    An ObjectRestored event follows for each write. Raises RestoreError, also if the node boots before it has stored: what was
    read and written before that no longer counts. This module's text says which state the node is in.
    """
    so_far = Restoration(plan) if restoration is None else restoration
    if not plan.writes and not store:
        so_far.is_done = True
        return so_far
    boots = node.boots if plan.boots is None else plan.boots
    try:
        _check_boots(node, boots)
        if store:
            yield from _check_store(node)
        so_far.state_before, limit = yield from _find_state(node)
        yield from _to_state(node, nmt, NmtState.PRE_OPERATIONAL, limit, so_far)
        _check_boots(node, boots)
        for write in plan.writes:
            yield from _write(node, write, verify, so_far)
        if store:
            yield from _store(node, so_far)
        if so_far.state_before not in (None, NmtState.PRE_OPERATIONAL):
            limit = yield from _heartbeat_limit(node)  # the restore may have changed it
            yield from _to_state(node, nmt, so_far.state_before, limit, so_far)
            if not so_far.stored:
                _check_boots(node, boots)
    except Cancelled:
        yield from _stay(node, nmt, so_far)
        raise
    except _FAILURES as failed:
        yield from _stay(node, nmt, so_far)
        raise RestoreError(_told(node, so_far, str(failed)), so_far) from failed
    so_far.is_done = True
    return so_far


def _check_boots(node: RemoteNode, boots: int) -> None:
    """Raise ProcedureError if the node has booted again. While a request is open, its boot-up ends that."""
    if node.boots != boots:
        raise ProcedureError("it has booted since its values were read, and so lost what it had not stored. Try: the same again")


def _write(node: RemoteNode, write: PlannedWrite, verify: bool, so_far: Restoration) -> Procedure[None]:
    variable = write.variable
    try:
        yield from download(node.sdo, variable.index, variable.subindex, write.data, block="auto")
    except Cancelled:
        so_far.in_doubt = write
        raise
    except SdoTransferError as failed:
        if failed.not_confirmed:
            so_far.in_doubt = write
        raise
    so_far.written += 1
    if verify and variable.access.readable:
        block: Block = "auto" if variable.size is None else False
        shown = yield from upload_again(node, variable.index, variable.subindex, block)
        if not _shows(variable, shown, write.data):
            raise VerifyMismatchError(node.node_id, write, shown)
    news = ObjectRestored(node.node_id, variable.index, variable.subindex, write.data, so_far.written, len(so_far.plan.writes))
    yield from act(lambda now: node.out.events.append(news))


def _shows(variable: Variable, shown: bytes, written: bytes) -> bool:
    """Return whether a device shows what was written. It may fill a text up to the length of its memory."""
    if shown == written:
        return True
    if variable.data_type is DataType.VISIBLE_STRING:
        return shown.startswith(written) and not shown[len(written) :].strip(b"\0 ")
    try:  # a BOOLEAN of 0xFF is true as well as one of 1
        return same_value(variable, variable.decode(shown), variable.decode(written))
    except ValueRangeError:
        return False


def _check_store(node: RemoteNode) -> Procedure[None]:
    """Check, before anything is written, that the device can store. Raises ProcedureError if it cannot."""
    try:
        capability = int.from_bytes((yield from upload_again(node, STORE, 1, False)), "little")
    except SdoTransferError as failed:
        if failed.abort_code in ABSENT:
            raise ProcedureError("the device cannot store its parameters: it has no 0x1010:01") from failed
        raise
    if not capability & ON_COMMAND:
        raise ProcedureError(f"the device does not store its parameters on command: 0x1010:01 is 0x{capability:08X}")


def _store(node: RemoteNode, so_far: Restoration) -> Procedure[None]:
    standing, node.sdo.timeout = node.sdo.timeout, max(node.sdo.timeout, STORE_TIMEOUT)
    try:
        yield from download(node.sdo, STORE, 1, SIGNATURES[STORE].to_bytes(4, "little"))
    except Cancelled:
        so_far.store_in_doubt = True
        raise
    except SdoTransferError as failed:
        so_far.store_in_doubt = failed.not_confirmed
        raise
    finally:
        node.sdo.timeout = standing
    so_far.stored = True


def _find_state(node: RemoteNode) -> Procedure[tuple[NmtState | None, Time]]:
    """Return the node's NMT state by its heartbeat, and after how many ns that counts as missing; None and 0 if it sends none.

    A state that we commanded does not count: the node has not confirmed it."""
    if node.nmt_state is NmtState.STOPPED:
        return NmtState.STOPPED, 0  # it has no SDO in this state, so 0x1017 cannot be read
    limit = yield from _heartbeat_limit(node)
    if not limit:
        return None, 0
    try:
        heard = yield from wait_for_event(node, HeartbeatReceived, limit, "a heartbeat", _is_of(node))
    except StepTimeoutError:
        return None, 0  # the device does not keep to its 0x1017
    return heard.state, limit


def _is_of(node: RemoteNode, state: NmtState | None = None) -> _Match:
    return lambda heard: heard.node_id == node.node_id and state in (None, heard.state)


def _heartbeat_limit(node: RemoteNode) -> Procedure[Time]:
    """Return after how many ns a heartbeat counts as missing; 0 if the node sends none."""
    data = yield from unless_refused(upload_again(node, indices.PRODUCER_HEARTBEAT_TIME, 0, False))
    period = int.from_bytes(data or b"", "little") * MILLISECOND
    return min(period + period // 2 + HEARTBEAT_MARGIN, MAX_HEARTBEAT_WAIT) if period else 0


def _to_state(node: RemoteNode, nmt: NmtMaster, state: NmtState, limit: Time, so_far: Restoration) -> Procedure[None]:
    """Command a state and await a heartbeat that shows it. limit: ns until a heartbeat counts as missing; 0: it sends none."""
    so_far.state = state
    for _ in range(NMT_TRIES):
        yield from act(lambda now: nmt.send(_COMMAND_TO[state], node.node_id, now))
        if not limit:
            yield from sleep(NMT_REACTION_TIME)
            return
        try:
            yield from wait_for_event(node, HeartbeatReceived, limit, "the heartbeat", _is_of(node, state))
            return
        except StepTimeoutError:
            continue
    shown = "sends none" if node.nmt_state is None else f"shows {node.nmt_state.name}"
    raise ProcedureError(f"node {node.node_id} was sent {NMT_TRIES} times to {state.name}, but its heartbeat {shown}")


def _stay(node: RemoteNode, nmt: NmtMaster, so_far: Restoration) -> Procedure[None]:
    """Command Pre-operational again, so that nothing half done becomes active."""
    if so_far.state is not None:
        so_far.state = NmtState.PRE_OPERATIONAL
        yield from act(lambda now: nmt.enter_pre_operational(node.node_id, now))


def _told(node: RemoteNode, so_far: Restoration, reason: str) -> str:
    if so_far.state is None:
        return f"nothing was written to node {node.node_id}: {reason}"
    return (
        f"the restore of node {node.node_id} ended after {so_far.written} of {len(so_far.plan.writes)} writes: {reason}; "
        "the node stays Pre-operational"
    )
