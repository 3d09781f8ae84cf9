"""`canopen drive`: what a drive shows, why it does not move, what its numbers mean; in virtual time."""

from __future__ import annotations

import re
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_cli.shared import session
from canopen_cli.shared.problem import ExitCode
from canopen_data.describing import describe
from canopen_data.eds.writer import write_eds
from canopen_master.simulation.host import simulate
from canopen_master.simulation.serving import DEMO_LOCATOR, SimulatedDevices, simulated_drives
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import POWERED, State
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.simulation.drive.answers import Answer
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import Shape
from canopen_transports import open_transport
from tests.cli.cli_support import Alarm, Run, stands
from tests.cli.command_examples import json_that_fits
from tests.core.devices import io_device

DEMO = ("-b", "demo")
WINDOW = 10
"""Counts: 0x6067 of the simulated drive, within which it is at its target."""


def prepare(monkeypatch: pytest.MonkeyPatch, change: Callable[[DriveNode], None]) -> list[DriveNode]:
    """Let something happen to drive 3 before a command begins; return the drives of the commands to come."""
    made: list[DriveNode] = []

    @asynccontextmanager
    async def prepared(*arguments: Any) -> AsyncIterator[SimulatedDevices]:
        async with simulated_drives(*arguments) as simulation:
            await trio.sleep(0.1)
            made.append(simulation.drives[3])
            change(made[-1])
            yield simulation

    monkeypatch.setattr(session, "simulated_drives", prepared)
    return made


def powered(drive: DriveNode) -> None:
    """Another program has enabled it."""
    for word in (0x06, 0x07, 0x0F):
        drive.values.store[objects.CONTROLWORD] = word
        drive.drive.written(0x6040, 0, 0)


def of_another_maker(drive: DriveNode) -> None:
    drive.values.store[objects.VENDOR_ID] = 0x99


def moving(drive: DriveNode) -> None:
    """Another program moves it, by its own profile."""
    powered(drive)
    for index, data in ((0x6060, b"\x01"), (0x607A, (90_000).to_bytes(4, "little")), (0x6040, b"\x1f\x00")):
        assert drive.write(index, 0, data, 0) is None


