"""The pump: what is sent in which order, and what happens when a bus does not do its part."""

import pytest

from canopen_master import BusChanged, BusError, FramesLost, FramesNotSent, open_master
from canopen_master.participant.bus import MAX_SEND_QUEUE
from canopen_proto.frame import Frame
from canopen_proto.machine import LocalProtocolError
from canopen_proto.procedures.objects import read
from canopen_proto.sdo.events import SdoUploaded
from canopen_transports import BusState, BusStateChanged, FrameNotSentError, Received, Report, VirtualTransport, open_transport
from tests.loops import Channel, loop, settled
from tests.master.world import BUS, Breakable, simulated, virtual_time


@virtual_time
async def test_sync_goes_before_sdo_that_was_asked_for_earlier() -> None:
    cable = Breakable()
    async with open_master(cable) as master:
        master.launch(read(master.node(3).remote, "statusword"))
        master.sync_start(1.0)
        await loop.sleep(0.1)
        assert [frame for _, frame in cable.sent] == ["080#", "603#4041600000000000"]


@virtual_time
async def test_sdo_is_held_back_right_before_a_sync() -> None:
    async with simulated(3), open_master(cable := Breakable()) as master:
        node = master.node(3)
        await node.read("statusword")
        master.sync_start(0.01)
        await loop.sleep(0.0098)
        await node.read("statusword")
        assert loop.current_time() == pytest.approx(0.01)
    tail = [(round(time, 6), frame[:3]) for time, frame in cable.sent[2:]]
    assert tail == [(0.01, "080"), (0.01, "603")]


@virtual_time
async def test_sdo_is_not_held_back_for_a_sync_that_was_stopped() -> None:
    async with simulated(3), open_master(BUS) as master:
        node = master.node(3)
        master.sync_start(0.01)
        await loop.sleep(0.0098)
        async with loop.open_nursery() as nursery:
            nursery.start_soon(node.read, "statusword")
            await settled()
            master.sync_stop()
        assert loop.current_time() < 0.0102


@virtual_time
async def test_lost_frames_are_reported_and_the_master_goes_on() -> None:
    async with (
        simulated(3),
        open_master(small := VirtualTransport("test", queue_size=4)) as master,
        await open_transport(BUS) as other,
    ):
        with master.events(FramesLost) as events:
            for _ in range(10):
                small._queue.put((Frame(0x783, b"\x05"), None))  # all at once, as the kernel would
            await other.send(Frame(0x783, b"\x05"))
            report = await events.receive()
            assert report.lost == 7
            assert "4 frames" in report.reason
        assert await master.node(3).read("statusword") == 0x240


@virtual_time
async def test_a_device_in_this_process_answers_in_the_turn_of_the_request() -> None:
    async with simulated(3), open_master(BUS) as master:
        remote = master.node(3).remote
        await master.node(3).read("statusword")
        with master.events(SdoUploaded) as events:
            master.node(3).begin(lambda now: remote.read("statusword", now))
            assert [event.data for event in events.take()] == [b"\x40\x02"]  # and no other task has run


class Away:
    """A transport whose bus goes away and comes back as it is told."""

    def __init__(self) -> None:
        self._reports: Channel[BusStateChanged] = Channel()
        self.is_away = False
        self.sent: list[str] = []

    def tell(self, state: BusState) -> None:
        self.is_away = state is BusState.DOWN
        self._reports.send(BusStateChanged("away", state, f"the plug is {state.value}"))

    async def send(self, frame: Frame) -> None:
        await loop.checkpoint()
        if self.is_away:
            raise FrameNotSentError("CO111", "away", f"cannot send {frame} on away", seen="the plug is down")
        self.sent.append(str(frame))

    async def receive(self) -> Received | Report:
        return await self._reports.receive()

    async def aclose(self) -> None:
        await loop.checkpoint()


@virtual_time
async def test_a_bus_that_goes_away_and_comes_back_is_reported_and_nothing_old_is_sent() -> None:
    bus = Away()
    async with open_master(bus) as master:
        with master.events(BusChanged, FramesNotSent) as events:
            bus.tell(BusState.PASSIVE)
            assert await events.receive() == BusChanged(0, BusState.PASSIVE, "the plug is error-passive")
            bus.tell(BusState.DOWN)
            assert await events.receive() == BusChanged(0, BusState.DOWN, "the plug is down")
            assert master.bus().state is BusState.DOWN
            await master.send_sync()
            assert await events.receive() == FramesNotSent(0, 1, "the plug is down")
            for _ in range(5):
                await master.send_sync()
            bus.tell(BusState.UP)
            assert await events.receive() == FramesNotSent(0, 5, "the plug is down")
            assert await events.receive() == BusChanged(0, BusState.UP, "the plug is up")
            await master.nmt_start()
            assert bus.sent == ["000#0100"]
            bus.is_away = True  # and a transport that says it of the frame only
            await master.send_sync()
            await master.send_sync()
            bus.is_away = False
            await master.send_sync()
            assert [(await events.receive()).count for _ in range(2)] == [1, 1]


