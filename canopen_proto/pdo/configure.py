"""Bring the PDOs of a device to the settings that are wanted, and exchange them; or exchange them as the device has set them up.

    exchange_pdos          PDOs that somebody has chosen (their layout): each is compared, written where it differs, and exchanged
    define_pdo             a PDO of PDOs.csv: the manual's `definePDO`, which the manual marks as not implemented yet
    use_device_pdo         one PDO, as the device has it
    exchange_device_pdos   all PDOs, as the device has them. Its mapping decides what the bytes of a PDO mean: if its file says
                           something else, values would be wrong and nobody would notice. So each difference is returned
    renew_tpdos            those TPDOs that were exchanged until we set them up anew

`configure_pdo` is the one that writes, in the sequence of CiA 301 v4.2.0, 7.5.2.36: destroy the PDO, disable its mapping, write
the entries, their number and the transmission type, create the PDO. The old settings are read first. If a step is refused, or the
procedure is cancelled, the old settings are written back by the same sequence, so that no device is left half mapped. If that
fails too, the error says so; the PDO is then at worst destroyed, which is the safe state.

Source: CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Final, Protocol

from canopen_proto.abort import AbortOrigin
from canopen_proto.cob_id import check_can_id
from canopen_proto.dictionary import Direction, PdoDescription
from canopen_proto.dictionary.download_order import Write
from canopen_proto.frame import RoutingKey
from canopen_proto.machine import MILLISECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, mapped, split_mux
from canopen_proto.pdo.mapping import MAX_ENTRIES, Mapping, MappingError, entries_of
from canopen_proto.pdo.producer import PdoProducer
from canopen_proto.pdo.settings import (
    COB_ID,
    CYCLIC_TYPES,
    EACH_SYNC,
    EVENT_TIMER,
    INHIBIT_TIME,
    INHIBIT_UNIT,
    TRANSMISSION_TYPE,
    PdoSettings,
    cob_id_step,
    communication_index,
    mapping_index,
    places_of,
    step_text,
)
from canopen_proto.pdo.slots import described_pdos
from canopen_proto.procedures.objects import ABSENT, ObjectAccess, UnexpectedLengthError, read_if_present, unless_refused
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, SdoTransferError, act, download, upload
from canopen_proto.sdo.client import SdoClient

_FAILURES: Final = (SdoTransferError, LocalProtocolError)
"""How a step can fail: the transfer fails, or the client refuses it because its queue is full."""


class InvalidPdoError(ProcedureError):
    """A device shows impossible settings of a PDO: more entries than allowed, or objects that its dictionary here lacks."""


class PdoRefusedError(ProcedureError):
    """A device refused new settings of a PDO, or its old ones; or somebody else of this program wrote the PDO at the same time.
    step: the number of the step that failed or was cancelled, from 1 on. restored: whether the device has its old settings."""

    def __init__(self, message: str, *, step: int, restored: bool) -> None:
        super().__init__(message)
        self.step = step
        self.restored = restored


@dataclass(frozen=True, slots=True)
class PdoDifference:
    """A PDO whose settings in the device differ from its dictionary's. None: not valid, or not there."""

    direction: Direction
    number: int
    described: PdoSettings | None
    present: PdoSettings | None

    def __str__(self) -> str:
        return f"{self.direction} {self.number} is {_text(self.present)}; the file says {_text(self.described)}"


def _text(settings: PdoSettings | None) -> str:
    if settings is None:
        return "not in use"
    objects = ", ".join(f"{index:04X}:{subindex:02X}/{bits}" for index, subindex, bits in map(mapped, settings.entries))
    return f"{settings.can_id_text} with {objects}"


class _Mixed(ProcedureError):
    """Somebody else of us wrote the PDO meanwhile."""


