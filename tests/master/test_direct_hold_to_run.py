"""`move_until_user_interrupt` and `interactive_homing` of the direct API: a drive moves as long as somebody holds it."""

import threading
import time
from collections.abc import Callable, Iterator

import pytest
import trio
from trio.testing import MockClock

from canopen_master import ChainSettings, open_master, standard_drives
from canopen_master.direct import Session, hold_to_run
from canopen_master.direct.drive import COUNTS, DirectDrive
from canopen_master.direct.hold_to_run import move_while_held
from canopen_proto.drives.axis import DriveInFaultError
from canopen_proto.drives.cia402.objects import HOMING_METHOD, POSITION_ACTUAL_VALUE
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import LocalProtocolError
from canopen_proto.simulation.drive.node import DriveNode
from tests.master.direct_world import INTERVAL, LIMIT, LOOSE, PATIENT, Devices, devices
from tests.master.world import BUS, drives, simulated, virtual_time

pytest.importorskip("ruckig", reason="hold to run needs the extra `motion`")
pytestmark = pytest.mark.trio_only("`direct` has a trio loop of its own")

SPEED = 2000.0
"""Millidegrees per second."""


@pytest.fixture(params=["powerball"])
def arm(request: pytest.FixtureRequest) -> Iterator[Devices]:
    makers = standard_drives(12) if request.param == "standard" else ()
    with devices(*(() if makers else (12,)), makers=makers) as arm:
        yield arm


