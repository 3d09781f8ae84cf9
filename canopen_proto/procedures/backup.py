"""Reading all that a node holds: for a backup, a comparison, a dump.

Theory of operation
-------------------
`back_up` asks for each readable object of the node's dictionary, one after the other, by SDO. It changes nothing in the device.
Each object ends in one `Reading`, whose `result` says what came of it; none is passed over in silence. What is not asked for:

- write-only objects, and those whose ObjFlags (bit 1) keep them out of an upload (CiA 306-1);
- DOMAINs, unless they are wanted: a DOMAIN may be a firmware image, and no line of a DCF holds one.

A device may refuse some of its objects, or not know what its EDS lists: that is noted, and the next one is asked for. Where an
answer is missing, or the transfer broke (an abort of the class "service error" says nothing of the object), the object is asked
for once more: reading changes nothing, and a frame may be lost. A device that does not answer at all is another matter: if the
very first object, or MAX_SILENT in a row, get no answer, the device is gone, and the procedure fails. It also fails if the device
is reset meanwhile, as what it said before may not be so any more.

An ObjectRead event tells of each object as it is known.

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
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.procedures.steps import Procedure, SdoFailed, act, upload
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import Block

MAX_SILENT: Final = 3
"""Objects in a row without an answer, after which the device counts as gone. One may be a device's fault, or a lost frame."""
NO_UPLOAD: Final = 2
"""ObjFlags, bit 1: refuses to be read by an upload of the whole dictionary. CiA 306-1."""


class ReadResult(StrEnum):
    """What came of one object."""

    READ = "read"
    WRITE_ONLY = "write-only"
    KEPT_OUT = "kept out"
    """Its ObjFlags forbid an upload; not asked for."""
    DOMAIN = "domain"
    """Not asked for."""
    ABSENT = "absent"
    """The device does not have it, though its dictionary does; or has no data in it, as in a history without errors."""
    REFUSED = "refused"
    """With any other abort code."""
    WRONG_LENGTH = "wrong length"
    """The bytes are no value of the object's type."""
    NO_ANSWER = "no answer"
    """Or none that makes sense."""

    @property
    def is_missing(self) -> bool:
        """Whether a complete backup would have it."""
        return self in (ReadResult.REFUSED, ReadResult.WRONG_LENGTH, ReadResult.NO_ANSWER)


_SERVICE_ERROR: Final = 0x05
"""The highest byte of abort codes that are about the protocol: toggle bit, time-out, sequence, CRC (CiA 301 v4.2.0, table 22)."""
_REFUSALS: Final[dict[int, ReadResult]] = {
    **dict.fromkeys((*ABSENT, AbortCode.NO_DATA), ReadResult.ABSENT),
    AbortCode.WRITE_ONLY: ReadResult.WRITE_ONLY,
}
"""Abort codes that say no more than that there is nothing to be read."""


@dataclass(frozen=True, slots=True)
class Reading:
    """One object. data: its bytes, where the device sent some; value: the same as a value (READ only). abort_code: of a transfer
    that failed."""

    variable: Variable
    result: ReadResult
    data: bytes | None = None
    value: Value | None = None
    abort_code: int | None = None


@dataclass(slots=True)
class Backup:
    """What a node held. dictionary: by which it was read. readings: by index and subindex."""

    node_id: int
    dictionary: ObjectDictionary
    readings: list[Reading] = field(default_factory=list)

    @property
    def values(self) -> dict[int, Value]:
        """What was read, by mux."""
        return {each.variable.mux: each.value for each in self.readings if each.value is not None}

    @property
    def counts(self) -> dict[ReadResult, int]:
        """How many objects ended in each way; only those ways that occurred."""
        counts = Counter(each.result for each in self.readings)
        return {result: counts[result] for result in ReadResult if counts[result]}

    @property
    def is_complete(self) -> bool:
        """Whether nothing is missing that should be there."""
        return not any(each.result.is_missing for each in self.readings)


