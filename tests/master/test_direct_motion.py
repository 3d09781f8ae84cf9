"""The direct half of the manual's blocking API: what moves. Frames are those of the wire, in candump's notation."""

import threading
from collections.abc import Iterator

import pytest

from canopen_master import MasterClosedError, NodeSilentError, standard_drives
from canopen_master.direct import Session
from canopen_proto.datatypes import ValueRangeError
from canopen_proto.dictionary import PdoNotFoundError
from canopen_proto.drives.axis import DriveInFaultError
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import LocalProtocolError
from canopen_proto.nmt import NmtState
from canopen_proto.pdo.configure import PdoRefusedError
from canopen_proto.procedures.steps import ProcedureError
from tests.master.direct_world import INTERVAL, LIMIT, LOOSE, PATIENT, Devices, devices, until


@pytest.fixture
def arm() -> Iterator[Devices]:
    with devices(3, 12) as arm:
        yield arm


@pytest.fixture
def session(arm: Devices) -> Iterator[Session]:
    with Session() as session:
        assert session.open_connection(arm.bus, sdo_timeout=PATIENT, watchdog=LOOSE), session.last_error()
        yield session


def follow(session: Session, *nodes: int) -> None:
    session.init_nmt()
    for node in nodes:
        assert session.init_device(node)
        assert session.set_sync_interval(node, INTERVAL)
        assert session.enable_ip_mode(node)


def hold(session: Session, node: int, position: int) -> None:
    """Send one set-point until the device is there. This is real time: behind a late SYNC the axis comes back from its ramp."""

    def is_there() -> bool:
        session.send_pos(node, position)
        session.send_sync(10)
        return session.get_pos(node) == position

    until(is_there)


def go_on(session: Session, *nodes: int) -> None:
    """Send set-points until one is refused, as an error of this thread."""
    while True:
        for node in nodes:
            session.send_pos(node, 3100)
        session.send_sync(10)


# ---- homing ----


def test_two_drives_are_homed_by_two_threads(session: Session, arm: Devices) -> None:
    session.init_nmt()
    homed = {}

    def home(node: int) -> None:
        homed[node] = session.init_device(node) and session.homing(node)

    threads = [threading.Thread(target=home, args=(node,)) for node in (3, 12)]
    for thread in threads:
        thread.start()
    until(lambda: arm.is_moving(3) and arm.is_moving(12))
    for thread in threads:
        thread.join(LIMIT)
    assert homed == {3: True, 12: True}
    assert [session.get_pos(node) for node in (3, 12)] == [0, 0]


def test_halt_from_another_thread_ends_a_homing(session: Session, arm: Devices) -> None:
    results: list[tuple[bool, Exception | None]] = []
    thread = threading.Thread(target=lambda: results.append((session.homing(12), session.last_error())))
    thread.start()
    until(lambda: arm.is_moving(12))
    assert session.halt(12)
    assert not arm.is_moving(12)
    thread.join(LIMIT)
    assert [(homed, str(why)) for homed, why in results] == [(False, "drive 12 was halted meanwhile")]
    assert "operation_enable" in session.send_sdo(12, "statusword").constants


def test_a_connection_that_is_closed_meanwhile_ends_the_calls(session: Session, arm: Devices) -> None:
    errors: list[Exception] = []

    def home() -> None:
        try:
            session.homing(12)
        except MasterClosedError as error:
            errors.append(error)

    thread = threading.Thread(target=home)
    thread.start()
    until(lambda: arm.is_moving(12))
    session.close_connection()
    thread.join(LIMIT)
    assert len(errors) == 1
    assert not arm.is_moving(12)


def test_a_drive_that_shows_homing_mode_homes_by_the_standard() -> None:
    with devices(makers=standard_drives(5)) as machine, Session() as session:
        assert session.open_connection(machine.bus, sdo_timeout=PATIENT, watchdog=LOOSE)
        assert session.send_sdo(5, "homing_method", 37).value == 37  # where it stands
        assert session.homing(5)
        assert session.get_pos(5) == 0


