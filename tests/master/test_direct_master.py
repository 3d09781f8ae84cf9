"""The master half of the manual's blocking API: chains that any thread may command, over the master's own cycle."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import trio

from canopen_data import DataError
from canopen_master import (
    BusError,
    ChainError,
    ChainFaultError,
    ChainFileError,
    ChainHaltedError,
    ChainState,
    Master,
    MasterClosedError,
    SetPointRefusedError,
    direct,
    powerballs,
    read_record,
)
from canopen_master.direct import NotConnectedError, Session
from canopen_master.simulation.host import DeviceMaker
from canopen_proto.drives.cia402.states import State
from canopen_proto.drives.trajectory import Path as JointPath
from canopen_proto.drives.trajectory import Segment
from canopen_proto.machine import LocalProtocolError
from canopen_proto.nmt import NmtState
from canopen_proto.pdo.consumer import PdoReceived
from canopen_transports import TransportError
from tests.master.direct_world import INTERVAL, LIMIT, LOOSE, PATIENT, Devices, devices, near_home, until

CHAINS = "arm joint1 can0 3 joint2 can0 12"


@pytest.fixture
def joints() -> Callable[..., list[DeviceMaker]]:
    return powerballs


@pytest.fixture
def arm(joints: Callable[..., list[DeviceMaker]]) -> Iterator[Devices]:
    with devices(makers=joints(3, 12)) as arm:
        yield arm


@pytest.fixture
def session(arm: Devices) -> Iterator[Session]:
    with Session() as session:
        session.using_master_thread = True
        session.init_chain_map(text=CHAINS)
        assert session.open_connection(arm.bus, sdo_timeout=PATIENT, watchdog=LOOSE), session.last_error()
        session.init_nmt()
        session.init_listener_thread()
        yield session


@pytest.mark.parametrize("joints", [near_home])
def test_a_chain_is_led_from_a_clients_thread(session: Session, arm: Devices) -> None:
    session.init_incoming_pdo_processor_thread()
    session.init_master_thread(INTERVAL)
    chain = session.chain_map["arm"]
    assert repr(chain) == "<chain arm: joint1, joint2>"
    done: list[bool] = []

    def command() -> None:
        done.append(chain.init() and chain.homing() and chain.ip_mode())
        chain.set_pos([100, -100])

    client = threading.Thread(target=command)
    client.start()
    client.join(LIMIT)
    assert done == [True]
    assert chain.is_homed
    assert chain.state is ChainState.FOLLOWING
    until(lambda: chain.get_current_pos() == [100, -100])
    assert chain.get_desired_pos() == [100, -100]
    assert [line.partition(":")[0] for line in chain.describe()] == ["joint1", "joint2"]
    assert len(session.incoming_pdos) == 0  # they were processed
    assert chain.shut_down(), session.last_error()
    until(lambda: {node.state for node in arm.host.nodes} == {NmtState.STOPPED})
    assert {node.drive.state for node in map(arm.node, (3, 12))} == {State.SWITCH_ON_DISABLED}


def test_a_clients_loop_gets_the_cycles(session: Session) -> None:
    session.init_master_thread(INTERVAL)
    chain = session.chain_map["arm"]
    with pytest.raises(ChainError, match="cannot give cycles"):
        next(chain.cycles())
    assert chain.init(), session.last_error()
    assert chain.ip_mode(), session.last_error()
    start = chain.get_current_pos()
    for number, cycle in enumerate(chain.cycles()):
        assert cycle.number == number
        assert cycle.time == pytest.approx(INTERVAL / 1000 * number)  # however late this thread was
        chain.set_pos([position + round(1_000 * cycle.time) for position in start])
        if number == 5:
            break
    assert chain.get_desired_pos() == [position + 500 for position in start]
    assert chain.halt(), session.last_error()


def test_a_chain_moves_and_follows_a_path_from_a_clients_thread(session: Session, tmp_path: Path) -> None:
    session.init_master_thread(INTERVAL)
    chain = session.chain_map["arm"]
    assert chain.init(), session.last_error()
    start = [float(position) for position in chain.get_current_pos()]
    chain.override = 0.5
    assert chain.override == 0.5
    with chain.record(tmp_path / "run.csv") as recorder:
        assert chain.move([position + 300 for position in start], speed=0.5), session.last_error()
    record = read_record(tmp_path / "run.csv")
    assert len(record) == recorder.rows > 0
    assert record["joint2.set_point"][-1] == start[1] + 300
    assert chain.get_desired_pos() == [position + 300 for position in start]
    back = [Segment(1.0, (position + 300, 0.0, 0.0, -3000.0, 4500.0, -1800.0)) for position in start]
    chain.override = 1.0
    assert chain.follow(JointPath([[segment] for segment in back])), session.last_error()
    assert chain.get_desired_pos() == start
    assert not chain.follow(JointPath([[segment] for segment in back]))
    assert "does not begin where joint1 stands" in str(session.last_error())
    assert not chain.move([0.0])
    assert chain.halt(), session.last_error()


def test_a_recording_is_whole_although_the_connection_ends(session: Session, tmp_path: Path) -> None:
    session.init_master_thread(INTERVAL)
    chain = session.chain_map["arm"]
    assert chain.init(), session.last_error()
    with pytest.raises(PermissionError), chain.record(tmp_path / "run.csv"):
        raise PermissionError
    with chain.record(tmp_path / "run.csv"):
        assert chain.ip_mode(), session.last_error()
        session.close_connection()
    record = read_record(tmp_path / "run.csv")
    assert record["joint1.mode"][-1] == 7


def test_sync_is_the_masters(session: Session, arm: Devices) -> None:
    began = time.monotonic()
    session.init_master_thread(sync_interval=200)
    session.send_sync(0)
    session.send_sync(0)
    sent = arm.frames(last="080#").count("080#")
    assert sent <= 1 + (time.monotonic() - began) / 0.2
    assert session.chain_map["arm"].init(), session.last_error()
    assert session.chain_map["arm"].ip_mode(), session.last_error()
    session.send_pos(12, 3010)  # of a joint: the master's cycle takes it along
    assert session.chain_map["arm"].get_desired_pos() == [3000, 3010]


def test_a_wrong_call_raises(session: Session) -> None:
    chain = session.chain_map["arm"]
    with pytest.raises(LocalProtocolError, match=r"init_master_thread\(\) first"):
        chain.init()
    session.using_master_thread = False
    with pytest.raises(LocalProtocolError, match="using_master_thread"):
        session.init_master_thread(INTERVAL)
    session.using_master_thread = True
    session.init_master_thread(INTERVAL)
    with pytest.raises(LocalProtocolError, match="runs already"):
        session.init_master_thread(INTERVAL)
    assert not chain.homing()
    assert isinstance(session.last_error(), ChainError)
    assert chain.init(), session.last_error()
    with pytest.raises(ChainError):
        chain.set_pos([0, 0])
    assert chain.ip_mode(), session.last_error()
    with pytest.raises(SetPointRefusedError):
        chain.set_pos([0])
    session.close_connection()
    with pytest.raises(NotConnectedError):
        chain.halt()


def test_halt_ends_a_homing_and_recover_goes_on(session: Session, arm: Devices) -> None:
    session.init_master_thread(INTERVAL)
    chain = session.chain_map["arm"]
    assert chain.init(), session.last_error()
    results: list[tuple[bool, Exception | None]] = []
    thread = threading.Thread(target=lambda: results.append((chain.homing(), session.last_error())))
    thread.start()
    until(lambda: arm.is_moving(3) and arm.is_moving(12))
    assert chain.halt(), session.last_error()
    assert not arm.is_moving(3)
    assert not arm.is_moving(12)
    thread.join(LIMIT)
    ((homed, why),) = results
    assert not homed
    assert isinstance(why, ChainHaltedError)
    assert chain.recover(), session.last_error()


def test_a_fault_of_one_joint_stops_the_chain(session: Session, arm: Devices) -> None:
    session.init_master_thread(INTERVAL)
    chain = session.chain_map["arm"]
    assert chain.init(), session.last_error()
    assert chain.ip_mode(), session.last_error()
    arm.break_down(12)
    until(lambda: chain.state is ChainState.FAULT)
    with pytest.raises(ChainFaultError, match="joint2"):
        session.send_pos(3, 3000)
    with pytest.raises(ChainFaultError, match="joint2"):
        chain.set_pos([0, 0])
    assert chain.recover(), session.last_error()
    assert chain.state is ChainState.FOLLOWING


def test_a_handler_sees_each_pdo_and_may_fail(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[PdoReceived] = []
    shown: list[threading.ExceptHookArgs] = []
    monkeypatch.setattr(threading, "excepthook", shown.append)

    def handle(pdo: PdoReceived) -> None:
        seen.append(pdo)
        raise ValueError(len(seen))

    session.init_incoming_pdo_processor_thread(handle)
    session.init_master_thread(INTERVAL)
    assert session.chain_map["arm"].init(), session.last_error()
    until(lambda: len(shown) >= 3)
    assert {pdo.node_id for pdo in seen} <= {3, 12}
    assert shown[0].exc_type is ValueError
    names = {thread.name for thread in threading.enumerate()}
    session.close_connection()
    assert "canopen incoming PDOs" in names
    until(lambda: "canopen incoming PDOs" not in {thread.name for thread in threading.enumerate()})


def test_chain_files(tmp_path: Path) -> None:
    with Session() as session:
        session.init_chain_map("multiple_devices.csv")
        assert list(session.chain_map) == ["arm1"]
        assert session.chain_map["arm1"].joints == tuple(f"joint{number}" for number in range(1, 7))
        file = tmp_path / "chains.csv"
        file.write_text("a joint1 can0\n")
        with pytest.raises(ChainFileError, match="node-ID"):
            session.init_chain_map(file)
        with pytest.raises(DataError, match="no data file"):
            session.init_chain_map("absent.csv")
        assert list(session.chain_map) == ["arm1"]


def test_the_buses_of_a_chain_file_are_opened_with_the_one_that_is_named() -> None:
    with Session() as session, session.simulated([3], "virtual:a"), session.simulated([4], "virtual:b"):
        session.using_master_thread = True
        session.init_chain_map(text="arm joint1 virtual:a 3 joint2 virtual:b 4")
        assert session.open_connection("virtual:a")
        session.init_master_thread()
        assert session.chain_map["arm"].init(), session.last_error()
        until(lambda: session.chain_map["arm"].get_current_pos() == [3000, 3000])
        assert session.send_sdo(3, "statusword").node_id == 3
        session.close_connection()
        assert session.open_connection("virtual:c")  # none of the file's
        with pytest.raises(ChainFileError, match="is not open"):
            session.init_master_thread()
        session.close_connection()
        assert session.open_connection("virtual:c", buses={"virtual:a": "virtual:a", "virtual:b": "virtual:b"})
        session.init_master_thread()


def test_simulated_drives_on_a_bus_that_cannot_be_opened() -> None:
    with Session() as session, session.simulated([3], "nonsense"):
        assert not session.open_connection("virtual:a")
        assert "nonsense" in str(session.last_error())


def test_a_call_that_raises_why_the_bus_failed_has_told_it(session: Session, arm: Devices) -> None:
    """Also a call that begins before the master is left."""

    async def fail_and_look(master: Master) -> None:
        master.on_failure(master.bus(), TransportError("CO111", arm.bus, "the adapter is gone"))
        master.check_open()

    with pytest.raises(BusError, match="the adapter is gone"):
        session._connection.call(fail_and_look)
    session.close_connection()


def test_a_bus_that_fails_ends_what_waits(session: Session, arm: Devices) -> None:
    async def fail(master: Master) -> None:
        master.on_failure(master.bus(), TransportError("CO111", arm.bus, "the adapter is gone"))

    results: list[tuple[bool, Exception | None]] = []
    thread = threading.Thread(target=lambda: results.append((session.homing(12), session.last_error())))
    thread.start()
    until(lambda: arm.is_moving(12))
    with contextlib.suppress(BusError):
        session._connection.call(fail)
    thread.join(LIMIT)
    ((homed, why),) = results
    assert not homed
    assert isinstance(why, BusError)
    with pytest.raises(BusError, match="the adapter is gone"):
        session.init_nmt()
    session.close_connection()  # it was told already


def test_a_bus_that_fails_unnoticed_is_told_by_close(session: Session, arm: Devices) -> None:
    async def fail(master: Master) -> None:
        trio.lowlevel.current_trio_token().run_sync_soon(
            master.on_failure, master.bus(), TransportError("CO111", arm.bus, "the adapter is gone")
        )

    session._connection.call(fail)
    until(lambda: not session._connection.is_open)
    with pytest.raises(BusError, match="the adapter is gone"):
        session.close_connection()
    assert session.open_connection(arm.bus, sdo_timeout=PATIENT, watchdog=LOOSE)


def test_the_module_has_a_master_half_too() -> None:
    with direct.simulated([12]):
        direct.init_chain_map("single_device.csv")
        assert direct.open_connection("virtual")
        with pytest.raises(LocalProtocolError):
            direct.init_master_thread()
        direct.using_master_thread = True
        try:
            direct.init_master_thread()
        finally:
            direct.using_master_thread = False
        assert direct.chain_map["chain1"].init()
        direct.close_connection()
        with pytest.raises((NotConnectedError, MasterClosedError, BusError)):
            direct.chain_map["chain1"].init()
