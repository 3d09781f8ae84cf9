"""Read all objects of a node: for a backup, a comparison, a dump.

`back_up` reads each readable object of the node's dictionary by SDO, one after the other. It changes nothing in the device. Each
object, read or not, ends in one `Reading`, whose `result` says how it went. Not read are:

- write-only objects, and those whose ObjFlags (bit 1) exclude them from an upload (CiA 306-1);
- DOMAINs, unless they are wanted: a DOMAIN may be a firmware image, and a DCF cannot hold one.

A device may refuse some of its objects, or lack what its EDS lists: that is noted, and the next object is read. If an answer is
missing, or the transfer broke (an abort of the class "service error" says nothing about the object), the object is read once
more: reading changes nothing, and a frame may be lost. But if the very first object, or MAX_SILENT in a row, get no answer, the
device is gone, and the procedure fails. It also fails if the device is reset meanwhile: the values read before may no longer be
true.

An ObjectRead event reports each object as soon as its result is known.

Source: CiA 302-3 (upload of a device's configuration); CiA 306-1 v1.4.0, ObjFlags.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import DataType, Value, ValueRangeError
from canopen_proto.dictionary.model import ObjectDictionary, Variable
from canopen_proto.machine import Event
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.procedures.steps import Procedure, SdoTransferError, act, upload
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import Block
from canopen_proto.sdo.codec import what_was_asked

MAX_SILENT: Final = 3
"""Objects in a row without an answer, after which the device counts as gone. One may be a device's fault, or a lost frame."""
NO_UPLOAD: Final = 2
"""ObjFlags, bit 1: an upload of the whole dictionary leaves the object out. CiA 306-1."""


class ReadResult(StrEnum):
    """The outcome of reading one object."""

    READ = "read"
    WRITE_ONLY = "write-only"
    KEPT_OUT = "kept out"
    """Its ObjFlags exclude it from an upload; not read."""
    DOMAIN = "domain"
    """A DOMAIN, not read."""
    ABSENT = "absent"
    """The device does not have it, although its dictionary does; or it holds no data, as a history without errors."""
    REFUSED = "refused"
    """The device refused it, with any other abort code."""
    WRONG_LENGTH = "wrong length"
    """The bytes are no value of the object's type."""
    NO_ANSWER = "no answer"
    """The device gave no answer, or none that makes sense."""
    CONTESTED = "contested"
    """Another SDO client used the channel, whenever it was tried."""

    @property
    def is_missing(self) -> bool:
        """Whether a complete backup should have this object."""
        return self in (ReadResult.REFUSED, ReadResult.WRONG_LENGTH, ReadResult.NO_ANSWER, ReadResult.CONTESTED)


_SERVICE_ERROR: Final = 0x05
"""The highest byte of abort codes about the protocol: toggle bit, time-out, sequence, CRC (CiA 301 v4.2.0, table 22)."""
_REFUSALS: Final[dict[int, ReadResult]] = {
    **dict.fromkeys((*ABSENT, AbortCode.NO_DATA), ReadResult.ABSENT),
    AbortCode.WRITE_ONLY: ReadResult.WRITE_ONLY,
}
"""Abort codes that only mean that there is nothing to read."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The result for one object. data: its bytes, None if the device sent none; value: the same, decoded (READ only). abort_code:
    of a transfer that failed."""

    variable: Variable
    result: ReadResult
    data: bytes | None = None
    value: Value | None = None
    abort_code: int | None = None


@dataclass(slots=True)
class Backup:
    """The objects of a node as read. dictionary: used for reading. readings: in order of index and subindex.

    others_doing: what another SDO client did on the node's channel meanwhile, its last request in words; "" if none was heard.
    """

    node_id: int
    dictionary: ObjectDictionary
    readings: list[Reading] = field(default_factory=list)
    others_doing: str = ""

    @property
    def values(self) -> dict[Mux, Value]:
        """The values that were read, by mux."""
        return {each.variable.mux: each.value for each in self.readings if each.value is not None}

    @property
    def counts(self) -> dict[ReadResult, int]:
        """The number of objects with each result; only results that occurred."""
        counts = Counter(each.result for each in self.readings)
        return {result: counts[result] for result in ReadResult if counts[result]}

    @property
    def is_complete(self) -> bool:
        """Whether every object that should be read was read, and no other client used the channel meanwhile."""
        return not self.others_doing and not any(each.result.is_missing for each in self.readings)


class ObjectRead(Event):
    """The result of one object of a backup is known. done, total: numbers of objects; total 0: not known."""

    __match_args__ = ("node_id", "index", "subindex", "result", "done", "total")

    def __init__(self, node_id: int, index: int, subindex: int, result: ReadResult, done: int, total: int) -> None:
        self.node_id = node_id
        self.index = index
        self.subindex = subindex
        self.result = result
        self.done = done
        self.total = total


