"""Programs in a world: trio, asyncio and python-can, unchanged; their time is the world's, and a wait in real time is told."""

from __future__ import annotations

import _thread
import asyncio
import os
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType

import can
import pytest
import trio
import trio.testing

from canopen_master import ChainSettings, open_master
from canopen_master.errors import DeviceRefusedError
from canopen_proto import EmcyReceived
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.testing import DidNotHappenError, Lose, World, boot_up, emcy, heartbeat, nmt, sdo_answer
from canopen_testing import ProgramWorld, ThreadStartedError, WallClockWaitError, WorldCanBus
from canopen_testing.present import present, present_world
from canopen_transports import open_transport

pytest_plugins = "pytester"


async def configure(locator: str = "virtual:can0") -> str:
    """What a user writes."""
    async with open_master(locator) as master:
        node = master.node(5, "sample_io.eds")
        await node.write("producer_heartbeat_time", 500)
        await node.start()
        await trio.sleep(3)
        return await node.read_str("manufacturer_device_name")


def world_of(seed: int = 0, **more: object) -> ProgramWorld:
    world = ProgramWorld(seed, **more)  # type: ignore[arg-type]
    world.device("sample_io.eds", 5)
    return world


# ---- trio ----


def test_a_trio_program_runs_unchanged() -> None:
    world = world_of()
    assert world.run(configure) == "Sample I/O"
    assert 3 * SECOND < world.now < 4 * SECOND
    world.bus().saw(nmt("start", 5)).then(heartbeat(5)).then(heartbeat(5)).within(501 * MILLISECOND)
    world.bus().observer.clean()


def test_the_file_of_a_drive_makes_a_drive_that_moves() -> None:
    world = ProgramWorld()
    assert isinstance(world.device("sample_drive.eds", 5), DriveNode)
    with pytest.raises(DeviceRefusedError, match="which node-ID"):
        world.device("sample_drive.eds")


def test_whatever_bus_it_opens_is_that_of_the_world() -> None:
    world = world_of()
    assert world.run(configure, "socketcan:can0") == "Sample I/O"
    other = ProgramWorld()
    other.advance(48 * 3600 * SECOND)
    other.device("sample_io.eds", 5, bus="PCAN_USBBUS1")
    assert trio.run(configure, "pcan:PCAN_USBBUS1@500k", clock=other) == "Sample I/O"
    other.advance(SECOND)


def test_a_recording_is_still_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    path.write_text("(0000000000.000000) can0 705#00\n")

    async def main() -> str:
        async with await open_transport(f"file:{path}") as bus:
            received = await bus.receive()
            assert isinstance(received, tuple)
            return str(received[0])

    assert ProgramWorld().run(main) == "705#00"


def test_two_participants_of_a_program_meet_in_the_world() -> None:
    world = ProgramWorld(faults=[Lose(nth=2)])

    async def main() -> list[str]:
        one, other = await open_transport("virtual:can0"), await open_transport("virtual:can0")
        async with one, other:
            for text in ("100#01", "100#02", "100#03"):
                await one.send(Frame.parse(text))
            await trio.sleep(0.01)
            return [str((await other.receive())[0]) for _ in range(2)]  # type: ignore[index]

    assert world.run(main) == ["100#01", "100#03"]
    assert [each.sender for each in world.bus().trace] == ["program"] * 3
    assert world.bus().participants == []


LIFE = """
import trio
from canopen_master import open_master
from canopen_proto.testing import Lose, sdo_answer
from canopen_testing import ProgramWorld

async def main():
    async with open_master("virtual:can0") as master, trio.open_nursery() as nursery:
        async def work(node_id):
            node = master.node(node_id)
            for number in range(20):
                try:
                    await node.write("producer_heartbeat_time", 100 + number)
                except Exception as error:
                    print(error)
                await trio.sleep(0.01)
        for node_id in (5, 6, 7):
            nursery.start_soon(work, node_id)

world = ProgramWorld(1, [Lose(sdo_answer(), chance=0.1)])
for node_id in (5, 6, 7):
    world.drive(node_id)
world.run(main)
for each in world.bus().trace:
    print(*each)
"""


