"""Compare a node with what the NMT master knows of it, by reading only: `compare_node`.

Read are the device type, the identity, the program if one is expected, and each object that the configuration of the entry
writes: with the last value, if it writes one several times. Nothing is written, and no NMT command is sent.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortOrigin
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.manager.boot.entry import BootEntry
from canopen_proto.parameter_storage import SIGNATURES
from canopen_proto.procedures.steps import Procedure, SdoTransferError, upload
from canopen_proto.remote_node import RemoteNode

TRIES: Final = 3
"""How often a read is sent that is not answered."""
_COMMUNICATION: Final = (indices.RPDO_COMMUNICATION, indices.TPDO_COMMUNICATION)
_WITHOUT_RTR: Final = 1 << 30
"""Bit of a PDO's COB-ID: a device may show it as it has it (CiA 301 v4.2.0, 7.5.2.37)."""


@dataclass(frozen=True, slots=True)
class Compared:
    """One object of a node. expected: None = any. found: None = it could not be read, and abort_code says why.

    is_setting: it belongs to the configuration; else to the node itself.
    """

    index: int
    subindex: int
    expected: bytes | None
    found: bytes | None
    abort_code: int | None = None
    is_setting: bool = False

    @property
    def is_right(self) -> bool:
        """Whether the node has what is expected. An object that could not be read counts as wrong, unless anything is right."""
        if self.expected is None or self.expected == self.found:
            return True
        if self.found is None or len(self.found) != len(self.expected):
            return False
        is_cob_id = self.subindex == 1 and any(self.index in each for each in _COMMUNICATION)
        return is_cob_id and not (_number(self.found) ^ _number(self.expected)) & ~_unimportant(_number(self.expected))


@dataclass(frozen=True, slots=True)
class NodeComparison:
    """A node beside its entry. answers: it answered the first read; if not, nothing else was read."""

    node_id: int
    answers: bool
    objects: tuple[Compared, ...] = ()

    @property
    def wrong(self) -> tuple[Compared, ...]:
        """The objects that are not as expected."""
        return tuple(each for each in self.objects if not each.is_right)

    @property
    def is_right(self) -> bool:
        """Whether the node is there, and all is as expected."""
        return self.answers and not self.wrong


def compare_node(node: RemoteNode, entry: BootEntry, *, settings: bool = True) -> Procedure[NodeComparison]:
    """Read a node, and compare it with its entry. settings: the configuration, too. Raises nothing: faults are in the result."""
    found: list[Compared] = []
    for index, subindex, expected, is_setting in _wanted(entry, settings):
        data, abort_code, answers = yield from _read(node, index, subindex)
        if not answers and not found:
            return NodeComparison(entry.node_id, False)
        if data is not None and expected is not None and not is_setting:
            data = data.ljust(len(expected), b"\0")  # a number, in as many bytes as the device likes
        found.append(Compared(index, subindex, expected, data, abort_code, is_setting))
    return NodeComparison(entry.node_id, True, tuple(found))


def _wanted(entry: BootEntry, settings: bool) -> Iterator[tuple[int, int, bytes | None, bool]]:
    """Return what to read: index, subindex, the bytes that are expected, and whether it is a setting."""
    yield indices.DEVICE_TYPE, 0, _bytes(entry.device_type), False
    for subindex, number in enumerate(entry.identity, start=1):
        yield indices.IDENTITY_OBJECT, subindex, _bytes(number), False
    for index, subindex, number in entry.program:
        yield index, subindex, _bytes(number), False
    last = {(index, subindex): data for index, subindex, data in entry.configuration}
    for (index, subindex), data in last.items() if settings else ():
        if index not in SIGNATURES:
            yield index, subindex, data, True


def _read(node: RemoteNode, index: int, subindex: int) -> Procedure[tuple[bytes | None, int | None, bool]]:
    """Return the bytes of an object, or the abort code, and whether the node answered."""
    tries = 0
    while True:
        tries += 1
        try:
            return (yield from upload(node.sdo, index, subindex)), None, True
        except SdoTransferError as failed:
            is_silent = failed.origin is AbortOrigin.TIMEOUT
            if not is_silent or tries == TRIES:
                return None, failed.abort_code, not is_silent


def _unimportant(cob_id: int) -> int:
    """Return the bits of a COB-ID that make no difference: of a PDO that does not exist all but bit 31."""
    return COB_ID_INVALID - 1 if cob_id & COB_ID_INVALID else _WITHOUT_RTR


def _bytes(number: int | None) -> bytes | None:
    return None if number is None else number.to_bytes(4, "little")


def _number(data: bytes) -> int:
    return int.from_bytes(data, "little")
