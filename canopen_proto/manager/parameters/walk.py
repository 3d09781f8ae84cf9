"""Read a node whose objects are not known.

`walk` reads subindex 0 of every index of some ranges. If there is an object, it reads subindex 1. If there is one too, the object
is an ARRAY or a RECORD: its subindex 0 holds the highest subindex (CiA 301 v4.2.0, 7.4.4), and all up to that are read. (In a PDO
mapping, subindex 0 holds the number of valid entries; the others mean nothing.) An object's name and type come from the
standards' tables if its length agrees with them. Else its length decides: up to 8 bytes are an unsigned number, more are octets.

A walk is bounded: it tries each index once, at most 254 subindices of each object, and returns at most MAX_OBJECTS objects; a
device that answers everything would have 16 million. DEFAULT_RANGES are the usual places of objects: about 7000 indices, 5 s at
500 kbit/s. PROGRESS_STEP says how often progress is reported.

A walk cannot see access rights (an object counts as `rw` unless a table says otherwise), write-only objects and limits.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from canopen_proto import indices
from canopen_proto.datatypes import DataType, integer_type
from canopen_proto.dictionary.model import Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.machine import Event, LocalProtocolError
from canopen_proto.manager.parameters.backup import Backup, Patience, Reading, ReadResult, ask, back_up, others_doing, reading_of
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.procedures.steps import Procedure, SdoTransferError, act
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import Block

COMMUNICATION: Final = indices.COMMUNICATION_AREA
"""The communication profile area; CiA 301 v4.2.0, table 41."""
DEFAULT_RANGES: Final = (COMMUNICATION, range(0x2000, 0x2400), range(0x6000, 0x6800))
"""Communication objects, the first manufacturer-specific objects, the first device of the standardised profile area."""
MAX_OBJECTS: Final = 20_000
"""The most variables that a walk returns: ten times as many as the largest files in the field describe."""
MAX_SUBINDEX: Final = 0xFE
"""0xFF holds the structure of an object; CiA 301 v4.2.0, 7.4.4."""
PROGRESS_STEP: Final = 64
"""Indices between two WalkProgress events."""
_INTEGER_SIZES: Final = range(1, 9)


class WalkProgress(Event):
    """A walk has reached an index. done, total: numbers of indices; found: the number of objects found so far."""

    __match_args__ = ("node_id", "index", "done", "total", "found")

    def __init__(self, node_id: int, index: int, done: int, total: int, found: int) -> None:
        self.node_id = node_id
        self.index = index
        self.done = done
        self.total = total
        self.found = found


def walk(
    node: RemoteNode,
    ranges: Iterable[Sequence[int]] = DEFAULT_RANGES,
    *,
    names: ObjectDictionary | None = None,
    domains: bool = True,
) -> Procedure[Backup]:
    """Read all objects of a node at these indices. The result's `dictionary` describes them, as well as a walk can see them.

    ranges: of indices 1..0xFFFF, else LocalProtocolError. names: gives names and types to objects whose length agrees; all others
    get them from the standards' tables. domains: also read objects that are known to be DOMAINs. Raises SdoTransferError if the
    device is gone, as `back_up` does. Stops at MAX_OBJECTS variables.
    """
    indices = sorted({index for each in ranges for index in each})
    if indices and not 1 <= indices[0] <= indices[-1] <= 0xFFFF:
        raise LocalProtocolError(f"walk: indices are 0x0001..0xFFFF, not 0x{indices[0]:X}..0x{indices[-1]:X}")
    found = _Walk(node, names, domains)
    heard = node.sdo.other.count
    for done, index in enumerate(indices):
        if done % PROGRESS_STEP == 0:
            news = WalkProgress(node.node_id, index, done, len(indices), len(found.readings))
            yield from act(lambda now, news=news: node.out.events.append(news))  # type: ignore[misc]
        yield from found.walk_index(index)
        if len(found.readings) >= MAX_OBJECTS:
            break
    return Backup(node.node_id, _dictionary_of(found.readings), found.readings, others_doing(node, heard))


def back_up_by_names(node: RemoteNode, names: ObjectDictionary, *, domains: bool = False) -> Procedure[Backup]:
    """Read all objects of a node that has no file of its own. domains: also read objects that are known to be DOMAINs.

    The whole communication profile area is walked: no general list of names can tell which PDOs and services a device has. Of the
    other areas, the objects in `names` are read, as by `back_up`. WalkProgress events come first, then ObjectRead events.
    """
    walked = yield from walk(node, [COMMUNICATION], names=names, domains=domains)
    rest = yield from back_up(node, names, only=[each for each in names if each.index not in COMMUNICATION], domains=domains)
    dictionary = names.with_objects(walked.dictionary.objects.values())
    return Backup(node.node_id, dictionary, walked.readings + rest.readings, walked.others_doing or rest.others_doing)


class _Walk:
    """A walk under way. names, domains: see `walk`."""

    def __init__(self, node: RemoteNode, names: ObjectDictionary | None, domains: bool) -> None:
        self.readings: list[Reading] = []
        self._node = node
        self._names = names
        self._domains = domains
        self._patience = Patience()

    def walk_index(self, index: int) -> Procedure[None]:
        """Read all objects at an index."""
        first = yield from self._ask(index, 0)
        if first is None or (isinstance(first, bytes) and len(first) != 1):
            return  # the highest subindex has one byte: an object of another length is a VAR
        if (yield from self._ask(index, 1)) is None:
            return
        highest = min(first[0], MAX_SUBINDEX) if isinstance(first, bytes) else 1
        for subindex in range(2, highest + 1):
            yield from self._ask(index, subindex)

    def _ask(self, index: int, subindex: int) -> Procedure[bytes | SdoTransferError | None]:
        """Read an object and note its reading; return the answer, None if the device does not have the object."""
        known = self._known(index, subindex)
        if known is not None and known.data_type is DataType.DOMAIN and not self._domains:
            self.readings.append(Reading(known, ReadResult.DOMAIN))
            return b""
        block: Block = "auto" if known is not None and known.data_type is DataType.DOMAIN else False
        answer = yield from ask(self._node, index, subindex, block, self._patience)
        if isinstance(answer, SdoTransferError) and answer.abort_code in ABSENT:
            return None
        self.readings.append(_reading(index, subindex, known, answer))
        return answer

    def _known(self, index: int, subindex: int) -> Variable | None:
        known = None if self._names is None else self._names.get(index, subindex)
        return find_standard(index, subindex) if known is None else known


def _reading(index: int, subindex: int, known: Variable | None, answer: bytes | SdoTransferError) -> Reading:
    # What cannot be read is as it is named.
    if known is not None and (known.access.readable or isinstance(answer, SdoTransferError)):
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
