"""Frames in bursts, loud and quiet, are the same as one after the other by the long way: events, frames, values, deadlines.

The oracle is a network whose nodes have no short ways (`Group._entrance`), and which hears each frame by itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Direction
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.following import Following
from canopen_proto.drives.axis.limits import Limit
from canopen_proto.drives.cia402 import objects
from canopen_proto.emcy import EmcyReceived
from canopen_proto.frame import Frame, RoutingKey, routing_key
from canopen_proto.group import Group
from canopen_proto.heartbeat import HeartbeatReceived, OwnHeartbeat
from canopen_proto.machine import MILLISECOND, Event, LocalProtocolError, Machine, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.procedures.steps import Procedure, Wait, wait_for_event
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoUploaded
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from canopen_proto.sync import SyncConsumer, SyncProducer
from tests.builds import replaces_what_is_compiled
from tests.examples import examples

DICTIONARY = drive_dictionary(Shape.STANDARD, 1)
STATUSWORD = MappedEntry(0x6041, 0, 16, DataType.UNSIGNED16)
MAPPINGS = (
    Mapping(
        (STATUSWORD, MappedEntry(0x6064, 0, 32, DataType.INTEGER32), MappedEntry(0x6061, 0, 8, DataType.INTEGER8)),
    ),
    Mapping((STATUSWORD, MappedEntry(5, 0, 8, DataType.UNSIGNED8))),  # a dummy behind it
    Mapping(
        (
            MappedEntry(1, 0, 1, DataType.BOOLEAN),
            MappedEntry(0x606C, 0, 32, DataType.INTEGER32),
            MappedEntry(1, 0, 7, DataType.BOOLEAN),
        )
    ),
    Mapping(()),
)
BUG_ID = 0x7A0


def long_way() -> type[RemoteNode]:
    """A node without short ways."""

    class LongWay(RemoteNode):
        def _entrance(self, key: RoutingKey) -> Machine:
            return Group._entrance(self, key)

    return LongWay


class Buggy(Machine):
    """Raises at some frames."""

    def can_ids(self) -> tuple[RoutingKey, ...]:
        return routing_key(BUG_ID), routing_key(0x185)

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.can_id == BUG_ID or frame.data[:1] == b"\xee":
            raise LocalProtocolError("a bug")


def after(node: RemoteNode, *kinds: type[Event]) -> Procedure[list[str]]:
    """Wait for an event of exactly each of these kinds, one after the other."""
    heard = []
    for kind in kinds:
        event = yield Wait(100 * MILLISECOND, node, lambda event: True, (kind,))
        heard.append(repr(event))
    return heard


class Bus:
    """Two nodes, one of them a drive that is watched, with a device and producers beside them."""

    def __init__(self, kind: type[RemoteNode]) -> None:
        self.network = Network()
        out = self.network.out
        self.drive = kind(out, 5, DICTIONARY, heartbeat_timeout=80 * MILLISECOND)
        self.other = kind(out, 6, DICTIONARY)
        self.sync, self.nmt, self.own = SyncProducer(out), NmtMaster(out), OwnHeartbeat(out, 6)
        self.device = DriveNode(out, 12, DriveSettings(position=0))
        for machine in (self.drive, self.other, self.sync, SyncConsumer(out), self.nmt, self.own, self.device):
            self.network.attach(machine)
        self.buggy = Buggy(out)
        self.heard: list[tuple[tuple[Any, ...], Time]] = []
        self.bugs = 0
        self.axis = Axis(self.drive)
        self.device.boot(0)
        self.map(self.drive, 1, 0, 0)
        self.map(self.drive, 2, 1, 0)
        self.map(self.other, 1, 2, 0)
        self.drive.add_rpdo(1, routing_key(0x205), Mapping((MappedEntry(0x6040, 0, 16, DataType.UNSIGNED16),)), 1)
        self.drive.enable_rpdo(1, 0)
        for node in (self.drive, self.other):
            node.add_listener(self.listen)
        self.following = Following(self.axis)
        self.following.begin(Limit(0.1, "x"), 7, cyclic={objects.STATUSWORD: 1}, period=10 * MILLISECOND)

    def map(self, node: RemoteNode, number: int, mapping: int, now: Time) -> None:
        node.add_tpdo(number, routing_key(0x180 + 0x100 * (number - 1) + node.node_id), MAPPINGS[mapping], now)

    def listen(self, muxes: Sequence[Any], now: Time) -> None:
        """Do something in the middle of a burst: what, the statusword of the drive decides."""
        self.heard.append((tuple(muxes), now))
        acts: dict[int, Callable[[], object]] = {
            1: lambda: self.drive.heartbeat.set_timeout(30 * MILLISECOND, now, begun=True),
            2: lambda: self.map(self.drive, 3, 1, now),
            3: lambda: self.guard(now),
            4: lambda: self.drive.read(0x6041, now),
            5: self.other.stop_guarding,
            6: lambda: self.drive.sdo.abort_all(0x08000000, now),
            7: lambda: self.drive.enable_rpdo(1, now),
            8: lambda: self.network.attach(self.buggy),
        }
        acts.get(self.drive.values.store.get(objects.STATUSWORD, 0) & 0xF, lambda: None)()  # type: ignore[operator]

    def guard(self, now: Time) -> None:
        self.other.stop_guarding()
        self.other.start_guarding(20 * MILLISECOND, 2, now)

    def command(self, number: int, now: Time) -> None:
        """Do something between two bursts."""
        network, drive, other = self.network, self.drive, self.other
        acts: tuple[Callable[[], object], ...] = (
            lambda: drive.read(0x6041, now),
            lambda: drive.write(0x6040, 6, now),
            lambda: self.guard(now),
            other.stop_guarding,
            lambda: self.nmt.send(NmtCommand.START, 0, now),
            lambda: self.nmt.send(NmtCommand.RESET_NODE, 5, now),
            lambda: drive.heartbeat.set_timeout(0, now),
            lambda: drive.heartbeat.set_timeout(50 * MILLISECOND, now, begun=True),
            lambda: network.run(wait_for_event(drive, PdoReceived, 100 * MILLISECOND, "x"), now),
            lambda: network.run(wait_for_event(other, HeartbeatReceived, 100 * MILLISECOND, "x"), now),
            lambda: drive.remove_pdo(Direction.TPDO, 2),
            lambda: self.map(other, 1, 0, now),
            lambda: self.map(other, 1, 3, now),
            lambda: self.own.start(20 * MILLISECOND, now),
            lambda: self.sync.start(10 * MILLISECOND, now),
            self.sync.stop,
            lambda: [each.configure(each.key, MAPPINGS[0], 1) for each in other.tpdos.values()],
            lambda: [each.configure(each.key, MAPPINGS[0], 255, 15 * MILLISECOND) for each in other.tpdos.values()],
            lambda: [each.set_enabled(not each.enabled, now) for each in drive.tpdos.values()],
            lambda: network.attach(self.buggy),
            lambda: network.detach(self.buggy),
            lambda: other.foreign_writes.listen([objects.CONTROLWORD], lambda now: None),
            lambda: drive.add_mpdo(Direction.TPDO, 4, routing_key(0x485)),
            lambda: network.run(after(drive, EmcyReceived, PdoReceived), now),
            lambda: network.run(after(other, PdoReceived, HeartbeatReceived, PdoReceived), now),
            lambda: network.run(after(drive, SdoUploaded, PdoReceived, EmcyReceived), now),
        )
        acts[number]()

    def one_by_one(self, burst: Sequence[tuple[Frame, int | None]], now: Time) -> None:
        for frame, stamp in burst:
            try:
                self.network.receive(frame, now, stamp)
            except LocalProtocolError:
                self.network.out.root.timestamp = None
                self.bugs += 1

    def at_once(self, burst: Sequence[tuple[Frame, int | None]], now: Time) -> None:
        left = iter(burst)
        while True:
            try:
                assert self.network.receive_many(left, now) is None
                return
            except LocalProtocolError:
                self.bugs += 1

    def drained(self, now: Time) -> tuple[Any, list[str]]:
        frames, events = self.network.drain(now)
        return frames, [re.sub(r" at 0x[0-9a-f]+", "", repr(event)) for event in events]

    def known(self) -> list[Any]:
        """All that the frames have left behind."""
        nodes = [
            (
                dict(each.values.store), dict(each.heard_at), each.nmt_state, each.boots, each.last_sync, each.heartbeat.state,
                each.heartbeat.last_heard, each.heartbeat.lost, each.heartbeat.deadline, each._in_doubt, set(each._writes),
                sorted(each.tpdos),
            )
            for each in (self.drive, self.other)
        ]  # fmt: skip
        network = self.network
        return [
            nodes, dict(self.device.values.store), self.device.nmt.state, self.following.is_on, self.axis.state, self.heard,
            self.bugs, network.can_ids(), network.last_heard, network.heard_nodes(), network.next_deadline(),
        ]  # fmt: skip


words = st.builds(lambda low, high: bytes((low, high)), st.integers(0, 12), st.sampled_from([0, 2, 4, 6, 0x10, 0x12]))
whole = st.tuples(words, st.binary(min_size=5, max_size=5)).map(b"".join)  # as long as the first mapping
payloads = st.one_of(whole, whole, whole, st.tuples(words, st.binary(max_size=6)).map(b"".join), st.just(b"\xee" + bytes(6)))
pdos = st.builds(Frame, st.sampled_from([0x185, 0x186, 0x185, 0x186, 0x285, 0x385, 0x20C, 0x30C, 0x485]), payloads)
states = st.sampled_from([b"\x00", b"\x04", b"\x05", b"\x05", b"\x05", b"\x7f", b"\x85", b"\x33", b"", b"\x05\x05"])
SDO_FRAMES = ("4b41600037120000", "6040600000000000", "8041600000000206", "2b40600006000000", "4041600000000000")
frames = st.one_of(
    pdos,
    pdos,
    pdos,
    st.builds(Frame, st.sampled_from([0x705, 0x706, 0x70C]), states),
    st.builds(Frame, st.just(0x080), st.sampled_from([b"", b"", b"\x01"])),
    st.builds(Frame, st.just(0x000), st.sampled_from([b"\x01\x00", b"\x02\x0c", b"\x80\x00", b"\x81\x0c", b"\x01\x0c"])),
    st.builds(Frame, st.sampled_from([0x085, 0x086]), st.sampled_from([bytes(8), bytes.fromhex("1023010000000000")])),
    st.builds(Frame, st.sampled_from([0x585, 0x605, 0x60C]), st.sampled_from(SDO_FRAMES).map(bytes.fromhex)),
    st.builds(Frame, st.just(BUG_ID), st.just(b"")),
    st.builds(Frame, st.just(0x12345), st.just(b""), st.just(1)),
)
traffic = st.lists(st.tuples(frames, st.none() | st.integers(0, 99)), min_size=3, max_size=14)
commands = st.integers(0, 25) | st.sampled_from(
    [0, 1, 8, 11, 12, 16, 17, 18, 23, 24, 25]
)  # requests under way, and PDOs of each kind
steps = st.tuples(traffic, st.lists(commands, min_size=1, max_size=4), st.sampled_from([0, 1, 5, 10, 20, 60, 100]))


def without_the_usual(events: list[str]) -> list[str]:
    return [event for event in events if not event.startswith(("PdoReceived(", "HeartbeatReceived("))]


@replaces_what_is_compiled
@examples(150, least=30)
@given(st.lists(steps, min_size=2, max_size=8))
def test_bursts_loud_and_quiet_are_the_same_as_single_frames(script: list[tuple[list[Any], list[int], int]]) -> None:
    single, loud, quiet = Bus(long_way()), Bus(RemoteNode), Bus(RemoteNode)
    quiet.network.quiet = True
    buses = (single, loud, quiet)
    now = 0
    for bus in buses:
        bus.drained(now)
    for burst, commands, later in script:
        for bus in buses:
            for number in commands:
                bus.command(number, now)
        single.one_by_one(burst, now)
        loud.at_once(burst, now)
        quiet.at_once(burst, now)
        assert single.known() == loud.known() == quiet.known()
        ours, theirs, hushed = (bus.drained(now) for bus in buses)
        assert ours == theirs
        assert (ours[0], without_the_usual(ours[1])) == (hushed[0], without_the_usual(hushed[1]))
        now += later * MILLISECOND
        for bus in buses:
            bus.network.handle_timeout(now)
        ours, theirs, hushed = (bus.drained(now) for bus in buses)
        assert ours == theirs == hushed
    assert single.known() == loud.known() == quiet.known()
