"""What the pump makes of transports that can more than carry frames: filters, and SYNC that they send themselves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pytest

from canopen_master import BusChanged, BusError, FramesNotSent, open_master
from canopen_proto.frame import Frame
from canopen_proto.procedures.objects import read
from canopen_proto.sync import SyncSent
from canopen_transports import BusState, BusStateChanged, FrameNotSentError, Received, Report, TransportError
from tests.loops import Channel, loop, settled
from tests.master.world import BUS, simulated, virtual_time


class Able:
    """A transport that filters and sends SYNC, and tells what it was asked for."""

    locator = "able"

    def __init__(self, filtered: bool = True, sends_sync: bool = True) -> None:
        self.filtered = filtered
        self.sends_sync = sends_sync
        self.keys: list[set[int]] = []
        self.cyclic: list[tuple[list[str], int]] = []
        self.sent: list[str] = []
        self.room = 512
        self.refusal: TransportError | None = None
        self._feed: Channel[Frame | Report] = Channel()

    def feed(self, item: Frame | Report) -> None:
        self._feed.send(item)

    async def send(self, frame: Frame) -> None:
        await loop.checkpoint()
        self.sent.append(str(frame))

    async def receive(self) -> Received | Report:
        item = await self._feed.receive()
        return (item, None) if isinstance(item, Frame) else item

    async def aclose(self) -> None:
        await loop.checkpoint()

    def set_filters(self, keys: Iterable[int] | None) -> bool:
        self.keys.append(set(keys or ()))
        return len(self.keys[-1]) <= self.room

    def start_cyclic(self, frames: Sequence[Frame], period: int) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.cyclic.append(([str(frame) for frame in frames], period))

    def stop_cyclic(self) -> None:
        self.cyclic.append(([], 0))


@virtual_time
async def test_filters_follow_what_the_machines_want() -> None:
    bus = Able()
    async with open_master(bus) as master:
        network = master.bus().network
        assert not network.hears_all
        count = len(bus.keys)
        master.node(12)
        assert {0x58C, 0x70C, 0x8C} <= bus.keys[-1]
        master.node(13)
        assert {0x58C, 0x58D} <= bus.keys[-1]
        assert len(bus.keys) == count + 2
        await master.nmt_start()
        assert len(bus.keys) == count + 2  # nothing changed
        bus.room = 3
        master.node(14)
        assert network.hears_all


@virtual_time
async def test_a_transport_that_need_not_filter_is_not_asked() -> None:
    bus = Able(filtered=False, sends_sync=False)
    async with open_master(bus) as master:
        master.node(12)
        master.sync_start(0.01)
        assert master.bus().network.hears_all
        await loop.sleep(0.001)
        master.sync_stop()
    assert bus.sent == ["080#"]
    assert not bus.keys
    assert not bus.cyclic


@virtual_time
async def test_sync_that_the_transport_sends_is_reported_as_ours() -> None:
    bus = Able()
    async with open_master(bus) as master:
        with master.events(SyncSent) as events:
            master.sync_start(0.01)
            assert bus.cyclic == [(["080#"], 10_000_000)]
            assert master.sync_period == 10_000_000
            for pause in (0.01, 0.0104, 0.0301):
                await loop.sleep(pause)
                bus.feed(Frame(0x80))
            assert [await events.receive() for _ in range(3)] == [SyncSent(0, None, skipped) for skipped in (0, 0, 2)]
        bus.feed(BusStateChanged("able", BusState.UP, "a new one"))
        await loop.sleep(0)
        await settled()
        assert bus.cyclic[1:] == [(["080#"], 10_000_000)]  # it may have forgotten
        master.sync_stop()
        assert bus.cyclic[2:] == [([], 0)]
        assert master.sync_period == 0
        bus.feed(Frame(0x80))  # somebody else's
        await settled()
        master.sync_start(0.02)
        assert bus.sent == []


@virtual_time
async def test_syncs_that_came_while_the_process_was_stalled_are_one_cycle() -> None:
    bus = Able()
    async with open_master(bus) as master:
        with master.events(SyncSent) as events:
            master.sync_start(0.01)
            bus.feed(Frame(0x80))
            await loop.sleep(0.03)
            for _ in range(3):
                bus.feed(Frame(0x80))
            await settled()
            await loop.sleep(0.01)
            bus.feed(Frame(0x80))
            assert [await events.receive() for _ in range(3)] == [SyncSent(0, None, skipped) for skipped in (0, 2, 0)]


@virtual_time
async def test_sync_with_a_counter_is_a_row_of_frames() -> None:
    bus = Able()
    async with open_master(bus) as master:
        master.bus().sync.configure(0x80, 3)  # type: ignore[union-attr]
        master.sync_start(0.004)
        assert bus.cyclic == [(["080#01", "080#02", "080#03"], 4_000_000)]
        with master.events(SyncSent) as events:
            bus.feed(Frame(0x80, b"\x02"))
            assert await events.receive() == SyncSent(0, 2, 0)


@virtual_time
async def test_a_bus_that_is_away_again_before_its_sync_could_be_started() -> None:
    bus = Able()
    async with open_master(bus) as master:
        with master.events(BusChanged) as events:
            master.sync_start(0.01)
            bus.refusal = TransportError("CO111", "able", "cannot send 080# cyclically on able", seen="it is DOWN")
            bus.feed(BusStateChanged("able", BusState.UP, "the plug is in"))
            assert await events.receive() == BusChanged(0, BusState.UP, "the plug is in")
            refused = await events.receive()
            assert refused.state is BusState.FAULT
            assert refused.reason == "SYNC is not sent: cannot send 080# cyclically on able (it is DOWN)"
            bus.refusal = None
            bus.feed(BusStateChanged("able", BusState.UP, "the plug is in again"))
            assert (await events.receive()).state is BusState.UP
            assert bus.cyclic == [(["080#"], 10_000_000)] * 2


@virtual_time
async def test_sdo_is_held_back_before_a_sync_of_the_transport() -> None:
    bus = Able()
    async with open_master(bus) as master:
        node = master.node(3)
        master.sync_start(0.01)
        bus.feed(Frame(0x80))
        await settled()
        await loop.sleep(0.0099)
        async with loop.open_nursery() as nursery:
            nursery.start_soon(node.read, 0x1000)
            await settled()
            assert bus.sent == []
            await loop.sleep(0.0005)
            assert bus.sent == ["603#4000100000000000"]
            nursery.cancel_scope.cancel()


class Eager(Able):
    """A transport that takes frames at once, while it has room."""

    def __init__(self) -> None:
        super().__init__(filtered=False, sends_sync=False)
        self.at_once: list[str] = []
        self.failure: Exception | None = None

    def send_nowait(self, frame: Frame) -> bool:
        if self.failure is not None:
            raise self.failure
        if self.room:
            self.at_once.append(str(frame))
        return bool(self.room)


@virtual_time
async def test_frames_go_out_in_the_turn_that_made_them_where_the_transport_can() -> None:
    bus = Eager()
    async with open_master(bus) as master, loop.open_nursery() as nursery:
        node = master.node(3)
        master.launch(read(node.remote, 0x1000))
        assert bus.at_once == ["603#4000100000000000"]
        bus.room = 0
        master.sync_start(0.1)
        bus.room = 512
        nursery.start_soon(master.send_sync)  # something waits: it stays behind that
        await settled()
        assert bus.sent == ["080#", "080#"]
        assert len(bus.at_once) == 1
        await master.send_sync()
        assert bus.at_once[1:] == ["080#"]
        await loop.sleep(0.0999)
        master.launch(read(master.node(4).remote, 0x1000))
        assert bus.at_once[2:] == []  # a SYNC is near
        await loop.sleep(0.0002)
        assert bus.at_once[2:] == ["080#", "604#4000100000000000"]
        assert len(bus.sent) == 2


@virtual_time
async def test_a_bus_that_is_away_or_fails_when_a_frame_is_to_go_out_at_once() -> None:
    bus = Eager()
    with pytest.raises(BusError, match="cannot send on able"):
        async with open_master(bus) as master:
            with master.events(FramesNotSent) as events:
                bus.failure = FrameNotSentError("CO111", "able", "cannot send", seen="it is away")
                for _ in range(3):
                    await master.send_sync()
                bus.failure = None
                await master.send_sync()
                assert [(await events.receive()).count for _ in range(2)] == [1, 2]
            bus.failure = loop.ClosedResourceError()
            await master.send_sync()


@virtual_time
async def test_a_listener_is_told_each_frame_and_nothing_is_filtered_meanwhile() -> None:
    """What comes while one of ours is being sent waits for it: an answer is never told before its request."""

    class Answering(Able):
        async def send(self, frame: Frame) -> None:
            self.feed(Frame.parse("583#4B41600040020000"))
            await loop.sleep(0.01)
            await super().send(frame)

    bus, told = Answering(sends_sync=False), list[tuple[str, bool]]()
    async with open_master(bus) as master:
        node = master.node(3)
        await settled()
        filtered = len(bus.keys)
        end = master.bus("able").listen(lambda frame, now, stamp, is_sent: told.append((str(frame), is_sent)))
        assert bus.keys[filtered:] == [set()]  # all
        await node.read("statusword")
        bus.feed(Frame.parse("123#01"))
        await loop.sleep(0.1)
        assert told == [("603#4041600000000000", True), ("583#4B41600040020000", False), ("123#01", False)]
        end()
        assert bus.keys[-1] == bus.keys[filtered - 1]
        bus.feed(Frame.parse("123#02"))
        await settled()
        assert len(told) == 3


@virtual_time
async def test_whatever_ends_a_bus_never_does_a_listener_miss_what_came_before() -> None:
    """They came while a frame was being sent, which the transport then could not do."""

    class Dying(Able):
        async def send(self, frame: Frame) -> None:
            self.feed(Frame.parse("083#1023010000000000"))
            await loop.sleep(0.01)
            raise loop.ClosedResourceError

    bus, told = Dying(sends_sync=False), list[str]()
    with pytest.raises(BusError, match="cannot send"):
        async with open_master(bus) as master:
            master.bus("able").listen(lambda frame, now, stamp, is_sent: told.append(str(frame)))
            await master.send_sync()
    assert told == ["083#1023010000000000"]


@virtual_time
async def test_whoever_listens_never_is_told_what_came_before_it_listened() -> None:
    class Slow(Able):
        async def send(self, frame: Frame) -> None:
            self.feed(Frame.parse("083#1023010000000000"))
            await loop.sleep(0.01)
            await super().send(frame)

    bus, first, second = Slow(sends_sync=False), list[str](), list[str]()
    async with open_master(bus) as master, loop.open_nursery() as nursery:
        end = master.bus("able").listen(lambda frame, now, stamp, is_sent: first.append(str(frame)))
        nursery.start_soon(master.send_sync)
        await loop.sleep(0.005)
        end()
        master.bus("able").listen(lambda frame, now, stamp, is_sent: second.append(str(frame)))
        await loop.sleep(0.1)
        assert (first, second) == ([], ["080#"])  # it was on its way by then


@virtual_time
async def test_a_listener_is_told_the_request_first_though_the_answer_comes_before_it_is_handed_over() -> None:
    """A simulated device of the same process answers while our frame is being sent."""
    told: list[tuple[str, bool]] = []
    async with simulated(3), open_master(BUS) as master:
        master.bus(BUS).listen(lambda frame, now, stamp, is_sent: told.append((str(frame)[:11], is_sent)))
        await master.node(3).read("statusword")
        await master.node(3).read("device_type")
    assert told == [("603#4041600", True), ("583#4B41600", False), ("603#4000100", True), ("583#4300100", False)]
