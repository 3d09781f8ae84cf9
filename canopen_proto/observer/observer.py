"""`Observer`: every frame of a bus in words, and what is wrong on that bus. It listens only.

    observer = Observer(dictionaries.get)
    for frame, now in recording:
        observation = observer.observe(frame, now)
        observation.meaning.text, observation.findings

It begins with the predefined connection set (CiA 301 v4.2.0, 7.3.3) and with what the devices' files say. It uses the COB-IDs,
SDO channels and PDOs of each device from the moment when the recording shows them (parameters.py).

RULES says what it looks for. Each finding comes with the frame that shows it. Nothing is guessed: a rule that needs what the
recording does not show (the beginning of a transfer, a mapping, the state of a node) is silent. Memory is bounded: the state and
the parameters of 127 nodes, and one transfer for each SDO channel.

Left out: services of other standards but LSS and the flying master (CiA 302-2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Final, TypeAlias

from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.explained import counted
from canopen_proto.frame import (
    ALL_NODE_IDS,
    EMCY,
    ERROR_CONTROL,
    FUNCTION,
    KEY_EXTENDED,
    KEY_REMOTE,
    MAX_NODE_ID,
    NMT,
    RPDO4,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    SYNC,
    TIME,
    TPDO1,
    TPDO4,
    Frame,
    RoutingKey,
)
from canopen_proto.frame_bits import frame_bits
from canopen_proto.indices import CONSUMER_HEARTBEAT_TIME, DEVICE_TYPE, IDENTITY_OBJECT, PRODUCER_HEARTBEAT_TIME
from canopen_proto.lss import messages as lss
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Time
from canopen_proto.multiplexer import index_of, subindex_of
from canopen_proto.nmt import STATE_OF_BYTE, NmtState
from canopen_proto.observer import words
from canopen_proto.observer.finding import AT_ONCE, BusFinding, Gaps, duration_text
from canopen_proto.observer.meaning import Meaning, Say
from canopen_proto.observer.node_rules import MAX_CONSUMERS, NodeRules
from canopen_proto.observer.parameters import Channel, CobIdService, ObservedParameters, channels_of, services_of
from canopen_proto.observer.pdo import PROFILE, STATUSWORDS, ObservedPdo, ObservedPdos
from canopen_proto.observer.pdo_rules import PdoTimings
from canopen_proto.observer.sdo import SdoFollower, Settled
from canopen_proto.observer.sequences import Sequences, Summary
from canopen_proto.observer.service_rules import ServiceRules
from canopen_proto.pdo.settings import place_of
from canopen_proto.sdo.codec import REQUESTS, SdoFrame

RULES: Final = {
    "toggle": "the toggle bit of a segment, or of a guarding answer, does not alternate",
    "crc": "the CRC of a block transfer does not fit its data",
    "size": "a value has another size than was announced",
    "missing": "frames are missing here",
    "copied": "a frame is there twice",
    "sdo": "an SDO frame that the standard does not have, or that contradicts the transfer",
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
    "boot-up": "a node boots in the middle of operation",
    "two sync": "two nodes produce SYNC",
    "sync counter": "the counter of SYNC is out of its range",
    "late heartbeat": "a heartbeat later than its consumers allow, or a node that sent some is silent",
    "length": "a frame of a wrong length",
    "load": "the load of the bus is over the limit",
}
"""By the name of a rule: what is wrong, in words."""

LOAD_LIMIT: Final = 0.9
"""Share of the bit rate. Above it, a bus delays what has a low priority beyond any bound that a plan gives."""
_SILENCE: Final = 50 * MILLISECOND
"""A full bus has no pause as long. Behind one, frames may come that were held back: they say nothing about the load."""
_MAX_TOLD: Final = 1024
"""Pairs of PDOs with one COB-ID of which it is kept that they were told: more than a bus of 127 nodes can have by mistake."""
_EMPTY: Final = ObjectDictionary((), source="nothing")
_BOOT_UP: Final = b"\0"
_TOGGLE: Final = 0x80
_PRODUCER_TIME: Final = PRODUCER_HEARTBEAT_TIME.to_bytes(2, "little") + b"\0"
_TPDO: Final = Direction.TPDO  # found in a tenth of the time, for each PDO
_DOWNLOADS: Final = (SdoFrame.DOWNLOAD, SdoFrame.BLOCK_DOWNLOAD)

_Route: TypeAlias = Callable[[Frame, Time, list[BusFinding]], Meaning]
"""Takes a frame of one service of one node. Puts what is wrong into the list."""


class Observation:
    """A frame in words, and what is wrong: with this frame, or at its time.

    settled: the value that a device is known to hold by this frame, of an SDO transfer that is over. bits: of the frame on the
    wire; 0 if the observer was given no bit rate.
    summaries: of sequences of frames that are over (sequences.py), with this frame or before it. is_part: the frame belongs to
    such a sequence, so a summary of it comes with this frame, with one behind it, or by `Observer.unfinished`.
    statuswords: of drives (CiA 402) that the node itself tells with this frame, each with its index: 0x6041, 0x6841 ...
    """

    __slots__ = ("bits", "findings", "is_part", "meaning", "settled", "statuswords", "summaries")

    def __init__(
        self,
        meaning: Meaning,
        findings: tuple[BusFinding, ...],
        settled: Settled | None,
        bits: int,
        is_part: bool,
        summaries: tuple[Summary, ...],
        statuswords: tuple[tuple[int, int], ...],
    ) -> None:
        self.meaning = meaning
        self.findings = findings
        self.settled = settled
        self.bits = bits
        self.is_part = is_part
        self.summaries = summaries
        self.statuswords = statuswords

    def behind(self, finding: BusFinding) -> Observation:
        """Return the same with one finding more, before its own."""
        findings = (finding, *self.findings)
        return Observation(self.meaning, findings, self.settled, self.bits, self.is_part, self.summaries, self.statuswords)


class Observer:
    """See this module's text.

    dictionary_of: returns the dictionary of a node-ID, or None. bitrate: bit/s; 0 if it is not known: then no look at the load.
    drives: nodes of which it is known otherwise that they are drives: PDOs.csv may describe their PDOs (pdo.py). load_limit:
    share of the bit rate, 0 to 1, above which the load is a finding. exact: all frames are there, with the times of the bus
    itself, as in a simulation whose frames take no time; else frames that come closer than any bus brings them were queued
    (AT_ONCE), and a pause of the whole bus may be one of the recorder.
    """

    def __init__(
        self,
        dictionary_of: Callable[[int], ObjectDictionary | None] = lambda node_id: None,
        *,
        bitrate: int = 0,
        load_limit: float = LOAD_LIMIT,
        drives: Iterable[int] = (),
        exact: bool = False,
    ) -> None:
        self._dictionaries = {node_id: dictionary_of(node_id) or _EMPTY for node_id in ALL_NODE_IDS}
        self._parameters = ObservedParameters(self._dictionaries)
        self._pdos = ObservedPdos(self._parameters)
        self._cob_ids: dict[int, tuple[tuple[RoutingKey, CobIdService, int], ...]] = {}  # by node-ID
        self._channels: dict[int, tuple[Channel, ...]] = {}  # by node-ID
        self._followers: dict[Channel, SdoFollower] = {}  # those that were heard
        self._routes: dict[RoutingKey, _Route] = {}  # those that were needed since the last change
        self._assigned: dict[RoutingKey, _Route] | None = None  # those that parameters say
        self._gaps = Gaps()
        self._is_exact = exact
        self._nodes = NodeRules(self._gaps)
        self._services = ServiceRules(self._gaps)
        self._timings = PdoTimings(self._nodes.is_operational, self._gaps)
        self._sequences = Sequences()
        self._told: set[str] = set()
        self._alive: set[int] = set()  # nodes that have sent something
        self._is_shared_told = True  # that the nodes alive share COB-IDs
        self._now: Time = -NEVER
        self._heard: Time = -NEVER  # the last frame
        self._load = _Load(bitrate, load_limit) if bitrate else None
        self._settled: Settled | None = None  # by this frame
        self._lengths: dict[ObservedPdo, int] = {}  # those that came: the wrong length of the last one, or 0
        self._statuswords: tuple[tuple[int, int], ...] = ()  # by this frame
        for node_id in drives:
            self._pdos.identified(node_id, DEVICE_TYPE, PROFILE)
        for node_id, dictionary in self._dictionaries.items():
            self._renew(node_id)
            self._read_consumers(node_id, dictionary)

    def observe(self, frame: Frame, now: Time) -> Observation:
        """Return what a frame means, and what is wrong. Frames come in order. now: ns; an earlier one counts as the last."""
        self._gaps.is_at_once = not self._is_exact and now - self._now < AT_ONCE
        if now > self._now:
            self._now = now
        else:
            now = self._now
        found: list[BusFinding] = []
        if now >= self._nodes.deadline or now >= self._timings.deadline:
            self._late(now, found)
        self._heard = now
        sequences = self._sequences
        if now >= sequences.deadline:
            sequences.overdue(now)
        route = self._routes.get(frame.key)
        if route is None:
            route = self._find_route(frame.key)
        meaning = route(frame, now, found)
        if not self._is_shared_told:
            self._is_shared_told = True
            found += self._shared()
        bits = 0 if self._load is None else self._load.add(frame, now, found)
        settled, self._settled = self._settled, None
        statuswords, self._statuswords = self._statuswords, ()
        findings = tuple(found) if found else ()
        if sequences.is_part or sequences.ended:
            is_part, summaries = sequences.take()
            return Observation(meaning, findings, settled, bits, is_part, summaries, statuswords)
        return Observation(meaning, findings, settled, bits, False, (), statuswords)

    def _late(self, now: Time, found: list[BusFinding]) -> None:
        """Tell what has not come in time. found: takes the findings.

        Where several nodes became late while no frame was heard at all, that is one cause, and none of them is to blame: the
        recorder stood still, its cable was off, or its clock was set. A simulation has no recorder.
        """
        silent = self._nodes.silent_in_pause(now) | self._timings.silent_in_pause(now)
        if len(silent) > 1 and not self._is_exact:
            pause, names = duration_text(now - self._heard), ", ".join(map(str, sorted(silent)))
            self._gaps.missing(0, f"no frame at all for {pause}, and nodes {names} were due", now, found)
            self._not_heard(now)
        found += self._nodes.overdue(now)
        found += self._timings.overdue(now)

    def _not_heard(self, now: Time) -> None:
        """Take note that frames were not heard: what is missing until now may be one of them."""
        self._nodes.lost(now)
        self._timings.lost()
        self._services.lost()

    def idle(self, now: Time) -> tuple[tuple[BusFinding, ...], tuple[Summary, ...]]:
        """Return what is wrong because nothing comes, and the sequences that a silence has ended. now: ns; all frames before it
        have been observed."""
        now = self._now = max(now, self._now)
        found = self._nodes.overdue(now) + self._timings.overdue(now)
        self._sequences.overdue(now)
        _, summaries = self._sequences.take()
        return tuple(found), summaries

    def lost(self, text: str, now: Time) -> BusFinding:
        """Take the receiver's own word that it lost frames here (an overrun), and return it as a finding.

        What such frames would have shown is no other finding then. text: the receiver's words. now: ns, as for `observe`.
        """
        self._now = max(now, self._now)
        self._not_heard(self._now)
        return self._gaps.lost(text, self._now)

    def learn(self, node_id: int, index: int, subindex: int, data: bytes) -> None:
        """Take a communication parameter that a device is known to hold, because somebody has read or written it elsewhere: a
        COB-ID, a mapping. It counts like one that the recording has shown, until the device boots. data: little-endian."""
        if self._parameters.settle(node_id, index, subindex, data):
            self._renew(node_id, index)

    def unfinished(self) -> tuple[Summary, ...]:
        """Return the sequences that are not over yet, and forget them: behind the last frame of a recording."""
        self._sequences.overdue(NEVER)
        _, summaries = self._sequences.take()
        return summaries

    # ---- which service has a COB-ID ----

    def _find_route(self, key: RoutingKey) -> _Route:
        """Return who takes the frames with a routing key. It is kept, but for 29-bit identifiers that nobody has: of these there
        are too many."""
        route = self._known_route(key)
        if route is None:
            if key & KEY_EXTENDED:
                return partial(_plain, "?", 0, words.of_extended)
            route = self._predefined(key)
        self._routes[key] = route
        return route

    def _known_route(self, key: RoutingKey) -> _Route | None:
        """Return the route by what the recording or the files say, or None."""
        data_key = RoutingKey(key & ~KEY_REMOTE)
        pdo = self._pdos.find(data_key)
        pdos = (pdo,) if pdo is not None else self._pdos.guesses(data_key)
        if pdos:
            if key & KEY_REMOTE:
                return partial(_plain, pdos[0].name, pdos[0].node_id, words.of_request)
            return partial(self._pdo, pdos[0]) if pdo is not None else partial(self._one_of, pdos)
        if self._assigned is None:
            self._assigned = self._assignments()
        return self._assigned.get(key)

    def _assignments(self) -> dict[RoutingKey, _Route]:
        """Return the routes of what is not where the predefined connection set has it. The lower node-ID goes first."""
        routes: dict[RoutingKey, _Route] = {}
        channels = set()
        for node_id in self._dictionaries:
            for key, service, whose in self._cob_ids[node_id]:
                routes.setdefault(key, self._service_route(service, whose))
            for channel in self._channels[node_id]:
                channels.add(channel)
                routes.setdefault(channel.to_server, partial(self._request, channel))
                routes.setdefault(channel.to_client, partial(self._answer, channel))
        for gone in self._followers.keys() - channels:
            if gone != _first_channel(gone.node_id):
                del self._followers[gone]
        return routes

    def _service_route(self, service: CobIdService, node_id: int) -> _Route:
        if service is CobIdService.EMCY:
            return partial(self._emergency, node_id)
        return self._sync if service is CobIdService.SYNC else self._time

    def _predefined(self, key: RoutingKey) -> _Route:
        """Return the route by the predefined connection set, of 11-bit identifiers. CiA 301 v4.2.0, 7.3.3"""
        function, node_id = key & FUNCTION, key & MAX_NODE_ID
        if key & KEY_REMOTE:
            if node_id and function == ERROR_CONTROL:
                return partial(self._guarding_request, node_id)
            if node_id and TPDO1 <= function <= TPDO4:
                return partial(_plain, _pdo_name(function), node_id, words.of_request)
            return partial(_plain, "?", 0, words.of_remote)
        if key == NMT:
            return self._nmt
        if key == SYNC:
            return self._sync
        if key == TIME:
            return self._time
        if key in (lss.FROM_MASTER, lss.FROM_SLAVE):
            return self._lss
        if key in words.NEGOTIATION:
            return partial(_plain, "NMT master", 0, words.of_negotiation)
        if node_id:
            if function == EMCY:
                return partial(self._emergency, node_id)
            if function == SDO_CLIENT_TO_SERVER:
                return partial(self._request, _first_channel(node_id))
            if function == SDO_SERVER_TO_CLIENT:
                return partial(self._answer, _first_channel(node_id))
            if function == ERROR_CONTROL:
                return partial(self._error_control, node_id)
            if TPDO1 <= function <= RPDO4:
                return partial(_plain, _pdo_name(function), node_id, words.of_bytes)
        return partial(_plain, "?", 0, words.of_bytes)

    def _renew(self, node_id: int, index: int | None = None) -> None:
        """Take note that communication parameters of a device may have changed; index: only those of this object."""
        if index is None or place_of(index) is not None:
            self._pdos.renew(node_id, index)
            self._is_shared_told = False
        if index is None or place_of(index) is None:
            self._cob_ids[node_id] = tuple(services_of(self._parameters, node_id))
            self._channels[node_id] = tuple(channels_of(self._parameters, node_id))
            self._assigned = None
        self._routes.clear()
        self._lengths.clear()

    # ---- the services ----

    def _nmt(self, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        data = frame.data
        if len(data) == 2:
            self._timings.commanded(data[1])
            found += self._nodes.command(data[0], data[1], now)
            self._sequences.command(data[0], data[1], now)
        else:
            found.append(BusFinding("length", 0, f"an NMT command of {counted(len(data), 'byte')}; it has two"))
        node_id = data[1] if len(data) > 1 and data[1] <= MAX_NODE_ID else 0
        return Meaning("NMT", node_id, words.of_nmt, frame)

    def _error_control(self, node_id: int, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        data = frame.data
        self._lives(node_id)
        found += self._nodes.error_control(node_id, data, now)
        service = "heartbeat"
        if data == _BOOT_UP:
            service = "boot-up"
            self._sequences.booted(node_id, now)
            self._services.booted(node_id)
            self._timings.booted(node_id)
            for channel, follower in self._followers.items():
                if channel.node_id == node_id:
                    follower.booted()
            self._nodes.no_consumers(node_id)  # it has its power-on values again
            self._read_consumers(node_id, self._dictionaries[node_id])
            if self._parameters.booted(node_id):
                self._renew(node_id)
        elif len(data) == 1 and data[0] & _TOGGLE:
            service = "guarding"
        if len(data) == 1 and STATE_OF_BYTE[data[0]] is NmtState.OPERATIONAL:
            self._sequences.operational(node_id, now)
        return Meaning(service, node_id, words.of_error_control, frame)

    def _guarding_request(self, node_id: int, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        self._nodes.asked(node_id)
        return Meaning("guarding", node_id, words.of_guarding_request, frame)

    def _sync(self, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        self._services.sync(frame.data, now, found)
        self._timings.sync(now, found)
        return Meaning("SYNC", 0, words.of_sync, frame)

    def _time(self, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        found += self._services.length("TIME", 0, frame.data)
        return Meaning("TIME", 0, words.of_time, frame)

    def _lss(self, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        found += self._services.length("LSS", 0, frame.data)
        self._services.lss(frame.data, now, found, by_master=frame.key == lss.FROM_MASTER)
        self._sequences.lss(frame.data, now, by_master=frame.key == lss.FROM_MASTER)
        return Meaning("LSS", 0, words.of_lss, frame)

    def _emergency(self, node_id: int, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        self._lives(node_id)
        found += self._services.length("EMCY", node_id, frame.data)
        found += self._services.emergency(node_id, now)
        return Meaning("EMCY", node_id, words.of_emergency, frame)

    def _one_of(self, pdos: tuple[ObservedPdo, ...], frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        """Take a PDO that PDOs.csv describes: the first one with its length. A frame of another length is none of these."""
        for pdo in pdos:
            if pdo.byte_length == len(frame.data):
                self._statuswords = pdo.statuswords(frame.data) if pdo.has_statusword else ()
                return Meaning(pdo.name, pdo.node_id, pdo.say, frame)
        return Meaning(_pdo_name(frame.can_id & FUNCTION), frame.can_id & MAX_NODE_ID, words.of_bytes, frame)

    def _pdo(self, pdo: ObservedPdo, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        if len(frame.data) != pdo.byte_length:
            self._odd_length(pdo, len(frame.data), now, found)
        else:
            self._lengths[pdo] = 0
            if pdo.has_statusword:
                self._statuswords = pdo.statuswords(frame.data)
        if pdo.direction is _TPDO:
            self._nodes.pdo(pdo.node_id, now, found)
        self._timings.came(pdo.node_id, pdo.name, frame.data, now, found)
        return Meaning(pdo.name, pdo.node_id, pdo.say, frame)

    def _odd_length(self, pdo: ObservedPdo, size: int, now: Time, found: list[BusFinding]) -> None:
        """A PDO has another length than its mapping. One with the right length proves the mapping: else its change is missing."""
        text = f"{pdo.name} has {size} bytes, and its mapping {pdo.byte_length}"
        last = self._lengths.get(pdo)
        if last is None and pdo.is_recorded:
            self._gaps.missing(pdo.node_id, f"{text}, which no PDO had yet", now, found)
        elif last != size:
            found.append(BusFinding("pdo length", pdo.node_id, text, is_certain=last is not None))
            self._lengths[pdo] = size

    def _request(self, channel: Channel, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        self._nodes.sdo(channel.node_id, now, found, is_answer=False)
        if frame.data[1:4] == _PRODUCER_TIME and REQUESTS[frame.data[0]] in _DOWNLOADS:
            self._nodes.is_to_begin(channel.node_id)
        follower = self._follower(channel)
        meaning = follower.take(frame, now, found, is_client=True)
        self._sequences.sdo(channel.node_id, None, follower.aborted, now)
        return meaning

    def _answer(self, channel: Channel, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
        self._lives(channel.node_id)
        self._nodes.sdo(channel.node_id, now, found, is_answer=True)
        follower = self._follower(channel)
        meaning = follower.take(frame, now, found, is_client=False)
        self._sequences.sdo(channel.node_id, follower.settled, follower.aborted, now)
        if follower.settled is not None:
            self._settled = follower.settled
            found += self._settle(follower.settled, now)
        return meaning

    def _follower(self, channel: Channel) -> SdoFollower:
        follower = self._followers.get(channel)
        if follower is None:
            follower = self._followers[channel] = SdoFollower(channel.node_id, self._dictionaries[channel.node_id], self._gaps)
        return follower

    def _settle(self, settled: Settled, now: Time) -> list[BusFinding]:
        """Take note of a value that a node holds."""
        node_id, place, data, is_read = settled
        index, subindex, value = index_of(place), subindex_of(place), int.from_bytes(data[:4], "little")
        if index == CONSUMER_HEARTBEAT_TIME and len(data) == 4:
            self._nodes.consumer(node_id, subindex, value)
        elif index == PRODUCER_HEARTBEAT_TIME:
            self._nodes.producer(node_id, value * MILLISECOND, now)
        elif index == DEVICE_TYPE or (index == IDENTITY_OBJECT and subindex == 1):
            if self._pdos.identified(node_id, index, value):
                self._routes.clear()
        elif subindex == 0 and index in STATUSWORDS:
            self._statuswords = ((index, value & 0xFFFF),)
        self._timings.settle(node_id, index, subindex, value)
        if not is_read:
            self._parameters.store(node_id, index, subindex, data)
        if self._parameters.settle(node_id, index, subindex, data):
            self._renew(node_id, index)
        return self._services.settle(node_id, index, value)

    def _lives(self, node_id: int) -> None:
        """Take note that a node has sent a frame that only the node itself sends."""
        if node_id not in self._alive:
            self._alive.add(node_id)
            self._is_shared_told = False

    def _shared(self) -> list[BusFinding]:
        """Return PDOs of two nodes with one COB-ID that were not told yet. A file alone is no evidence: both have to be there."""
        found = []
        for key, first, second in self._pdos.shared():
            if not {first.node_id, second.node_id} <= self._alive:
                continue
            text = f"{first.name} of node {first.node_id} and {second.name} of node {second.node_id} have the COB-ID 0x{key:X}"
            if text not in self._told and len(self._told) < _MAX_TOLD:
                self._told.add(text)
                found.append(BusFinding("shared cob-id", second.node_id, text, is_certain=False))
        return found

    def _read_consumers(self, node_id: int, dictionary: ObjectDictionary) -> None:
        for subindex in range(1, MAX_CONSUMERS + 1):
            variable = dictionary.get(CONSUMER_HEARTBEAT_TIME, subindex)
            if variable is None:
                break
            value = variable.initial_of(node_id)
            if isinstance(value, int):
                self._nodes.consumer(node_id, subindex, value)


def _plain(service: str, node_id: int, say: Say, frame: Frame, now: Time, found: list[BusFinding]) -> Meaning:
    """Take a frame of a service without rules."""
    return Meaning(service, node_id, say, frame)


def _first_channel(node_id: int) -> Channel:
    """Return the predefined SDO channel of a node."""
    return Channel(RoutingKey(SDO_CLIENT_TO_SERVER + node_id), RoutingKey(SDO_SERVER_TO_CLIENT + node_id), node_id)


def _pdo_name(function: int) -> str:
    """Return the name of the PDO with a function code: TPDO1 is 3, RPDO1 4, TPDO2 5 ..."""
    number = (function >> 7) - (TPDO1 >> 7)
    return f"{'RPDO' if number % 2 else 'TPDO'} {number // 2 + 1}"


class _Load:
    """The load of the bus in each second. A second begins with a frame, so that one that is over the limit is one in truth."""

    def __init__(self, bitrate: int, limit: float) -> None:
        self._bitrate = bitrate
        self._limit = limit
        self._begin: Time | None = None
        self._last: Time = 0
        self._is_behind_silence = False  # what was held back may come in this second
        self._bits = 0

    def add(self, frame: Frame, now: Time, found: list[BusFinding]) -> int:
        """Count a frame, and return its bits on the wire."""
        if self._begin is None or now - self._begin >= SECOND:
            elapsed = SECOND if self._begin is None else now - self._begin
            share = self._bits * SECOND / (elapsed * self._bitrate)
            if self._limit < share and not self._is_behind_silence:
                text = f"the load was {share * 100:.0f} % of {self._bitrate} bit/s in the last {elapsed / SECOND:.3g} s"
                found.append(BusFinding("load", 0, f"{text}; the limit is {self._limit * 100:.0f} %"))
            self._is_behind_silence = now - self._last > _SILENCE
            self._begin, self._bits = now, 0
        elif now - self._last > _SILENCE:
            self._is_behind_silence = True
        self._last = now
        bits = frame_bits(frame)
        self._bits += bits
        return bits