# ---- set-points ----


def test_set_points_and_sync_alternate_as_the_manual_says(session: Session, arm: Devices) -> None:
    follow(session, 12)
    assert session.get_pos(12) == 3000
    session.send_sync(1)
    session.send_sync(1)
    arm.frames()
    for position in range(3100, 3600, 100):
        session.send_pos(12, position)
        session.send_sync(10)
    session.send_sdo(12, "modes_of_operation_display")  # answered, so all before it has been sent
    expected = []
    for position in range(3100, 3600, 100):
        expected += [f"20C#1F000000{position.to_bytes(4, 'little').hex().upper()}", "080#"]
    watch = "60C#4061600000000000"  # no PDO of its brings the mode
    assert [frame for frame in arm.frames() if frame[:3] in ("20C", "080", "60C") and frame != watch] == expected
    hold(session, 12, 3500)
    assert session.enable_brake(12)
    assert arm.node(12).drive.state is State.READY_TO_SWITCH_ON


def test_the_devices_pdos_come_to_the_queue(session: Session, arm: Devices) -> None:
    session.init_listener_thread()
    follow(session, 12)
    session.send_sync()
    received = session.incoming_pdos.get(LIMIT)
    assert received is not None
    assert received.node_id == 12
    assert received.get("position_actual_value") == 3000
    assert set(received.values) == {"statusword", "torque_actual_value", "position_actual_value"}
    session.close_connection()
    assert session.open_connection(arm.bus, sdo_timeout=PATIENT, watchdog=LOOSE)
    assert len(session.incoming_pdos) == 0


def test_no_set_point_to_a_drive_that_would_not_follow(session: Session, arm: Devices) -> None:
    session.init_nmt()
    assert session.init_device(12)
    arm.frames()
    with pytest.raises(LocalProtocolError, match=r"enable_ip_mode\(12\) first"):
        session.send_pos(12, 0)
    assert session.enable_ip_mode(12)
    arm.frames()
    with pytest.raises(ValueRangeError):
        session.send_pos(12, 2**31)
    assert session.drive_mode(12, 1)
    with pytest.raises(LocalProtocolError):
        session.send_pos(12, 0)
    assert not [frame for frame in arm.frames() if frame.startswith("20C")]


def test_a_fault_in_the_middle_of_a_move_is_raised(session: Session, arm: Devices) -> None:
    follow(session, 12)
    session.send_pos(12, 3100)
    session.send_sync(5)
    arm.break_down(12, 0x8611)
    with pytest.raises(DriveInFaultError, match="0x8611"):
        go_on(session, 12)
    with pytest.raises(LocalProtocolError):
        session.send_pos(12, 3100)


def test_a_drive_that_leaves_operation_enabled_is_told(session: Session, arm: Devices) -> None:
    follow(session, 12)
    arm.send(0x60C, "2B40600006000000")  # somebody else: shutdown
    until(lambda: arm.node(12).drive.state is State.READY_TO_SWITCH_ON)
    with pytest.raises(ProcedureError, match="drive 12 left operation enabled by itself"):
        go_on(session, 12)