class _Writing:
    """Writes settings of a PDO. Ends, before the next step, if somebody else of us writes its CAN-ID or its mapping meanwhile:
    what the device has then is nobody's. done: the steps that were answered."""

    def __init__(self, node: PdoNode, settings: PdoSettings, present: int) -> None:
        self.steps = settings.steps(present)
        self.done = 0
        self._node = node
        self._place = settings.place
        self._writes = self._counted()

    def run(self) -> Procedure[None]:
        """Raises SdoTransferError, LocalProtocolError, _Mixed."""
        for index, subindex, data in self.steps:
            yield from download(self._node.sdo, index, subindex, data)
            self.done += 1
            self._writes += index == mapping_index(*self._place) or subindex == COB_ID
            if self._counted() != self._writes:
                raise _Mixed("somebody else of this program wrote this PDO at the same time; what it has now is not known")

    def _counted(self) -> int:
        return self._node.set_up.get(self._place, 0)


class PdoNode(ObjectAccess, Protocol):
    """A node whose PDOs can be read, written and exchanged: a RemoteNode, which stands above this room."""

    sdo: SdoClient
    pdo_writes: int
    rpdos: dict[int, PdoProducer]
    set_up: dict[tuple[Direction, int], int]
    read_pdos: set[tuple[Direction, int]]
    unread_pdos: set[tuple[Direction, int]]

    def add_pdo(self, description: PdoDescription, now: Time, *, number: int | None = None, transmission_type: int = 1) -> object:
        """See RemoteNode."""

    def add_tpdo(self, number: int, key: RoutingKey, mapping: Mapping, now: Time, *, is_read: bool = False) -> object:
        """See RemoteNode."""

    def add_rpdo(
        self, number: int, key: RoutingKey, mapping: Mapping, transmission_type: int = 1, *, is_read: bool = False
    ) -> object:
        """See RemoteNode."""

    def remove_pdo(self, direction: Direction, number: int) -> None:
        """See RemoteNode."""


# ---- reading and writing ----


def read_pdo(node: PdoNode, direction: Direction, number: int) -> Procedure[PdoSettings]:
    """Read the present settings of a PDO of the device (number: 1..512), without its times. direction: as the device sees it.

    It reads once more if we write a PDO of the node meanwhile. Raises SdoTransferError if the device has no such PDO;
    InvalidPdoError or UnexpectedLengthError if its settings are impossible.
    """
    while True:
        writes = node.pdo_writes
        try:
            settings = yield from _read_pdo(node, direction, number)
        except InvalidPdoError:
            if writes == node.pdo_writes:
                raise
        else:
            if writes == node.pdo_writes:
                return settings


def _read_pdo(node: PdoNode, direction: Direction, number: int) -> Procedure[PdoSettings]:
    communication, mapping = communication_index(direction, number), mapping_index(direction, number)
    cob_id = yield from _number(node, communication, COB_ID, 4)
    transmission_type = yield from _number(node, communication, TRANSMISSION_TYPE, 1)
    count = yield from _number(node, mapping, 0, 1)
    if count > MAX_ENTRIES:
        text = f"{direction} {number}: {count} mapped objects; a PDO has {MAX_ENTRIES} at most"
        raise InvalidPdoError(f"a PDO of node {node.node_id} makes no sense: {text}")
    entries: tuple[int, ...] = ()
    for subindex in range(1, count + 1):
        entries = (*entries, (yield from _number(node, mapping, subindex, 4)))
    return PdoSettings(number, direction, cob_id, transmission_type, entries)


def _number(node: PdoNode, index: int, subindex: int, size: int) -> Procedure[int]:
    data = yield from upload(node.sdo, index, subindex)
    if len(data) != size:
        raise UnexpectedLengthError(f"node {node.node_id}: 0x{index:04X}:{subindex:02X} came with {len(data)} bytes, not {size}")
    return int.from_bytes(data, "little")


