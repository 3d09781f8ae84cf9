"""Reading a node of which nobody knows what objects it has.

Theory of operation
-------------------
`walk` asks for subindex 0 of every index of some ranges. Where there is an object, it asks for subindex 1; where that is too, it
is an ARRAY or a RECORD, whose subindex 0 tells the highest subindex (CiA 301 v4.2.0, 7.4.4), and all up to that are asked for.
(Of a PDO mapping it tells how many entries count; the others say nothing.) What an object is called, and its type, come from the
standards' tables where its length agrees with them; else its length decides: up to 8 bytes are an unsigned number, all else is
octets.

A walk is bounded: each index is asked for once, each object for at most 254 subindices, and it gives MAX_OBJECTS objects at most,
since a device that answers everything has 16 million. DEFAULT_RANGES are where objects usually are: about 7000 indices, 5 s at
500 kbit/s; PROGRESS_STEP says how often progress is told.

What it cannot see: access rights (all count as `rw` where no table says otherwise), objects that can only be written, limits.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from canopen_proto.datatypes import DataType, integer_type
from canopen_proto.dictionary.model import Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.machine import Event, LocalProtocolError, event
from canopen_proto.procedures.backup import Backup, Patience, Reading, ReadResult, ask, reading_of
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.procedures.steps import Procedure, SdoFailed, act
from canopen_proto.remote_node import RemoteNode

DEFAULT_RANGES: Final = (range(0x1000, 0x2000), range(0x2000, 0x2400), range(0x6000, 0x6800))
"""Communication objects, the first of the manufacturer's, the first device of the standardised profile area."""
MAX_OBJECTS: Final = 20_000
"""Variables that a walk gives: ten times what the largest files in the field describe."""
MAX_SUBINDEX: Final = 0xFE
"""0xFF tells the structure of an object; CiA 301 v4.2.0, 7.4.4."""
PROGRESS_STEP: Final = 64
"""Indices between two WalkProgress events."""
_INTEGER_SIZES: Final = range(1, 9)


@event
class WalkProgress(Event):
    """A walk has come to an index. done, total: indices; found: objects that have answered."""

    index: int
    done: int
    total: int
    found: int


def walk(node: RemoteNode, ranges: Iterable[Sequence[int]] = DEFAULT_RANGES) -> Procedure[Backup]:
    """Read what a node has at these indices; `dictionary` of the result describes it as far as that can be seen.

    ranges: of indices 1..0xFFFF, else LocalProtocolError. Raises SdoFailed where the device is gone, as `back_up` does. Stops
    with MAX_OBJECTS variables.
    """
    indices = sorted({index for each in ranges for index in each})
    if indices and not 1 <= indices[0] <= indices[-1] <= 0xFFFF:
        raise LocalProtocolError(f"walk: indices are 0x0001..0xFFFF, not 0x{indices[0]:X}..0x{indices[-1]:X}")
    patience = Patience()
    readings: list[Reading] = []
    for done, index in enumerate(indices):
        if done % PROGRESS_STEP == 0:
            news = WalkProgress(node.node_id, index, done, len(indices), len(readings))
            yield from act(lambda now, news=news: node.out.events.append(news))  # type: ignore[misc]
        yield from _walk_index(node, index, readings, patience)
        if len(readings) >= MAX_OBJECTS:
            break
    return Backup(node.node_id, _dictionary_of(readings), readings)


def _walk_index(node: RemoteNode, index: int, readings: list[Reading], patience: Patience) -> Procedure[None]:
    first = yield from ask(node, index, 0, "auto", patience)
    if _is_absent(first):
        return
    readings.append(_reading(index, 0, first))
    if isinstance(first, bytes) and len(first) != 1:
        return  # the highest subindex has one byte: this is a VAR
    second = yield from ask(node, index, 1, "auto", patience)
    if _is_absent(second):
        return
    readings.append(_reading(index, 1, second))
    highest = min(first[0], MAX_SUBINDEX) if isinstance(first, bytes) else 1
    for subindex in range(2, highest + 1):
        answer = yield from ask(node, index, subindex, "auto", patience)
        if not _is_absent(answer):
            readings.append(_reading(index, subindex, answer))


def _is_absent(answer: bytes | SdoFailed) -> bool:
    return isinstance(answer, SdoFailed) and answer.abort_code in ABSENT


def _reading(index: int, subindex: int, answer: bytes | SdoFailed) -> Reading:
    known = find_standard(index, subindex)
    if known is not None and known.access.readable:
        reading = reading_of(known, answer)
        if reading.result is not ReadResult.WRONG_LENGTH:
            return reading
    data_type = DataType.OCTET_STRING
    if isinstance(answer, bytes) and len(answer) in _INTEGER_SIZES:
        data_type = integer_type(len(answer))
    name = f"object_{index:04x}" + (f":{subindex:02x}" if subindex else "")
    return reading_of(Variable(index, subindex, name, data_type), answer)


def _dictionary_of(readings: list[Reading]) -> ObjectDictionary:
    by_index: dict[int, list[Variable]] = {}
    for each in readings:
        by_index.setdefault(each.variable.index, []).append(each.variable)
    return ObjectDictionary(Object.of(variables[0].name.partition(":")[0], variables) for variables in by_index.values())