def test_a_drive_whose_pdos_no_longer_come_is_silent(arm: Devices) -> None:
    session = Session()
    assert session.open_connection(arm.bus, sdo_timeout=2, watchdog=LOOSE)
    follow(session, 3, 12)
    session.send_sync(20)
    arm.send(0x000, "020C")  # somebody else: stop
    until(lambda: arm.node(12).state is NmtState.STOPPED)
    with pytest.raises(NodeSilentError, match="node 12"):
        go_on(session, 3, 12)
    session.close_connection()  # the master wakes it, to see it halted
    assert arm.node(12).state is NmtState.PRE_OPERATIONAL
    assert arm.node(12).values.store[0x6040_00] == 0x11F


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        ("2F60600001000000", "drive 12 (no longer follows its set-points: bit 12|changed its mode of operation)"),  # 0x6060 = 1
        ("237D6002E40C0000", "drive 12 (is held by a limit of its own: bit 11|no longer follows)"),  # 0x607D:02 = 3300
    ],
)
def test_a_drive_that_does_not_follow_is_told_and_halted(session: Session, arm: Devices, frame: str, reason: str) -> None:
    follow(session, 12)
    session.send_sync(1)
    if frame.startswith("237D"):
        arm.send(0x60C, "237D6001F0D8FFFF")  # 0x607D:01 = -10000
    arm.send(0x60C, frame)

    def move_on() -> None:
        for sent in range(1, 30):
            session.send_pos(12, 3000 + 50 * sent)
            session.send_sync(10)
            arm.frames(0, last="18C#")

    with pytest.raises(ProcedureError, match=reason):
        move_on()
    with pytest.raises(LocalProtocolError, match=r"enable_ip_mode\(12\) first"):
        session.send_pos(12, 3000)
    until(lambda: arm.node(12).values.store[0x6040_00] & 0x100)  # type: ignore[operator]
    until(lambda: not arm.is_moving(12))


def test_a_set_point_that_waits_for_sync_does_not_come_to_life_behind_the_brake(session: Session, arm: Devices) -> None:
    follow(session, 12)
    session.send_pos(12, 3100)
    assert session.enable_brake(12)
    arm.frames()
    session.send_sync(5)
    session.send_sync(5)
    assert not [frame for frame in arm.frames(last="18C#") if frame.startswith("20C#")]
    assert arm.node(12).drive.state is State.READY_TO_SWITCH_ON
    assert session.init_device(12)
    assert session.enable_ip_mode(12)
    session.send_pos(12, 3100)
    assert session.shutdown_device(12)
    session.send_sync(5)
    assert arm.node(12).drive.state is State.SWITCH_ON_DISABLED


# ---- other PDOs ----


def test_define_pdo_makes_a_standard_drive_follow() -> None:
    with devices(makers=standard_drives(5)) as machine, Session() as session:
        assert session.open_connection(machine.bus, sdo_timeout=PATIENT, watchdog=LOOSE)
        session.init_nmt()
        assert session.define_pdo(5, "schunk_default_rPDO"), session.last_error()
        assert session.define_pdo(5, "schunk_default_tPDO"), session.last_error()
        until(lambda: machine.node(5).state is NmtState.OPERATIONAL)
        assert session.init_device(5)
        assert session.set_sync_interval(5, INTERVAL)
        assert session.enable_ip_mode(5)
        hold(session, 5, 3050)
        received = session.incoming_pdos.get(LIMIT)
        assert received is not None
        assert "torque_actual_value" in received.values
        with pytest.raises(PdoNotFoundError):
            session.define_pdo(5, "schunk_rPDO")


def test_a_pdo_that_the_device_refuses_is_false(session: Session, arm: Devices) -> None:
    assert not session.define_pdo(12, "csv_rPDO")  # a Schunk joint has no target velocity
    assert isinstance(session.last_error(), PdoRefusedError)


def test_a_dictionary_without_the_manuals_pdos_has_no_set_points(arm: Devices) -> None:
    with Session(rpdo="none", tpdo="none") as session:
        assert session.open_connection(arm.bus, sdo_timeout=PATIENT, watchdog=LOOSE)
        session.init_nmt()
        assert session.init_device(12)
        with pytest.raises(LocalProtocolError, match="define_pdo"):
            session.enable_ip_mode(12)


def test_a_drive_that_lacks_the_mode_is_false(session: Session, arm: Devices) -> None:
    arm.node(12).values.store[0x6502_00] = 0x21
    assert session.init_device(12)
    assert not session.enable_ip_mode(12)
    assert "does not support interpolated position" in str(session.last_error())