def configure_pdo(node: PdoNode, settings: PdoSettings) -> Procedure[PdoSettings]:
    """Write the settings of a PDO to the device; return its old settings, with those times that were written.

    A PDO that is exchanged as the device has it goes on with the new settings. A TPDO is received by its new mapping, and not at
    all while it is written. An RPDO is sent again once it is enabled anew (`RemoteNode.enable_rpdo`). A PDO that its user has
    described (`RemoteNode.add_pdo`) stays as described.

    The node must be Pre-operational for most devices. Raises PdoRefusedError, which names the step, the abort and the settings in
    force now, and also if somebody else of this program writes the PDO at the same time; or, as `read_pdo` does, an error while
    reading the old settings: nothing was written then.
    """
    before = yield from read_pdo(node, *settings.place)
    index = communication_index(*settings.place)
    if settings.inhibit_time is not None:
        before = replace(before, inhibit_time=(yield from _number(node, index, INHIBIT_TIME, 2)) * INHIBIT_UNIT)
    if settings.event_time is not None:
        before = replace(before, event_time=(yield from _number(node, index, EVENT_TIMER, 2)) * MILLISECOND)
    writing = _Writing(node, settings, before.cob_id)
    name = f"{settings.name} of node {node.node_id}"
    try:
        yield from writing.run()
    except Cancelled:
        try:
            yield from _put_back(node, before, settings, writing)
        except (*_FAILURES, _Mixed) as failed:
            message = f"setting {name} up was cancelled, and its old settings could not be put back: {failed}"
            raise PdoRefusedError(message, step=writing.done + 1, restored=False) from failed
        raise
    except _Mixed as mixed:  # nothing is put back: the other one still writes, too
        message = f"{name} could not be set up: step {writing.done} of {len(writing.steps)}: {mixed}"
        raise PdoRefusedError(message, step=writing.done, restored=False) from mixed
    except _FAILURES as refused:
        done = writing.done
        what = " = ".join(step_text(writing.steps[done]))
        message = f"{name} could not be set up: step {done + 1} of {len(writing.steps)} ({what}): {refused}"
        in_doubt = isinstance(refused, SdoTransferError) and refused.origin is not AbortOrigin.PEER
        if done or in_doubt:  # else nothing has changed
            try:
                yield from _put_back(node, before, settings, writing)
            except (*_FAILURES, _Mixed) as failed:
                message += f"; and its old settings could not be put back: {failed}"
                raise PdoRefusedError(message, step=done + 1, restored=False) from refused
        raise PdoRefusedError(f"{message}; it has its old settings", step=done + 1, restored=True) from refused
    yield from _renew(node, settings)
    return before


def _put_back(node: PdoNode, before: PdoSettings, settings: PdoSettings, writing: _Writing) -> Procedure[None]:
    """Write the old settings. The step after the last that was answered may have been executed: an answer may have been lost."""
    is_created = writing.done == len(writing.steps) - 1  # a strict device wants this COB-ID when it is destroyed
    yield from _Writing(node, before, settings.cob_id if is_created else before.cob_id).run()
    yield from _renew(node, before)


def _renew(node: PdoNode, settings: PdoSettings) -> Procedure[None]:
    """Go on with a PDO that was exchanged when its settings were written. settings: those that the device has now."""
    if settings.place not in node.unread_pdos:
        return
    if not settings.is_valid or not settings.entries:
        node.remove_pdo(*settings.place)
        return
    try:
        mapping = _mapping_of(node, settings, lacks_objects=True)
    except InvalidPdoError:
        return  # it stays in `unread_pdos`: whoever exchanges it next is told why it cannot be
    rpdo = node.rpdos.get(settings.number)  # one that is sent when it is triggered is not sent at each SYNC from now on
    yield from _exchange(node, settings, mapping, sends_at_sync=rpdo is None or rpdo.transmission_type in CYCLIC_TYPES)


def steps_to(node: PdoNode, settings: PdoSettings) -> Procedure[list[Write]]:
    """Return the downloads that `exchange_pdos` would make for a PDO now. The node is only read. Raises as `read_pdo`."""
    present = yield from read_pdo(node, *settings.place)
    return [] if settings.are_in(present) else settings.steps(present.cob_id)


def steps_to_destroy(
    node: PdoNode, pdos: Iterable[PdoSettings], which: Callable[[int], bool] = lambda cob_id: True
) -> Procedure[list[Write]]:
    """Return the downloads that destroy those of these PDOs that are valid in the device itself, which may lack some.

    which: by their COB-IDs in the device. Raises SdoTransferError if it does not answer.
    """
    steps = []
    for pdo in pdos:
        data = yield from unless_refused(upload(node.sdo, communication_index(*pdo.place), COB_ID), ABSENT)
        present = pdo if data is None else replace(pdo, cob_id=int.from_bytes(data, "little"))
        if data is not None and present.is_valid and which(present.cob_id):
            steps.append(cob_id_step(present.destroyed))
    return steps


