"""Change the settings of a device's PDO: the manual's `definePDO`, which the manual marks as not implemented yet.

The sequence is that of CiA 301 v4.2.0, 7.5.2.36: destroy the PDO, disable its mapping, write the entries, their number and the
transmission type, create the PDO. The old settings are read first. If a step is refused, or the procedure is cancelled, the old
settings are written back by the same sequence, so that no device is left half mapped. If that fails too, the error says so; the
PDO is then at worst destroyed, which is the safe state.
"""

from __future__ import annotations

from typing import Final, Protocol

from canopen_proto.abort import AbortOrigin
from canopen_proto.cob_id import check_can_id
from canopen_proto.dictionary import Direction, PdoDescription
from canopen_proto.frame import COB_ID_INVALID, RoutingKey, key_of_cob_id
from canopen_proto.machine import LocalProtocolError, Time
from canopen_proto.pdo.mapping import MAX_ENTRIES, Mapping, MappingError
from canopen_proto.pdo.settings import PdoSettings, RemapStep, objects_to_read
from canopen_proto.procedures.objects import ObjectAccess, UnexpectedLength
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, SdoFailed, act, download, upload
from canopen_proto.sdo.client import SdoClient

_FAILURES: Final = (SdoFailed, LocalProtocolError)
"""How a step can fail: the transfer fails, or the client refuses it because its queue is full."""


class StrangePdo(ProcedureError):
    """A device shows impossible settings of a PDO: more entries than allowed, or objects that its dictionary here lacks."""


class PdoRefused(ProcedureError):
    """A device refused new settings of a PDO, or its old ones. step: the number of the step that failed or was cancelled, from 1
    on. restored: whether the device has its old settings."""

    def __init__(self, message: str, *, step: int, restored: bool) -> None:
        super().__init__(message)
        self.step = step
        self.restored = restored


class PdoNode(ObjectAccess, Protocol):
    """A node whose PDOs can be read, written and exchanged: a RemoteNode, which stands above this room."""

    sdo: SdoClient

    def add_pdo(self, description: PdoDescription, now: Time, *, number: int | None = None, transmission_type: int = 1) -> object:
        """See RemoteNode."""

    def add_tpdo(self, number: int, key: RoutingKey, mapping: Mapping, now: Time) -> object:
        """See RemoteNode."""

    def add_rpdo(self, number: int, key: RoutingKey, mapping: Mapping, transmission_type: int = 1) -> object:
        """See RemoteNode."""


def read_pdo(node: PdoNode, direction: Direction, number: int) -> Procedure[PdoSettings]:
    """Read the present settings of a PDO of the device.

    Raises SdoFailed if the device has no such PDO; StrangePdo or UnexpectedLength if its settings are impossible.
    """
    answers: dict[tuple[int, int], bytes] = {}
    fixed = objects_to_read(number, direction)
    sizes = dict(zip(fixed, (4, 1, 1), strict=True))  # COB-ID, transmission type, number of mapped objects
    for index, subindex in fixed:
        answers[index, subindex] = yield from _upload(node, index, subindex, sizes[index, subindex])
    count = min(answers[fixed[-1]][0], MAX_ENTRIES + 1)  # from_read refuses too many
    if count <= MAX_ENTRIES:
        for index, subindex in objects_to_read(number, direction, count)[len(fixed) :]:
            answers[index, subindex] = yield from _upload(node, index, subindex, 4)
    try:
        return PdoSettings.from_read(number, direction, answers)
    except MappingError as error:
        raise StrangePdo(f"a PDO of node {node.node_id} makes no sense: {error}") from error


def _upload(node: PdoNode, index: int, subindex: int, size: int) -> Procedure[bytes]:
    data = yield from upload(node.sdo, index, subindex)
    if len(data) != size:
        raise UnexpectedLength(f"node {node.node_id}: 0x{index:04X}:{subindex:02X} came with {len(data)} bytes, not {size}")
    return data


