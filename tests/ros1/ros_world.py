"""A ROS master of its own, nodes as processes, and simulated drives that the test itself serves, for the tests of the ROS 1 node.

All in real time: the tests wait for conditions, with a generous limit, and every process is ended.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import xmlrpc.client
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, TypeVar

import pytest
import trio

import canopen_data
import canopen_master
import canopen_proto
import canopen_ros
import canopen_transports
from canopen_master.simulation.serving import DEMO_NODES, SimulatedDevices, drive_maker, simulated_devices
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE
from canopen_proto.drives.cia402.states import State
from canopen_proto.simulation.drive.settings import Shape
from canopen_transports.tcp import BusServer, serve_bus

T = TypeVar("T")

PATIENCE: Final = 60.0
"""Seconds, for a machine that is busy with other things."""
TOOLS: Final = ("roslaunch", "rosrun", "rosservice", "rostopic")

missing: Final = [module for module in ("rospy", "actionlib", "genpy") if importlib.util.find_spec(module) is None]
missing_tools: Final = [tool for tool in TOOLS if shutil.which(tool) is None]
needs_ros = pytest.mark.skipif(
    bool(missing or missing_tools),
    reason=f"NOT RUN: no ROS 1 for this Python ({', '.join(missing + missing_tools)}): see docs/ros.md for what to install",
)


def until(condition: Callable[[], T | None], what: str, check: Callable[[], object] = lambda: None) -> T:
    """Wait until a condition gives something true, and return that. check: raises if it can no longer come."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        check()
        time.sleep(0.02)
    raise AssertionError(f"not within {PATIENCE:g} s: {what}")


class Drives:
    """Six simulated joints of an arm on a bus that other processes can join (`locator`), served by a thread of the test."""

    def __init__(self) -> None:
        self.locator = ""
        self._thread = threading.Thread(target=trio.run, args=(self._serve,), name="drives")
        self._ready = threading.Event()
        self._simulation: SimulatedDevices
        self._token: trio.lowlevel.TrioToken
        self._end: trio.Event

    async def _serve(self) -> None:
        self._token, self._end = trio.lowlevel.current_trio_token(), trio.Event()
        async with trio.open_nursery() as nursery:
            (self.locator,) = await nursery.start(serve_bus, "127.0.0.1", 0, BusServer())
            makers = [drive_maker(number, node_id, Shape.STANDARD) for number, node_id in enumerate(DEMO_NODES)]
            async with simulated_devices({self.locator: makers}) as self._simulation:
                self._ready.set()
                await self._end.wait()
            nursery.cancel_scope.cancel()

    def __enter__(self) -> Drives:
        self._thread.start()
        assert self._ready.wait(PATIENCE)
        return self

    def __exit__(self, *raised: object) -> None:
        trio.from_thread.run_sync(self._end.set, trio_token=self._token)
        self._thread.join(PATIENCE)

    def _ask(self, question: Callable[[SimulatedDevices], T]) -> T:
        return trio.from_thread.run_sync(question, self._simulation, trio_token=self._token)

    @property
    def moving(self) -> list[int]:
        """The node-IDs of the drives that really move."""
        return self._ask(lambda simulation: simulation.moving)

    @property
    def states(self) -> dict[int, State]:
        return self._ask(lambda simulation: {node_id: node.drive.state for node_id, node in simulation.drives.items()})

    @property
    def positions(self) -> dict[int, int]:
        """The positions that the drives report, in counts."""
        return self._ask(
            lambda simulation: {node_id: int(node.values[POSITION_ACTUAL_VALUE]) for node_id, node in simulation.drives.items()}
        )

    def all_move(self) -> bool:
        """Whether all six move."""
        return len(self.moving) == len(DEMO_NODES)

    def all_stand(self) -> bool:
        """Whether none of the six moves."""
        return not self.moving


class Process:
    """A process in a session of its own, and what it has printed."""

    def __init__(self, arguments: Sequence[str] | str, environment: Mapping[str, str], output: Path) -> None:
        """It runs in the folder of `output`."""
        self._output = output
        with output.open("wb") as file:
            self.process = subprocess.Popen(
                arguments,
                shell=isinstance(arguments, str),
                executable="/bin/bash" if isinstance(arguments, str) else None,
                env=dict(environment),
                cwd=output.parent,
                stdin=subprocess.PIPE,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def text(self) -> str:
        """All that it has printed."""
        return self._output.read_text(encoding="utf-8", errors="replace")

    def must_live(self) -> None:
        if self.process.poll() is not None:
            raise AssertionError(f"ended with status {self.process.returncode}:\n{self.text}")

    def prints(self, text: str) -> None:
        """Wait until it has printed a text."""
        until(lambda: text in self.text, f"it prints {text!r}; it printed:\n{self.text}")

    def interrupt(self) -> None:
        """Press Ctrl-C."""
        os.killpg(self.process.pid, signal.SIGINT)

    def wait(self) -> int:
        """Wait for its end, and return its exit status."""
        try:
            return self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"still there after {PATIENCE:g} s; it printed:\n{self.text}") from None

    def kill(self) -> None:
        """End it at once."""
        self.process.kill()
        self.process.communicate()


