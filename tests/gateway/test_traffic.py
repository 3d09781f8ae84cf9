"""What passes on a bus: the ring, the monitor's feed, the network of who sends what to whom, and traces. In virtual time."""

from __future__ import annotations

import io
from itertools import groupby
from typing import Any

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st

from canopen_gateway import GatewayService, open_gateway
from canopen_gateway.traffic import FrameRing, FrameWish, NetTraffic
from canopen_gateway.traffic import trace as trace_module
from canopen_gateway.traffic.feed import MOST_ROWS
from canopen_gateway.traffic.network import MOST_PDOS
from canopen_gateway.traffic.network_views import NetworkViews
from canopen_gateway.traffic.trace import CHUNK, TrafficTrace, channel_of, plain_name
from canopen_gateway.traffic.traffic import LATE, LOOK, MOST_KEYS, SLICE, ReadPdos
from canopen_master import open_master
from canopen_master.machine_file import parse_machine
from canopen_master.pdo_reading import PdoRead
from canopen_proto.dictionary import Direction
from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.machine import SECOND
from canopen_proto.pdo.settings import PdoSettings
from canopen_transports import BusState, BusStateChanged, ReceiveOverrun, open_transport
from canopen_transports.candump_text import read_candump
from tests.builds import replaces_what_is_compiled
from tests.gateway.gateway_world import gateway
from tests.master.world import BUS, arm_of, virtual_time

frames = st.builds(
    lambda data, extended, can_id: Frame(can_id % (1 << 29 if extended else 1 << 11), data, EXTENDED if extended else 0),
    st.binary(max_size=8),
    st.booleans(),
    st.integers(0, (1 << 29) - 1),
) | st.builds(lambda can_id, dlc: Frame(can_id, b"", REMOTE, dlc), st.integers(0, 0x7FF), st.integers(0, 8))


@given(st.lists(st.tuples(frames, st.booleans()), max_size=40), st.integers(1, 20))
def test_a_ring_gives_back_the_last_frames_as_they_were(passed: list[tuple[Frame, bool]], capacity: int) -> None:
    ring = FrameRing(capacity)
    for time, (frame, is_sent) in enumerate(passed):
        ring.add(time, frame, is_sent)
    expected = [(time, frame, is_sent) for time, (frame, is_sent) in enumerate(passed)][-capacity:]
    assert [ring.at(number) for number in range(ring.first, ring.count)] == expected
    copy = ring.copy(ring.first, ring.count)
    assert [copy[number] for number in range(len(copy))] == expected
    for time in range(len(passed) + 1):
        assert ring.since(time) == max(time, ring.first)


async def settled() -> None:
    """All that has come is understood, and what should have come is missed."""
    await trio.sleep((LATE + SECOND) / SECOND + LOOK)


async def said(*texts: str) -> None:
    wire = await open_transport(BUS)
    for text in texts:
        await wire.send(Frame.parse(text))
    await trio.sleep(2 * LOOK)
    await wire.aclose()


@virtual_time
async def test_a_monitor_tells_frames_as_canopen_monitor_does_and_findings_pass_each_choice() -> None:
    async with gateway(3) as (_, service):
        traffic = service.traffic(BUS)
        with traffic.watch(FrameWish.of([], [])) as every, traffic.watch(FrameWish.of([3], ["SDO", "emcy"])) as some:
            await service.node(BUS, 3).read("device_type")
            await said("704#05", "084#1023010000000000", "703#7F", "703#33")
            rows = every.take()
            assert [row.service for row in rows if row.kind == "frame"][:2] == ["SDO", "SDO"]
            assert "device_type" in rows[0].text
            assert [row.frame for row in rows if row.service == "EMCY"] == ["084#1023010000000000"]
            seconds = [row.seconds for row in rows]
            assert seconds == sorted(seconds)
            chosen = some.take()
            assert {row.service for row in chosen if row.kind == "frame"} == {"SDO"}
            assert [(row.node_id, row.text.partition(":")[0]) for row in chosen if row.kind == "finding"] == [(3, "state")]
            assert (every.seen, some.seen) == (6, 6)
            assert (every.fitting, some.fitting) == (6, 2)
            assert traffic.found["state"] == 1
            assert [row.text for row in traffic.findings] == [row.text for row in chosen if row.kind == "finding"]
            assert every.take() == []


