"""The direct half of the manual's blocking API: connection, NMT, SDO, and the sequences of one drive."""

import threading
import time
from collections.abc import Iterator

import pytest

from canopen_data import DataError
from canopen_master import BusError, HaltNotConfirmedError, SdoRefusedError, SdoTimeoutError, direct
from canopen_master.direct import AlreadyConnectedError, NotConnectedError, Session
from canopen_proto.datatypes import ValueRangeError
from canopen_proto.dictionary import ConstantNotFoundError, ObjectNotFoundError
from canopen_proto.drives.axis import ModeUnsupportedError
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import LocalProtocolError
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.procedures.steps import SdoTransferError, StepTimeoutError
from tests.master.direct_world import LIMIT, LOOSE, PATIENT, Devices, devices, until


@pytest.fixture(scope="module")
def two_joints() -> Iterator[Devices]:
    with devices(3, 12) as arm:
        yield arm


@pytest.fixture
def arm(two_joints: Devices) -> Devices:
    two_joints.power_cycle()
    return two_joints


@pytest.fixture
def session(arm: Devices) -> Iterator[Session]:
    with Session() as session:
        assert session.open_connection(arm.bus, sdo_timeout=PATIENT, watchdog=LOOSE), session.last_error()
        yield session


# ---- connection ----


def test_a_bus_that_cannot_be_opened_gives_false_and_the_reason() -> None:
    with Session() as session:
        assert not session.open_connection("vrtual:demo")
        assert isinstance(session.last_error(), BusError)
        assert "did you" in str(session.last_error()) or "virtual" in str(session.last_error())
        assert session.open_connection("virtual:demo")
        assert session.last_error() is None


def test_only_one_connection_at_a_time(session: Session) -> None:
    assert not session.open_connection("virtual:other")
    assert isinstance(session.last_error(), AlreadyConnectedError)
    session.close_connection()
    assert session.open_connection("virtual:other")


