"""The command line and the manual's demos on vcan0, each a process, against `canopen sim` in another."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from canopen_cli.shared.problem import ExitCode
from tests.cli.test_demos import NEAR, numbers, without_numbers
from tests.master.script_ends import environment
from tests.vcan.support import needs_vcan, raw_socket

pytestmark = needs_vcan

CANOPEN = [sys.executable, "-c", "import sys; from canopen_cli.entry import main; sys.exit(main())"]
LIMIT = 90.0
PATIENT = ["--timeout", "10s"]
LATE = re.compile("no longer follows its set-points|is silent: no PDO")
"""The message of a demo that halts because this computer was too busy for SYNC or an answer in time: the drives, in another
process, do not wait for it. It is then tried again."""
TRIES = 5


@contextmanager
def simulated(*node_ids: int) -> Iterator[None]:
    """Drives in a process of their own."""
    with raw_socket("vcan0") as listener:
        listener.settimeout(LIMIT)
        ids = ",".join(map(str, node_ids))
        command = [*CANOPEN, "sim", "-b", "socketcan:vcan0", "--ids", ids]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=environment()) as process:
            try:
                missing = {0x700 + node_id for node_id in node_ids}
                while missing:  # until all have booted
                    missing.discard(int.from_bytes(listener.recv(16)[:4], "little"))
                yield
            finally:
                process.terminate()
                process.communicate(timeout=LIMIT)


def run(*command: str, statuses: tuple[int, ...] = (ExitCode.OK,)) -> str:
    for _ in range(TRIES):
        done = subprocess.run(command, capture_output=True, text=True, env=environment(), timeout=LIMIT, check=False)
        if LATE.search(done.stderr) is None:
            break
    assert done.returncode in statuses, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def drives() -> Iterator[None]:
    with simulated(3, 4, 5, 6, 7, 8, 12):
        yield


def test_scan_and_read(drives: None) -> None:
    found = run(*CANOPEN, "scan", "-b", "socketcan:vcan0", "--ids", "3-8,12", *PATIENT)
    for node_id in (3, 4, 5, 6, 7, 8, 12):
        assert re.search(rf"^ *{node_id} \(0x{node_id:02X}\) +pre-operational +servo drive", found, re.MULTILINE), found
    assert "0x00020192" in run(*CANOPEN, "read", "12", "0x1000", "-b", "vcan0", *PATIENT)


@pytest.mark.parametrize("options", ["", "?sync=bcm&filter=ids"])
def test_the_demonstration(drives: None, options: str) -> None:
    command = [*CANOPEN, "demo", "--bus", f"socketcan:vcan0{options}", "--seconds", "1", "--cycle", "200ms", *PATIENT]
    said = run(*command)
    for joint, node_id in enumerate((3, 4, 5, 6, 7, 8), 1):
        assert re.search(rf"^joint{joint} +{node_id} .* switch on disabled +yes ", said, re.MULTILINE), said


def test_a_command_that_finds_nobody_says_so_and_fails(drives: None) -> None:
    command = [*CANOPEN, "read", "99", "0x1000", "-b", "socketcan:vcan0"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(), timeout=LIMIT, check=False)
    assert done.returncode != 0
    assert "node 99 did not answer reading 1000:00" in done.stderr


@pytest.mark.parametrize(
    ("demo", "line"),
    [
        ("homing 12", "device 12 is referenced, at 0 mdeg"),
        ("single_device 12 --cycles 1 --steps 10", "device 12 ends at 0 mdeg"),
        ("multiple_devices 3 4 --cycles 1 --steps 10", "cycle 1: sent to 35, 35 mdeg"),
        ("canopenmaster_single_device --pause 0 --steps 10", "sent to [1000] mdeg, ends at [1000] mdeg"),
    ],
)
def test_the_manuals_demos(drives: None, demo: str, line: str) -> None:
    name, *arguments = demo.split()
    said = run(sys.executable, "-m", f"canopen_cli.demos.{name}", *arguments, "--bus", "socketcan:vcan0")
    (shown,) = [shown for shown in said.splitlines() if without_numbers(shown) == without_numbers(line)]
    assert numbers(shown) == pytest.approx(numbers(line), abs=NEAR)