def configure_pdo(node: PdoNode, settings: PdoSettings) -> Procedure[PdoSettings]:
    """Write the settings of a PDO to the device; return its old settings. The node must be Pre-operational for most devices.

    Raises PdoRefused, which names the step, the abort and the settings in force now; or, as `read_pdo` does, an error while
    reading the old settings: nothing was written then.
    """
    before = yield from read_pdo(node, settings.direction, settings.number)
    steps = settings.steps(before.cob_id)
    name = f"{settings.direction} {settings.number} of node {node.node_id}"
    done = 0
    try:
        for index, subindex, data in steps:
            yield from download(node.sdo, index, subindex, data)
            done += 1
    except Cancelled:
        try:
            yield from _put_back(node, before, settings, done, len(steps))
        except _FAILURES as failed:
            message = f"setting {name} up was cancelled, and its old settings could not be put back: {failed}"
            raise PdoRefused(message, step=done + 1, restored=False) from failed
        raise
    except _FAILURES as refused:
        message = f"{name} could not be set up: step {done + 1} of {len(steps)} ({_what(steps[done])}): {refused}"
        in_doubt = isinstance(refused, SdoFailed) and refused.origin is not AbortOrigin.PEER
        if done or in_doubt:  # else nothing has changed
            try:
                yield from _put_back(node, before, settings, done, len(steps))
            except _FAILURES as failed:
                message += f"; and its old settings could not be put back: {failed}"
                raise PdoRefused(message, step=done + 1, restored=False) from refused
        raise PdoRefused(f"{message}; it has its old settings", step=done + 1, restored=True) from refused
    return before


def _put_back(node: PdoNode, before: PdoSettings, settings: PdoSettings, done: int, count: int) -> Procedure[None]:
    """Write the old settings. The step after the `done` ones may have been executed: an answer may have been lost."""
    standing = settings.cob_id if done == count - 1 else before.cob_id  # a strict device wants this COB-ID when it is destroyed
    for index, subindex, data in before.steps(standing):
        yield from download(node.sdo, index, subindex, data)


def define_pdo(
    node: PdoNode, description: PdoDescription, *, number: int | None = None, transmission_type: int = 1
) -> Procedure[PdoSettings]:
    """Write a PDO of PDOs.csv to the device, exchange it from then on (`RemoteNode.add_pdo`), and return its old settings.

    An RPDO is not sent before `RemoteNode.enable_rpdo`. Raises as `configure_pdo`; nothing has changed on our side then.
    """
    settings = PdoSettings.from_description(description, node.node_id, transmission_type, number)
    before = yield from configure_pdo(node, settings)
    yield from act(
        lambda now: node.add_pdo(description, now, number=settings.number, transmission_type=transmission_type),
    )
    return before


def use_device_pdo(node: PdoNode, direction: Direction, number: int) -> Procedure[Mapping | None]:
    """Exchange a PDO with the device's own settings; return its mapping, or None if the PDO is not valid or carries nothing.

    Raises SdoFailed; StrangePdo if its settings are impossible, or if the node's dictionary lacks an object that it maps.
    """
    settings = yield from read_pdo(node, direction, number)
    if settings.cob_id & COB_ID_INVALID or not settings.entries:
        return None
    try:
        mapping = Mapping.from_parameters(settings.entries, node.dictionary)
    except MappingError as error:
        raise StrangePdo(f"{direction} {number} of node {node.node_id}: {error}") from error
    check_rpdo(node, settings)
    key = key_of_cob_id(settings.cob_id)
    if direction is Direction.TPDO:
        yield from act(lambda now: node.add_tpdo(number, key, mapping, now))
    else:
        yield from act(lambda now: node.add_rpdo(number, key, mapping, settings.transmission_type))
    return mapping


def check_rpdo(node: PdoNode, settings: PdoSettings) -> None:
    """Raise StrangePdo if these settings of a device would have us send an RPDO on the CAN-ID of another service: 0 is NMT."""
    if settings.direction is Direction.RPDO and check_can_id(settings.cob_id) is not None:
        text = f"its COB-ID 0x{settings.cob_id:X} has a CAN-ID that no PDO may have; nothing is sent there"
        raise StrangePdo(f"{settings.direction} {settings.number} of node {node.node_id}: {text}")


def _what(step: RemapStep) -> str:
    index, subindex, data = step
    return f"0x{index:04X}:{subindex:02X} = 0x{int.from_bytes(data, 'little'):0{2 * len(data)}X}"