LIFE_IN_ASYNCIO = """
import asyncio
from canopen_proto.testing import Lose, sdo_answer
from canopen_master import open_master
from canopen_testing import ProgramWorld

async def main():
    async with open_master("virtual:can0") as master:
        async def work(node_id):
            node = master.node(node_id)
            for number in range(20):
                try:
                    await node.write("producer_heartbeat_time", 100 + number)
                except Exception as error:
                    print(error)
                await asyncio.sleep(0.01)
        await asyncio.gather(*map(work, (5, 6, 7)))

world = ProgramWorld(1, [Lose(sdo_answer(), chance=0.1)])
for node_id in (5, 6, 7):
    world.drive(node_id)
world.run_asyncio(main)
for each in world.bus().trace:
    print(*each)
"""


def life(program: str, hash_seed: str) -> str:
    environment = {**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", program]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout


@pytest.mark.thorough(2)
@pytest.mark.parametrize("program", [LIFE, LIFE_IN_ASYNCIO], ids=["trio", "asyncio"])
def test_a_seed_gives_a_program_the_same_frames_in_each_process(program: str) -> None:
    one, other = life(program, "0"), life(program, "99")
    assert one == other
    assert one.count("60") > 100


def test_a_chain_of_joints_is_made_ready_in_a_world() -> None:
    world = ProgramWorld()
    world.drive(3)

    async def main() -> float:
        async with open_master("virtual:can0") as master:
            arm = master.load_chains(text="arm joint1 can0 3", settings=ChainSettings(cycle_time=0.01))["arm"]
            await arm.initialise()
            return arm.positions[0]

    assert world.run(main) == world.nodes[3].values.store[0x606400]


def test_tasks_that_wait_for_all_others_come_before_time_passes() -> None:
    world = ProgramWorld()

    async def main() -> list[float]:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(trio.sleep, 5)
            await trio.testing.wait_all_tasks_blocked()
            seen = [trio.current_time()]
            await trio.sleep(1.5)
            await trio.testing.wait_all_tasks_blocked()
            return [*seen, trio.current_time()]

    assert world.run(main) == [0.0, 1.5]


def beating() -> ProgramWorld:
    """A world in which something happens each millisecond."""
    world = world_of()
    world.nodes[5].set_value(0x1017, 0, 1, 0)
    return world


def test_time_stands_still_while_a_thread_works_for_the_program() -> None:
    def works() -> int:
        time.sleep(0.03)
        return 5

    async def in_trio() -> list[float]:
        both = [await trio.to_thread.run_sync(works, limiter=limiter) for limiter in (None, trio.CapacityLimiter(1))]
        return [*both, trio.current_time()]

    async def in_asyncio() -> list[float]:
        loop = asyncio.get_running_loop()
        return [await asyncio.to_thread(works), await loop.run_in_executor(None, works), loop.time()]

    for _ in range(3):
        world = beating()
        assert world.run(in_trio) == [5, 5, 0.0]
        world.run(trio.sleep, 0.0105)
        assert world.run_asyncio(in_asyncio) == [5, 5, 0.0105]
        assert world.now == 10_500_000, "the end of the executor's threads takes no time either"


def test_a_thread_that_does_not_come_back_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canopen_testing.program_world.WORKING", 0.05)
    asked = threading.Event()

    async def in_trio() -> None:
        await trio.to_thread.run_sync(asked.wait, abandon_on_cancel=True)

    async def in_asyncio() -> None:
        await asyncio.to_thread(asked.wait)

    threading.Timer(0.5, asked.set).start()  # the threads end, whatever becomes of the programs
    with pytest.raises(DidNotHappenError, match=r"waits for the thread of wait from .*, which works for 0.05 s of real"):
        beating().run(in_trio)
    with pytest.raises(DidNotHappenError, match=r"waits for the thread of Event.wait, which works"):
        beating().run_asyncio(in_asyncio)


def test_a_thread_of_the_programs_own_is_named_and_refused() -> None:
    def start(name: str) -> None:
        threading.Thread(target=print, name=name).start()

    async def in_a_program() -> None:
        start("logger 7")

    world = world_of()
    text = r"the thread 'logger 7' \(print\) runs in real time"
    for run in (world.run, world.run_asyncio):
        with pytest.raises(ThreadStartedError, match=text):
            run(in_a_program)
    with present(world):
        with pytest.raises(ThreadStartedError, match=text):
            start("logger 7")
        with WorldCanBus("can0", world=world) as bus, pytest.raises(ThreadStartedError, match="Notifier for bus"):
            can.Notifier(bus, [can.Printer()])
        with ThreadPoolExecutor() as pool, pytest.raises(ThreadStartedError, match="ThreadPoolExecutor"):
            pool.submit(print)
        with pytest.raises(ThreadStartedError, match=r"a thread \(print\) runs in real time"):
            _thread.start_new_thread(print, ())
    start("outside of a world")
    world.allows_threads = True
    world.run(in_a_program)
    world.run_asyncio(in_a_program)


def test_a_recording_has_a_thread_that_decides_nothing(tmp_path: Path) -> None:
    world = ProgramWorld()
    world.drive(3)

    async def main() -> float:
        async with open_master("virtual:can0") as master:
            arm = master.load_chains(text="arm joint1 can0 3", settings=ChainSettings(cycle_time=0.01))["arm"]
            await arm.initialise()
            async with arm.record(tmp_path / "arm.csv"):
                await trio.sleep(0.1)
            return trio.current_time()

    times = set()
    for _ in range(2):
        world = ProgramWorld()
        world.drive(3)
        times.add(world.run(main))
    assert len(times) == 1
    assert (tmp_path / "arm.csv").read_text().count("\n") > 9


# ---- asyncio ----


def test_an_asyncio_program_runs_unchanged() -> None:
    world = world_of()
    world.nodes[5].set_value(0x1017, 0, 500, 0)

    async def main() -> list[int]:
        with can.Bus(interface="canopen_world", channel="can0", bitrate=500_000) as bus:
            reader = can.AsyncBufferedReader()
            notifier = can.Notifier(bus, [reader], loop=asyncio.get_running_loop())
            ids = [(await reader.get_message()).arbitration_id for _ in range(3)]
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(asyncio.Event().wait(), 100)
            notifier.stop()
            return ids

    assert world.run_asyncio(main) == [0x705] * 3
    assert world.now > 100 * SECOND


def test_a_master_for_asyncio() -> None:
    world = world_of()

    async def main() -> tuple[object, object]:
        async with open_master("socketcan:can0") as master:
            node = master.node(5)
            return tuple(await asyncio.gather(node.read("device_type"), node.read((0x1018, 1))))

    assert world.run_asyncio(main) == (0x0007_0191, 0xFFFF_FF01)


# ---- python-can, blocking ----


def test_a_blocking_program_waits_in_the_worlds_time() -> None:
    world = world_of()
    with WorldCanBus("can0", world=world) as bus:
        bus.send(can.Message(arbitration_id=0, data=[1, 5], is_extended_id=False))
        first = bus.recv()
        assert first is not None
        assert (first.arbitration_id, bytes(first.data)) == (0x185, bytes(5))
        before = world.now
        assert bus.recv(0.05) is None
        assert world.now == before + 50 * MILLISECOND
        assert bus.recv(0) is None
    assert [each.name for each in world.bus().participants] == ["node 5"]


def test_a_read_of_a_bus_on_which_nothing_happens_ends_with_its_timeout() -> None:
    world = ProgramWorld()
    with WorldCanBus("can0", world=world) as bus:
        assert bus.recv(0.5) is None
        assert world.now == SECOND // 2
        with pytest.raises(
            DidNotHappenError, match=r"a frame for recv\(\) of the bus can0 .* did not come .* nothing more will happen"
        ):
            bus.recv()


def test_a_bus_without_a_world_is_told() -> None:
    with pytest.raises(LocalProtocolError, match="there is no world"):
        present_world()


# ---- bit timing ----


def test_with_a_bit_rate_frames_take_the_time_of_their_bits_and_the_lowest_goes_first() -> None:
    world = ProgramWorld()
    bus = world.bus("can0", bitrate=125_000)
    one, other = (world.listener(lambda frame, now: None, name=name) for name in ("one", "other"))
    world.send(one, Frame.parse("300#0000000000000000"))
    world.send(other, Frame.parse("100#FFFFFFFFFFFFFFFF"))
    world.advance(SECOND)
    assert [str(each.frame)[:3] for each in bus.trace] == ["100", "300"]
    first, second = (each.time for each in bus.trace)
    assert 111 * 8_000 - 24_000 <= first <= 135 * 8_000
    assert 111 * 8_000 <= second - first <= 135 * 8_000
    assert world.bus("can0", bitrate=125_000) is bus
    with pytest.raises(LocalProtocolError, match="can0 has 125000 bit/s already: it cannot have 500000 bit/s too"):
        world.bus("can0", bitrate=500_000)


def test_a_bus_gets_its_bit_rate_as_long_as_nothing_is_under_way() -> None:
    world = ProgramWorld()
    bus, master = world.bus(), world.master()
    world.drive(5)
    assert world.bus(bitrate=10_000) is bus
    began = world.now
    assert master.read(5, "device_type") == 0x0002_0192
    assert world.now - began > 20 * MILLISECOND, "two frames of eight bytes"
    bus.send("705#05")
    other = ProgramWorld()
    other.bus().send("705#05")
    with pytest.raises(LocalProtocolError, match="frames are under way on the bus can0"):
        other.bus(bitrate=125_000)
    other.advance(MILLISECOND)
    assert other.bus(bitrate=125_000).bitrate == 125_000


def test_two_nodes_with_one_id_drive_each_other_off_the_bus() -> None:
    world = ProgramWorld()
    bus = world.bus("can0", bitrate=125_000)
    drive = world.drive(5)
    rival = world.listener(lambda frame, now: None)
    drive.set_value(0x1017, 0, 100, 0)
    world.advance(99 * MILLISECOND)
    for _ in range(40):
        world.send(rival, Frame.parse("705#05"))
    world.advance(SECOND)
    bus.saw(emcy(5, 0x8140))


def test_a_master_works_on_a_bus_with_a_bit_rate() -> None:
    world = ProgramWorld()
    world.bus("can0", bitrate=125_000)
    world.drive(5)
    world.master().write(5, "producer_heartbeat_time", 100)
    world.run_until(heartbeat(5))
    world.run_until(heartbeat(5))
    world.bus().saw(boot_up(5)).then(sdo_answer(5))


# ---- what is told ----


def test_a_wait_in_real_time_is_told() -> None:
    async def main() -> None:
        time.sleep(0.5)

    with pytest.raises(WallClockWaitError, match=r"time.sleep\(0.5\) waits in real time"):
        ProgramWorld().run(main)
    with pytest.raises(WallClockWaitError):
        ProgramWorld().run_asyncio(main)
    time.sleep(0.0001)


def test_what_else_waits_in_real_time_is_told() -> None:
    async def main() -> None:
        await asyncio.sleep(0.1)

    loop = asyncio.new_event_loop()
    coroutine = main()
    waits: list[tuple[Callable[[], object], str]] = [
        (lambda: threading.Event().wait(0.1), "a wait for an event, a queue or another thread is one in real time"),
        (lambda: queue.Queue[int]().get(timeout=0.1), "a wait for an event"),
        (lambda: asyncio.run(main()), "this asyncio loop runs in real time: use `world.run_asyncio"),
        (lambda: loop.run_until_complete(coroutine), "this asyncio loop runs in real time"),
        (lambda: loop.run_forever(), "this asyncio loop runs in real time"),
        (lambda: trio.run(trio.sleep, 0.1), "trio.run has a clock in real time: use `world.run"),
    ]
    with present(ProgramWorld()):
        for wait, text in waits:
            with pytest.raises(WallClockWaitError, match=text):
                wait()
        assert not threading.Event().wait(0)
        trio.run(trio.sleep, 1, clock=trio.testing.MockClock(autojump_threshold=0))
    loop.close()
    asyncio.run(main())


def test_a_bus_in_earnest_is_refused_in_a_world() -> None:
    with present(ProgramWorld()), pytest.raises(LocalProtocolError, match="a SocketCAN socket is a bus in earnest"):
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    with present(ProgramWorld()):
        socket.socket().close()


def test_the_loop_that_is_missing_is_named(suite: pytest.Pytester) -> None:
    suite.makepyfile("""
        import asyncio, pytest, trio

        async def test_without_a_mark(canopen_world):
            await asyncio.sleep(1)

        @pytest.mark.asyncio
        async def test_with_a_mark(canopen_world):
            await trio.sleep(1)
    """)
    text = suite.runpytest("-p", "no:asyncio").stdout.str()
    assert "this test runs in trio; to run it in asyncio, mark it @pytest.mark.asyncio" in text
    assert "this test runs in asyncio; to run it in trio, mark it @pytest.mark.trio" in text


def test_a_sleep_that_was_imported_by_its_name_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds = ProgramWorld(), ProgramWorld()
    for number, world in enumerate(worlds):  # the second module comes when a world was there already
        module = ModuleType(f"users_{number}")
        exec("from time import sleep as wait\nasync def main(): wait(0.5)", vars(module))
        monkeypatch.setitem(sys.modules, module.__name__, module)
        with pytest.raises(WallClockWaitError, match=r"time.sleep\(0.5\) waits in real time"):
            world.run(module.main)
        assert module.wait is time.sleep, "it is given back"


def test_a_program_that_waits_for_what_never_comes_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canopen_testing.program_world.IN_EARNEST", 0.05)

    async def forever() -> None:
        await trio.sleep_forever()

    async def never() -> None:
        await asyncio.Event().wait()

    with pytest.raises(DidNotHappenError, match="waits for what never comes: at 0 s"):
        ProgramWorld().run(forever)
    with pytest.raises(DidNotHappenError, match="waits for what never comes: at 0 s"):
        ProgramWorld().run_asyncio(never)
    beating = ProgramWorld()
    beating.drive(5).set_value(0x1017, 0, 1000, 0)
    with pytest.raises(DidNotHappenError, match=r"has run for its limit, until 60.*s of the world.\n(.|\n)*705#7F"):
        beating.run(forever, limit=60 * SECOND)


def test_a_stuck_program_is_shown_where_it_waits() -> None:
    async def reads(bus: str) -> None:
        async with open_master(bus) as master, trio.open_nursery() as nursery:
            nursery.start_soon(trio.sleep_forever)
            nursery.start_soon(looks)
            with master.events(EmcyReceived) as events:
                async for _ in events:  # for an emergency
                    raise AssertionError

    async def looks() -> None:
        while True:
            await trio.sleep(1)  # and looks again

    async def awaits() -> None:
        await looks_in_asyncio()

    async def looks_in_asyncio() -> None:
        await asyncio.gather(asyncio.Event().wait(), waits(2))  # for both

    async def waits(seconds: float) -> None:
        while True:
            await asyncio.sleep(seconds)  # and again

    with pytest.raises(DidNotHappenError) as told:
        world_of().run(reads, "virtual:can0", limit=5 * SECOND)
    where = str(told.value).partition("The program waits here:\n")[2].partition("The last frames")[0]
    assert [line.partition(": ")[2] for line in where.splitlines()] == [
        "async for _ in events:  # for an emergency",
        "await trio.sleep(1)  # and looks again",
    ]
    assert all(line.startswith("  test_programs.py:") for line in where.splitlines())
    with pytest.raises(DidNotHappenError) as told:
        world_of().run_asyncio(awaits, limit=5 * SECOND)
    where = str(told.value).partition("The program waits here:\n")[2].partition("The last frames")[0]
    assert [line.partition(": ")[2] for line in where.splitlines()] == [
        "await asyncio.gather(asyncio.Event().wait(), waits(2))  # for both",
        "await asyncio.sleep(seconds)  # and again",
    ]


def test_a_program_may_wait_in_vain_in_another_world() -> None:
    async def main() -> None:
        World().run_until(lambda: False)  # of its own

    for run in (ProgramWorld().run, ProgramWorld().run_asyncio):
        with pytest.raises(DidNotHappenError, match="nothing more will happen") as told:
            run(main)
        assert any(entry.name == "main" for entry in told.traceback)


def test_a_program_that_is_ended_has_time_to_clean_up() -> None:
    cleaned: list[str] = []

    async def in_trio() -> None:
        try:
            await trio.sleep_forever()
        finally:
            with trio.CancelScope(shield=True):
                await trio.sleep(1)
            cleaned.append("trio")

    async def in_asyncio() -> None:
        try:
            await asyncio.sleep(1000)
        finally:
            await asyncio.sleep(2)
            cleaned.append("asyncio")

    async def with_an_arm() -> None:
        async with open_master("virtual:can0") as master:
            master.node(5)
            while True:
                await trio.sleep(1)

    for seed in range(3):
        world = ProgramWorld(seed=seed)
        world.drive(5).set_value(0x1017, 0, 1000, 0)
        for run, program in ((world.run, in_trio), (world.run_asyncio, in_asyncio), (world.run, with_an_arm)):
            began = world.now
            with pytest.raises(DidNotHappenError, match="has run for its limit"):
                run(program, limit=10 * SECOND)
            assert 10 * SECOND <= world.now - began < 20 * SECOND
    assert cleaned == ["trio", "asyncio"] * 3


STUBBORN = """
import asyncio, contextlib, trio
from canopen_proto import SECOND
from canopen_proto.testing import DidNotHappenError
from canopen_testing import ProgramWorld

async def in_trio():
    with trio.CancelScope(shield=True):
        await trio.sleep(1000)

async def in_asyncio():
    while True:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(1000)

world = ProgramWorld()
for run, program in ((world.run_asyncio, in_asyncio), (world.run, in_trio)):
    began = world.now
    try:
        run(program, limit=10 * SECOND)
    except DidNotHappenError:
        print((world.now - began) / SECOND)
"""


def test_a_program_that_does_not_end_when_it_is_cancelled_is_left() -> None:
    """In a process of its own: its tasks are thrown away while they run, and Python tells of that."""
    assert [float(each) for each in life(STUBBORN, "0").split()] == [pytest.approx(70, abs=5)] * 2


def test_a_program_has_the_limit_of_its_world() -> None:
    world = ProgramWorld()
    world.limit = 10 * SECOND
    with pytest.raises(DidNotHappenError, match="has run for its limit, until 10 s"):
        world.run(trio.sleep, 3600)
    with pytest.raises(DidNotHappenError, match="has run for its limit, until 20 s"):
        trio.run(world.watched, trio.sleep, 3600, clock=world)
    with pytest.raises(DidNotHappenError, match="has run for its limit, until 30 s"):
        world.run_asyncio(asyncio.sleep, 3600)
    world.run(trio.sleep, 15, limit=20 * SECOND)


def test_a_mistake_is_told_at_once_with_the_right_form() -> None:
    world = ProgramWorld()

    async def main() -> None:
        pass

    for run, name in ((world.run, "world.run"), (world.run_asyncio, "world.run_asyncio")):
        with pytest.raises(LocalProtocolError, match=rf"give the function, as in {name}\(main\)"):
            run(main())

    async def runs_another() -> None:
        world.run(main)

    with pytest.raises(LocalProtocolError, match="a program runs in this world already"):
        world.run(runs_another)
    with pytest.raises(LocalProtocolError, match="a bit rate is bit/s, such as 125_000, not '125k'"):
        world.bus(bitrate="125k")  # type: ignore[arg-type]
    with pytest.raises(LocalProtocolError, match="limit is 5: times are nanoseconds"):
        world.run(main, limit=5)
    with pytest.raises(DeviceRefusedError, match='sim_node."sample_drive.eds", node_id=5.') as told:
        world.device("sample_drive.eds")
    assert "--id" not in str(told.value)
    with pytest.raises(LocalProtocolError, match="node-ID 300 is outside 1..127"):
        world.device("sample_drive.eds", 300)


def test_a_program_cannot_let_time_pass_without_awaiting() -> None:
    world = ProgramWorld()

    async def main() -> None:
        world.advance(SECOND)

    with pytest.raises(LocalProtocolError, match="await trio.sleep"):
        world.run(main)
    with pytest.raises(LocalProtocolError, match="await asyncio.sleep"):
        world.run_asyncio(main)
    world.advance(SECOND)


def test_an_emergency_reaches_a_supervisor() -> None:
    world = ProgramWorld()
    drive = world.drive(5)

    async def main() -> int:
        async with open_master("virtual:can0") as master:
            with master.events(EmcyReceived) as events:
                await master.node(5).start()
                drive.raise_fault(0x7300, world.now)
                async for event in events:
                    return event.code
        raise AssertionError

    assert world.run(main) == 0x7300
    world.bus().saw(emcy(5, 0x7300)).within(100 * MILLISECOND)
