"""The blocking master: threads, timeouts, Ctrl-C, callbacks, and all the ways in which it ends. Its drives are simulated."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import pytest
import trio

from canopen_data.descriptions import load_description
from canopen_master import (
    BusError,
    CallTimeoutError,
    ChainHaltedError,
    DeviceModel,
    HaltNotConfirmedError,
    MasterClosedError,
    PatientClock,
    SdoTimeoutError,
)
from canopen_master.blocking import (
    BlockingChain,
    BlockingMaster,
    BlockingSimulatedDevices,
    callbacks,
    loop_thread,
    open_master,
    simulated_devices,
)
from canopen_proto import EmcyReceived, Event, LocalProtocolError, PdoReceived
from canopen_proto.drives.cia402.states import State
from canopen_proto.procedures import read
from tests.master.direct_world import LIMIT, near_home, until
from tests.master.test_blocking_background import interrupt_when

BUS = "virtual:blocking"
STATION = DeviceModel(load_description("sample_io.eds").dictionary, node_id=5)
IO = 0x00070191
"""The device type of the station."""
THREADS = {"canopen master", "canopen events"}


@pytest.fixture(autouse=True)
def patient_world(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of it is in this process: a computer that is busy makes nothing late."""
    monkeypatch.setattr(loop_thread, "make_clock", PatientClock)


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    yield
    until(lambda: not THREADS & {each.name for each in threading.enumerate()})


@contextmanager
def world(*node_ids: int, **options: Any) -> Iterator[tuple[BlockingSimulatedDevices, BlockingMaster]]:
    """Drives and an I/O station, and a master that asks patiently."""
    with (
        simulated_devices({BUS: [*near_home(*node_ids), STATION]}) as devices,
        open_master(BUS, **({"sdo_timeout": 10.0} | options)) as master,
    ):
        yield devices, master


def arm_of(master: BlockingMaster, *node_ids: int) -> BlockingChain:
    joints = " ".join(f"joint{number} can0 {node_id}" for number, node_id in enumerate(node_ids, start=1))
    arm = master.load_chains(text=f"arm {joints}\n")["arm"]
    arm.initialise()
    return arm


def assert_halted(devices: BlockingSimulatedDevices) -> None:
    """No drive moves, and those with power were told to halt."""
    assert devices.moving == []
    for drive in devices.drives.values():
        assert drive.drive.state is not State.OPERATION_ENABLED or int(str(drive.values.read("controlword"))) & 0x100


def assert_stands(devices: BlockingSimulatedDevices) -> None:
    """No drive goes on. The last cycle of a ramp may not be over, in which a drive moves by less than it could be told."""
    before = {node_id: position(devices, node_id) for node_id in devices.drives}
    until(lambda: devices.moving == [])
    assert {node_id: position(devices, node_id) for node_id in devices.drives} == pytest.approx(before, abs=2)


def position(devices: BlockingSimulatedDevices, node_id: int) -> int:
    """In counts, now."""
    found: list[int] = []
    devices.change(node_id, lambda drive, now: (drive.drive.refresh(now), found.append(int(str(drive.values[0x6064_00])))))
    return found[0]


def in_thread(function: Callable[[], object]) -> threading.Thread:
    thread = threading.Thread(target=function)
    thread.start()
    return thread


# ---- nodes, drives, events ----


def test_objects_are_read_and_written_by_name() -> None:
    with world() as (_, master):
        node = master.node(5, "sample_io.eds")
        assert node["device_type"] == node.read_int(0x1000) == IO
        node["producer_heartbeat_time"] = 500
        assert node["producer_heartbeat_time"] == 500
        assert node.read_str("manufacturer_device_name")
        assert master.node(5) is node
        assert node.wait_for_heartbeat(LIMIT) is node.nmt_state
        with pytest.raises(KeyError):
            node["no such object"]
        assert master.run(read(node.remote, "device_type")) == IO


def test_pdos_come_to_a_loop() -> None:
    with world() as (_, master):
        node = master.node(5, "sample_io.eds")
        with node.events(PdoReceived) as pdos:
            node.start()
            for pdo in pdos:
                assert pdo.node_id == 5
                break
            assert pdos.take() == []


