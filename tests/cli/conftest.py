"""Fixtures of the tests that run commands with simulated drives, in virtual time: see cli_support.py."""

from __future__ import annotations

import pytest

from canopen_master.simulation.serving import SimulatedDevices
from tests.cli.cli_support import Alarm, Run, runner, watched_simulations


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))


@pytest.fixture
def alarm() -> Alarm:
    return Alarm()


@pytest.fixture
def simulations(monkeypatch: pytest.MonkeyPatch, alarm: Alarm) -> list[SimulatedDevices]:
    return watched_simulations(monkeypatch, alarm)
