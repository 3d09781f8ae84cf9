"""Scripts that end without closing their master: each in a process of its own, on a bus of which all frames are kept.

The processes are forked from one that has read in the modules, once for all.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

LIMIT = 800.0
"""Seconds for all ends of a script."""
LIMIT_OF_ONE = 400
"""Seconds for one end, which then says where each of its threads waits; 60 s for the start of its homing."""

_HEAD = f"""
import faulthandler, json, os, signal, sys, threading, time
from can.interfaces.virtual import VirtualBus
import canopen_master.simulation.host, canopen_proto.simulation.drive.node, canopen_transports.python_can
from canopen_master import blocking, direct as canopen
from canopen_master.blocking import classes
from canopen_master.simulation import powerballs

AT_ONCE = 4  # they wait most of the time, but a computer is small
children, ended = {{}}, {{}}

def wait_for_one():
    child, status = os.wait()
    ended[children[child]] = os.waitstatus_to_exitcode(status)

for name, end in json.loads(sys.argv[1]).items():
    if len(children) - len(ended) == AT_ONCE:
        wait_for_one()
    child = os.fork()
    if not child:
        for stream, number in (("out", 1), ("err", 2)):
            os.dup2(os.open(f"{{name}}.{{stream}}", os.O_CREAT | os.O_WRONLY, 0o600), number)
        faulthandler.dump_traceback_later({LIMIT_OF_ONE}, exit=True)
        break
    children[child] = name
else:  # the one that read in the modules, once for all
    while len(ended) < len(children):
        wait_for_one()
    print(json.dumps(ended))
    sys.exit()

BUS = "pythoncan:virtual:script"

class Homing(threading.Event):
    def wait(self):
        if not super().wait(60):
            os.write(2, b"not within 60 s: the frame that starts the homing")
            os._exit(99)

homes = Homing()

send = VirtualBus.send

def send_and_tell(bus, message, timeout=None):  # a thread that listened would be gone at the end before it has told all
    send(bus, message, timeout)
    sys.stdout.write(f"{{message.arbitration_id:03X}}#{{message.data.hex().upper()}}\\n")
    if message.arbitration_id == 0x60C and message.data[:6] == bytes.fromhex("2B4060001F00"):  # bit 4: homing starts
        homes.set()

VirtualBus.send = send_and_tell

def press(times, when):
    when()
    for _ in range(times):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)

def press_ctrl_c(times, when):
    threading.Thread(target=press, args=(times, when), daemon=True).start()
"""

HALT = 0x100
"""Bit 8 of the controlword."""


def environment() -> dict[str, str]:
    root = Path(__file__).parents[2]
    paths = [str(root / each) for each in (".", "transports", "master", "data")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join([*paths, os.environ.get("PYTHONPATH", "")]), "PYTHONUNBUFFERED": "1"}


def endings(folder: Path, script: str, ends: Mapping[str, str]) -> dict[str, tuple[int, str, str]]:
    """Run a script with each of some ends. Return exit status, output (with the frames) and errors, by the name of the end."""
    command = [sys.executable, "-c", f"{_HEAD}{script}exec(end)\n", json.dumps(dict(ends))]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, env=environment(), cwd=folder, timeout=LIMIT, check=True)
    texts = {name: [(folder / f"{name}.{stream}").read_text(encoding="utf-8") for stream in ("out", "err")] for name in ends}
    return {name: (status, *texts[name]) for name, status in json.loads(done.stdout).items()}


def last_controlword(output: str) -> int:
    """Return the last controlword that was sent to node 12, by SDO or by RPDO 1, once it moved."""
    _, moving, after = output.partition("moving\n")
    assert moving, output
    words = re.findall(r"^(?:60C#2B406000|20C#)(....)", after, re.MULTILINE)
    return int.from_bytes(bytes.fromhex(words[-1]), "little")