def test_a_chain_is_homed_moves_jogs_and_is_recorded(tmp_path: Any) -> None:
    with world(3, 4) as (devices, master):
        arm = arm_of(master, 3, 4)
        assert [*arm.joints] == ["joint1", "joint2"]
        assert arm.devices[0].node is master.node(3) is master.devices[master.node(3), 0].node
        arm.home()
        assert arm.is_homed
        with arm.record(tmp_path / "run.csv") as recorder:
            arm.move([0.02, 0.01])
            assert arm.positions == pytest.approx([0.02, 0.01], abs=1e-3)
        assert recorder.rows > 0
        assert len((tmp_path / "run.csv").read_text().splitlines()) > recorder.rows
        with arm.jog() as jog:
            jog.velocity([0.05, 0.05])
            until(lambda: devices.moving)
        assert_stands(devices)
        arm.override = 0.5
        assert arm.override == 0.5
        for cycle in arm.cycles():
            arm.set_positions(arm.desired)
            if cycle.number == 2:
                break
        arm.shut_down()


def test_what_has_no_blocking_form_runs_in_the_loop() -> None:
    with world() as (_, master):
        node = master.node(5, "sample_io.eds")

        async def twice(master: Any, node: Any) -> int:
            return 2 * int(await node.read_int("device_type"))

        assert master.in_loop(twice, node) == 2 * node.read_int("device_type")
        assert master.in_loop(lambda master: trio.lowlevel.in_trio_run())
        with pytest.raises(ZeroDivisionError):
            master.in_loop(lambda master: 1 / 0)


def test_a_stream_is_read_and_written_in_pieces() -> None:
    with world() as (_, master):
        node = master.node(5, "sample_io.eds")
        name = node.read_bytes("manufacturer_device_name")
        with node.read_stream(0x1008) as stream:
            assert b"".join(stream) == name
            assert stream.size == len(name)
        threads: list[str] = []

        def pieces() -> Iterator[bytes]:
            threads.append(threading.current_thread().name)
            yield b"\x64"
            yield b"\x00"

        node.write_stream(0x1017, 0, pieces(), 2)
        assert node["producer_heartbeat_time"] == 100
        assert threads != ["canopen master"]


# ---- several threads ----


def test_each_thread_gets_the_answer_to_its_own_question() -> None:
    objects = {"device_type": IO, "identity_object:vendor_id": None, "manufacturer_device_name": None}
    with world() as (_, master):
        node = master.node(5, "sample_io.eds")
        expected = {key: node[key] for key in objects}
        wrong: list[object] = []

        def ask(key: str) -> None:
            wrong.extend(value for _ in range(50) if (value := node[key]) != expected[key])

        threads = [in_thread(lambda key=key: ask(key)) for key in [*objects] * 3]  # type: ignore[misc]
        for thread in threads:
            thread.join(LIMIT)
        assert wrong == []


def test_two_masters_share_a_loop_and_meet_on_one_virtual_bus() -> None:
    with world() as (_, first), open_master(BUS, sdo_timeout=10.0) as second:
        assert first.node(5)["device_type"] == second.node(5)["device_type"]
        assert len([each for each in threading.enumerate() if each.name == "canopen master"]) == 1


# ---- what ends a call ----


def test_a_call_that_takes_longer_than_its_timeout_is_taken_back() -> None:
    with world() as (_, master):
        with pytest.raises(CallTimeoutError, match="not done within 0.01 s") as caught:
            master.node(77).read("device_type", timeout=0.01)
        assert caught.value.timeout == 0.01
        assert isinstance(caught.value, TimeoutError)
        assert master.node(5)["device_type"] == IO


def test_a_motion_that_takes_longer_than_its_timeout_stands_when_the_call_ends() -> None:
    with world(3) as (devices, master):
        arm = arm_of(master, 3)
        arm.follow()
        with pytest.raises(CallTimeoutError):
            arm.move([arm.positions[0] + 3.0], timeout=0.3)
        assert_stands(devices)


def test_ctrl_c_in_a_call_stops_what_moves_before_it_is_raised() -> None:
    with world(3) as (devices, master):
        arm = arm_of(master, 3)
        arm.follow()
        pressing = interrupt_when(lambda: devices.moving)
        with pytest.raises(KeyboardInterrupt):
            arm.move([arm.positions[0] + 3.0])
        assert_stands(devices)
        pressing.join(LIMIT)
        arm.move([arm.positions[0] + 0.01])


def test_ctrl_c_between_two_calls_leaves_the_block_and_halts() -> None:
    with simulated_devices({BUS: near_home(3)}) as devices:
        with pytest.raises(KeyboardInterrupt), open_master(BUS, sdo_timeout=10.0) as master:
            arm = arm_of(master, 3)
            arm.follow()
            moving = in_thread(lambda: ends(arm.move, [arm.positions[0] + 3.0]))
            until(lambda: devices.moving)
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(LIMIT)
        assert_halted(devices)
        moving.join(LIMIT)