class Client:
    """A client of the node, as a process: see ros_client.py."""

    def __init__(self, process: Process) -> None:
        self._process = process

    def __call__(self, request: str, *arguments: Any) -> Any:
        """Make a request, and return its answer."""
        stdin = self._process.process.stdin
        assert stdin is not None
        lines = len(self._lines())
        stdin.write(json.dumps([request, *arguments]).encode() + b"\n")
        stdin.flush()
        until(lambda: len(self._lines()) > lines, f"the answer to {request}", self._process.must_live)
        answer = json.loads(self._lines()[-1])
        assert not isinstance(answer, dict) or "raised" not in answer, answer
        return answer

    def _lines(self) -> list[str]:
        return [line for line in self._process.text.splitlines(keepends=True) if line.endswith("\n")]

    def call(self, service: str) -> str:
        """Call a service, which has to succeed; return its message."""
        success, message = self("call", service)
        assert success, message
        return str(message)

    def goals(self, *goals: Mapping[str, Any]) -> tuple[list[dict[str, Any]], list[dict[str, float]]]:
        """Send goals; return what the client was told of each, and the positions meanwhile."""
        report = self("goals", goals)
        return report["goals"], report["states"]

    @property
    def positions(self) -> dict[str, float]:
        """The positions of the joints, from the next message."""
        return dict(self("positions"))

    @property
    def state(self) -> str:
        """The state of chain arm."""
        return str(self("state", "/arm"))


class Ros:
    """A ROS environment with a free port for its master, which roslaunch starts."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._processes: list[Process] = []
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port: int = free.getsockname()[1]
        package = Path(canopen_ros.__file__).parent
        sources = {Path(each.__file__).parents[1] for each in (canopen_proto, canopen_data, canopen_transports, canopen_master)}
        paths = os.pathsep.join(str(path) for path in sources if path.name != "site-packages")  # of an installation: none
        self.environment = {
            **os.environ,
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
            "PYTHONPATH": paths,
            "PYTHONUNBUFFERED": "1",
            "ROS_MASTER_URI": f"http://127.0.0.1:{self.port}",
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder),
            "ROS_LOG_DIR": str(folder / "log"),
            "ROS_PACKAGE_PATH": os.pathsep.join([str(package), "/usr/share"]),
        }

    @property
    def printed(self) -> str:
        """All that the process that was started first has printed."""
        return self._processes[0].text

    def __enter__(self) -> Ros:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        for process in reversed(self._processes):
            if error is not None:
                print(f"--- {process.process.args}\n{process.text}")
            process.kill()
        for process_id in self._left_over():
            with contextlib.suppress(ProcessLookupError):
                os.kill(process_id, signal.SIGKILL)

    def _left_over(self) -> list[int]:
        """The processes of this environment: roslaunch puts each of its nodes into a session of its own, and may die before."""
        found = []
        for environ in Path("/proc").glob("[0-9]*/environ"):
            with contextlib.suppress(OSError):
                if f"ROS_HOME={self._folder}".encode() in environ.read_bytes().split(b"\0"):
                    found.append(int(environ.parent.name))
        return found

    def start(self, command: str | Sequence[str], **environment: str) -> Process:
        """Start a command (a text: of the shell) and return at once."""
        output = self._folder / f"output{len(self._processes)}.txt"
        process = Process(command, {**self.environment, **environment}, output)
        self._processes.append(process)
        return process

    def run(self, command: str | Sequence[str], status: int = 0, **environment: str) -> str:
        """Run a command to its end and return what it printed; it has to end with this status."""
        process = self.start(command, **environment)
        assert process.wait() == status, process.text
        return process.text

    def client(self) -> Client:
        """Start a client."""
        return Client(self.start([sys.executable, str(Path(__file__).with_name("ros_client.py"))]))

    def launch(self, command: str, **environment: str) -> Process:
        """Run a roslaunch, which starts the ROS master, too; return when the node offers its services."""
        process = self.start(command, **environment)
        until(self.has_services, "the node offers its services", process.must_live)
        return process

    def has_services(self) -> bool:
        """Whether the last service of the node is registered at the master."""
        return self._ask("lookupService", "/set_object") is not None

    def has_master(self) -> bool:
        """Whether the ROS master answers."""
        return self._ask("getPid") is not None

    def master_process(self) -> int:
        """The process-ID of the ROS master."""
        return int(str(self._ask("getPid")))

    def node_process(self) -> int:
        """The process-ID of the node, as it tells by itself."""
        with xmlrpc.client.ServerProxy(str(self._ask("lookupNode", "/ros_canopen"))) as node:
            answer = node.getPid("/test")
        assert isinstance(answer, list)
        return int(str(answer[2]))

    def _ask(self, question: str, *arguments: str) -> object:
        """Ask the ROS master; None if it does not answer, or does not know."""
        try:
            with xmlrpc.client.ServerProxy(self.environment["ROS_MASTER_URI"]) as master:
                answer = getattr(master, question)("/test", *arguments)
        except OSError:
            return None
        return answer[2] if isinstance(answer, list) and answer[0] == 1 else None
