"""The packages on Windows and macOS, as far as Linux can show it: without what only Unix, or only Linux, has."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import pytest

PROGRAM = """
import asyncio, ctypes, functools, importlib, json, os, pkgutil, selectors, signal, socket, subprocess, sys
import hypothesis, hypothesis.stateful, hypothesis.strategies
import can, click, matplotlib, msgpack, rich, trio, trio.testing  # as these are on each system: they look after themselves
import can.interfaces.udp_multicast, rich.prompt
import duckdb, hypercorn.trio, mcp.server, paho.mqtt.client, prometheus_client, prompt_toolkit, starlette.applications, zenoh
import textual.app, textual.pilot, textual.widgets

pair = functools.partial(socket.socketpair, socket.AF_UNIX)  # Windows has this function, made otherwise
socket.socketpair = lambda: pair()

GONE = ("fcntl", "termios", "tty", "pty", "resource", "grp", "pwd", "curses", "syslog", "crypt", "nis")

class Without:
    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        return None if name in GONE else self.finder.find_spec(name, path, target)

for name in GONE:
    sys.modules.pop(name, None)
sys.meta_path[:] = map(Without, sys.meta_path)
for module, starts in (
    (socket, ("AF_CAN", "PF_CAN", "CAN_", "SOL_CAN", "AF_UNIX", "AF_NETLINK", "AF_PACKET", "MSG_DONTWAIT", "SCM_", "CMSG_",
              "SO_PEERCRED", "SO_MARK", "SO_BINDTODEVICE")),
    (signal, ("SIGHUP", "SIGQUIT", "SIGUSR", "SIGALRM", "SIGKILL", "SIGTSTP", "SIGCONT", "SIGWINCH", "SIGPIPE", "SIGCHLD",
              "pthread_", "alarm", "setitimer", "getitimer", "siginterrupt", "sigwait")),
    (os, ("sched_", "SCHED_", "fork", "getuid", "geteuid", "getgid", "getegid", "getgroups", "uname", "getpgid", "killpg",
          "setsid", "O_NOCTTY", "O_NONBLOCK", "O_CLOEXEC", "O_DIRECTORY", "openpty", "pipe2", "mkfifo", "fchmod",
          "fpathconf", "sysconf", "statvfs", "wait3", "wait4", "nice", "getpriority", "setpriority", "ctermid", "ttyname",
          "tcgetpgrp")),
):
    for name in [name for name in vars(module) if name.startswith(starts)]:
        delattr(module, name)
sys.platform = "win32"
failed, count = {}, 0
for package in "proto", "data", "transports", "master", "check", "testing", "ros", "gateway", "cli":
    package = "canopen_" + package
    path = importlib.import_module(package).__path__
    for each in pkgutil.walk_packages(path, package + ".", onerror=lambda name: failed.update({name: repr(sys.exception())})):
        if not each.name.endswith("__main__") and not each.name.startswith(("canopen_ros.ros1.", "canopen_ros.ros2.")):
            try:
                importlib.import_module(each.name)
                count += 1
            except Exception as error:
                failed[each.name] = repr(error)

from canopen_master import Realtime, RealtimeRefusedError, open_master, powerballs, simulate
from canopen_master.claims.channel_claim import channel_claim
from canopen_cli.live.screen import _terminal
from canopen_cli.motion.jog import is_terminal
from canopen_transports import TransportError, open_transport

async def work():
    told = {}
    try:
        await open_transport("socketcan:can0")
    except TransportError as error:
        told["socketcan"] = str(error)
    try:
        async with open_master("virtual:other", realtime=Realtime(required=True)):
            pass
    except RealtimeRefusedError as error:
        told["realtime"] = str(error)
    async with channel_claim("socketcan:can0", 12):
        told["claim"] = "none"
    with _terminal() as terminal:
        told["keys"] = f"{terminal} {is_terminal()}"
    async with trio.open_nursery() as nursery:
        await nursery.start(simulate, await open_transport("virtual:platform"), powerballs(12))
        async with open_master("virtual:platform", realtime=Realtime()) as master:
            told["statusword"] = await master.node(12).read_int("statusword")
        nursery.cancel_scope.cancel()
    return told

print(json.dumps({"count": count, "failed": failed, "told": trio.run(work)}))
"""


@pytest.fixture(scope="module")
def seen() -> dict[str, Any]:
    """What a process without all of that has to say."""
    path = os.pathsep.join(sys.path)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_each_module_is_imported(seen: dict[str, Any]) -> None:
    assert seen["failed"] == {}
    assert seen["count"] > 550


def test_what_a_system_lacks_is_told_where_it_is_asked_for(seen: dict[str, Any]) -> None:
    told = seen["told"]
    assert "cannot open socketcan:can0" in told["socketcan"]
    assert "SocketCAN" in told["socketcan"]
    assert "win32" in told["socketcan"]
    assert "this is not Linux" in told["realtime"]
    assert told["keys"] == "None False"


def test_what_needs_none_of_it_works(seen: dict[str, Any]) -> None:
    assert seen["told"]["statusword"] >= 0
    assert seen["told"]["claim"] == "none"
