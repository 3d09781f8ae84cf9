"""The manual's demos on a virtual bus with simulated drives: in this process, and as a user runs them, as programs."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from canopen_cli.demos import (
    canopenmaster_multiple_devices,
    canopenmaster_single_device,
    getpos,
    homing,
    memtest,
    move_device,
    multiple_devices,
    single_device,
)
from canopen_cli.shared.problem import ExitCode
from canopen_master import direct
from canopen_master.direct import connection
from tests.master.direct_world import devices, near_home
from tests.master.script_ends import environment

LIMIT = 100.0
NEAR = 300
"""Millidegrees that an axis may still have to go at the end: three steps of the fastest demo. In real time, SYNC may be late."""

RUNS = {
    "homing 12 --bus virtual": ["homing device 12", "device 12 is referenced, at 0 mdeg"],
    "single_device 12 --bus virtual --cycles 1 --steps 10": [
        "homing device 12",
        "device 12 is referenced, at 0 mdeg",
        "cycle 1: sent to 1000 mdeg",
        "cycle 1: sent to 0 mdeg",
        "device 12 ends at 0 mdeg",
    ],
    "multiple_devices 3 4 --bus virtual:arm --cycles 1 --steps 10": [
        "homing device 3",
        "homing device 4",
        "moving to and fro for 0.2 s; Ctrl-C ends it and halts all devices",
        "cycle 1: sent to 35, 35 mdeg",
        "device 3 ends at 35 mdeg",
        "device 4 ends at 35 mdeg",
    ],
    "canopenmaster_single_device --bus virtual --pause 0 --steps 10": [
        "homing joint1",
        "referenced, at [0] mdeg",
        "sent to [1000] mdeg, ends at [1000] mdeg",
    ],
    "canopenmaster_multiple_devices 3 4 --bus virtual --pause 0 --steps 10": [
        "homing joint1, joint2",
        "referenced, at [0, 0] mdeg",
        "sent to [1000, 1000] mdeg, ends at [1000, 1000] mdeg",
    ],
    "getpos 3 12 --bus virtual": ["device 3 is at 3000 mdeg", "device 12 is at 3000 mdeg"],
    "move_device 12 --bus virtual --steps 10 --speed -10000": [
        "device 12 is at 3000 mdeg",
        "faster: sent to 2450 mdeg, at -10000 mdeg/s",
        "on: sent to 1450 mdeg, at -10000 mdeg/s",
        "slower: sent to 900 mdeg, at -1000 mdeg/s",
        "rest: sent to 900 mdeg, at 0 mdeg/s",
        "device 12 ends at 900 mdeg",
    ],
}

DEMOS = {
    "homing": homing,
    "single_device": single_device,
    "multiple_devices": multiple_devices,
    "canopenmaster_single_device": canopenmaster_single_device,
    "canopenmaster_multiple_devices": canopenmaster_multiple_devices,
    "getpos": getpos,
    "move_device": move_device,
}

WARNING = "will not stop by itself if this program dies: no 0x6007"
"""Of the simulated Powerball, as of the real one."""


def numbers(text: str) -> list[int]:
    return [int(number) for number in re.findall(r"-?\d+", text)]


def without_numbers(text: str) -> str:
    return re.sub(r"-?\d+", "#", text)


def start(command: str) -> subprocess.Popen[str]:
    demo, *arguments = command.split()
    return subprocess.Popen(
        [sys.executable, "-m", f"canopen_cli.demos.{demo}", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )


def assert_as_in_the_manual(command: str, output: str) -> None:
    assert without_numbers(output) == without_numbers("\n".join([*RUNS[command], ""]))
    for line, expected in zip(output.splitlines(), RUNS[command], strict=True):
        assert numbers(line) == pytest.approx(numbers(expected), abs=NEAR if "ends at" in line else 5)  # it follows with a lag


PROGRAM = "multiple_devices 3 4 --bus virtual:arm --cycles 1 --steps 10"


@pytest.fixture(scope="module", autouse=True)
def program() -> Iterator[subprocess.Popen[str]]:
    """A demo that takes its time while the other tests run; the last test waits for it."""
    with start(PROGRAM) as process:
        yield process
        process.kill()


def test_ctrl_c_halts_and_says_so() -> None:
    with start("single_device 12 --bus virtual --cycles 1000") as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "homing device 12\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(LIMIT) == 130
        assert "ends at" not in process.stdout.read()
        assert [line for line in process.stderr if WARNING not in line] == ["interrupted; the drives are halted\n"]


def test_sigterm_ends_a_demo_in_order() -> None:
    with start("canopenmaster_single_device --bus virtual") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "homing joint1\n"
        process.terminate()
        assert process.wait(LIMIT) == 128 + signal.SIGTERM


# ---- in this process ----


@pytest.fixture(autouse=True)
def _own_signals() -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)
    direct.using_master_thread = False


def test_without_arguments_the_manuals_line_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert homing.main([]) == ExitCode.USAGE
    assert capsys.readouterr().out == "Please call the program with the CAN deviceID, e.g. './homing 12'\n"
    assert single_device.main([]) == ExitCode.USAGE
    assert capsys.readouterr().out == "Please call the program with the CAN deviceID, e.g. './single_device 12'\n"
    assert multiple_devices.main([]) == ExitCode.USAGE
    assert capsys.readouterr().out == "Please call the program with the CAN deviceIDs, e.g. './multiple_devices 3 4 5 6 7 8'\n"
    assert single_device.main(["3", "4"]) == ExitCode.USAGE
    assert canopenmaster_single_device.main(["3", "4"]) == ExitCode.USAGE
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("given", "said"), [("200", "outside 1..127"), ("0", "outside 1..127"), ("abc", "'abc' is not a node-ID")]
)
def test_a_wrong_id_is_told(capsys: pytest.CaptureFixture[str], given: str, said: str) -> None:
    assert single_device.main([given, "--bus", "virtual"]) == ExitCode.USAGE
    assert said in capsys.readouterr().err


def test_an_unknown_option_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        homing.main(["12", "--steps", "3"])
    assert "--steps" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        single_device.main(["12", "--cycles", "-5"])
    assert "-5 is less than 1" in capsys.readouterr().err


def test_a_bus_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert single_device.main(["12", "--bus", "socketcan:none0"]) == ExitCode.CANNOT_OPEN
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "Cannot open CAN device; aborting."
    assert lines[1].startswith("CO101: cannot open socketcan:none0")


def test_a_device_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert homing.main(["12", "--bus", "pythoncan:virtual:empty"]) == ExitCode.NO_ANSWER
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "The fault of device 12 could not be reset; aborting."
    assert "node 12 did not answer" in lines[1]


def test_another_device_of_the_masters_demo(capsys: pytest.CaptureFixture[str]) -> None:
    assert canopenmaster_single_device.main(["7", "--bus", "pythoncan:virtual:empty"]) == ExitCode.NO_ANSWER
    assert "node 7" in capsys.readouterr().err


@pytest.mark.thorough(4)
@pytest.mark.parametrize("command", RUNS)
def test_a_demo_does_what_the_manual_says(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setattr(connection, "powerballs", near_home)
    name, *arguments = command.split()
    status, said = DEMOS[name].main(arguments), capsys.readouterr()
    assert status == ExitCode.OK, said.err
    assert_as_in_the_manual(command, said.out)


def test_memory_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert memtest.main(["12", "--bus", "virtual", "--steps", "5"]) == ExitCode.OK
    said = capsys.readouterr().out
    assert re.fullmatch(r"5 answers of device 12: \d+ KiB are left behind, \d+ KiB at most\n", said)
    assert int(numbers(said)[2]) < 1024


def test_an_interrupt_is_told(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(node: int) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr(direct, "homing", interrupted)
    assert homing.main(["12", "--bus", "virtual"]) == ExitCode.INTERRUPTED
    assert capsys.readouterr().err == "interrupted; the drives are halted\n"


def test_a_fault_in_the_middle_of_a_move(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(direct, "homing", lambda node: True)
    with devices(12) as arm:
        steps = iter(range(1000))

        def send_sync(milliseconds: float) -> None:
            if next(steps) == 5:
                arm.break_down(12, 0x8611)
            sync(milliseconds)

        sync = direct.send_sync
        monkeypatch.setattr(direct, "send_sync", send_sync)
        assert single_device.main(["12", "--bus", arm.bus]) == ExitCode.DRIVE_FAULT
        assert "0x8611" in capsys.readouterr().err


def test_a_demo_is_a_program(program: subprocess.Popen[str]) -> None:
    output, errors = program.communicate(timeout=LIMIT)
    assert program.returncode == 0, errors
    assert all(WARNING in line for line in errors.splitlines()), errors
    assert_as_in_the_manual(PROGRAM, output)