# ---- exchanging ----


def exchange_pdos(node: PdoNode, pdos: Iterable[PdoSettings], *, sends_at_sync: bool = True) -> Procedure[None]:
    """Exchange these PDOs with the node; each is configured first if the node's settings differ. So a device that was configured
    before is only read.

    The node should be Pre-operational: most devices accept new settings only then. An RPDO is not sent before
    `RemoteNode.enable_rpdo`. sends_at_sync: an event-driven RPDO (types 254 and 255), which acts as soon as it comes, is sent at
    each SYNC too; else only when it is triggered. Raises InvalidPdoError, with nothing sent, if the node's dictionary lacks an
    object; SdoTransferError, InvalidPdoError or UnexpectedLengthError if the node's settings cannot be read; PdoRefusedError if
    the node refuses these.
    """
    for settings in pdos:
        mapping = _mapping_of(node, settings)
        present = yield from read_pdo(node, *settings.place)
        if not settings.are_in(present):
            yield from configure_pdo(node, settings)
        yield from _exchange(node, settings, mapping, sends_at_sync=sends_at_sync)


def define_pdo(
    node: PdoNode, description: PdoDescription, *, number: int | None = None, transmission_type: int = 1
) -> Procedure[PdoSettings]:
    """Write a PDO of PDOs.csv to the device, exchange it from then on (`RemoteNode.add_pdo`), and return its old settings.
    number: 1..512; None = that of the predefined connection set. transmission_type: 0..240 synchronous, 254 and 255 event-driven.

    An RPDO is not sent before `RemoteNode.enable_rpdo`. Raises as `configure_pdo`; nothing has changed on our side then.
    """
    settings = PdoSettings.from_description(description, node.node_id, transmission_type, number)
    before = yield from configure_pdo(node, settings)
    yield from act(
        lambda now: node.add_pdo(description, now, number=settings.number, transmission_type=transmission_type),
    )
    return before


def use_device_pdo(node: PdoNode, direction: Direction, number: int) -> Procedure[Mapping | None]:
    """Exchange a PDO with the device's own settings; return its mapping, or None if the PDO is not valid or carries nothing: it
    is exchanged no more then. direction: as the device sees it. number: 1..512.

    Raises SdoTransferError; InvalidPdoError if its settings are impossible, or if the node's dictionary lacks an object that it
    maps.
    """
    settings = yield from read_pdo(node, direction, number)
    if not settings.is_valid or not settings.entries:
        _leave(node, settings.place)
        return None
    mapping = _mapping_of(node, settings)
    yield from _exchange(node, settings, mapping, sends_at_sync=False)
    return mapping


def exchange_device_pdos(node: PdoNode) -> Procedure[tuple[PdoDifference, ...]]:
    """Exchange the PDOs that the dictionary has records for, with the device's settings; return where the dictionary differs.

    A TPDO is received from now on. For an RPDO, the present values of its objects are read first, so that it sends these once it
    is enabled (`RemoteNode.enable_rpdo`); until then it is not sent. A PDO that maps objects which the dictionary lacks is
    exchanged too; they become unsigned numbers. MPDOs are left out. Raises SdoTransferError if the device does not answer;
    InvalidPdoError, UnexpectedLengthError.
    """
    described = {pdo.place: pdo for pdo in described_pdos(node.dictionary, node.node_id)}
    differences = []
    for direction, number in places_of(node.dictionary.objects):
        try:
            read = yield from unless_refused(read_pdo(node, direction, number), ABSENT)
            present = read if read is not None and read.is_valid and read.entries else None
        except InvalidPdoError:
            if (direction, number) not in node.unread_pdos:
                _leave(node, (direction, number))
            continue  # an MPDO, or impossible settings: there is no mapping to use
        if present is not None and direction is Direction.RPDO:
            present = yield from _read_its_values(node, present)
        wanted = described.get((direction, number))
        if _key_and_objects(present) != _key_and_objects(wanted):
            differences.append(PdoDifference(direction, number, wanted, present))
        if present is not None:
            mapping = _mapping_of(node, present, lacks_objects=True)
            yield from _exchange(node, present, mapping, sends_at_sync=True)
        else:
            _leave(node, (direction, number))
    return tuple(differences)


