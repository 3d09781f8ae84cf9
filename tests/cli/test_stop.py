"""`canopen drive NODE stop|disable`: stop goes first, the words and the exit status are true, whatever answers are lost."""

from __future__ import annotations

import itertools
import signal
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st

from canopen_cli.shared import session
from canopen_cli.shared.problem import ExitCode
from canopen_master.master import Master
from canopen_master.session import open_master
from canopen_master.simulation.host import DeviceMaker
from canopen_master.simulation.serving import SimulatedDevices, simulated_drives
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_proto.nmt import NmtCommand
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from canopen_transports import VirtualTransport
from tests.cli.cli_support import Run, runner
from tests.examples import examples
from tests.master.world import Link

DEMO = ("-b", "demo")
WORDS = {"stop": "603#2B40600002000000", "disable": "603#2B40600000000000"}


def lossy(
    monkeypatch: pytest.MonkeyPatch,
    is_lost: Callable[[], bool],
    prepare: Callable[[DriveNode], None],
    make: Callable[[int, int], DeviceMaker] | None = None,
) -> list[Any]:
    """Let the commands run on a bus on which answers of drive 3 are lost. prepare: is called with it; make: makes it.

    Returns a list of what each command had: the drive, and the bus.
    """
    made: list[Any] = []

    @asynccontextmanager
    async def opened(locator: str, **options: Any) -> AsyncIterator[Master]:
        link = Link(locator.removeprefix("virtual:"))
        link.copies = lambda frame, is_sent: int(is_sent or frame.can_id != 0x583 or not is_lost())
        made.append(link)
        async with open_master(link, **options) as master:
            yield master

    @asynccontextmanager
    async def simulation(devices: Any) -> AsyncIterator[SimulatedDevices]:
        async with simulated_drives(devices, Shape.STANDARD, make=make) as there:
            prepare(there.drives[3])
            made.append(there.drives[3])
            yield there

    monkeypatch.setattr(session, "open_master", opened)
    monkeypatch.setattr(session, "simulated_drives", simulation)
    return made


def runs(node: DriveNode) -> None:
    """Another program has let it run at 20,000 counts per second."""
    for index, value, size in ((0x6060, Mode.PROFILE_VELOCITY, 1), (0x60FF, 20_000, 4), *((0x6040, w, 2) for w in (6, 7, 15))):
        node.write(index, 0, int(value).to_bytes(size, "little"), 0)


def coasting(friction: float) -> Callable[[int, int], DeviceMaker]:
    """Drives that take the power away at once on a quick stop, with a mass and without a brake. friction: N·m."""
    mechanics = Mechanics(viscous_friction=0.0, coulomb_friction=friction, brake_torque=0.0)
    settings = DriveSettings(mechanics=mechanics)
    return lambda number, node_id: partial(DriveNode, node_id=node_id, settings=settings)


def runs_without_a_ramp(node: DriveNode) -> None:
    node.write(0x605A, 0, bytes(2), 0)
    runs(node)
    plant = node.drive._servo._plant
    assert plant is not None
    plant.velocity = 20_000.0


@pytest.mark.parametrize(("friction", "status"), [(0.3, ExitCode.OK), (0.0, ExitCode.DRIVE_FAULT)])
def test_an_axis_that_coasts_without_power_is_not_stopped_before_it_stands(
    run: Run, monkeypatch: pytest.MonkeyPatch, friction: float, status: ExitCode
) -> None:
    """0x605A = 0: a quick stop takes the power away, and Switch on disabled comes at once."""
    made = lossy(monkeypatch, lambda: False, runs_without_a_ramp, coasting(friction))
    outcome = run("drive", "3", "stop", *DEMO)
    drive = made[0]
    assert drive.drive.state is State.SWITCH_ON_DISABLED
    assert outcome.status == status, outcome.err
    assert ("without power (it coasts)" in outcome.err) == (status != ExitCode.OK)
    assert (abs(drive.drive._servo.velocity) < 100) == (status == ExitCode.OK)


def sent(link: Link) -> list[tuple[float, str]]:
    """What the command has sent, with the times."""
    return [(time, str(frame)) for time, is_sent, frame in link.log if is_sent]


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("own")


