"""`Observer`: every frame of a bus in words, and what is wrong on that bus. It listens only.

    observer = Observer(dictionaries.get)
    for frame, now in recording:
        observation = observer.observe(frame, now)
        observation.meaning.text, observation.findings

RULES says what it looks for. Each finding comes with the frame that shows it. Nothing is guessed: a rule that needs what the
recording does not show (the beginning of a transfer, a mapping, the state of a node) is silent. Memory is bounded: the state of
127 nodes, and one transfer of each.

Left out: COB-IDs of other services that were changed at run time, and SDO channels beyond the first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.frame import (
    EMCY,
    ERROR_CONTROL,
    EXTENDED,
    MAX_NODE_ID,
    NMT,
    REMOTE,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    Frame,
)
from canopen_proto.frame_bits import frame_bits
from canopen_proto.indices import CONSUMER_HEARTBEAT_TIME, PRODUCER_HEARTBEAT_TIME
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Time
from canopen_proto.observer.decoding import Decoder
from canopen_proto.observer.finding import Finding
from canopen_proto.observer.meaning import Meaning
from canopen_proto.observer.node_rules import MAX_CONSUMERS, NodeRules
from canopen_proto.observer.pdo_rules import PdoRules
from canopen_proto.observer.sdo import Settled
from canopen_proto.observer.sdo_rules import SdoRules
from canopen_proto.observer.service_rules import ServiceRules

RULES: Final = {
    "toggle": "the toggle bit of a segment, or of a guarding answer, does not alternate",
    "crc": "the CRC of a block transfer does not fit its data",
    "size": "a value has another size than was announced",
    "no request": "an SDO answer without a request, or for another one",
    "sdo": "an SDO frame that does not fit the transfer",
    "two masters": "two clients use one SDO channel at the same time",
    "double id": "two nodes have one ID",
    "shared cob-id": "two nodes send PDOs with one COB-ID",
    "pdo length": "a PDO is longer or shorter than its mapping",
    "inhibit time": "a PDO or an emergency sooner than its inhibit time allows",
    "late pdo": "a PDO does not come when SYNC, or its event timer, asks for it",
    "synchronous pdo": "a synchronous PDO comes twice behind one SYNC",
    "not operational": "a PDO of a node that is not operational",
    "stopped": "an SDO to or from a node that is stopped",
    "state": "a heartbeat with a state that CiA 301 does not have",
    "nmt": "an NMT command that CiA 301 does not have",
    "two sync": "two nodes produce SYNC",
    "sync counter": "the counter of SYNC leaves a number out, or goes back",
    "late heartbeat": "a heartbeat later than its consumers allow",
    "length": "a frame of a wrong length",
    "load": "the load of the bus is over the limit",
}
"""By the name of a rule: what is wrong, in words."""

LOAD_LIMIT: Final = 0.9
"""Share of the bit rate. Above it, a bus delays what has a low priority beyond any bound that a plan gives."""
_BY_THE_NODE: Final = (EMCY, SDO_SERVER_TO_CLIENT, ERROR_CONTROL)
"""Function codes of frames that only the node itself sends."""
_MAX_TOLD: Final = 1024
"""Pairs of PDOs with one COB-ID of which it is kept that they were told: more than a bus of 127 nodes can have by mistake."""


class Observation(NamedTuple):
    """A frame in words, and what is wrong: with this frame, or at its time."""

    meaning: Meaning
    findings: tuple[Finding, ...]


class Observer:
    """See this module's text.

    dictionary_of: returns the dictionary of a node-ID, or None. bitrate: bit/s; 0 if it is not known: then no look at the load.
    """

    def __init__(
        self,
        dictionary_of: Callable[[int], ObjectDictionary | None] = lambda node_id: None,
        *,
        bitrate: int = 0,
        load_limit: float = LOAD_LIMIT,
    ) -> None:
        self._decoder = Decoder(dictionary_of)
        self._nodes = NodeRules()
        self._services = ServiceRules()
        self._timings = PdoRules(self._nodes.is_operational)
        self._channels: dict[int, SdoRules] = {}
        self._told: set[str] = set()
        self._alive: set[int] = set()  # nodes that have sent something
        self._now: Time = -NEVER
        self._load = _Load(bitrate, load_limit) if bitrate else None
        for node_id in range(1, MAX_NODE_ID + 1):
            dictionary = dictionary_of(node_id)
            if dictionary is not None:
                self._read_consumers(node_id, dictionary)

    def observe(self, frame: Frame, now: Time) -> Observation:
        """Return what a frame means, and what is wrong. Frames come in order. now: ns; an earlier one counts as the last."""
        now = self._now = max(now, self._now)
        found = self._nodes.overdue(now) + self._timings.overdue(now)
        found += self._look_at(frame, now)
        meaning = self._decoder.decode(frame)
        if not frame.flags & REMOTE:
            found += self._of_service(meaning, frame.data, now)
        pdo = self._decoder.pdo
        if pdo is not None and not pdo.is_guess and not frame.flags & REMOTE:
            size, due = len(frame.data), pdo.mapping.byte_length
            if size != due:
                found.append(Finding("pdo length", pdo.node_id, f"{pdo.name} has {size} bytes, and its mapping {due}"))
            if pdo.direction is Direction.TPDO:
                found += self._nodes.pdo(pdo.node_id, now)
            found += self._timings.came(pdo.node_id, pdo.name, now)
        settled = self._decoder.settled
        if settled is not None:
            found += self._settle(*settled)
        found += self._shared()
        if self._load is not None:
            found += self._load.add(frame, now)
        return Observation(meaning, tuple(found))

    def _of_service(self, meaning: Meaning, data: bytes, now: Time) -> list[Finding]:
        """Return what is wrong by the rules of SYNC, TIME, EMCY and LSS."""
        service, node_id = meaning.service, meaning.node_id
        if service == "SYNC":
            return self._services.sync(data) + self._timings.sync()
        if service == "EMCY":
            return self._services.length(service, node_id, data) + self._services.emergency(node_id, now)
        if service in ("TIME", "LSS"):
            return self._services.length(service, node_id, data)
        if service == "boot-up":
            self._services.booted(node_id)
            self._timings.booted(node_id)
        return []

    def _settle(self, node_id: int, settled: Settled) -> list[Finding]:
        """Take note of a value that a node holds."""
        index, subindex = settled.place
        value = int.from_bytes(settled.data[:4], "little")
        if index == CONSUMER_HEARTBEAT_TIME and len(settled.data) == 4:
            self._nodes.consumer(node_id, subindex, value)
        elif index == PRODUCER_HEARTBEAT_TIME:
            self._nodes.producer(node_id, value * MILLISECOND)
        self._timings.settle(node_id, index, subindex, value)
        return self._services.settle(node_id, index, value)

    def _look_at(self, frame: Frame, now: Time) -> list[Finding]:
        """Return what is wrong by the rules of NMT, error control and SDO."""
        data = frame.data
        if frame.flags & (REMOTE | EXTENDED):
            if frame.flags == REMOTE and frame.can_id & 0x780 == ERROR_CONTROL:
                self._nodes.asked(frame.can_id & 0x7F)
            return []
        if frame.can_id == NMT:
            if len(data) != 2:
                return [Finding("length", 0, f"an NMT command of {len(data)} bytes; it has two")]
            self._timings.commanded(data[1])
            return self._nodes.command(data[0], data[1], now)
        function, node_id = frame.can_id & 0x780, frame.can_id & 0x7F
        if not node_id:
            return []
        if function in _BY_THE_NODE:
            self._alive.add(node_id)
        if function == ERROR_CONTROL:
            return self._nodes.error_control(node_id, data, now)
        if function == SDO_CLIENT_TO_SERVER:
            return self._nodes.sdo(node_id, now, is_answer=False) + self._channel(node_id).client(data, now)
        if function == SDO_SERVER_TO_CLIENT:
            return self._nodes.sdo(node_id, now, is_answer=True) + self._channel(node_id).server(data, now)
        return []

    def _channel(self, node_id: int) -> SdoRules:
        if node_id not in self._channels:
            self._channels[node_id] = SdoRules(node_id)
        return self._channels[node_id]

    def _shared(self) -> list[Finding]:
        """Return PDOs of two nodes with one COB-ID that were not told yet. A file alone is no evidence: both have to be there."""
        found = []
        for key, first, second in self._decoder.shared_cob_ids():
            if not {first.node_id, second.node_id} <= self._alive:
                continue
            text = f"{first.name} of node {first.node_id} and {second.name} of node {second.node_id} have the COB-ID 0x{key:X}"
            if text not in self._told and len(self._told) < _MAX_TOLD:
                self._told.add(text)
                found.append(Finding("shared cob-id", second.node_id, text))
        return found

    def _read_consumers(self, node_id: int, dictionary: ObjectDictionary) -> None:
        for subindex in range(1, MAX_CONSUMERS + 1):
            variable = dictionary.get(CONSUMER_HEARTBEAT_TIME, subindex)
            if variable is None:
                break
            value = variable.initial_of(node_id)
            if isinstance(value, int):
                self._nodes.consumer(node_id, subindex, value)


class _Load:
    """The load of the bus in each second. A second begins with a frame, so that one that is over the limit is one in truth."""

    def __init__(self, bitrate: int, limit: float) -> None:
        self._bitrate = bitrate
        self._limit = limit
        self._begin: Time | None = None
        self._bits = 0

    def add(self, frame: Frame, now: Time) -> list[Finding]:
        found = []
        if self._begin is None or now - self._begin >= SECOND:
            elapsed = SECOND if self._begin is None else now - self._begin
            share = self._bits * SECOND / (elapsed * self._bitrate)
            if share > self._limit:
                text = f"the load was {share * 100:.0f} % of {self._bitrate} bit/s in the last {elapsed / SECOND:.3g} s"
                found.append(Finding("load", 0, f"{text}; the limit is {self._limit * 100:.0f} %"))
            self._begin, self._bits = now, 0
        self._bits += frame_bits(frame)
        return found