def _leave(node: PdoNode, place: tuple[Direction, int]) -> None:
    """Exchange a PDO no more that the device had once and has no more. One that its user has described stays."""
    if place in node.read_pdos or place in node.unread_pdos:
        node.remove_pdo(*place)


def renew_tpdos(node: PdoNode) -> Procedure[None]:
    """Receive the TPDOs again that we have set up anew since they were read (`RemoteNode.unread_pdos`), as the device has them
    now. One that is not valid at present stays there. RPDOs are left alone. Raises SdoTransferError, UnexpectedLengthError."""
    for direction, number in sorted(each for each in node.unread_pdos if each[0] is Direction.TPDO):
        try:
            settings = yield from read_pdo(node, direction, number)
        except InvalidPdoError:
            continue  # an MPDO, or impossible settings
        if settings.is_valid and settings.entries:
            yield from _renew(node, settings)


def _read_its_values(node: PdoNode, settings: PdoSettings) -> Procedure[PdoSettings | None]:
    """Read the values that an RPDO is going to send. Return its settings, which are others if we have written a PDO of the node
    meanwhile; None: it is not valid any more, or carries nothing."""
    while settings.is_valid and settings.entries:
        writes = node.pdo_writes
        yield from read_commanded(node, _mapping_of(node, settings, lacks_objects=True).muxes)
        if writes == node.pdo_writes:
            return settings
        settings = yield from read_pdo(node, *settings.place)
    return None


def _key_and_objects(settings: PdoSettings | None) -> object:
    return None if settings is None else (settings.key, settings.entries)


def read_commanded(node: PdoNode, keys: Iterable[Mux]) -> Procedure[None]:
    """Read the present values of objects that an RPDO is going to carry, so that it sends these. 0 is sent for an object that
    cannot be read, such as a write-only command. Call it before the RPDO is exchanged. Raises SdoTransferError if nobody
    answers. keys: the muxes of these objects; the values go to `values`."""
    for key in keys:
        yield from unless_refused(read_if_present(node, split_mux(key)))


def _mapping_of(node: PdoNode, settings: PdoSettings, *, lacks_objects: bool = False) -> Mapping:
    """Return the mapping of a PDO by the node's dictionary, which may lack objects. Raises InvalidPdoError."""
    try:
        if lacks_objects:
            mapping = Mapping(entries_of(settings.entries, node.dictionary))
        else:
            mapping = Mapping.from_parameters(settings.entries, node.dictionary)
    except MappingError as error:
        raise InvalidPdoError(f"{settings.name} of node {node.node_id}: {error}") from error
    check_rpdo(node, settings)
    return mapping


def _exchange(node: PdoNode, settings: PdoSettings, mapping: Mapping, *, sends_at_sync: bool) -> Procedure[None]:
    """Exchange a PDO on our side. sends_at_sync: see `exchange_pdos`."""
    kind = settings.transmission_type
    if settings.direction is Direction.TPDO:
        yield from act(lambda now: node.add_tpdo(settings.number, settings.key, mapping, now, is_read=True))
    else:
        kind = EACH_SYNC if sends_at_sync and kind not in CYCLIC_TYPES else kind
        yield from act(lambda now: node.add_rpdo(settings.number, settings.key, mapping, kind, is_read=True))


def check_rpdo(node: PdoNode, settings: PdoSettings) -> None:
    """Raise InvalidPdoError if these settings of a device would have us send an RPDO on the CAN-ID of another service: 0 is
    NMT."""
    if settings.direction is Direction.RPDO and check_can_id(settings.cob_id) is not None:
        text = f"its COB-ID 0x{settings.cob_id:X} has a CAN-ID that no PDO may have; nothing is sent there"
        raise InvalidPdoError(f"{settings.name} of node {node.node_id}: {text}")
