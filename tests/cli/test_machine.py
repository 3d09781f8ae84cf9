"""-m and CANOPEN_MACHINE: every command takes bus, node-IDs and dictionaries from the machine file; `canopen machine`."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from canopen_cli.shared import session
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_master import ChainState, Master
from canopen_master.demonstration import run as demonstration
from canopen_master.machine_file import parse_machine
from canopen_master.simulation.serving import simulated_drives
from canopen_proto.simulation.drive.settings import Shape
from canopen_proto.sync import SyncSent
from tests.cli.cli_support import SHORT, TWO, Run

CELL = """
[buses.left]
locator = "virtual:left"
bitrate = "1M"

[buses.right]
locator = "virtual:right"

[nodes.shoulder]
bus = "left"
id = 3

[nodes.drive4]
bus = "right"
id = 4
file = "sample_drive.eds"
overlay = "units.toml"

[joints.shoulder]
[joints.wrist]
node = "drive4"

[chains.arm]
joints = ["shoulder", "wrist"]
"""
ONE = "[buses.can0]\n[nodes]\nshoulder = { id = 3 }\nelbow = { id = 4 }\n[joints]\nshoulder = {}\nelbow = {}\n"


@pytest.fixture
def shape() -> Shape:
    return Shape.SCHUNK_POWERBALL


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shape: Shape) -> str:
    """A machine with two buses, in the current folder; on each a simulated joint is there while a command runs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "units.toml").write_text("[objects.6064]\naliases = ['place']\nunit = 'deg'\nfactor = 0.001\n")
    (tmp_path / "cell.toml").write_text(CELL)
    (tmp_path / "one.toml").write_text(ONE)
    open_master = session.open_master

    @asynccontextmanager
    async def with_drives(bus: Any, **options: Any) -> AsyncIterator[Any]:
        drives = (("virtual:left", 3), ("virtual:right", 4))
        locator = bus if isinstance(bus, str) else bus.locator
        simulation = simulated_drives([each for each in drives if each[0] == locator], shape)
        async with simulation, open_master(bus, **options) as master:
            yield master

    monkeypatch.setattr(session, "open_master", with_drives)
    return "cell.toml"


def test_joints_and_nodes_are_named_in_place_of_bus_and_node_id(run: Run, cell: str) -> None:
    for name, node_id in (("shoulder", 3), ("wrist", 4), ("drive4", 4)):
        done = run("read", name, "statusword", "-m", cell, "--json")
        assert (done.status, done.json["node"]) == (ExitCode.OK, node_id), done.err
    done = run("read", "wrist", "place", "-m", cell, "--json")
    assert done.json["unit"] == "deg"  # by the side file of the machine file
    assert run("read", "shoulder", "place", "-m", cell).status == ExitCode.USAGE


@pytest.mark.parametrize("before", [True, False])
def test_the_file_may_stand_before_the_command_or_in_the_environment(
    run: Run, cell: str, monkeypatch: pytest.MonkeyPatch, before: bool
) -> None:
    if before:
        assert run("-m", cell, "drive", "wrist", "state").status == ExitCode.OK
        assert run("drive", "wrist", "state", "-m", cell).status == ExitCode.OK
    else:
        monkeypatch.setenv("CANOPEN_MACHINE", cell)
        monkeypatch.setenv("CANOPEN_BUS", "virtual:nowhere")
        assert run("drive", "wrist", "state").status == ExitCode.OK
        assert run("home", "shoulder").status == ExitCode.OK
        assert run("nmt", "start", "wrist").status == ExitCode.OK