@pytest.mark.parametrize("command", WORDS)
def test_the_first_frame_is_the_stop_whatever_is_lost(capsys: pytest.CaptureFixture[str], own: Path, command: str) -> None:
    @examples(100)
    @given(lost=st.lists(st.booleans(), max_size=14), later=st.booleans())
    def check(lost: list[bool], later: bool) -> None:
        fates: Iterator[bool] = itertools.chain(lost, itertools.repeat(later))
        with pytest.MonkeyPatch.context() as monkeypatch:
            bus_and_drive = lossy(monkeypatch, lambda: next(fates), runs)
            outcome = runner(capsys, monkeypatch, own)("drive", "3", command, *DEMO)
        drive, bus = bus_and_drive
        assert sent(bus)[0][1] == WORDS[command]
        stopped = {"stop": (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED), "disable": (State.SWITCH_ON_DISABLED,)}[command]
        assert drive.drive.state in stopped  # only answers were lost
        assert outcome.status in (ExitCode.OK, ExitCode.NO_ANSWER)
        if outcome.status == ExitCode.OK:
            assert not all((*lost, later))
            assert "state             " in outcome.out
        else:
            assert "CO411" in outcome.err
            assert "IT MAY STILL MOVE" in outcome.err
        for frame in (each for _, each in sent(bus) if each.startswith("000#")):  # each NMT command was announced
            assert {"000#8003": "enter pre-operational", "000#0203": "'stop' is sent"}[frame] in outcome.err

    check()


def test_a_stopped_node_is_told_all_the_same(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def prepare(node: DriveNode) -> None:
        runs(node)
        node.execute(NmtCommand.STOP, 0)

    made = lossy(monkeypatch, lambda: False, prepare)
    outcome = run("drive", "3", "stop", *DEMO)
    drive, bus = made
    assert outcome.status == ExitCode.OK
    assert sent(bus)[0][1] == WORDS["stop"]
    assert "NMT 'enter pre-operational' is sent to node 3" in outcome.err
    assert drive.drive.state in (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)


def test_a_node_that_is_not_there(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    made = lossy(monkeypatch, lambda: True, lambda node: None)
    outcome = run("drive", "99", "stop", *DEMO)
    assert outcome.status == ExitCode.NO_ANSWER
    assert sent(made[1])[0][1] == "663#2B40600002000000"
    assert "nothing confirms that it has arrived. IT MAY STILL MOVE" in " ".join(outcome.err.split())


@pytest.mark.parametrize(("until", "status"), [(0.3, ExitCode.OK), (30.0, ExitCode.NO_ANSWER)])
def test_another_sdo_client_is_no_silence_of_the_drive(
    run: Run, monkeypatch: pytest.MonkeyPatch, until: float, status: ExitCode
) -> None:
    """until: how long it sends requests on the channel of the drive, in s."""
    made: list[Any] = []

    async def stranger() -> None:
        while len(made) < 2:
            await trio.sleep(0)
        line = VirtualTransport(made[1].locator.removeprefix("link:"))
        begun = trio.current_time()
        while trio.current_time() < begun + until:
            await line.send(Frame.parse("603#6000000000000000"))
            await trio.sleep(0.005)
        await line.aclose()

    def prepare(node: DriveNode) -> None:
        runs(node)
        trio.lowlevel.spawn_system_task(stranger)

    made = lossy(monkeypatch, lambda: False, prepare)
    outcome = run("drive", "3", "stop", *DEMO)
    drive, bus = made
    said = " ".join(outcome.err.split())
    assert outcome.status == status
    assert sent(bus)[0][1] == WORDS["stop"]
    assert drive.drive.state in (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)
    assert "does not answer" not in said
    if status == ExitCode.OK:
        assert not [frame for _, frame in sent(bus) if frame.startswith("000#")]
    else:
        assert "another SDO client on its channel asked for a segment of a read: end that program" in said
        assert "IT MAY STILL MOVE" in said


@pytest.mark.parametrize("since", [0.05, 0.5])
def test_ctrl_c_halts_though_no_answer_comes_any_more(run: Run, monkeypatch: pytest.MonkeyPatch, since: float) -> None:
    """since: how long the drive has not answered by then."""
    silent: list[bool] = []
    begun: list[float] = []

    async def life() -> None:
        await trio.sleep(2)
        silent.append(True)
        await trio.sleep(since)
        begun.append(trio.current_time())
        signal.raise_signal(signal.SIGINT)

    def start(node: DriveNode) -> None:
        trio.lowlevel.spawn_system_task(life)

    made = lossy(monkeypatch, lambda: bool(silent), start)
    outcome = run("drive", "3", "velocity", "5000", *DEMO)
    drive, bus = made
    assert outcome.status == ExitCode.INTERRUPTED
    told = [time for time, frame in sent(bus) if frame.startswith("603#2B4060000F01") and time >= begun[0]]
    assert told
    assert told[0] - begun[0] <= 0.15
    assert drive.values[objects.CONTROLWORD] != 0x0F
    assert "not confirmed" in outcome.err or "did not answer" in outcome.err
