"""Runs the command line in virtual time, for its tests: `run("read", "3", "statusword", "-b", "demo")`."""

from __future__ import annotations

import json
import signal
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import trio
from trio.testing import MockClock

from canopen_cli.app import main
from canopen_cli.live import source as live_source
from canopen_cli.motion import chain_session
from canopen_cli.shared import session
from canopen_cli.simulation import sim
from canopen_master.demonstration import run as demonstration
from canopen_master.simulation.serving import DEMO_LOCATOR, SimulatedDevices, simulated_devices, simulated_drives
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE
from canopen_proto.machine import SECOND, Outbox
from canopen_proto.simulation.drive.node import DriveNode

LATER = 10**9 * SECOND
SHORT = ("--seconds", "0.5", "--cycle", "20ms")
TWO_JOINTS = ("--chains", str(Path(__file__).parents[1] / "files" / "two_joints.csv"))
"""Of `canopen demo`: where the six of its own say no more, in a third of the time."""
TWO = (*SHORT, *TWO_JOINTS)


class Outcome(NamedTuple):
    """How a command ended, and what it wrote."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """What stdout is as JSON, which has no NaN."""
        return json.loads(self.out, parse_constant=_no_json)

    @property
    def error(self) -> Any:
        """What stderr is as JSON: the error of --json, alone."""
        return json.loads(self.err, parse_constant=_no_json)


def _no_json(text: str) -> None:
    raise ValueError(f"{text} is no JSON")


Run = Callable[..., Outcome]


class Alarm:
    """Sends this process signals, at virtual times that count from when the simulated drives are there."""

    def __init__(self) -> None:
        self.signals: list[tuple[float, int]] = []
        self.task: Callable[[SimulatedDevices], Awaitable[None]] | None = None
        """Something else that happens to the drives meanwhile."""

    def set(self, *signals: tuple[float, int]) -> None:
        """Send each signal so many seconds after the one before. For the next command only."""
        self.signals = list(signals)

    async def ring(self, simulation: SimulatedDevices) -> None:
        """What goes on beside the command."""
        if self.task is not None:
            await self.task(simulation)
        signals, self.signals = self.signals, []
        for seconds, number in signals:
            await trio.sleep(seconds)
            signal.raise_signal(number)


def runner(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, own_files: Path) -> Run:
    """The function that runs a command. own_files: an empty folder, so that what a user has in ~/.canopen does not count."""
    monkeypatch.setenv("CANOPEN_DATA", str(own_files))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(own_files / "config"))
    for name in ("CANOPEN_BUS", "CANOPEN_MACHINE", "FORCE_COLOR", "COLUMNS", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)

    def run(*arguments: str) -> Outcome:
        capsys.readouterr()
        status = main(arguments, clock=MockClock(autojump_threshold=0))
        written = capsys.readouterr()
        return Outcome(status, written.out, written.err)

    return run


def runner_in_folder(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """As `runner`, with an empty folder of its own as the current one, where commands leave their files."""
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    return runner(capsys, monkeypatch, tmp_path)


def watched_simulations(monkeypatch: pytest.MonkeyPatch, alarm: Alarm) -> list[SimulatedDevices]:
    """The simulated drives that commands make from now on, to look into when they have ended. alarm: rings in them."""
    simulations: list[SimulatedDevices] = []

    @asynccontextmanager
    async def watched(*arguments: Any, **options: Any) -> AsyncIterator[SimulatedDevices]:
        async with simulated_drives(*arguments, **options) as simulation:
            simulations.append(simulation)
            trio.lowlevel.spawn_system_task(alarm.ring, simulation)
            yield simulation

    monkeypatch.setattr(demonstration, "simulated_drives", watched)
    monkeypatch.setattr(session, "simulated_drives", watched)
    monkeypatch.setattr(live_source, "simulated_drives", watched)
    monkeypatch.setattr(sim, "simulated_drives", watched)
    monkeypatch.setattr(chain_session, "simulated_drives", watched)
    return simulations


def only_drive(monkeypatch: pytest.MonkeyPatch, alarm: Alarm, make: Callable[[Outbox, int], DriveNode]) -> list[DriveNode]:
    """Make drive 5 the only one on the bus of the demonstration; return the drives of the commands to come."""
    made: list[DriveNode] = []

    @asynccontextmanager
    async def simulated(*arguments: object) -> AsyncIterator[SimulatedDevices]:
        async with simulated_devices({DEMO_LOCATOR: [lambda out: make(out, 5)]}) as simulation:
            made.append(simulation.drives[5])
            trio.lowlevel.spawn_system_task(alarm.ring, simulation)
            yield simulation

    monkeypatch.setattr(session, "simulated_drives", simulated)
    return made


def stands(node: DriveNode) -> bool:
    """Whether a drive that nobody commands any more is where it was when it was last looked at (each 10 ms while it moves)."""
    before = node.values[POSITION_ACTUAL_VALUE]
    node.drive.refresh(LATER)
    after = node.values[POSITION_ACTUAL_VALUE]
    assert isinstance(before, int)
    assert isinstance(after, int)
    return abs(after - before) <= 5