def ends(function: Callable[..., object], *arguments: object) -> None:
    """Call something that the end of the master ends, in one of the two ways in which that ends the async one, too."""
    with pytest.raises((MasterClosedError, ChainHaltedError)):
        function(*arguments)


def test_another_call_is_not_disturbed_by_one_that_is_taken_back() -> None:
    with world() as (_, master):
        silent, node, answers = master.node(77), master.node(5), []

        def ask() -> None:
            answers.extend(node["device_type"] for _ in range(30))

        asking = in_thread(ask)
        while asking.is_alive():
            with pytest.raises(CallTimeoutError):
                silent.read("device_type", timeout=0.001)
        assert answers == [IO] * 30


def test_a_context_whose_block_is_interrupted_ends_at_once() -> None:
    with world(3) as (devices, master):
        arm = arm_of(master, 3)
        with pytest.raises(KeyboardInterrupt), arm.jog() as jog:
            jog.velocity([0.2])
            until(lambda: devices.moving)
            raise KeyboardInterrupt
        assert_stands(devices)
        with pytest.raises(ValueError, match="of mine"), arm.jog() as jog:
            raise ValueError("of mine")


# ---- how it ends ----


def test_after_the_block_each_use_is_refused() -> None:
    with world(3) as (devices, master):
        node, arm = master.node(3), arm_of(master, 3)
        events = master.events(Event)
        handler = node.on(Event, print)
        arm.follow()
        master.close()
        assert_halted(devices)
        for use in (
            lambda: node["device_type"],
            lambda: node.nmt_state,
            lambda: arm.positions,
            lambda: master.node(4),
            lambda: node.on(Event, print),
            lambda: master.in_loop(lambda master: 0),
            events.receive,
            arm.jog().__enter__,
        ):
            with pytest.raises(MasterClosedError):
                use()
        events.close()
        handler.close()
        master.close()
        assert [halt.problem for halt in master.halts] == [""]


def test_a_drive_that_does_not_confirm_its_halt_is_told_by_the_end() -> None:
    devices: AbstractContextManager[BlockingSimulatedDevices] = simulated_devices({BUS: near_home(3)})
    devices.__enter__()
    master = open_master(BUS, sdo_timeout=10.0)
    arm_of(master, 3)
    devices.__exit__(None, None, None)
    with pytest.raises(HaltNotConfirmedError, match="node 3"):
        master.close()


def test_an_error_of_the_block_keeps_what_its_end_has_to_say_as_a_note() -> None:
    devices: AbstractContextManager[BlockingSimulatedDevices] = simulated_devices({BUS: near_home(3)})
    devices.__enter__()
    with pytest.raises(ValueError, match="of mine") as caught, open_master(BUS, sdo_timeout=10.0) as master:
        arm_of(master, 3)
        devices.__exit__(None, None, None)
        raise ValueError("of mine")
    assert "not every drive confirmed" in caught.value.__notes__[0]


def test_a_bus_that_cannot_be_opened_is_an_error_of_open_master() -> None:
    with pytest.raises(BusError):
        open_master("socketcan:nosuchbus0")


def test_drives_stand_when_the_thread_that_holds_the_master_has_ended() -> None:
    with simulated_devices({BUS: near_home(3)}) as devices:
        found: list[BlockingMaster] = []

        def hold() -> None:
            found.append(open_master(BUS, sdo_timeout=10.0))
            arm = arm_of(found[0], 3)
            arm.follow()

        in_thread(hold).join(LIMIT)
        until(lambda: found[0].is_closed)
        with pytest.raises(MasterClosedError):
            found[0].node(3)
        found[0].close()
        assert_halted(devices)


def test_a_silent_node_is_an_error_with_its_reason_as_in_the_async_master() -> None:
    with world(sdo_timeout=0.02) as (_, master), pytest.raises(SdoTimeoutError, match="node 77"):
        master.node(77)["device_type"]


# ---- callbacks ----


def test_a_callback_runs_in_a_thread_of_its_own_and_may_call_the_master() -> None:
    with world(3) as (devices, master):
        node, found = master.node(3), []

        def look(emergency: EmcyReceived) -> None:
            found.append((emergency.code, threading.current_thread().name, node["statusword"], handler.dropped))

        handler = node.on(EmcyReceived, look)
        master.on((EmcyReceived,), lambda emergency: found.append(emergency.code))
        devices.raise_fault(3, 0x8611)
        until(lambda: len(found) == 2)
        assert found[0][:2] == (0x8611, "canopen events")
        assert int(found[0][2]) & 0x08
        assert found[1] == 0x8611
        handler.close()
        handler.close()


