"""`canopen jog`: hold to run. Keys come in virtual time, as a terminal repeats them."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import trio
from trio.testing import MockClock

from canopen_cli.motion import jog
from canopen_cli.shared import terminal_keys
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.terminal_keys import END, LEFT, RIGHT, TerminalKeys
from canopen_master import read_record
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE
from canopen_proto.drives.cia402.states import State
from tests.cli.cli_support import Outcome, Run, stands
from tests.master.test_recording import wait_for_file

pytest.importorskip("ruckig", reason="a jog needs the extra `motion`")

Jog = Callable[..., Outcome]
REPEAT = 0.04
CTRL_C, HANG_UP = "Ctrl-C", "hang up"


def held(key: str, seconds: float) -> list[tuple[float, str]]:
    """A key that is held: after half a second it comes again, and then with each REPEAT."""
    return [(0.1, key), (0.5, key), *[(REPEAT, key)] * round((seconds - 0.5) / REPEAT)]


@pytest.fixture
def jogged(run: Run, monkeypatch: pytest.MonkeyPatch) -> Jog:
    @contextmanager
    def nothing() -> Iterator[None]:
        yield

    monkeypatch.setattr(jog, "is_terminal", lambda: True)
    monkeypatch.setattr(jog, "key_by_key", nothing)

    def command(*keys: tuple[float, str], options: tuple[str, ...] = ()) -> Outcome:
        """keys: seconds after the one before."""
        left = list(keys)

        async def read() -> bytes:
            if not left:
                await trio.sleep_forever()
            seconds, key = left[0]
            await trio.sleep(seconds)
            left.pop(0)
            if key in (CTRL_C, HANG_UP):
                signal.raise_signal(signal.SIGINT if key == CTRL_C else signal.SIGHUP)
                await trio.sleep_forever()
            return b"" if key == END else key.encode()

        monkeypatch.setattr(jog, "read_terminal", read)
        return run("jog", "-b", "demo", *options)

    return command


def degrees(simulations: list[SimulatedDevices]) -> list[float]:
    return [float(drive.values[POSITION_ACTUAL_VALUE]) / 1000 for drive in simulations[0].drives.values()]  # type: ignore[arg-type]


def test_a_joint_moves_while_its_key_is_held(jogged: Jog, simulations: list[SimulatedDevices], tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    keys = [*held(RIGHT, 2.5), (1.0, "3"), *held(LEFT, 1.5), (1.0, "q")]
    outcome = jogged(*keys, options=("--record", str(file)))
    assert outcome.status == 0, outcome.err
    positions = degrees(simulations)
    assert positions[0] == pytest.approx(-14 + 2 * 3, abs=1)  # a tenth of 30 degrees per second, for 2 s
    assert positions[2] == pytest.approx(21 - 1 * 3, abs=1)
    assert [positions[number] for number in (1, 3, 4, 5)] == [9, -7, 16, -22]
    assert all(drive.drive.state is State.SWITCH_ON_DISABLED for drive in simulations[0].drives.values())
    velocities = [abs(value) for value in read_record(file)["joint1.velocity"] if value == value]
    assert max(velocities) < 3.5


@pytest.mark.thorough(2)
@pytest.mark.parametrize("keys", [(RIGHT, "+", "x"), (LEFT, "-", "\x1bOA")])  # not both ways in one run: it might come back
def test_a_tap_moves_nothing(jogged: Jog, simulations: list[SimulatedDevices], keys: tuple[str, ...]) -> None:
    taps = [(1.5, key) for key in keys for _ in range(2)]
    assert jogged(*taps, (1.5, "q")).status == 0
    assert degrees(simulations) == [-14, 9, 21, -7, 16, -22]


@pytest.mark.thorough(2)
@pytest.mark.parametrize("end", [[(0.04, END)], [(0.04, "q")], [(0.04, "2"), (0.5, "q")], [(5.0, "q")]])
def test_whatever_comes_in_place_of_the_key_ends_the_motion(
    jogged: Jog, simulations: list[SimulatedDevices], end: list[tuple[float, str]]
) -> None:
    assert jogged(*held(RIGHT, 1.0), *end).status == 0
    assert degrees(simulations)[0] == pytest.approx(-14 + 3 * 0.55, abs=0.6)
    assert all(stands(drive) for drive in simulations[0].drives.values())


def test_ctrl_c(jogged: Jog, simulations: list[SimulatedDevices]) -> None:
    outcome = jogged(*held(RIGHT, 1.5), (0.01, CTRL_C))
    assert outcome.status == ExitCode.INTERRUPTED
    assert "the joints braked and were halted" in outcome.err
    assert all(stands(drive) for drive in simulations[0].drives.values())
    assert -13 < degrees(simulations)[0] < -9


def test_a_terminal_that_goes_away(jogged: Jog, simulations: list[SimulatedDevices]) -> None:
    outcome = jogged(*held(RIGHT, 1.5), (0.01, HANG_UP))
    assert outcome.status == ExitCode.INTERRUPTED
    assert "by the end of its terminal" in outcome.err
    assert all(stands(drive) for drive in simulations[0].drives.values())
    assert -13 < degrees(simulations)[0] < -9


def test_a_position_limit_ends_it(jogged: Jog, simulations: list[SimulatedDevices], tmp_path: Path) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text(
        '[buses.left]\nlocator = "virtual:x"\n[nodes]\na = { id = 3 }\n'
        '[joints]\na = { unit = "degree", max_position = -12, max_speed = 30 }\n[chains.arm]\njoints = ["a"]\n'
    )
    outcome = jogged(*held(RIGHT, 4), (1.0, "q"), options=("-m", str(cell), "--speed", "0.5"))
    assert outcome.status == 0, outcome.err
    assert degrees(simulations)[0] == pytest.approx(-12, abs=0.02)


def test_a_pipe_holds_no_keys(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run("jog", "-b", "demo")
    assert outcome.status == ExitCode.USAGE
    assert "CO122" in outcome.err
    assert not simulations


def test_keys_that_waited_count_once() -> None:
    left = [b"\x1b[C\x1b[C\x1b[C", b"a\x1bOD", b"12\x04", b""]

    async def read() -> bytes:
        await trio.lowlevel.checkpoint()
        return left.pop(0)

    async def test() -> None:
        keys = TerminalKeys(read)
        assert [await keys.next() for _ in range(4)] == [RIGHT, LEFT, END, END]

    trio.run(test, clock=MockClock(autojump_threshold=0))


def test_the_terminal_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = os.openpty()
    with os.fdopen(theirs) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)

        async def test() -> None:
            with terminal_keys.key_by_key():
                os.write(ours, b"x")  # without Enter
                assert await terminal_keys.read_terminal() == b"x"
                os.close(ours)
                assert await terminal_keys.read_terminal() == b""

        trio.run(test)
    wait_for_file()