class ObjectRead(Event):
    """One object of a backup is known. done, total: how many of all; total 0: not known."""

    __slots__ = ("done", "index", "result", "subindex", "total")
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

    dictionary: which objects it has; by default what the node's is. only: these objects of it. domains: DOMAINs too. block: how
    objects of variable length are read, see `Block`. Raises SdoFailed where the device is gone; see this module's text.
    """
    dictionary = node.dictionary if dictionary is None else dictionary
    backup = Backup(node.node_id, dictionary)
    wanted = list(dictionary if only is None else only)
    patience = Patience()
    for variable in wanted:
        result = _not_asked(dictionary, variable, domains)
        if result is None:
            reading = yield from _read(node, variable, block, patience)
        else:
            reading = Reading(variable, result)
        backup.readings.append(reading)
        yield from report(node, reading, len(backup.readings), len(wanted))
    return backup


def _not_asked(dictionary: ObjectDictionary, variable: Variable, domains: bool) -> ReadResult | None:
    """Why an object is not asked for; None where it is."""
    if not variable.access.readable:
        return ReadResult.WRITE_ONLY
    if (variable.object_flags | dictionary.objects[variable.index].object_flags) & NO_UPLOAD:
        return ReadResult.KEPT_OUT
    if variable.data_type is DataType.DOMAIN and not domains:
        return ReadResult.DOMAIN
    return None


def _read(node: RemoteNode, variable: Variable, block: Block, patience: Patience) -> Procedure[Reading]:
    answer = yield from ask(node, variable.index, variable.subindex, block if variable.size is None else False, patience)
    return reading_of(variable, answer)


def reading_of(variable: Variable, answer: bytes | SdoFailed) -> Reading:
    """What an answer says of an object."""
    if isinstance(answer, SdoFailed):
        if answer.origin is not AbortOrigin.PEER:
            result = ReadResult.NO_ANSWER
        else:
            result = _REFUSALS.get(answer.abort_code, ReadResult.REFUSED)
        return Reading(variable, result, abort_code=answer.abort_code)
    try:
        return Reading(variable, ReadResult.READ, answer, variable.decode(answer))
    except ValueRangeError:
        return Reading(variable, ReadResult.WRONG_LENGTH, answer)


class Patience:
    """How much silence of a device is borne."""

    def __init__(self) -> None:
        self._left = 1  # the first request shows whether anybody is there

    def note(self, answer: bytes | SdoFailed) -> None:
        """Raise what has failed where the device is gone."""
        if not isinstance(answer, SdoFailed) or answer.origin is AbortOrigin.PEER:
            self._left = MAX_SILENT
            return
        self._left -= 1
        if not self._left or answer.abort_code == AbortCode.NO_SDO_CONNECTION:
            raise answer


def ask(node: RemoteNode, index: int, subindex: int, block: Block, patience: Patience) -> Procedure[bytes | SdoFailed]:
    """An object's bytes, or why there are none. Raises SdoFailed where the device is gone."""
    answer: bytes | SdoFailed
    try:
        answer = yield from upload_again(node, index, subindex, block)
    except SdoFailed as failed:
        answer = failed
    patience.note(answer)
    return answer


def upload_again(node: RemoteNode, index: int, subindex: int, block: Block) -> Procedure[bytes]:
    """Read an object, once more if the first transfer broke or got no answer. Raises SdoFailed if the second one fails, too."""
    try:
        return (yield from upload(node.sdo, index, subindex, block=block))
    except SdoFailed as failed:
        if not _is_of_transfer(failed):
            raise
    return (yield from upload(node.sdo, index, subindex, block=block))


def _is_of_transfer(failed: SdoFailed) -> bool:
    """Whether a failure is one of the transfer, and says nothing of the object or the device."""
    if failed.origin is AbortOrigin.PEER:
        return failed.abort_code >> 24 == _SERVICE_ERROR
    return failed.abort_code != AbortCode.NO_SDO_CONNECTION


def report(node: RemoteNode, reading: Reading, done: int, total: int) -> Procedure[None]:
    """Tell of an object by an ObjectRead event."""
    news = ObjectRead(node.node_id, reading.variable.index, reading.variable.subindex, reading.result, done, total)
    yield from act(lambda now: node.out.events.append(news))


def same_value(variable: Variable, one: Value | None, other: Value | None) -> bool:
    """Whether two values of an object have the same bytes, so that 0.1 is what a REAL32 makes of it.

    None, a value that is not known, is equal to None only.
    """
    if one is None or other is None:
        return one is other
    try:
        return variable.encode(one) == variable.encode(other)
    except ValueRangeError:  # values of two files that differ in the type
        return False