def test_the_thread_of_the_callbacks_is_begun_where_no_interrupt_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    """An asynchronous exception for a thread that is beginning another one may end that one (CPython 3.11), and `Thread.start`
    then waits for ever."""
    begin, begun_by = threading.Thread.start, {}

    def started(thread: threading.Thread) -> None:
        begun_by[thread.name] = threading.current_thread().name
        begin(thread)

    monkeypatch.setattr(threading.Thread, "start", started)
    with world(3) as (devices, master):
        seen: list[int] = []
        for _ in range(2):
            master.node(3).on(EmcyReceived, lambda emergency: seen.append(emergency.code))
        devices.raise_fault(3, 0x1000)
        until(lambda: len(seen) == 2)
        assert len([each for each in threading.enumerate() if each.name == "canopen events"]) == 1
    assert begun_by["canopen events"] == "canopen master"


def test_a_slow_callback_delays_no_call_and_what_it_loses_is_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(callbacks, "QUEUE_SIZE", 3)
    caplog.set_level(logging.WARNING, "canopen_master")
    with world(3) as (devices, master):
        goes_on, began, seen = threading.Event(), threading.Event(), []

        def slow(emergency: EmcyReceived) -> None:
            began.set()
            goes_on.wait(LIMIT)
            seen.append(emergency.code)

        with master.node(3).on(EmcyReceived, slow) as handler:
            devices.raise_fault(3, 0x1000)
            assert began.wait(LIMIT)
            for code in range(0x1001, 0x1009):
                devices.raise_fault(3, code)
            assert master.node(3)["device_type"]  # nobody waits for the callback
            assert handler.dropped == 5
            goes_on.set()
            until(lambda: len(seen) == 4)
    assert seen == [0x1000, 0x1006, 0x1007, 0x1008]
    assert "5 events are lost" in caplog.text


def test_a_callback_that_raises_is_shown_and_gets_the_next_event(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[threading.ExceptHookArgs] = []
    monkeypatch.setattr(threading, "excepthook", shown.append)
    with world(3) as (devices, master):
        master.node(3).on(EmcyReceived, lambda emergency: 1 // (emergency.code - 0x1000))
        devices.raise_fault(3, 0x1000)
        until(lambda: shown)
        devices.raise_fault(3, 0x1001)
    assert [each.exc_type for each in shown] == [ZeroDivisionError]


def test_a_callback_may_close_the_master(monkeypatch: pytest.MonkeyPatch) -> None:
    with world(3) as (devices, master):
        master.node(3).on(EmcyReceived, lambda emergency: master.close())
        devices.raise_fault(3, 0x1000)
        until(lambda: master.is_closed)


def test_a_callback_that_never_returns_is_left_behind(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(callbacks, "LAST_EVENTS_TIME", 0.01)
    goes_on, began = threading.Event(), threading.Event()

    def hang(emergency: EmcyReceived) -> None:
        began.set()
        goes_on.wait(LIMIT)

    with world(3) as (devices, master):
        master.node(3).on(EmcyReceived, hang)
        devices.raise_fault(3, 0x1000)
        assert began.wait(LIMIT)
    assert "does not return" in caplog.text
    goes_on.set()


# ---- who may call ----


def test_the_thread_of_the_loop_may_not_wait_for_itself() -> None:
    with world() as (_, master):
        node = master.node(5)
        with pytest.raises(LocalProtocolError, match="own thread"):
            master.in_loop(lambda _: node["device_type"])
        with pytest.raises(LocalProtocolError, match="own thread"):
            master.in_loop(lambda _: master.close())
        assert node["device_type"]


def test_it_works_where_a_loop_of_asyncio_runs_as_in_a_notebook() -> None:
    async def cell() -> object:
        with world() as (_, master):
            return master.node(5)["device_type"]

    assert asyncio.run(cell()) == IO


def test_a_loop_that_ends_takes_no_more_and_another_one_begins() -> None:
    for _ in range(20):
        masters: list[BlockingMaster] = []
        threads = [in_thread(lambda: opened_and_closed(masters)) for _ in range(4)]  # noqa: B023 - joined below
        for thread in threads:
            thread.join(LIMIT)
        assert len(masters) == 4
        assert loop_thread._shared is not None


def opened_and_closed(masters: list[BlockingMaster]) -> None:
    with open_master(BUS) as master:
        assert master.buses
        masters.append(master)
