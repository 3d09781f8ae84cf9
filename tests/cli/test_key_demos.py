"""The demos that move a device by keys: the keys come from a test, or from a terminal of a program of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import trio

from canopen_cli.demos import interactive_homing, keys, move_single_device, move_until_user_interrupt
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.terminal_keys import END
from canopen_master.direct import hold_to_run
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE
from canopen_proto.drives.cia402.states import State
from tests.cli.test_demos import _own_signals  # noqa: F401 - a fixture
from tests.master.direct_world import LIMIT, Devices, devices
from tests.master.script_ends import environment

pytest.importorskip("ruckig", reason="hold to run needs the extra `motion`")

Hold = Callable[..., None]


@pytest.fixture
def arm() -> Iterator[Devices]:
    with devices(12) as arm:
        yield arm


def place(arm: Devices) -> int:
    position = arm.node(12).values[POSITION_ACTUAL_VALUE]
    assert isinstance(position, int)
    return position


@pytest.fixture
def hold(monkeypatch: pytest.MonkeyPatch, arm: Devices) -> Hold:
    """Hold one key after the other, each until the device has moved by 300 millidegrees; then the others, once each."""

    @contextmanager
    def nothing() -> Iterator[None]:
        yield

    monkeypatch.setattr(keys, "is_terminal", lambda: True)
    monkeypatch.setattr(keys, "key_by_key", nothing)
    monkeypatch.setattr(hold_to_run, "DEAD_MAN", LIMIT)  # a busy computer is late

    def prepare(held: str, once: str) -> None:
        left, taps, begun = list(held), list(once), list[int]()

        async def read() -> bytes:
            await trio.sleep(0.02)
            if left:
                begun[:] = begun or [place(arm)]
                if abs(place(arm) - begun[0]) < 300:
                    return left[0].encode()
                left.pop(0)
                begun.clear()
            else:
                await trio.sleep(0.3)  # longer than a key that is held leaves between its repetitions
            return b"" if left or not taps else taps.pop(0).encode()

        monkeypatch.setattr(keys, "read_terminal", read)

    return prepare


def test_plus_and_minus_move_it_to_and_fro(hold: Hold, arm: Devices, capsys: pytest.CaptureFixture[str]) -> None:
    start = place(arm)
    hold("+", "xq")
    assert move_single_device.main(["12", "--bus", arm.bus]) == ExitCode.OK, capsys.readouterr().err
    there = place(arm)
    assert there >= start + 300
    assert arm.node(12).drive.state is State.SWITCH_ON_DISABLED
    arm.power_cycle()
    start = place(arm)
    hold("-", "q")
    assert move_single_device.main(["12", "--bus", arm.bus]) == ExitCode.OK
    assert place(arm) <= start - 300
    assert "hold + or -: it moves; q: end" in capsys.readouterr().out


@pytest.mark.thorough(4)
@pytest.mark.parametrize("tap", ["+", "x", "+q", END])
def test_a_tap_moves_nothing(hold: Hold, arm: Devices, tap: str) -> None:
    start = place(arm)
    hold("", tap + "q")
    assert move_single_device.main(["12", "--bus", arm.bus]) == ExitCode.OK
    assert place(arm) == start


def test_any_key_moves_it_until_it_is_released(hold: Hold, arm: Devices, capsys: pytest.CaptureFixture[str]) -> None:
    start = place(arm)
    hold(" ", "q")
    assert move_until_user_interrupt.main(["12", "--bus", arm.bus, "--speed", "-4000"]) == ExitCode.OK, capsys.readouterr().err
    assert place(arm) <= start - 300
    assert f"device 12 ends at {place(arm)} mdeg" in capsys.readouterr().out


def test_a_device_is_led_to_its_home_position(hold: Hold, arm: Devices, capsys: pytest.CaptureFixture[str]) -> None:
    hold(" ", "q")
    assert interactive_homing.main(["12", "--bus", arm.bus, "--speed", "1000"]) == ExitCode.OK, capsys.readouterr().err
    assert abs(place(arm)) <= 5


@pytest.mark.parametrize("demo", [move_single_device, move_until_user_interrupt, interactive_homing])
def test_without_a_terminal_nothing_is_sent(
    demo: object, arm: Devices, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keys, "is_terminal", lambda: False)
    arm.frames()
    assert demo.main(["12", "--bus", arm.bus]) == ExitCode.USAGE  # type: ignore[attr-defined]
    assert "CO122: this demo needs a terminal" in capsys.readouterr().err
    assert arm.frames() == []


@pytest.mark.thorough(5)
@pytest.mark.parametrize(("key", "status"), [(b"q", 0), (b"\x04", 0), (b"\x03", 130)])
def test_in_a_terminal_of_its_own(key: bytes, status: int) -> None:
    ours, theirs = os.openpty()
    command = [sys.executable, "-m", "canopen_cli.demos.move_single_device", "12", "--bus", "virtual"]

    def begin() -> None:  # the terminal becomes the program's own, so that Ctrl-C is its signal
        os.setsid()
        import fcntl
        import termios

        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        signal.signal(signal.SIGINT, signal.default_int_handler)

    with subprocess.Popen(
        command,
        stdin=theirs,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
        preexec_fn=begin,
    ) as process:
        os.close(theirs)
        assert process.stdout is not None
        assert "hold + or -" in process.stdout.readline()
        os.write(ours, key)
        assert process.wait(LIMIT) == status, process.stderr.read() if process.stderr else ""
    os.close(ours)