def test_what_is_no_node_and_no_service_is_refused() -> None:
    for nodes, services in (([0], []), ([128], []), ([3], ["sod"]), ([], ["pdo" * 40]), ([], ["tpdo 1234"])):
        with pytest.raises(ValueError, match=r"no node-ID|no service"):
            FrameWish.of(nodes, services)
    with pytest.raises(ValueError, match="at most"):
        FrameWish.of([], [f"tpdo {number}" for number in range(30)])
    assert FrameWish.of([], ["TPDO 1"]).fits("TPDO 1", 3)
    assert not FrameWish.of([], ["tpdo 1"]).fits("TPDO 12", 3)


@virtual_time
async def test_a_feed_that_nobody_takes_is_bounded_and_counts_what_it_left_out() -> None:
    async with gateway() as (_, service):
        traffic = service.traffic(BUS)
        with traffic.watch(FrameWish()) as feed:
            await said(*(["123#01"] * 3 * MOST_ROWS), "703#33", "704#33")
            rows = feed.take()
            assert len([row for row in rows if row.kind == "frame"]) == MOST_ROWS
            assert [row.service for row in rows if row.kind == "finding"].count("state") == 2  # these have room of their own
            assert feed.seen == feed.fitting == 3 * MOST_ROWS + 2
            assert feed.left_out == 2 * MOST_ROWS + 2
        assert len(traffic._feeds) == 0