def test_state_never_says_of_a_drive_that_moves_that_it_does_not(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    made = prepare(monkeypatch, moving)
    outcome = run("drive", "3", "state", *DEMO)
    assert made[-1].values.store[objects.POSITION_ACTUAL_VALUE] != 0
    assert "does not move" not in outcome.out
    assert re.search(r"^it moves +up: by \d+ counts while this command looked$", outcome.out, re.MULTILINE), outcome.out
    assert json_that_fits("drive state", run("drive", "3", "state", "--json", *DEMO))["moves"] is True


def test_a_mode_that_a_drive_shows_is_never_called_one_that_it_does_not_have(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Schunk's joints home in homing mode, which their 0x6502 lacks."""

    def homing(drive: DriveNode) -> None:
        assert drive.write(0x6060, 0, b"\x06", 0) is None

    prepare(monkeypatch, homing)
    outcome = run("drive", "3", "state", *DEMO)
    assert "mode              homing (hm)" in outcome.out.splitlines()
    assert "it does not have the mode" not in outcome.out


def test_state_tells_a_target_that_is_not_reached(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def blocked(drive: DriveNode) -> None:
        moving(drive)
        drive.answer(0x6064, 0, Answer(value=500))

    prepare(monkeypatch, blocked)
    outcome = run("drive", "3", "state", *DEMO)
    assert "it stands         but has not reached its target (bit 10 is 0)" in outcome.out.splitlines()


def test_state_tells_what_keeps_it_from_moving(run: Run) -> None:
    outcome = run("drive", "3", "state", *DEMO)
    assert outcome.status == 0
    for line in (
        "state             switch on disabled",
        "mode              no mode",
        "it does not move  it is not enabled: switch on disabled. Try: enable it: canopen drive enable 3 -b demo",
        f"{'':18}no mode of operation is selected (0x6061 is 0). Try: select one (0x6060): canopen drive mode 3 -b demo",
    ):
        assert line in outcome.out.splitlines()
    document = run("drive", "3", "state", *DEMO, "--json").json
    assert (document["state"], document["statusword"], document["mode"]) == ("switch on disabled", 0x0240, 0)
    assert [each["what"] for each in document["obstacles"]] == [
        "it is not enabled: switch on disabled",
        "no mode of operation is selected (0x6061 is 0)",
    ]


def test_a_fault_is_named_and_reset(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    drives = prepare(monkeypatch, lambda drive: drive.raise_fault(0x2310, 0))
    document = run("drive", "3", "state", *DEMO, "--json").json
    assert document["state"] == "fault"
    assert [each["what"] for each in document["obstacles"]] == ["it is in fault: 0x2310 continuous over-current, output side"]
    outcome = run("drive", "3", "fault-reset", *DEMO)
    assert outcome.status == 0
    assert "state             switch on disabled" in outcome.out
    assert drives[-1].drive.state is State.SWITCH_ON_DISABLED


def test_a_fault_that_stays(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    prepare(monkeypatch, lambda drive: drive.raise_fault(0x4310, 0, lasting=True))
    outcome = run("drive", "3", "fault-reset", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "CO402" in outcome.err
    assert "a fault reset did not clear" in outcome.err


def test_disable(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("drive", "3", "disable", *DEMO)
    assert outcome.status == 0
    assert "state             switch on disabled" in outcome.out


def device(monkeypatch: pytest.MonkeyPatch, values: dict[int, int]) -> None:
    """Put an I/O device on the bus of the demonstration; with objects of CiA 402 beside its own it has a statusword, too."""
    values = {objects.STATUSWORD: 0x0240, **values} if values else {}
    indices = dict.fromkeys(key >> 8 for key in values)
    highest = {index: max(key & 0xFF for key in values if key >> 8 == index) for index in indices}
    dictionary = io_device(5).with_objects([standard_object(index, highest=highest[index] or None) for index in indices])

    def made(*arguments: object) -> LocalNode:
        node = LocalNode(arguments[0], 5, dictionary)  # type: ignore[arg-type]
        for key, value in values.items():
            node.values.store[dictionary.variable((key >> 8, key & 0xFF)).mux] = value
        return node

    @asynccontextmanager
    async def simulated(*arguments: object) -> AsyncIterator[None]:
        async with trio.open_nursery() as nursery:
            await nursery.start(simulate, await open_transport("virtual:demo"), [made])
            await trio.sleep(0.1)
            yield
            nursery.cancel_scope.cancel()

    monkeypatch.setattr(session, "simulated_drives", simulated)


def test_units_and_which_objects_say_so(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    gear = {objects.GEAR_RATIO: 50, objects.GEAR_RATIO + 1: 1}
    encoder = {objects.POSITION_ENCODER_RESOLUTION: 2000, objects.POSITION_ENCODER_RESOLUTION + 1: 1}
    device(monkeypatch, {**encoder, **gear, objects.MOTOR_RATED_TORQUE: 1270, objects.POLARITY: 0x80, objects.HOME_OFFSET: -500})
    outcome = run("drive", "5", "units", *DEMO)
    assert outcome.status == 0
    rows = [" ".join(line.split()) for line in outcome.out.splitlines()]
    for row in (
        "a turn of the shaft 100000 counts 0x608F = 2000 / 1, 0x6091 = 50 / 1",
        "a turn of the motor 2000 counts 0x608F = 2000 / 1, 0x6091 = 50 / 1",
        "a degree 277.7777778 counts",
        "a velocity of 1 1 count per second the default",
        "an acceleration of 1 1 count per second² the velocity unit per second",
        "a torque of 1 0.00127 N·m 0x6076 = 1270 mN·m",
        "reversed position 0x607E",
        "the home position -500 counts 0x607C",
    ):
        assert row in rows
    document = run("drive", "5", "units", *DEMO, "--json").json
    assert (document["counts_per_turn"], document["rated_torque"], document["conflicts"]) == (100_000, 1.27, [])


def test_units_that_differ_and_a_drive_that_tells_nothing(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    outcome = run("drive", "3", "units", *DEMO)  # a joint of Schunk's tells nothing, but its vendor-ID is enough
    assert "a degree 1000 counts" in " ".join(outcome.out.split())
    prepare(monkeypatch, of_another_maker)
    outcome = run("drive", "3", "units", *DEMO)
    assert "The drive does not tell what a count is. Try: counts_per_turn in a machine file" in outcome.err
    machine = tmp_path / "elbow.toml"
    machine.write_text("[buses.can0]\n[nodes.elbow]\nid = 3\n[joints.elbow]\nunit = 'degree'\ncounts_per_turn = 4096\n")
    outcome = run("drive", "elbow", "units", "-m", str(machine), *DEMO)
    assert "The drive does not tell what a count is. The machine file does: 11.3778 in a degree" in outcome.err
    encoder = {objects.POSITION_ENCODER_RESOLUTION: 2000, objects.POSITION_ENCODER_RESOLUTION + 1: 1}
    device(monkeypatch, {**encoder, objects.SI_UNIT_POSITION: 0xFD410000})
    outcome = run("drive", "5", "units", *DEMO)
    assert "these differ: 0x608F = 2000 / 1: 2000 counts for a turn; 0x60A8 = 0xFD410000" in outcome.out


def test_modes_and_one_is_selected(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("drive", "3", "mode", *DEMO)
    assert "it has            profile position (pp), velocity (vl), interpolated position (ip)" in outcome.out.splitlines()
    assert run("drive", "3", "mode", "pp", *DEMO, "--json").json == {"mode": 1, "wanted_mode": 1, "supported_modes": [1, 2, 7]}
    assert simulations[-1].drives[3].drive.mode == Mode.PROFILE_POSITION
    assert "mode              interpolated position (ip)" in run("drive", "3", "mode", "7", *DEMO).out
    refused = run("drive", "3", "mode", "csp", *DEMO)
    assert refused.status == ExitCode.DRIVE_FAULT
    assert "CO405" in refused.err
    for word in ("dance", "200", "--5"):
        assert run("drive", "3", "mode", word, *DEMO).status == ExitCode.USAGE


def test_the_mode_of_a_drive_with_power_stays(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    prepare(monkeypatch, powered)
    outcome = run("drive", "3", "mode", "pp", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "has power (operation enabled)" in outcome.err
    assert "canopen drive disable 3" in outcome.err


def test_move(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("drive", "3", "move", "2000", *DEMO)
    assert outcome.status == 0
    assert outcome.out.startswith("moved             from -14000 to ")
    drive = simulations[-1].drives[3]
    assert drive.drive.state is State.SWITCH_ON_DISABLED
    assert drive.values[objects.POSITION_ACTUAL_VALUE] == pytest.approx(2000, abs=WINDOW)
    document = run("drive", "3", "move", "--relative", "--json", *DEMO, "--", "-500").json
    assert document == {"from": -14000, "to": pytest.approx(-14500, abs=WINDOW), "unit": "counts", "state": "switch on disabled"}


@pytest.mark.parametrize("command", ["move 10 --in degree", "home", "enable", "velocity 10 --mode vl"])
def test_a_drive_that_another_program_holds_never_gets_a_halt_from_a_command_that_is_refused(
    run: Run, monkeypatch: pytest.MonkeyPatch, alarm: Alarm, command: str
) -> None:
    made = prepare(monkeypatch, powered)
    words: list[object] = []

    async def beat() -> None:
        async with await open_transport(DEMO_LOCATOR) as transport:
            while True:
                await transport.send(Frame(0x77F, b"\x05"))
                words.append(made[-1].values.store[objects.CONTROLWORD] if made else 0x0F)
                await trio.sleep(0.05)

    @asynccontextmanager
    async def held(*arguments: Any) -> AsyncIterator[SimulatedDevices]:
        async with prepared(*arguments) as simulation, trio.open_nursery() as nursery:
            nursery.start_soon(beat)
            yield simulation
            nursery.cancel_scope.cancel()

    prepared = session.simulated_drives
    monkeypatch.setattr(session, "simulated_drives", held)
    verb, *rest = command.split()
    outcome = run("drive", verb, "3", *rest, *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert set(words) == {0x0F}
    assert outcome.err.count("another node 127 was heard") == 1
    assert "--master-id" in outcome.err
    assert "open_master" not in outcome.err


@pytest.mark.parametrize("command", ["state", "units", "move 100", "velocity 100", "enable"])
def test_a_node_that_is_no_drive_is_called_so_by_every_command(run: Run, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    def no_drive(drive: DriveNode) -> None:
        for index in (0x6040, 0x6041, 0x6064):
            drive.answer(index, 0, Answer(abort=AbortCode.NO_SUCH_OBJECT))

    prepare(monkeypatch, no_drive)
    verb, *rest = command.split()
    outcome = run("drive", verb, "3", *rest, *DEMO)
    assert outcome.status != 0
    assert "is no drive by CiA 402" in outcome.err
    assert "0x6064" not in outcome.err
    assert not outcome.out


def test_a_position_has_the_decimals_of_a_count(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """-14000 counts of 4096 in a turn are -1230.46875 degrees, and a count is 0.088: two decimals tell them apart."""
    prepare(monkeypatch, of_another_maker)
    machine = tmp_path / "elbow.toml"
    machine.write_text("[buses.can0]\n[nodes.elbow]\nid = 3\n[joints.elbow]\nunit = 'degree'\ncounts_per_turn = 4096\n")
    cell = ("-m", str(machine), *DEMO)
    assert "position          -1230.47 degree  (-14000 counts)" in run("drive", "elbow", "state", *cell).out.splitlines()
    assert run("drive", "elbow", "state", *cell, "--json").json["position_in_unit"] == -1230.46875
    moved = run("drive", "elbow", "move", "--relative", *cell, "--", "1").out.splitlines()[0]
    assert re.fullmatch(r"moved             from -1230.47 to -12\d\d\.\d{1,2} degrees", moved)


def test_a_move_in_a_unit_that_the_drive_does_not_tell(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    drives = prepare(monkeypatch, of_another_maker)
    outcome = run("drive", "3", "move", "10", "--in", "degree", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "does not tell how many counts a degree has" in outcome.err
    assert drives[-1].values[objects.POSITION_ACTUAL_VALUE] == -14000


@pytest.mark.parametrize("position", ["nan", "inf", "2000.5"])
def test_a_position_in_counts_is_a_whole_number(run: Run, position: str) -> None:
    outcome = run("drive", "3", "move", position, *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "CO120: a position in counts is a whole number" in outcome.err


@pytest.mark.parametrize("position", ["nan", "inf"])
def test_a_position_is_a_finite_number(run: Run, simulations: list[SimulatedDevices], position: str) -> None:
    outcome = run("drive", "3", "move", position, "--in", "degree", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert f"CO120: a position must be a finite number; it is {position}" in outcome.err
    assert simulations[-1].drives[3].drive.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("number", ["nan", "inf"])
@pytest.mark.parametrize("command", ["enable --seconds", "velocity 5 --acceleration", "torque 5 --any-speed --for"])
def test_an_option_that_is_no_finite_number_is_refused_before_a_drive_is_enabled(
    run: Run, simulations: list[SimulatedDevices], command: str, number: str
) -> None:
    outcome = run("drive", "3", *command.split(), number, *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert f"'{number}' is not a" in outcome.err  # finite number, or time
    assert not simulations


def test_a_unit_is_known_by_its_short_name_too(run: Run) -> None:
    degrees = run("drive", "move", "3", "2", "--in", "degree", "--dry-run", "--json", *DEMO)
    assert degrees.status == 0, degrees.err
    for name in ("deg", "degrees", "DEG", "°"):
        assert run("drive", "move", "3", "2", "--in", name, "--dry-run", "--json", *DEMO).json == degrees.json
    wrong = run("drive", "move", "3", "2", "--in", "nm", "--dry-run", *DEMO)
    assert (wrong.status, "'nm' is not one of 'counts', 'radian', 'degree'" in wrong.err) == (ExitCode.USAGE, True)


def test_a_mode_of_the_maker_needs_no_dashes_before_it(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("drive", "3", "mode", "-3", *DEMO)
    assert outcome.status == ExitCode.SDO_ABORT
    assert "refused writing 0x6060" in outcome.err


@pytest.mark.parametrize("at", [0.1, 0.5, 1.0])
def test_ctrl_c_halts_a_move(run: Run, simulations: list[SimulatedDevices], alarm: Alarm, at: float) -> None:
    alarm.set((at, signal.SIGINT))
    outcome = run("drive", "3", "move", "90000", *DEMO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "the drive was halted: it is not at its target" in outcome.err
    assert stands(simulations[-1].drives[3])
    has_power = simulations[-1].drives[3].drive.state in POWERED
    assert ("it still has power: canopen drive disable 3 -b demo" in outcome.err) == has_power


def test_ctrl_c_tells_that_a_drive_that_was_enabled_has_no_power(
    run: Run, simulations: list[SimulatedDevices], alarm: Alarm
) -> None:
    alarm.set((0.5, signal.SIGINT))
    outcome = run("drive", "3", "enable", *DEMO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert simulations[-1].drives[3].drive.state is State.SWITCH_ON_DISABLED
    assert "the drive has no power any more" in outcome.err


def test_a_move_that_takes_too_long(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("drive", "3", "move", "90000", "--limit", "200ms", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "did not reach its target position within 0.2 s" in outcome.err
    assert simulations[-1].drives[3].drive.state is State.OPERATION_ENABLED
    assert "it still has power: canopen drive disable 3 -b demo" in outcome.err
    assert stands(simulations[-1].drives[3])


def test_enable_holds_the_power_for_a_time(run: Run, simulations: list[SimulatedDevices], alarm: Alarm) -> None:
    seen = []

    async def look(simulation: SimulatedDevices) -> None:
        for _ in range(30):
            await trio.sleep(0.1)
            seen.append(simulation.drives[3].drive.state)

    alarm.task = look
    outcome = run("drive", "3", "enable", "--seconds", "2", *DEMO)
    assert outcome.status == 0
    assert "drive 3 is enabled, in interpolated position (ip); Ctrl-C disables it" in outcome.err
    assert "2 s are over: it gets no more power" in outcome.err
    assert State.OPERATION_ENABLED in seen
    assert simulations[-1].drives[3].drive.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("at", [0.02, 0.05, 0.1, 1.0])
def test_ctrl_c_disables(run: Run, simulations: list[SimulatedDevices], alarm: Alarm, at: float) -> None:
    alarm.set((at, signal.SIGINT))
    outcome = run("drive", "3", "enable", *DEMO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert simulations[-1].drives[3].drive.state is State.SWITCH_ON_DISABLED


def test_a_fault_ends_the_hold_and_is_told(run: Run, simulations: list[SimulatedDevices], alarm: Alarm) -> None:
    async def fault(simulation: SimulatedDevices) -> None:
        await trio.sleep(1)
        simulation.raise_fault(3, 0x2310)

    alarm.task = fault
    outcome = run("drive", "3", "enable", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "0x2310" in outcome.err


def test_stop(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("drive", "3", "stop", *DEMO)
    assert outcome.status == 0
    assert "controlword       0x0002" in outcome.out


def test_what_is_no_drive(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    device(monkeypatch, {})
    outcome = run("drive", "5", "state", *DEMO)
    assert outcome.status == ExitCode.SDO_ABORT
    assert "CO408" in outcome.err
    assert "canopen info 5" in outcome.err


@pytest.mark.parametrize("word", ["state", "units", "mode"])
def test_who_only_looks_changes_nothing(run: Run, monkeypatch: pytest.MonkeyPatch, word: str) -> None:
    """Neither the NMT state of a drive, nor one that another program moves."""
    drives = prepare(monkeypatch, powered)
    assert run("drive", "3", word, *DEMO).status == 0
    assert drives[-1].drive.state is State.OPERATION_ENABLED
    assert drives[-1].values[objects.CONTROLWORD] == 0x0F
    drives = prepare(monkeypatch, lambda drive: drive.execute(NmtCommand.STOP, 0))
    outcome = run("drive", "3", word, *DEMO)
    assert outcome.status == ExitCode.NO_ANSWER
    assert "canopen nmt preop 3" in outcome.err
    assert drives[-1].state is NmtState.STOPPED


def test_wrong_words(run: Run) -> None:
    outcome = run("drive", "3", "dance", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "there is no command 'dance'" in outcome.err
    assert run("drive", "200", "state", *DEMO).status == ExitCode.USAGE
    assert run("drive", "99", "state", *DEMO).status == ExitCode.NO_ANSWER


def test_a_plan_says_how_a_drive_would_follow_set_points_and_writes_nothing(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drives = prepare(monkeypatch, lambda drive: None)
    file = tmp_path / "drive.eds"
    file.write_text(write_eds(describe(drive_dictionary(Shape.SCHUNK_POWERBALL))), encoding="utf-8")
    outcome = run("drive", "3", "plan", "-e", str(file), *DEMO)
    assert outcome.status == 0, outcome.err
    assert "mode              interpolated position (ip): the first of csp, ip and pp that works" in outcome.out
    assert "not csp: 0x6502 of the drive lists pp, vl, ip" in outcome.out
    assert "RPDO 1            on 0x203, at each SYNC, as in the file" in outcome.out
    assert "Nothing would be written" in outcome.err
    before = dict(drives[-1].values.store)
    outcome = run("drive", "3", "plan", "--mode", "pp", "--json", "-e", str(file), *DEMO)
    assert outcome.json["mode"] == "pp"
    assert outcome.json["writes"][0] == {"object": "0x1401:01", "value": "0x80000303"}
    assert {key: drives[-1].values.store[key] for key in before if 0x140000 <= key < 0x1C0000} == {
        key: value for key, value in before.items() if 0x140000 <= key < 0x1C0000
    }
    refused = run("drive", "3", "plan", "--mode", "csp", "-e", str(file), *DEMO)
    assert refused.status == ExitCode.DRIVE_FAULT
    assert "0x6502 of the drive lists pp, vl, ip" in refused.err
    assert "try:   the file of this very drive" in refused.err


def test_a_plan_needs_the_drives_file(run: Run) -> None:
    outcome = run("drive", "3", "plan", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "CO134" in outcome.err