def back_up(
    node: RemoteNode,
    dictionary: ObjectDictionary | None = None,
    *,
    only: Iterable[Variable] | None = None,
    domains: bool = False,
    block: Block = "auto",
) -> Procedure[Backup]:
    """Read all readable objects of a node.

    dictionary: the objects to read; by default the node's. only: read only these objects of it. domains: read DOMAINs too. block:
    how to read DOMAINs, see `Block`. All else may have 1 to 4 bytes, which only a plain upload brings in one frame. Raises
    SdoTransferError if the device is gone; see this module's text.
    """
    dictionary = node.dictionary if dictionary is None else dictionary
    backup = Backup(node.node_id, dictionary)
    wanted = list(dictionary if only is None else only)
    patience = Patience()
    heard = node.sdo.other.count
    for variable in wanted:
        result = _not_asked(dictionary, variable, domains)
        if result is None:
            reading = yield from _read(node, variable, block, patience)
        else:
            reading = Reading(variable, result)
        backup.readings.append(reading)
        yield from report(node, reading, len(backup.readings), len(wanted))
    backup.others_doing = others_doing(node, heard)
    return backup


def others_doing(node: RemoteNode, heard: int) -> str:
    """Return what another SDO client did on the node's channel last; "" if none was heard since `other.count` was `heard`."""
    other = node.sdo.other
    return what_was_asked(other.heard) if other.count > heard else ""


def _not_asked(dictionary: ObjectDictionary, variable: Variable, domains: bool) -> ReadResult | None:
    """Return why an object is not to be read; None if it is to be read."""
    if not variable.access.readable:
        return ReadResult.WRITE_ONLY
    if (variable.object_flags | dictionary.objects[variable.index].object_flags) & NO_UPLOAD:
        return ReadResult.KEPT_OUT
    if variable.data_type is DataType.DOMAIN and not domains:
        return ReadResult.DOMAIN
    return None


def _read(node: RemoteNode, variable: Variable, block: Block, patience: Patience) -> Procedure[Reading]:
    answer = yield from ask(
        node, variable.index, variable.subindex, block if variable.data_type is DataType.DOMAIN else False, patience
    )
    return reading_of(variable, answer)


def reading_of(variable: Variable, answer: bytes | SdoTransferError) -> Reading:
    """Return the reading of an object that follows from an answer."""
    if isinstance(answer, SdoTransferError):
        if answer.origin is AbortOrigin.CONTESTED:
            result = ReadResult.CONTESTED
        elif answer.origin is not AbortOrigin.PEER:
            result = ReadResult.NO_ANSWER
        else:
            result = _REFUSALS.get(answer.abort_code, ReadResult.REFUSED)
        return Reading(variable, result, abort_code=answer.abort_code)
    try:
        return Reading(variable, ReadResult.READ, answer, variable.decode(answer))
    except ValueRangeError:
        return Reading(variable, ReadResult.WRONG_LENGTH, answer)


class Patience:
    """Counts how many more unanswered requests are allowed before a device counts as gone."""

    def __init__(self) -> None:
        self._left = 1  # the first request shows whether the device is there

    def note(self, answer: bytes | SdoTransferError) -> None:
        """Take note of an answer. Raises it, if it is a failure that shows that the device is gone."""
        if not isinstance(answer, SdoTransferError) or answer.origin is AbortOrigin.PEER:
            self._left = MAX_SILENT
            return
        self._left -= 1
        if not self._left or answer.abort_code == AbortCode.NO_SDO_CONNECTION:
            raise answer


def ask(node: RemoteNode, index: int, subindex: int, block: Block, patience: Patience) -> Procedure[bytes | SdoTransferError]:
    """Read an object; return its bytes or the failure. Raises SdoTransferError if the device is gone. patience: says when the
    device counts as gone. block: see `Block`."""
    answer: bytes | SdoTransferError
    try:
        answer = yield from upload_again(node, index, subindex, block)
    except SdoTransferError as failed:
        answer = failed
    patience.note(answer)
    return answer


def upload_again(node: RemoteNode, index: int, subindex: int, block: Block) -> Procedure[bytes]:
    """Read an object, once more if the first transfer broke or got no answer. Raises SdoTransferError if the second one fails
    too. block: see `Block`."""
    try:
        return (yield from upload(node.sdo, index, subindex, block=block))
    except SdoTransferError as failed:
        if not _is_of_transfer(failed):
            raise
    return (yield from upload(node.sdo, index, subindex, block=block))


def _is_of_transfer(failed: SdoTransferError) -> bool:
    """Return whether a failure concerns only the transfer, and says nothing about the object or the device."""
    if failed.origin is AbortOrigin.PEER:
        return failed.abort_code >> 24 == _SERVICE_ERROR
    return failed.abort_code != AbortCode.NO_SDO_CONNECTION


def report(node: RemoteNode, reading: Reading, done: int, total: int) -> Procedure[None]:
    """Report an object by an ObjectRead event. reading: what became of it. done, total: objects."""
    news = ObjectRead(node.node_id, reading.variable.index, reading.variable.subindex, reading.result, done, total)
    yield from act(lambda now: node.out.events.append(news))


def same_value(variable: Variable, one: Value | None, other: Value | None) -> bool:
    """Return whether two values of an object have the same bytes. So 0.1 equals the REAL32 nearest to it.

    None, an unknown value, equals only None.
    """
    if one is None or other is None:
        return one is other
    try:
        return variable.encode(one) == variable.encode(other)
    except ValueRangeError:  # values of two files that differ in the type
        return False
