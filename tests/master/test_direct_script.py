"""Scripts that end without closing their connection: a real process each, and its drive must be halted before it is gone."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

LIMIT = 100.0

SCRIPTS = """
import json, os, signal, sys, threading, time
import can
import canopen_master.simulation.host, canopen_proto.simulation.drive.node, canopen_transports.python_can
from canopen_master import direct as canopen

AT_ONCE = 4  # they wait most of the time, but a computer is small
children, ended = {}, {}

def wait_for_one():
    child, status = os.wait()
    ended[children[child]] = os.waitstatus_to_exitcode(status)

for name, end in json.loads(sys.argv[1]).items():
    if len(children) - len(ended) == AT_ONCE:
        wait_for_one()
    child = os.fork()
    if not child:
        for stream, number in (("out", 1), ("err", 2)):
            os.dup2(os.open(f"{name}.{stream}", os.O_CREAT | os.O_WRONLY, 0o600), number)
        break
    children[child] = name
else:  # the one that read in the modules, once for all
    while len(ended) < len(children):
        wait_for_one()
    print(json.dumps(ended))
    sys.exit()

BUS = "pythoncan:virtual:script"

homes = threading.Event()

def listen(bus=can.Bus("script", interface="virtual")):
    while True:
        message = bus.recv()
        sys.stdout.write(f"{message.arbitration_id:03X}#{message.data.hex().upper()}\\n")
        if message.arbitration_id == 0x60C and message.data[:6] == bytes.fromhex("2B4060001F00"):  # bit 4: homing starts
            homes.set()

def press(times, when):
    when()
    for _ in range(times):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)

def press_ctrl_c(times, when):
    threading.Thread(target=press, args=(times, when), daemon=True).start()

threading.Thread(target=listen, daemon=True).start()
drives = canopen.simulated([12], bus=BUS)
drives.__enter__()
assert canopen.open_connection(BUS, sdo_timeout=10), canopen.last_error()
canopen.init_nmt()
assert canopen.init_device(12)
assert canopen.set_sync_interval(12, 250)
assert canopen.enable_ip_mode(12)
for step in range(5):
    canopen.send_pos(12, 3000 + 100 * step)
    canopen.send_sync(10)
homes.clear()
sys.stdout.write("moving\\n")  # print() writes the line and its end apart: the other thread's lines would come between
"""


ENDS: dict[str, tuple[Any, ...]] = {
    "last line": ("", 0),
    "exception": ("raise RuntimeError('a mistake')", 1),
    "exit": ("sys.exit(7)", 7),
    "interrupt": ("os.kill(os.getpid(), signal.SIGINT); time.sleep(30)", -2),
    "interrupt of a call": ("press_ctrl_c(1, homes.wait); canopen.homing(12); time.sleep(30)", -2),
    "interrupts of a call, without end": ("press_ctrl_c(40, homes.wait); canopen.homing(12); time.sleep(30)", -2),
    "interrupts of the script's end": ("press_ctrl_c(40, lambda: time.sleep(0.03))", 0, -2),
    "terminated": (
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(143)); os.kill(os.getpid(), signal.SIGTERM); time.sleep(30)",
        143,
    ),
    "thread left": ("threading.Thread(target=canopen.homing, args=(12,)).start(); homes.wait()", 0),
}

HALTS = ("60C#2B4060000F01", "60C#2B4060001F01")
"""SDO writes of the controlword with bit 8."""


def environment() -> dict[str, str]:
    root = Path(__file__).parents[2]
    paths = [str(root / each) for each in (".", "transports", "master", "data")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join([*paths, os.environ.get("PYTHONPATH", "")]), "PYTHONUNBUFFERED": "1"}


@pytest.fixture(scope="module")
def endings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str, str]]:
    """Exit status, output and errors of each script."""
    folder = tmp_path_factory.mktemp("scripts")
    ends = json.dumps({name: end for name, (end, *_) in ENDS.items()})
    command = [sys.executable, "-c", f"{SCRIPTS}exec(end)\n", ends]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, env=environment(), cwd=folder, timeout=LIMIT, check=True)
    texts = {name: [(folder / f"{name}.{stream}").read_text(encoding="utf-8") for stream in ("out", "err")] for name in ENDS}
    return {name: (status, *texts[name]) for name, status in json.loads(done.stdout).items()}


@pytest.mark.parametrize("name", ENDS)
def test_a_script_that_ends_anyhow_leaves_its_drive_halted(endings: dict[str, tuple[int, str, str]], name: str) -> None:
    status, output, errors = endings[name]
    assert status in ENDS[name][1:], errors
    _, moving, after = output.partition("moving\n")
    assert moving, errors
    commands = [line for line in after.splitlines() if line.startswith("60C#2B406000")]
    assert commands[-1].startswith(HALTS), output
    assert "a mistake" in errors if name == "exception" else True
