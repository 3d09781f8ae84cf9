"""`canopen demo`: six joints boot, home and move; and whatever goes wrong leaves every drive halted. In virtual time."""

from __future__ import annotations

import builtins
import importlib
import math
import re
import signal
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio
from trio.testing import MockClock

from canopen_cli.plot.cycles import write_plot
from canopen_cli.shared.problem import ExitCode
from canopen_master.demonstration import run as demonstration
from canopen_master.demonstration.recording import Recording
from canopen_master.master import Master
from canopen_master.session import open_master
from canopen_master.simulation.serving import SimulatedDevices, simulated_drives
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from tests.cli.cli_support import SHORT, TWO, TWO_JOINTS, Alarm, Run, stands
from tests.cli.test_demo_eds import written


def assert_all_stand(simulations: list[SimulatedDevices]) -> None:
    (simulation,) = simulations
    assert all(stands(drive) for drive in simulation.drives.values())


def test_six_joints_home_and_move(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("demo", *SHORT)
    assert outcome.status == 0
    lines = [line.split() for line in outcome.out.splitlines() if line.startswith("joint")]
    assert [line[:3] for line in lines[1:]] == [[f"joint{n}", f"{n + 2}", f"(0x0{n + 2})"] for n in range(1, 7)]
    assert all("yes" in line for line in lines[1:])
    assert [word in outcome.err for word in ("✔ boot", "✔ home", "✔ move", "none missed", "canopen scan -b demo")] == [True] * 5
    assert [drive.drive.state for drive in simulations[0].drives.values()] == [State.SWITCH_ON_DISABLED] * 6
    assert_all_stand(simulations)


def test_the_result_as_json(run: Run) -> None:
    document = run("demo", *SHORT, "--json", "-q").json
    assert (document["chain"], document["simulated"], document["cycle_ms"]) == ("arm1", True, 20)
    assert document["missed_cycles"] == 0
    assert document["sync_cycles"] >= 25
    assert [joint["node"] for joint in document["joints"]] == [3, 4, 5, 6, 7, 8]
    for joint in document["joints"]:
        assert joint["homed"]
        assert 0 < joint["largest_following_error_degrees"] < 2
        assert joint["sdo_round_trips"] > 10


@pytest.mark.thorough(2)
@pytest.mark.parametrize("times", [1, 6])
def test_a_computer_that_is_too_slow_is_told(run: Run, simulations: list[SimulatedDevices], alarm: Alarm, times: int) -> None:
    """All was done all the same."""

    async def stall(simulation: SimulatedDevices) -> None:
        """Stop the whole process, again and again, while the arm moves."""
        await trio.sleep(3.2)
        for _ in range(times):
            await trio.sleep(0.1)
            clock = trio.lowlevel.current_clock()
            assert isinstance(clock, MockClock)
            clock.jump(0.065)

    alarm.task = stall
    for arguments in ((), ("--json",)):
        outcome = run("demo", "--seconds", "2", "--cycle", "20ms", *TWO_JOINTS, *arguments)
        assert outcome.status == ExitCode.OK
        assert_all_stand(simulations)
        simulations.clear()
        assert ("this computer could not keep a cycle of 20 ms" in outcome.err) is (times > 1)
        if arguments:
            sent, skipped = outcome.json["sync_cycles"], outcome.json["skipped_cycles"]
            assert 2.1 / 0.02 <= sent <= 2.1 / 0.02 + 3  # the path takes as many SYNCs as it ever did
            assert 2 * times <= skipped <= 4 * times
            assert outcome.json["late_share"] == pytest.approx(skipped / (sent + skipped), abs=1e-6)
        else:
            assert "0 missed, " in outcome.err
            assert re.search("SYNC cycles +missed +skipped +late\n.*\n +107 +0 +[0-9]+ +[0-9.]+ %", outcome.out)


@pytest.mark.thorough(2)
@pytest.mark.parametrize("has_ruckig", [True, False])
def test_a_planned_motion_where_ruckig_is(
    run: Run, simulations: list[SimulatedDevices], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, has_ruckig: bool
) -> None:
    """Its picture has both motions, and says where the planned one begins."""
    drawn = recordings_drawn(monkeypatch)
    if has_ruckig:
        pytest.importorskip("ruckig", reason="a planned motion needs the extra `motion`")
    else:
        monkeypatch.setattr(demonstration, "find_spec", lambda name: None)
    outcome = run("demo", "--seconds", "1", "--cycle", "20ms", *TWO_JOINTS, "--plot", str(tmp_path / "arm.png"))
    assert outcome.status == 0
    begins = drawn[0].planned_from
    assert (begins is not None and 1.0 <= begins < drawn[0].times[-1] - 1.0) is has_ruckig
    assert ("all joints arrived together" in outcome.err) is has_ruckig
    assert_all_stand(simulations)


def test_a_planned_motion_that_takes_too_long_stops_on_its_path(
    run: Run, simulations: list[SimulatedDevices], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ruckig", reason="a planned motion needs the extra `motion`")
    monkeypatch.setattr(demonstration, "PLANNED_TIME", 0.5)
    outcome = run("demo", "--seconds", "1", "--cycle", "20ms", *TWO_JOINTS)
    assert outcome.status == 0
    assert "stopped on the path" in outcome.err
    assert_all_stand(simulations)


def test_quiet_says_nothing_but_the_result(run: Run) -> None:
    assert run("demo", *TWO, "-q").err == ""


def test_on_a_terminal_it_draws(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    outcome = run("demo", *TWO)
    assert outcome.status == 0
    assert "●" in outcome.err
    assert "\x1b[32m" in outcome.out  # green
    assert "\x1b[32m" not in run("demo", *TWO, "--no-color").out


def test_the_bus_variable_does_not_make_it_move_real_drives(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CANOPEN_BUS", "socketcan:can0")
    assert run("demo", *TWO).status == 0


@pytest.mark.thorough(5)
@pytest.mark.parametrize("at", [0.0, 0.01, 0.02, 0.5, 1.3, 1.52, 1.57, 1.59, 1.67, 1.97, 2.12, 2.17])
def test_ctrl_c_leaves_every_drive_halted(run: Run, simulations: list[SimulatedDevices], alarm: Alarm, at: float) -> None:
    alarm.set((at, signal.SIGINT))
    outcome = run("demo", *TWO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "interrupted by Ctrl-C" in outcome.err
    assert "STILL MOVING" not in outcome.err
    assert_all_stand(simulations)
    if 0.5 <= at <= 1.97:
        assert "halted: joint1, joint2\n" in outcome.err


@pytest.mark.thorough(3)
@pytest.mark.parametrize("steps", range(25))
def test_a_cancel_while_the_simulated_drives_begin_ends_them(steps: int) -> None:
    async def serve() -> None:
        async with simulated_drives([("virtual:begin", 3), ("virtual:begin too", 3)]):
            await trio.sleep_forever()

    async def test() -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(serve)
            for _ in range(steps):
                await trio.lowlevel.checkpoint()
            nursery.cancel_scope.cancel()

    trio.run(test)


def test_a_second_ctrl_c_changes_nothing(run: Run, simulations: list[SimulatedDevices], alarm: Alarm) -> None:
    alarm.set((1.0, signal.SIGINT), (0.001, signal.SIGINT))
    outcome = run("demo", *TWO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "already ending" in outcome.err
    assert_all_stand(simulations)


def test_a_joint_that_still_moves_is_not_said_to_be_halted(run: Run, simulations: list[SimulatedDevices], alarm: Alarm) -> None:
    """Two joints hardly brake."""

    async def wear_out_the_brakes(simulation: SimulatedDevices) -> None:
        for node_id in (4, 7):
            simulation.drives[node_id].values.store[objects.PROFILE_DECELERATION] = 1

    alarm.task = wear_out_the_brakes
    alarm.set((1.3, signal.SIGINT), (0.005, signal.SIGINT))
    outcome = run("demo", "--seconds", "20", "--cycle", "20ms")
    assert outcome.status == ExitCode.INTERRUPTED
    told = [line.removeprefix("  also:  ").partition(": ") for line in outcome.err.splitlines()]
    fates = {what: set(joints.split(", ")) for what, _, joints in told if what in ("halted", "told to halt", "STILL MOVING")}
    moving = {f"joint{node_id - 2}" for node_id, drive in simulations[0].drives.items() if not stands(drive)}
    assert moving
    assert moving <= fates["STILL MOVING"]
    assert sum(map(len, fates.values())) == len(set().union(*fates.values())) == 6
    assert "CO131" in outcome.err
    assert "emergency stop" in outcome.err


@pytest.mark.thorough(2)
@pytest.mark.parametrize(("at", "joints", "names"), [(2.0, (), range(1, 7)), (3.1, TWO_JOINTS, range(1, 3))])
def test_ctrl_c_halts_drives_made_of_a_file(
    run: Run, simulations: list[SimulatedDevices], alarm: Alarm, at: float, joints: tuple[str, ...], names: range
) -> None:
    alarm.set((at, signal.SIGINT), (0.009, signal.SIGINT))
    outcome = run("demo", "--eds", "sample_drive.eds", "--seconds", "20", *joints)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "STILL MOVING" not in outcome.err
    assert f"halted: {', '.join(f'joint{number}' for number in names)}\n" in outcome.err
    assert_all_stand(simulations)


def test_sigterm_is_as_good(run: Run, simulations: list[SimulatedDevices], alarm: Alarm) -> None:
    alarm.set((1.8, signal.SIGTERM))
    outcome = run("demo", *TWO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "interrupted by SIGTERM" in outcome.err
    assert_all_stand(simulations)


def test_a_fault_in_the_middle_of_a_move(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("demo", *SHORT, "--fault", "5@0.2")
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert len(outcome.err.splitlines()) <= 16
    for word in ("CO402", "joint3 (node 5", "0x2310", "over-current", "in fault, without power: joint3", "try:", "✘ move"):
        assert word in outcome.err
    assert "halted: joint1, joint2, joint4, joint5, joint6" in outcome.err
    assert "await" not in outcome.err  # the library's advice would be of no use here
    assert_all_stand(simulations)


def test_the_fault_as_json(run: Run) -> None:
    error = run("demo", *TWO, "--fault", "4@0.2", "--json").error
    assert (error["code"], error["kind"], error["node"]) == ("CO402", "drive_fault", 4)
    assert error["try"]


def test_a_fault_wants_a_simulated_drive_of_the_chain(run: Run) -> None:
    assert run("demo", "--fault", "5@1", "-b", "can0").status == ExitCode.USAGE
    outcome = run("demo", "--fault", "5@9")
    assert outcome.status == ExitCode.USAGE
    assert "--for 11s" in outcome.err
    outcome = run("demo", "--fault", "99@1")
    assert outcome.status == ExitCode.USAGE
    assert "3, 4, 5, 6, 7, 8" in outcome.err


# ---- on a bus ----


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch, alarm: Alarm) -> list[SimulatedDevices]:
    """The bus virtual:real has two drives, which the command takes for real ones."""
    simulations: list[SimulatedDevices] = []

    @asynccontextmanager
    async def with_drives(*locators: str, **options: Any) -> AsyncIterator[Master]:
        async with simulated_drives(("virtual:real", node_id) for node_id in (3, 4)) as simulation:
            simulations.append(simulation)
            trio.lowlevel.spawn_system_task(alarm.ring, simulation)
            async with open_master(*locators, **options) as master:
                yield master

    monkeypatch.setattr(demonstration, "open_master", with_drives)
    return simulations


def test_the_same_on_a_bus(run: Run, bus: list[SimulatedDevices]) -> None:
    outcome = run("demo", *TWO, "-b", "virtual:real", "--timeout", "100ms")
    assert outcome.status == 0
    assert "2 drives on virtual:real" in outcome.err
    assert "Ctrl-C stops it" in outcome.err
    assert "scan -b demo" not in outcome.err
    assert_all_stand(bus)
    assert run("demo", *TWO, "-b", "virtual:real", "--json").json["simulated"] is False


def test_a_file_of_schunks_brings_its_scale(run: Run, bus: list[SimulatedDevices], tmp_path: Path) -> None:
    outcome = run("demo", *TWO, "--eds", written(tmp_path / "joint.dcf"), "-b", "virtual:real")
    assert outcome.status == 0, outcome.err
    assert_all_stand(bus)


def test_a_drive_on_a_bus_breaks_down(run: Run, bus: list[SimulatedDevices], alarm: Alarm) -> None:
    async def break_down(simulation: SimulatedDevices) -> None:
        await trio.sleep(4.9)
        simulation.raise_fault(4, 0x3210)

    alarm.task = break_down
    outcome = run("demo", *TWO, "-b", "virtual:real")
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "canopen info 4 -b virtual:real" in outcome.err
    assert "canopen home 4 --reset-fault -b virtual:real" in outcome.err
    assert_all_stand(bus)


# ---- bad input ----


def chain_file(tmp_path: Path, text: str) -> str:
    path = tmp_path / "my.csv"
    path.write_text(text)
    return str(path)


def test_another_chain_file_is_simulated_as_it_stands(run: Run, tmp_path: Path) -> None:
    chains = chain_file(tmp_path, "one j1 can0 12\ntwo left can0 0x10 right can1 16\n")
    outcome = run("demo", *SHORT, "--chains", chains, "--chain", "two", "--json")
    assert outcome.status == 0
    assert [joint["node"] for joint in outcome.json["joints"]] == [16, 16]
    assert run("demo", *SHORT, "--chains", chains, "--json").json["chain"] == "one"


def test_a_chain_that_the_file_does_not_have(run: Run) -> None:
    outcome = run("demo", "--chain", "arm2")
    assert outcome.status == ExitCode.USAGE
    assert "has no chain 'arm2'" in outcome.err
    assert "arm1" in outcome.err


def test_a_chain_file_that_is_not_there(run: Run) -> None:
    outcome = run("demo", "--chains", "nowhere.csv")
    assert outcome.status == ExitCode.BAD_FILE
    assert "multiple_devices.csv" in outcome.err


def test_a_malformed_chain_file_is_told_by_line_and_column(run: Run, tmp_path: Path) -> None:
    outcome = run("demo", "--chains", chain_file(tmp_path, "arm joint1 can0 3 joint2 can0 200\n"))
    assert outcome.status == ExitCode.BAD_FILE
    assert "my.csv:1:" in outcome.err
    assert "200" in outcome.err


def test_a_malformed_dictionary_is_told_by_line_and_column(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "indices.csv").write_text("controlword 0x6040 0x00 2 rw\nstatusword 0xZZ 0x00 2 ro\n")
    monkeypatch.setenv("CANOPEN_DATA", str(tmp_path))
    outcome = run("demo")
    assert outcome.status == ExitCode.BAD_FILE
    assert "indices.csv:2:" in outcome.err


def test_two_joints_of_one_node_are_refused(run: Run, tmp_path: Path) -> None:
    outcome = run("demo", "--chains", chain_file(tmp_path, "arm j1 can0 3 j2 can1 3"), "-b", "virtual:x")
    assert outcome.status == ExitCode.BAD_FILE


def test_a_bus_that_is_not_there(run: Run) -> None:
    outcome = run("demo", "-b", "socketcan:can77")
    assert outcome.status == ExitCode.CANNOT_OPEN
    assert "try:" in outcome.err
    assert run("demo", "-b", "nonsense:1").status == ExitCode.CANNOT_OPEN


def test_a_real_drive_whose_unit_nobody_said_is_not_moved(
    run: Run, bus: list[SimulatedDevices], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(objects, "SCHUNK_VENDOR_ID", 0x1234)
    outcome = run("demo", *TWO, "-b", "virtual:real")
    assert outcome.status == ExitCode.USAGE
    assert "joint1 (node 3 on virtual:real): the scale of the drive is not known" in outcome.err
    assert "--counts-per-degree 1000" in outcome.err
    assert "✔ boot" not in outcome.err
    assert_all_stand(bus)


def test_nobody_answers(run: Run) -> None:
    outcome = run("demo", "-b", "virtual:empty")
    assert outcome.status == ExitCode.NO_ANSWER
    assert "joint1 (node 3" in outcome.err
    assert "nothing had moved" in outcome.err
    assert "try:" in outcome.err


def test_a_cycle_that_the_drive_cannot_have(run: Run) -> None:
    assert run("demo", "--cycle", "1s").status == ExitCode.USAGE
    for cycle in ("1.05ms", "30.1ms"):
        outcome = run("demo", "--cycle", cycle)
        assert outcome.status == ExitCode.USAGE
        assert "boot" not in outcome.err
    assert "--cycle 30ms" in outcome.err
    assert run("demo", "--seconds", "0.5", "--cycle", "12.5ms", *TWO_JOINTS, "--json").json["cycle_ms"] == 12.5


# ---- the picture ----


def test_the_plot(run: Run, tmp_path: Path) -> None:
    picture = tmp_path / "arm.png"
    outcome = run("demo", *TWO, "--plot", str(picture))
    assert outcome.status == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(picture) in outcome.err.replace("\n", "")


def recordings_drawn(monkeypatch: pytest.MonkeyPatch) -> list[Recording]:
    """What --plot draws from now on."""
    drawn: list[Recording] = []

    def draw(path: Path, recording: Recording, *titles: str) -> None:
        drawn.append(recording)
        write_plot(path, recording, *titles)

    command = importlib.import_module("canopen_cli.demo.demo")  # the package has a command of that name
    monkeypatch.setattr(command, "write_plot", draw)
    return drawn


@pytest.mark.thorough
def test_a_breakdown_is_drawn_too(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = recordings_drawn(monkeypatch)
    picture = tmp_path / "arm.png"
    outcome = run("demo", "--seconds", "2", "--cycle", "20ms", *TWO_JOINTS, "--fault", "4@1.0", "--plot", str(picture))
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert picture.read_bytes().startswith(b"\x89PNG")
    (recording,) = drawn
    assert recording.broken is not None
    time, name = recording.broken
    assert (round(time, 1), name) == (1.0, "joint2")
    for joint in recording.joints:
        count = sum(math.isnan(each) for each in joint.commanded)  # the joints brake
        assert count > 3
        assert joint.actual[-1] == pytest.approx(joint.actual[-2], abs=0.02)
        assert joint.largest_error < 1


def test_a_plot_that_cannot_be_written_is_told_before_anything_moves(run: Run, tmp_path: Path) -> None:
    outcome = run("demo", "--plot", str(tmp_path / "no" / "arm.png"))
    assert outcome.status == ExitCode.BAD_FILE
    assert "boot" not in outcome.err
    outcome = run("demo", "--plot", str(tmp_path / "arm.docx"))
    assert outcome.status == ExitCode.USAGE
    assert ".png" in outcome.err


def test_a_plot_onto_a_full_or_forbidden_place(run: Run) -> None:
    outcome = run("demo", *TWO, "--plot", "/proc/arm.png")
    assert outcome.status in (ExitCode.BAD_FILE, ExitCode.PERMISSION)  # of root; of others
    assert "cannot write /proc/arm.png" in outcome.err


def test_without_matplotlib_it_says_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(
        name: str, globals: Mapping[str, Any] | None = None, locals: Mapping[str, Any] | None = None,
        fromlist: Sequence[str] = (), level: int = 0,
    ) -> Any:  # fmt: skip
        if name.startswith("matplotlib"):
            raise ModuleNotFoundError("No module named 'matplotlib'", name="matplotlib")
        return real(name, globals, locals, fromlist, level)

    monkeypatch.setattr(builtins, "__import__", without)
    outcome = run("demo", "--plot", "arm.png")
    assert outcome.status == ExitCode.USAGE
    assert "canopen-proto[plot]" in outcome.err


@pytest.mark.parametrize("there", [True, False])
def test_a_picture_that_this_user_may_not_write(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool) -> None:
    """Before anything moves. Whoever runs the tests may be root, who may write everywhere."""
    picture = tmp_path / "arm.png"
    if there:
        picture.touch()

    def refuse(path: Path, mode: str) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", refuse)
    outcome = run("demo", "--plot", str(picture))
    assert outcome.status == ExitCode.PERMISSION
    assert f"CO109: cannot write {picture}: Permission denied" in " ".join(outcome.err.split())
    assert "boot" not in outcome.err