@virtual_time
async def test_a_cut_cable_ends_what_waits_and_the_block() -> None:
    cable = Breakable()
    seen: list[BaseException] = []
    with pytest.raises(BusError) as caught:
        async with open_master(buses={"can0": cable}) as master, loop.open_nursery() as nursery:
            nursery.start_soon(_cut_after, cable, 0.1)
            try:
                await master.node(3).read("statusword")
            except BusError as error:
                seen.append(error)
            await loop.sleep_forever()  # cancelled
    assert seen == [caught.value]
    assert caught.value.bus == "can0"
    assert caught.value.code == "CO111"
    assert str(caught.value).startswith("CO111: bus can0: cannot receive on breakable:test")
    assert cable.closed == 1


async def _cut_after(cable: Breakable, seconds: float) -> None:
    await loop.sleep(seconds)
    cable.cut()


@virtual_time
async def test_after_a_failure_each_call_says_so() -> None:
    cable = Breakable()
    with pytest.raises(BusError):
        async with open_master(cable) as master:
            cable.cut()
            with loop.cancel_scope(shield=True):
                await loop.sleep(0.1)
                with pytest.raises(BusError):
                    master.node(3)
                with pytest.raises(BusError):
                    await master.send_sync()


@virtual_time
async def test_a_command_whose_frame_cannot_be_sent() -> None:
    cable = Breakable()
    with pytest.raises(BusError):
        async with open_master(cable) as master:
            cable.is_broken = True
            with pytest.raises(BusError):
                await master.nmt_start()


@virtual_time
async def test_a_bus_that_takes_no_frames_fills_the_queue_and_fails() -> None:
    cable = Breakable()
    cable.is_stuck = True
    with pytest.raises(BusError, match="does not take our frames") as caught:
        async with open_master(cable) as master:
            master.sync_start(0.001)
            await loop.sleep_forever()
    assert "frames still to be sent" in caught.value.seen
    assert loop.current_time() == pytest.approx(MAX_SEND_QUEUE * 0.001, abs=0.01)


@virtual_time
async def test_a_transport_that_somebody_else_closes() -> None:
    transport = await open_transport(BUS)
    with pytest.raises(BusError, match="somebody has closed the transport"):
        async with open_master(transport):
            await transport.aclose()
            await loop.sleep_forever()


class Rude:
    """A transport that does not keep to the rules."""

    async def send(self, frame: Frame) -> None:
        await loop.checkpoint()
        raise OSError(19, "No such device")

    async def receive(self) -> Received:
        await loop.sleep_forever()
        raise AssertionError

    async def aclose(self) -> None:
        await loop.checkpoint()


@virtual_time
async def test_a_transport_that_raises_anything() -> None:
    with pytest.raises(BusError, match="cannot send 000#0100 on bus0") as caught:
        async with open_master(Rude()) as master:
            await master.nmt_start()
    assert "OSError" in caught.value.seen
    assert caught.value.__cause__ is not None


@virtual_time
async def test_a_bug_in_a_machine_reaches_the_user_and_the_drives_are_halted_before() -> None:
    """Whatever a Machine raises is a bug; the pump outlives it."""
    from canopen_proto.machine import Machine, Time

    class Broken(Machine):
        def handle_timeout(self, now: Time) -> None:
            self._arm(now + 10**12)
            raise ZeroDivisionError("a bug")

    async with simulated(3) as host:
        with pytest.raises(ZeroDivisionError, match="a bug"):
            async with open_master(BUS) as master:
                node = master.node(3)
                await node.write("controlword", 6)
                await node.write("controlword", 7)
                await node.write("controlword", 15)
                network = master.bus().network
                broken = Broken(network.out)
                network.attach(broken)
                broken._arm(master.now() + 10**8)
                await master.send_sync()
                await loop.sleep_forever()
        assert host.nodes[0].values.store[0x6040_00] == 0x10F


@virtual_time
async def test_a_master_needs_buses_with_different_names() -> None:
    with pytest.raises(LocalProtocolError, match="needs a bus"):
        open_master()
    with pytest.raises(LocalProtocolError, match="named twice"):
        open_master("virtual:a", "virtual:a")