def test_a_data_file_that_is_wrong_is_a_reason_too(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    monkeypatch.setenv("CANOPEN_DATA", f"{tmp_path}/absent")
    with Session() as session:
        assert not session.open_connection("virtual:demo")
        assert isinstance(session.last_error(), DataError)


def test_without_a_connection_nothing_is_taken() -> None:
    session = Session()
    for call in (
        session.init_listener_thread,
        session.init_nmt,
        lambda: session.send_nmt("start_remote_node"),
        lambda: session.send_sync(0),
        lambda: session.send_sdo(12, "statusword"),
        lambda: session.init_device(12),
        lambda: session.send_pos(12, 0),
    ):
        with pytest.raises(NotConnectedError, match="open_connection"):
            call()
    session.close_connection()


def test_after_close_nothing_is_taken(session: Session) -> None:
    session.init_listener_thread()
    session.close_connection()
    session.close_connection()
    with pytest.raises(NotConnectedError):
        session.init_nmt()


def test_the_module_has_all_of_the_sessions_calls() -> None:
    for name in vars(Session):
        if not name.startswith("_"):
            assert callable(getattr(direct, name)), name
            assert name in direct.__all__
    with direct.simulated([5]):
        assert direct.open_connection("virtual")
        assert direct.send_sdo(5, "statusword").node_id == 5
    with pytest.raises(NotConnectedError):
        direct.init_nmt()


# ---- NMT and SDO ----


def test_init_nmt_starts_all_devices(session: Session, arm: Devices) -> None:
    session.init_nmt()
    assert arm.frames(last="000#") == ["000#0100"]
    until(lambda: [node.state for node in arm.host.nodes] == [NmtState.OPERATIONAL] * 2)


def test_send_nmt_to_one_device_or_to_all(session: Session, arm: Devices) -> None:
    session.send_nmt("stop_remote_node")
    session.send_nmt("start_remote_node", 12)
    session.send_nmt(NmtCommand.ENTER_PRE_OPERATIONAL, 3)
    assert arm.frames(last="000#8003") == ["000#0200", "000#010C", "000#8003"]
    with pytest.raises(ConstantNotFoundError, match="stop_remote_node"):
        session.send_nmt("stop_remote_nod")
    with pytest.raises(LocalProtocolError):
        session.send_nmt("stop_remote_node", 200)
    assert arm.frames() == []


def test_send_sdo_reads_and_writes_and_gives_the_message(session: Session) -> None:
    status = session.send_sdo(12, "statusword")
    assert (status.node_id, status.name, status.value) == (12, "statusword", 0x240)
    assert "switch_on_disabled" in status.constants
    written = session.send_sdo(12, "controlword", "sm_shutdown")
    assert (written.value, written.constants) == (6, ("sm_shutdown",))
    assert "ready_to_switch_on" in session.send_sdo(12, 0x6041).constants
    assert session.send_sdo(12, "ip_time_units", 20).value == 20
    assert session.send_sdo(12, (0x60C2, 1)).value == 20


def test_send_sdo_raises_what_went_wrong(session: Session, arm: Devices) -> None:
    with pytest.raises(ObjectNotFoundError, match="did you mean statusword"):
        session.send_sdo(12, "statsword")
    with pytest.raises(ValueRangeError):
        session.send_sdo(12, "controlword", 0x10000)
    with pytest.raises(LocalProtocolError):
        session.send_sdo(200, "statusword")
    with pytest.raises(LocalProtocolError, match="'12' is not a node-ID"):
        session.homing("12")  # type: ignore[arg-type]
    assert arm.frames() == []
    with pytest.raises(SdoRefusedError):
        session.send_sdo(12, "target_velocity")  # of modes that a Schunk joint does not have


def test_a_silent_device_is_a_timeout_or_false(arm: Devices) -> None:
    with Session() as session:
        assert session.open_connection(arm.bus, sdo_timeout=0.02)
        with pytest.raises(SdoTimeoutError, match="node 5 did not answer"):
            session.send_sdo(5, "statusword")
        assert not session.init_device(5)
        assert isinstance(session.last_error(), SdoTransferError)
        with pytest.raises(SdoTransferError):
            session.get_pos(5)
        with pytest.raises(LocalProtocolError):
            session.init_device(0)


def test_the_last_error_is_that_of_the_calling_thread(session: Session) -> None:
    assert not session.wait_for_status(12, "operation_enable", timeout=0)
    assert isinstance(session.last_error(), StepTimeoutError)
    seen: list[Exception | None] = []
    thread = threading.Thread(target=lambda: seen.append(session.last_error()))
    thread.start()
    thread.join(LIMIT)
    assert seen == [None]


# ---- drives ----


def test_states_up_and_down(session: Session, arm: Devices) -> None:
    assert session.fault_reset(12)
    assert session.init_device(12)
    assert "operation_enable" in session.send_sdo(12, "statusword").constants
    assert session.wait_for_status(12, "operation_enable")
    assert session.enable_break(12)
    assert arm.node(12).drive.state is State.READY_TO_SWITCH_ON
    assert session.release_break(12)
    assert session.set_motor_state(12, "switched_on")
    assert arm.node(12).drive.state is State.SWITCHED_ON
    with pytest.raises(ConstantNotFoundError):
        session.set_motor_state(12, "switch_off")


def test_shutdown_takes_power_and_communication_away(session: Session, arm: Devices) -> None:
    session.init_nmt()
    assert session.init_device(12)
    assert session.shutdown_device(12)
    until(lambda: arm.node(12).state is NmtState.STOPPED)
    assert arm.node(12).drive.state is State.SWITCH_ON_DISABLED
    assert arm.node(3).state is NmtState.OPERATIONAL
    assert arm.frames(last="000#020C")[-1] == "000#020C"


def test_the_manuals_sequence_twice(session: Session, arm: Devices) -> None:
    """The second program finds the node as the first has left it: stopped, where it has no SDO."""
    for _ in range(2):
        assert session.fault_reset(12), session.last_error()
        session.init_nmt()
        assert session.init_device(12)
        assert session.shutdown_device(12)
        session.close_connection()
        assert session.open_connection(arm.bus, sdo_timeout=2, watchdog=LOOSE)


def test_a_fault_is_reset(session: Session, arm: Devices) -> None:
    assert session.init_device(12)
    arm.break_down(12)
    time.sleep(0.12)  # until the state that was read before is too old
    assert not session.init_device(12)
    assert "is in fault" in str(session.last_error())
    assert session.fault_reset(12)
    assert session.init_device(12)


def test_modes(session: Session) -> None:
    assert session.drive_mode(12, "interpolated_position_mode")
    assert session.send_sdo(12, "modes_of_operation_display").value == 7
    assert session.drive_mode(12, 1)
    assert not session.drive_mode(12, "torque_profile_mode")
    assert isinstance(session.last_error(), ModeUnsupportedError)


def test_the_sync_interval_is_told_to_the_drive(session: Session, arm: Devices) -> None:
    assert session.set_sync_interval(12, 20)
    assert session.send_sdo(12, "ip_time_units").value == 20
    assert session.send_sdo(12, "ip_time_index").value == -3
    session.init_nmt()
    assert session.init_device(12)
    assert session.enable_ip_mode(12)
    assert session.send_sdo(12, "ip_time_units").value == 20


def test_leaving_halts_a_drive_whose_node_was_stopped(arm: Devices) -> None:
    session = Session()
    assert session.open_connection(arm.bus, sdo_timeout=PATIENT, watchdog=LOOSE)
    assert session.init_device(12)
    session.send_nmt("stop_remote_node", 12)
    session.close_connection()
    assert any(frame.startswith("60C#2B4060000F01") for frame in arm.frames())


def test_leaving_a_bus_that_does_not_answer_says_so(arm: Devices, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canopen_master.session.SHUTDOWN_TIME", 1.0)
    session = Session()
    assert session.open_connection(arm.bus, sdo_timeout=PATIENT, watchdog=LOOSE)
    assert session.init_device(12)
    arm.do(lambda host: arm.node(12).sdo.disable())
    with pytest.raises(HaltNotConfirmedError, match="node 12"):
        session.close_connection()
    with pytest.raises(NotConnectedError):
        session.init_nmt()