@pytest.fixture
def session(arm: Devices, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    monkeypatch.setattr(hold_to_run, "DEAD_MAN", LIMIT)  # a busy computer is late; the tests of the switch itself lower it
    with Session() as session:
        assert session.open_connection(arm.bus, sdo_timeout=PATIENT, watchdog=LOOSE), session.last_error()
        session.init_nmt()
        assert session.init_device(12)
        assert session.set_sync_interval(12, INTERVAL)
        yield session


def place(arm: Devices) -> int:
    position = arm.node(12).values[POSITION_ACTUAL_VALUE]
    assert isinstance(position, int)
    return position


def until_moved(arm: Devices, distance: int) -> Callable[[], bool]:
    """Hold until the drive has gone so far."""
    start = place(arm)

    def held() -> bool:
        time.sleep(0.01)
        return abs(place(arm) - start) < abs(distance)

    return held


@pytest.mark.thorough(2)
@pytest.mark.parametrize("speed", [SPEED, -SPEED])
def test_a_drive_moves_while_it_is_held_and_then_stands(session: Session, arm: Devices, speed: float) -> None:
    start = place(arm)
    assert session.move_until_user_interrupt(12, speed, until_moved(arm, 500)), session.last_error()
    assert not arm.is_moving(12)
    assert (place(arm) - start) * speed > 0
    assert 500 <= abs(place(arm) - start) < 5000
    assert arm.node(12).drive.state is State.OPERATION_ENABLED
    assert session.enable_ip_mode(12), session.last_error()


def test_nothing_moves_before_it_is_held(session: Session, arm: Devices) -> None:
    start = place(arm)
    arm.frames()
    assert session.move_until_user_interrupt(12, SPEED, lambda: False)
    assert set(arm.frames()) <= {"77F#05"}  # our heartbeat
    assert place(arm) == start


def test_a_holder_that_hangs_lets_go(session: Session, arm: Devices, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hold_to_run, "DEAD_MAN", 0.2)
    end, calls = threading.Event(), iter((True, True, True, True))

    def held() -> bool:
        return next(calls, None) is not None or not end.wait(LIMIT)

    assert session.move_until_user_interrupt(12, SPEED, held), session.last_error()
    assert not end.is_set()  # it still hangs, and the drive has stopped all the same
    end.set()
    assert not arm.is_moving(12)


def test_an_error_of_the_holder_brakes_first(session: Session, arm: Devices) -> None:
    moved = until_moved(arm, 300)

    def held() -> bool:
        if moved():
            return True
        raise ZeroDivisionError("the user's code")

    with pytest.raises(ZeroDivisionError):
        session.move_until_user_interrupt(12, SPEED, held)
    assert not arm.is_moving(12)


def test_halt_of_another_thread_ends_it(session: Session, arm: Devices) -> None:
    moved, halted = until_moved(arm, 300), list[threading.Thread]()

    def held() -> bool:
        if not moved() and not halted:
            halted.append(threading.Thread(target=session.halt, args=(12,)))
            halted[0].start()
        return True

    assert not session.move_until_user_interrupt(12, SPEED, held)
    assert "was halted meanwhile" in str(session.last_error())
    halted[0].join(LIMIT)
    assert not arm.is_moving(12)


def test_a_fault_ends_it(session: Session, arm: Devices) -> None:
    moved, broken = until_moved(arm, 300), list[bool]()

    def held() -> bool:
        if not moved() and not broken:
            broken.append(True)
            arm.break_down(12)
        return True

    assert not session.move_until_user_interrupt(12, SPEED, held)
    assert isinstance(session.last_error(), DriveInFaultError)


def test_a_chain_of_the_masters_cycle_is_jogged_otherwise(session: Session) -> None:
    session.using_master_thread = True
    session.init_master_thread(INTERVAL)
    with pytest.raises(LocalProtocolError, match="jog a chain instead"):
        session.move_until_user_interrupt(12, SPEED, lambda: True)


@pytest.mark.parametrize("arm", ["standard"], indirect=True)
def test_the_place_to_which_it_was_led_becomes_its_home(session: Session, arm: Devices) -> None:
    drive: DriveNode = arm.node(12)
    before = drive.values[HOMING_METHOD]
    assert session.define_pdo(12, "schunk_default_rPDO"), session.last_error()
    assert session.interactive_homing(12, SPEED, until_moved(arm, 300)), session.last_error()
    assert drive.values[HOMING_METHOD] == 37 != before
    assert abs(session.get_pos(12)) <= 1


def test_a_joint_without_methods_homes_in_its_own_way(session: Session, arm: Devices) -> None:
    assert session.interactive_homing(12, SPEED, lambda: False), session.last_error()
    assert abs(session.get_pos(12)) <= 5


@pytest.mark.thorough(4)
@pytest.mark.parametrize("gap", [0.045, 0.15, 0.19])
@pytest.mark.parametrize("brake", [10_000, 100_000])
def test_behind_a_gap_of_sync_a_drive_goes_on_from_where_it_is(gap: float, brake: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has braked by itself, and lies far beyond its last set-point. brake: its own, in millidegrees per second²."""
    speed, speeds, off_path = 10_000.0, [0.0], [False]

    async def asked(held: Callable[[], bool]) -> bool:
        await trio.sleep(0.02)
        return held()

    monkeypatch.setattr(hold_to_run, "_asked", asked)

    @virtual_time
    async def run() -> None:
        async with simulated(12) as host, open_master(BUS) as master:
            (node,) = drives(host)
            node.values.store.update({0x1006_00: 1_000_000, 0x6085_00: brake, 0x6084_00: brake})
            names = ChainSettings()
            drive = DirectDrive(master, master.device(master.node(12), settings=COUNTS), names.rpdo, names.tpdo)
            await master.nmt_start(12)
            await trio.sleep(0.1)
            await drive.change_state(State.OPERATION_ENABLED)
            await drive.set_interval(10)
            begin = trio.current_time()

            async def measure() -> None:
                while True:
                    node.drive.refresh(host.now())
                    speeds.append(abs(node.drive._servo.demand_velocity))
                    off_path.append(not drive.is_on_path)
                    await trio.sleep(0.0019)

            async def stall() -> None:
                await trio.sleep(0.8)
                clock = trio.lowlevel.current_clock()
                assert isinstance(clock, MockClock)
                clock.jump(gap)

            async with trio.open_nursery() as nursery:
                nursery.start_soon(measure)
                nursery.start_soon(stall)
                await move_while_held(drive, speed, lambda: trio.current_time() < begin + 1.5)
                nursery.cancel_scope.cancel()

    run()
    assert 0.99 * speed < max(speeds) <= 1.01 * speed
    assert sum(off_path) < 6  # of a SYNC interval: it does not come back to the path that it has left