def test_a_command_about_a_bus_needs_its_name_if_there_are_several(run: Run, cell: str) -> None:
    done = run("scan", "-m", cell)
    assert done.status == ExitCode.USAGE
    assert "CO121: which bus of cell.toml?" in done.err
    assert "its buses are left, right" in done.err
    assert [row["node"] for row in run("scan", "-m", cell, "-b", "right", "--json").json] == [4]
    assert run("read", "4", "statusword", "-m", cell, "-b", "right").status == ExitCode.OK
    done = run("read", "wrist", "statusword", "-m", cell, "-b", "left")
    assert "CO121: -b is on bus 'left' of cell.toml, and this command is about bus 'right'" in done.err
    done = run("home", "shoulder", "wrist", "-m", cell, "-b", "left")
    assert "CO121: -b is on bus 'left' of cell.toml, and this command is about bus 'right'" in done.err
    assert "CO121" in run("home", "shoulder", "4", "-m", cell, "-b", "right").err


def test_joints_on_several_buses_home_at_the_same_time(run: Run, cell: str) -> None:
    done = run("home", "shoulder", "wrist", "drive4", "-m", cell, "--json")
    assert done.status == ExitCode.OK, done.err
    assert [(each["node"], each["homed"], each["state"]) for each in done.json] == [
        (3, True, "switch on disabled"),
        (4, True, "switch on disabled"),
    ]
    rehearsed = run("home", "shoulder", "wrist", "-m", cell, "--dry-run")
    assert rehearsed.status == ExitCode.OK, rehearsed.err
    assert rehearsed.out.count("homing_operation_start") + rehearsed.out.count("controlword = 31") >= 2
    slow = run("home", "shoulder", "wrist", "-m", cell, "--limit", "1ms")
    assert slow.status == ExitCode.DRIVE_FAULT
    assert "a longer --limit (now 0.001 s)" in slow.err