@virtual_time
async def test_frames_that_come_faster_than_they_are_understood_are_counted() -> None:
    """The ring is what is bounded; the pump only ever adds to it."""
    async with gateway() as (_, service):
        traffic = NetTraffic(service.master, BUS, capacity=100)  # nobody runs it: it looks when it is told to
        with traffic.watch(FrameWish()) as feed:
            await said(*(["123#05"] * 250))
            assert traffic.ring.count == 250
            looks = 0
            while traffic.look():
                looks += 1
            assert (looks, traffic.dropped, feed.seen) == (-(-100 // SLICE), 150, 100)
            rows = feed.take()
            assert [row.text for row in rows if row.kind == "finding"] == [
                "missing: frames are missing here: 150 frames not looked at: this computer is too slow"
            ]
        traffic.close()
        await said("705#05")
        assert traffic.ring.count == 250


@replaces_what_is_compiled
@virtual_time
async def test_an_observer_that_fails_ends_alone() -> None:
    async with gateway(3) as (_, service):
        traffic = service.traffic(BUS)

        def broken(*given: object) -> Any:
            raise ZeroDivisionError("a bug")

        traffic._observer.observe = broken  # type: ignore[method-assign]
        assert await service.node(BUS, 3).read("device_type")
        await settled()
        assert isinstance(traffic.failure, ZeroDivisionError)
        assert await service.node(BUS, 3).read("device_type")  # and the trace goes on
        assert traffic.ring.count == 4


@virtual_time
async def test_a_trace_is_a_log_of_candump_with_its_place_and_time_in_its_name() -> None:
    async with gateway(3) as (_, service):
        traffic = service.traffic(BUS)
        begin = traffic.now()
        traffic.system = lambda: 1_790_000_000 * SECOND + traffic.now() - begin  # it is set once the network is there
        await service.node(BUS, 3).read("device_type")
        await trio.sleep(100)
        await service.node(BUS, 3).read("statusword")
        trace = await TrafficTrace.take('hall "2"/\r\n', {BUS: traffic}, seconds=50)
        assert trace.name == f"hall-2-{plain_name(BUS)}-20260921T141500Z.log"
        text = b"".join(trace.chunks()).decode()
        skipped: list[str] = []
        records = list(read_candump(io.StringIO(text), lambda reason, **more: skipped.append(reason)))
        assert [(str(each.frame), each.sent) for each in records] == [
            ("603#4041600000000000", True),
            ("583#4B41600040020000", False),
        ]
        assert {each.channel for each in records} == {channel_of(BUS, 0)}
        assert records[0].time == pytest.approx(1_790_000_100 * SECOND, abs=SECOND)
        assert skipped == []
        assert (await TrafficTrace.take("x", {BUS: traffic})).frames == 4
        assert (await TrafficTrace.take("x", {BUS: traffic}, frames=1)).frames == 1
        both = await TrafficTrace.take("x", {BUS: traffic, "virtual:2": traffic})
        assert "all-buses" in both.name
        times = [each.time for each in read_candump(io.StringIO(b"".join(both.chunks()).decode()), lambda *a, **k: None)]
        assert times == sorted(times)
        assert len(times) == 8


@virtual_time
async def test_a_trace_is_made_in_pieces() -> None:
    async with gateway() as (_, service):
        traffic = service.traffic(BUS)
        for number in range(CHUNK + 1):
            traffic.ring.add(number, Frame(0x123), False)
        trace = await TrafficTrace.take("x", {BUS: traffic})
        assert [piece.count(b"\n") for piece in trace.chunks()] == [CHUNK, 1]


@virtual_time
@pytest.mark.parametrize("each_turn", [0, 1, 49, 100, 101, 350, 2000])
async def test_a_trace_is_copied_in_slices_while_the_traffic_goes_on(monkeypatch: pytest.MonkeyPatch, each_turn: int) -> None:
    """Frames with their numbers as data; the ring is full, and each_turn of its oldest go in each turn of the others."""
    monkeypatch.setattr(trace_module, "SLICE", 100)
    copied: list[int] = []
    copy = FrameRing.copy

    def counted(ring: FrameRing, first: int, end: int) -> Any:
        assert first == end or ring.first <= first < end <= ring.count
        copied.append(end - first)
        return copy(ring, first, end)

    monkeypatch.setattr(FrameRing, "copy", counted)
    async with gateway() as (_, service):
        traffic = NetTraffic(service.master, BUS, capacity=1000)
        traffic.system = traffic.now

        def pass_by(many: int) -> None:
            for _ in range(many):
                traffic.ring.add(traffic.ring.count * 1000, Frame(0x123, traffic.ring.count.to_bytes(4)), False)

        async def go_on() -> None:
            while True:
                turns.append(len(copied))
                pass_by(each_turn)
                await trio.lowlevel.checkpoint()

        pass_by(1500)
        turns: list[int] = []
        async with trio.open_nursery() as nursery:
            nursery.start_soon(go_on)
            trace = await TrafficTrace.take("x", {BUS: traffic})
            nursery.cancel_scope.cancel()
        assert max(copied) <= 100  # so that no turn is long
        assert all({number, number + 1} & set(turns) for number in range(1, len(copied)))  # and others have theirs between
        found: list[int] = []
        gaps = 0
        losses: list[str] = []
        for line in b"".join(trace.chunks()).decode().splitlines():
            seen = list(read_candump([line], lambda reason, is_overrun=False: losses.append(f"{is_overrun}")))
            if seen:
                number = int.from_bytes(seen[0].frame.data)
                assert not found or number > found[-1]
                if number != (found[-1] + 1 if found else 500):
                    assert losses  # told right before
                    gaps += 1
                found.append(number)
                assert seen[0].time // 1000 == number
                losses.clear()
            else:
                assert losses == ["True"]
        assert not losses or found[-1:] != [1499]  # the last of them may be missing, too
        assert trace.frames == len(found)
        assert trace.frames + trace.lost == 1000
        assert (gaps + len(losses) > 0) == (trace.lost > 0)
        assert not trace.lost or each_turn >= 50  # two turns of the others may come between two slices
        assert trace.lost or each_turn <= 101


IN_SEGMENTS = (
    "603#4008100000000000", "583#4108100015000000",
    "603#6000000000000000", "583#0041414141414141",
    "603#7000000000000000", "583#1042424242424242",
    "603#6000000000000000", "583#0143434343434343",
)  # fmt: skip


@virtual_time
async def test_wherever_in_a_burst_frames_are_lost_never_is_a_device_named_for_them() -> None:
    """The receiver says where. The toggle bit of the next segment is that of the last one that was heard."""
    async with gateway() as (_, service):
        traffic, bus = service.traffic(BUS), service.master.bus(BUS)
        told: list[tuple[str, int]] = []
        end = bus.listen(
            lambda frame, now, stamp, is_sent: told.append((str(frame), 0)), lambda lost, seen: told.append((seen, lost))
        )
        burst = [(Frame.parse(each), None) for each in IN_SEGMENTS]
        bus.take_in(iter([*burst[:4], ReceiveOverrun("x", 2, "too slow"), *burst[6:]]), service.master.now())
        service.master.pump.pump()
        end()
        assert told == [*((each, 0) for each in IN_SEGMENTS[:4]), ("too slow", 2), *((each, 0) for each in IN_SEGMENTS[6:])]
        await trio.sleep(2 * LOOK)
        assert [(each.node_id, each.text) for each in traffic.findings] == [(0, "missing: frames are missing here: too slow")]
        assert (traffic.lost, list(traffic.losses)) == (2, [(4, 2)])


@virtual_time
async def test_a_bus_that_is_away_makes_no_node_late() -> None:
    """The adapter is pulled out for three seconds: whether the node went on meanwhile, nobody knows."""
    async with gateway() as (_, service):
        traffic, bus = service.traffic(BUS), service.master.bus(BUS)

        async def beats() -> None:
            for _ in range(8):
                bus.take_in(iter([(Frame.parse("763#05"), None)]), service.master.now())
                await trio.sleep(0.1)

        def late() -> list[int]:
            return [each.node_id for each in traffic.findings if each.text.startswith("late heartbeat")]

        await beats()
        bus.take_in(iter([BusStateChanged("x", BusState.DOWN, "unplugged")]), service.master.now())
        await trio.sleep(3)
        bus.take_in(iter([BusStateChanged("x", BusState.UP, "plugged in")]), service.master.now())
        await beats()
        assert late() == []
        await trio.sleep(3)
        assert late() == [99], "now it is silent itself"


@given(
    st.lists(st.tuples(st.integers(0, 20), st.integers(1, 5)), max_size=5),
    st.integers(1, 20),
    st.integers(1, 8),
    st.integers(0, 25),
)
@virtual_time
async def test_a_trace_says_where_its_receiver_has_lost_frames(
    losses: list[tuple[int, int]], capacity: int, size: int, frames: int
) -> None:
    async with gateway() as (_, service):
        traffic, bus = NetTraffic(service.master, BUS, capacity=capacity), service.master.bus(BUS)
        items: list[Any] = [(Frame(0x123, bytes((number,))), None) for number in range(20)]
        expected: list[Any] = list(range(20))
        for place, lost in sorted(losses, reverse=True):
            items.insert(place, ReceiveOverrun("x", lost, "too slow"))
            expected.insert(place, None)
        bus.take_in(iter(items), service.master.now())
        first = 20 - min(capacity, frames or 20, 20)
        expected = expected[expected.index(first) :]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(trace_module, "SLICE", size)
            trace = await TrafficTrace.take("x", {BUS: traffic}, frames=frames)
        lines = b"".join(trace.chunks()).decode().splitlines()
        traffic.close()
        seen: list[Any] = []  # both in their order
        seen.extend(each.frame.data[0] for each in read_candump(lines, lambda reason, is_overrun=False: seen.append(None)))
        assert seen == [each for each, _ in groupby(expected)]
        assert trace.lost == sum(lost for place, lost in losses if place > first)


def test_names_that_files_and_logs_can_have() -> None:
    assert [plain_name(each) for each in ("hall-2", "../../etc", "", "\u202e", "a b", "x" * 90)] == [
        "hall-2", "etc", "canopen", "canopen", "a-b", "x" * 40,
    ]  # fmt: skip
    assert [channel_of(each, 1) for each in ("socketcan:can0?sync=bcm", "arm", "\n")] == ["can0", "arm", "bus1"]


async def network(service: GatewayService) -> Any:
    return await NetworkViews(service.master).of(service.traffic(BUS), BUS, 1, {3: "joint1", 4: "joint2"})


@virtual_time
async def test_the_network_of_an_arm_that_moves() -> None:
    async with gateway(3, 4) as (_, service):
        service.traffic(BUS)
        arm = arm_of(service.master, 3, 4)
        await arm.initialise()
        await arm.follow()
        await trio.sleep(3)
        found = await network(service)
        by_id = {each["can_id"]: each for each in found["pdos"]}
        tpdo = next(each for each in found["pdos"] if each["senders"][:1] and each["senders"][0]["node"] == 3)
        assert (tpdo["senders"][0]["name"], tpdo["frames_per_second"]) == ("joint1", 100)
        assert tpdo["receivers"] == [{"node": 0, "name": "this master", "pdo": "", "known": "this master"}]
        assert "statusword" in tpdo["objects"]
        rpdo = next(each for each in found["pdos"] if each["receivers"][0]["node"] == 4)
        assert rpdo["senders"][0]["name"] == "this master"
        assert rpdo["frames_per_second"] == 100
        assert "position" in rpdo["objects"]
        assert len(by_id) == len(found["pdos"])
        with service.traffic(BUS).watch(FrameWish.of([], ["tpdo 1"])) as feed:
            await trio.sleep(0.1)
            assert "statusword = " in feed.take()[0].text  # by the mapping that the master uses, though no frame has shown it
            assert service.traffic(BUS).found["missing"] == 0
        loads = {each["node"]: each for each in found["nodes"]}
        assert loads[3]["frames_per_second"] >= 200
        assert loads[3]["bits_per_second"] > 10_000
        assert loads[3]["load"] is None  # nobody tells the bit rate of a virtual bus
        assert loads[0]["frames_per_second"] >= 100  # SYNC
        assert sum(each["frames_per_second"] for each in found["nodes"]) == found["frames_per_second"]
        assert found["syncs"] >= 300
        service.master.bus(BUS).bitrate = 1_000_000
        assert (await network(service))["nodes"][0]["load"] == pytest.approx(loads[3]["bits_per_second"] / 1e6, rel=0.05)


@virtual_time
async def test_what_a_device_itself_tells_goes_before_all_else() -> None:
    async with gateway(3) as (_, service):
        traffic = service.traffic(BUS)
        await said("2A1#0102", "185#00", "123#00")  # of nobody who is known; and what is no PDO
        await settled()
        before = await network(service)
        assert ["0x123"] not in [each["can_id"] for each in before["pdos"]]
        heard = {each["can_id"]: [end["known"] for end in each["senders"] + each["receivers"]] for each in before["pdos"]}
        assert heard["0x185"] == ["its frames"]
        read = await service.read_pdos(BUS, 3)
        assert read.pdos
        found = await network(service)
        ends = [end for each in found["pdos"] for end in each["senders"] if end["node"] == 3]
        assert ends
        assert {end["known"] for end in ends} == {"the device"}
        assert found["nodes"][0]["pdos"] == "the device"
        assert 0 <= found["nodes"][0]["read_age"] < 60  # the clock of a test jumps while a thread works
        assert traffic.pdos_read[3] is read


LINKED = """
[buses.left]
locator = "virtual:linked"
bitrate = "1M"
[nodes.lift]
bus = "left"
id = 5
file = "sample_drive.eds"
[nodes.slide]
bus = "left"
id = 6
file = "sample_drive.eds"
[joints.gear]
node = "slide"
[joints.lever]
node = "lift"
[[links]]
from = "lift position_actual_value"
to = "gear target_position"
[[links]]
from = ["lift statusword", "slide statusword"]
to = "master"
"""


@virtual_time
async def test_the_links_of_a_machine_file_and_what_its_devices_files_say() -> None:
    """Nobody is there, and nothing is sent: the machine file and the devices' own files tell it."""
    machine = parse_machine(LINKED)
    async with open_master(machine=machine) as master, open_gateway(master) as service:
        traffic = service.traffic("left")
        found = await NetworkViews(master).of(traffic, "left", 1, {5: "lift", 6: "slide"})
        linked = [each for each in found["pdos"] if each["links"]]
        ends = [[(end["name"], end["known"]) for end in (*each["senders"], *each["receivers"])] for each in linked]
        assert ends == [
            [("slide", "machine file"), ("this master", "machine file")],
            [("lift", "machine file"), ("slide", "machine file"), ("this master", "machine file")],
        ]
        assert [each["links"] for each in linked] == [["links[2]"], ["links[1]", "links[2]"]]
        assert "position_actual_value" in linked[1]["objects"]
        assert linked[1]["sent"] == "at each SYNC"
        known = {end["known"] for each in found["pdos"] for end in (*each["senders"], *each["receivers"])}
        assert "its file" in known
        assert (found["bitrate"], found["load"]) == (1_000_000, 0.0)
        assert found["notes"] == []
        assert traffic.ring.count == 0


@virtual_time
async def test_links_that_cannot_be_are_told_and_the_rest_is_shown() -> None:
    wrong = parse_machine(LINKED.replace("lift statusword", "lift no_such_object"))
    async with open_master(machine=wrong) as master, open_gateway(master) as service:
        found = await NetworkViews(master).of(service.traffic("left"), "left", 1, {5: "lift", 6: "slide"})
        assert any("no_such_object" in each for each in found["notes"]), found["notes"]
        assert found["pdos"]
        assert [each for each in found["pdos"] if each["links"]] == []


@virtual_time
async def test_a_bus_with_more_pdos_and_identifiers_than_anybody_shows() -> None:
    async with gateway() as (_, service):
        traffic = service.traffic(BUS)
        for node_id in range(1, 128):
            pdos = [PdoSettings(n, Direction.TPDO, 1 << 29 | node_id << 8 | n, 255, (0x60640020,)) for n in range(1, 9)]
            found = tuple(PdoRead(Direction.TPDO, pdo.number, pdo) for pdo in pdos)
            traffic.pdos_read[node_id] = ReadPdos(traffic.now(), found)
        shown = await network(service)
        assert len(shown["pdos"]) == MOST_PDOS
        assert shown["notes"] == [f"{127 * 8 - MOST_PDOS} further PDOs are left out here"]
        for number in range(MOST_KEYS + 500):
            traffic.ring.add(traffic.now(), Frame(0x10000 + number, b"", EXTENDED), False)
        while traffic.look():
            pass
        assert len(traffic.rates()) == MOST_KEYS


@virtual_time
async def test_what_a_device_says_cannot_break_a_line() -> None:
    """A device's own name, read over the bus, with control characters in it."""
    async with gateway() as (_, service):
        with service.traffic(BUS).watch(FrameWish()) as feed:
            await said("605#4008100000000000", "585#430810001B5B324A")  # an escape sequence that clears a screen
            rows = feed.take()
            assert rows
            assert all(row.text.isprintable() and row.service.isprintable() for row in rows)