def test_the_demos_drives_in_the_place_of_the_machines(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "one.toml"
    path.write_text(ONE)
    assert run("read", "elbow", "statusword", "-m", str(path), "-b", "demo", "--json").json["node"] == 4
    assert run("home", "shoulder", "elbow", "-m", str(path), "-b", "demo").status == ExitCode.OK
    assert run("drive", "elbow", "stop", "--dry-run", "-m", str(path), "-b", "demo").status == ExitCode.OK


def test_a_b_goes_before_the_environment(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL.replace('overlay = "units.toml"', ""))
    monkeypatch.setenv("CANOPEN_MACHINE", str(path))
    assert run("read", "5", "statusword", "-b", "demo").status == ExitCode.OK
    done = run("read", "wrist", "statusword", "-b", "demo")
    assert "CO120: 'wrist' is not a node-ID" in done.err
    assert f"-b demo is no bus of {path}: CANOPEN_MACHINE does not count then" in done.err
    assert f"-m {path} -b demo" in done.err
    assert run("read", "wrist", "statusword").status == ExitCode.NO_ANSWER


def test_a_name_that_is_none(run: Run, cell: str) -> None:
    done = run("read", "rist", "statusword", "-m", cell)
    assert done.status == ExitCode.USAGE
    assert "CO120: 'rist' is neither a node-ID nor a name in cell.toml" in done.err
    assert "did you mean wrist" in done.err
    assert "is not a node-ID" in run("drive", "rist", "state", "-b", "demo").err
    done = run("read", "wrist", "statusword", "-m", "none.toml")
    assert (done.status, "there is no file 'none.toml'" in done.err) == (ExitCode.BAD_FILE, True)


def test_the_next_command_asks_the_same_bus(run: Run, cell: str) -> None:
    done = run("read", "9", "statusword", "-m", cell, "-b", "right")
    assert done.status == ExitCode.NO_ANSWER
    assert "canopen scan -m cell.toml -b right" in done.err
    problem = CommandError(ExitCode.NO_ANSWER, "CO201", "x", tries=("canopen info 5    (what it is)",))
    assert problem.on_bus(None, "a b.toml").tries == ("canopen info 5 -m 'a b.toml'    (what it is)",)


def test_the_files_of_the_machine_serve_every_command(run: Run, cell: str, tmp_path: Path) -> None:
    assert run("info", "wrist", "-m", cell, "--json").json["file"]["name"] == "sample_drive.eds"
    (tmp_path / "a.log").write_text("(0.000000) can0 604#40C1600000000000\n")
    of_machine, of_data_files = (run("log", "decode", "a.log", *options).out for options in (("-m", cell, "-b", "right"), ()))
    assert of_machine.rpartition("60C1:00")[2].strip()  # a name, which only the device's own file has
    assert not of_data_files.rpartition("60C1:00")[2].strip()
    assert run("compare", "wrist", "sample_drive.eds", "-m", cell).status in (ExitCode.DIFFERENT, ExitCode.PARTIAL)
    assert run("drive", "wrist", "plan", "-m", cell, "--json").json["mode"] in ("csp", "ip", "pp")
    assert "CO134" in run("drive", "shoulder", "plan", "-m", cell).err
    assert "the file of node 3 (0x03) is needed" in run("check", "shoulder", "-m", cell).err
    assert run("check", "wrist", "--case", "2", "-m", cell, "--yes").status in (ExitCode.OK, ExitCode.DIFFERENT)


LIMITED = """
[buses.left]
locator = "virtual:left"
[nodes]
shoulder = { id = 3 }
[joints.shoulder]
unit = "degree"
direction = -1
max_position = 5
"""


def test_a_joint_moves_in_its_unit_and_within_its_limits(run: Run, cell: str) -> None:
    Path(cell).write_text(LIMITED)
    done = run("drive", "shoulder", "move", "--relative", "-m", cell, "--json", "--", "-2")
    assert done.status == ExitCode.OK, done.err
    assert done.json["unit"] == "degree"
    assert done.json["to"] - done.json["from"] == pytest.approx(-2, abs=0.02)
    assert done.json["from"] == pytest.approx(14)  # the simulated drive stands at -14000
    done = run("drive", "shoulder", "move", "20", "-m", cell)
    assert done.status != ExitCode.OK
    assert "max_position" in done.err
    done = run("drive", "3", "move", "1", "--in", "turn", "-m", cell)
    assert (done.status, "positions of shoulder are in the degree" in done.err) == (ExitCode.USAGE, True)
    done = run("drive", "shoulder", "move", "--dry-run", "-m", cell, "--", "-2")
    assert (done.status, "607A" in done.out) == (ExitCode.OK, True)
    assert run("home", "shoulder", "-m", cell).status == ExitCode.OK


@pytest.mark.parametrize("shape", [Shape.STANDARD])
def test_a_joint_runs_in_its_unit_and_within_its_limits(run: Run, cell: str) -> None:
    Path(cell).write_text(LIMITED.replace("max_position = 5", "max_speed = 3\ncounts_per_unit = 1000"))
    run_at = ("drive", "shoulder", "velocity", "-m", cell, "--seconds", "0.5")
    refused = run(*run_at, "5")
    assert refused.status != ExitCode.OK
    assert "max_speed" in refused.err
    done = run(*run_at, "2", "--json")
    assert (done.status, done.json["unit"], done.json["velocity"]) == (ExitCode.OK, "degree", pytest.approx(2)), done.err
    assert "positions of shoulder are in the degree" in run(*run_at, "--in", "rpm", "5").err


def test_a_check_tells_where_each_limit_comes_from(run: Run, cell: str) -> None:
    limits = "[joints]\nshoulder = { max_position = 40, max_jerk = 500 }\nelbow = { max_speed = 5 }"
    Path("one.toml").write_text(
        ONE.partition("[joints]")[0] + "[defaults.joints]\nunit = 'degree'\nmax_speed = 20\nmax_acceleration = 60\n" + limits
    )
    outcome = run("machine", "check", "one.toml")
    assert outcome.status == 0, outcome.err
    shown = [" ".join(line.split()) for line in outcome.out.splitlines()]
    for line in (
        "shoulder max_position 40 degree joints.shoulder",
        "shoulder max_speed 20 degree/s defaults.joints",
        "shoulder max_acceleration 60 degree/s² defaults.joints",
        "shoulder max_jerk 500 degree/s³ joints.shoulder",
        "elbow max_speed 5 degree/s joints.elbow",
        "max_jerk max_acceleration, reached in 0.1 s; of elbow",
        "min_position 0x607D of the drive, if it has it",
    ):
        assert line in shown
    document = run("machine", "check", "one.toml", "--json").json
    assert document["limits"]["elbow"]["max_speed"] == {"value": 5, "source": "joints.elbow"}
    assert document["limits"]["elbow"]["max_jerk"]["value"] is None


def test_a_joint_homes_as_the_file_says(run: Run, cell: str) -> None:
    Path(cell).write_text(LIMITED.replace("max_position = 5", 'homing_timeout = "1ms"'))
    done = run("home", "shoulder", "-m", cell)
    assert done.status != ExitCode.OK
    assert "a longer --limit (now 0.001 s)" in done.err
    assert run("home", "shoulder", "-m", cell, "--limit", "60s").status == ExitCode.OK


def test_a_scan_shows_names_and_what_is_not_there(run: Run, cell: str) -> None:
    Path(cell).write_text(CELL.replace("[joints.shoulder]", "[nodes.lamp]\nbus = 'right'\nid = 9\n[joints.shoulder]"))
    done = run("scan", "-m", cell, "-b", "right")
    assert "drive4" in done.out
    assert "of cell.toml not found: lamp (9)" in done.err
    assert [row["machine"] for row in run("scan", "-m", cell, "-b", "right", "--json").json] == ["drive4"]
    assert "not found" not in run("scan", "-m", cell, "-b", "right", "--ids", "4-8").err
    assert "not heard: lamp (9)" in run("scan", "--passive", "-m", cell, "-b", "right").err
    assert "machine" not in run("scan", "-b", "demo", "--json").json[0]


# ---- demo ----


def test_the_demonstration_moves_a_simulated_machine(run: Run, cell: str) -> None:
    done = run("demo", "-m", cell, *SHORT, "--json")
    assert done.status == ExitCode.OK, done.err
    shown = done.json
    assert (shown["chain"], shown["simulated"], shown["cycle_ms"]) == ("arm", True, 20)
    assert [(each["joint"], each["node"], each["homed"]) for each in shown["joints"]] == [
        ("shoulder", 3, True),
        ("wrist", 4, True),
    ]
    assert "made of sample_drive.eds" in done.err
    advice = run("demo", "-m", cell, *SHORT).err
    assert "scan -b demo" not in advice
    assert "the same with --fault 4@" in advice
    Path(cell).write_text('[master]\ncycle = "25ms"\n' + CELL)
    assert run("demo", "-m", cell, "--seconds", "0.5", "--json").json["cycle_ms"] == 25
    assert "CO322" in run("demo", "-m", cell, "--chain", "leg").err
    assert "CO322: one.toml has no chain" in run("demo", "-m", "one.toml").err
    for option in (("--chains", "x.csv"), ("--eds", "sample_drive.eds"), ("--counts-per-degree", "5")):
        assert f"CO123: {option[0]}: the machine file says that already" in run("demo", "-m", cell, *option).err


def test_a_machine_of_the_environment_does_not_move(run: Run, cell: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CANOPEN_MACHINE", cell)
    assert run("demo", *TWO, "--json").json["chain"] != "arm"


REAL = """
[buses.left]
locator = "virtual:left"
[buses.right]
locator = "virtual:right"
[nodes]
shoulder = { bus = "left", id = 3 }
wrist = { bus = "right", id = 4 }
[joints]
shoulder = { unit = "degree", max_speed = 8 }
wrist = { unit = "turn", max_speed = 0.02 }
[chains.arm]
joints = ["shoulder", "wrist"]
"""


def test_on_its_own_buses_a_machine_moves_within_its_limits(run: Run, cell: str, monkeypatch: pytest.MonkeyPatch) -> None:
    open_master = demonstration.open_master
    fastest = {"shoulder": 0.0, "wrist": 0.0}

    @asynccontextmanager
    async def with_drives(*buses: str, **options: Any) -> AsyncIterator[Any]:
        async with simulated_drives([("virtual:left", 3), ("virtual:right", 4)]), open_master(*buses, **options) as master:
            master.watch((SyncSent,), lambda _: look(master), master.bus("virtual:left"))
            yield master

    def look(master: Master) -> None:
        for device in master.chains["arm"].devices if master.chains else ():
            before, after = last.get(device.name), device.desired_position
            if before is not None and master.chains["arm"].state is ChainState.FOLLOWING:
                fastest[device.name] = max(fastest[device.name], abs(after - before) / 0.02)
            last[device.name] = after

    last: dict[str, float] = {}
    monkeypatch.setattr(demonstration, "open_master", with_drives)
    Path(cell).write_text(REAL)
    done = run("demo", "-m", cell, "-b", "left", *SHORT, "--json")
    assert done.status == ExitCode.OK, done.err
    assert not done.json["simulated"]
    assert 1 < fastest["shoulder"] <= 8.001
    assert 0.002 < fastest["wrist"] <= 0.020001
    Path(cell).write_text(REAL.replace('"turn"', '"millimetre"'))
    done = run("demo", "-m", cell, "-b", "left", *SHORT)
    assert (done.status, "wrist cannot swing by an angle" in done.err) == (ExitCode.USAGE, True)


# ---- sim, plan ----


def test_every_device_of_a_machine_is_simulated(run: Run, cell: str) -> None:
    done = run("sim", cell, "--seconds", "1", "--json")
    assert done.json == {"left": "virtual:left", "right": "virtual:right"}
    assert "1 simulated device on left, virtual:left" in done.err
    assert "node 4 (0x04)  sample_drive.eds: a simulated drive" in done.err
    assert run("sim", "-m", cell, "-b", "right", "--seconds", "1", "--json").json == {"right": "virtual:right"}
    assert "which bus of cell.toml?" in run("sim", cell, "-b", "virtual:other", "--seconds", "1").err
    assert run("sim", "one.toml", "-b", "virtual:other", "--seconds", "1", "--json").json == {"can0": "virtual:other"}


def test_a_machine_is_planned(run: Run, cell: str) -> None:
    done = run("plan", "-m", cell)
    assert "CO001: which bit rate has right?" in done.err
    left, right = run("plan", "-m", cell, "--bitrate", "500k", "--cycle", "5ms", "--json").json
    assert (left["bus"], left["bitrate"], left["cycle_ms"], left["fits"]) == ("left", 500_000, 5, True)
    assert {each["name"] for each in right["streams"] if each["node"] == 4} >= {"TPDO arm.wrist", "RPDO arm.wrist"}
    Path(cell).write_text(CELL.replace('"virtual:right"', '"virtual:right"\nbitrate = "125k"'))
    assert [each["bitrate"] for each in run("plan", "-m", cell, "--json").json] == [1_000_000, 125_000]
    done = run("plan")
    assert (done.status, "which network?" in done.err) == (ExitCode.USAGE, True)


def test_every_command_about_a_machine_takes_its_file_as_an_argument(
    run: Run, cell: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for command in (("plan", "--bitrate", "500k"), ("node", "list"), ("machine", "check")):
        outcome = run(*command, cell, "--json")
        assert outcome.status == ExitCode.OK, outcome.err
        assert run(*command, "-m", cell, "--json").json == outcome.json
        monkeypatch.setenv("CANOPEN_MACHINE", cell)
        assert run(*command, "--json").json == outcome.json
        monkeypatch.delenv("CANOPEN_MACHINE")
    assert "--chains arm.csv    (if it is a chain file)" in run("plan", "arm.csv").err
    assert "one of the two" in run("plan", cell, "--chains", "arm.csv").err


# ---- canopen machine ----


def test_a_machine_file_is_checked(run: Run, cell: str) -> None:
    done = run("machine", "check", cell)
    assert done.status == ExitCode.OK
    assert "no error" in done.err
    assert run("machine", "check", "-m", cell, "--json").json["chains"] == {"arm": ["shoulder", "wrist"]}
    Path(cell).write_text(CELL + "joint = 1\n[nodes.x]\n")
    done = run("machine", "check", cell)
    assert done.status == ExitCode.DIFFERENT
    assert "cell.toml:25:1: error CO301 chains.arm: there is no entry 'joint'; did you mean joints?" in done.out
    assert "3 errors" in done.err
    found = run("machine", "check", cell, "--json").json["findings"]
    assert [each["line"] for each in found] == [25, 26, 26]
    assert run("machine", "check", "none.toml").status == ExitCode.BAD_FILE
    assert run("machine", "check").status == ExitCode.USAGE


def test_faults_of_the_files_that_it_names(run: Run, cell: str, tmp_path: Path) -> None:
    (tmp_path / "units.toml").write_text("[objects.6064]\nfactor = 'x'\n")
    done = run("machine", "check", cell)
    assert done.status == ExitCode.DIFFERENT
    assert "units.toml" in done.out
    assert "objects.6064.factor" in done.out


def test_a_chain_file_becomes_a_machine_file_which_is_not_overwritten(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    done = run("machine", "from-chains", "multiple_devices.csv", "-o", str(path))
    assert done.status == ExitCode.OK, done.err
    machine = parse_machine(path.read_text())
    assert [machine.nodes[name].node_id for name in machine.chains["arm1"].joints] == [3, 4, 5, 6, 7, 8]
    assert machine.buses["pcan32"].locator == "/dev/pcan32"
    before = path.read_bytes()
    done = run("machine", "from-chains", "single_device.csv", "-o", str(path))
    assert (done.status, "CO135" in done.err) == (ExitCode.USAGE, True)
    assert path.read_bytes() == before
    done = run("machine", "from-chains", "single_device.csv", "-o", str(path), "--force", "--json")
    assert done.json["chains"] == {"chain1": ["joint1"]}


def test_names_of_buses_are_told_what_they_mean(run: Run, tmp_path: Path) -> None:
    chains, path = tmp_path / "arm.csv", tmp_path / "cell.toml"
    chains.write_text("arm j1 left 3 j2 right 3\n")
    arguments = ("machine", "from-chains", str(chains), "-o", str(path))
    done = run(*arguments)
    assert (done.status, "--locator left=socketcan:can0" in done.err) == (ExitCode.USAGE, True)
    assert not path.exists()
    assert run(*arguments, "--locator", "left=can0", "--locator", "right=virtual:b").status == ExitCode.OK
    assert {bus.name: bus.locator for bus in parse_machine(path.read_text()).buses.values()} == {
        "left": "can0",
        "right": "virtual:b",
    }
    assert run(*arguments, "--locator", "left").status == ExitCode.USAGE
    assert run(*arguments, "--force", "--locator", "middle=can0").status == ExitCode.USAGE


def test_the_bit_by_which_a_joint_shows_safe_torque_off_is_looked_at(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "sto.toml"
    bit = '{ object = "6041", bit = 6 }'
    file.write_text(f"[buses.can0]\n[nodes]\nshoulder = {{ id = 3 }}\n[joints]\nshoulder = {{ sto_input = {bit} }}\n")
    on = ("-m", str(file), "-b", "demo")
    outcome = run("drive", "shoulder", "state", *on)
    assert "it does not move  safe torque off is active (bit 6 of 0x6041:00 is 1). Try: release the emergency stop" in outcome.out
    assert "safe torque off" not in run("drive", "3", "state", "-b", "demo").out
