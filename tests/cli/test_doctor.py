"""`canopen doctor`: what it writes, and its exit status."""

from __future__ import annotations

from pathlib import Path

import pytest
import trio

from canopen_cli.bus import doctor as command
from canopen_transports.doctor import DoctorFinding, Health
from canopen_transports.errors import BusState
from canopen_transports.receive_test import Heard
from tests.cli.cli_support import Run, runner

WELL = [DoctorFinding("SocketCAN can0", Health.OK, "up, 500kbit/s", (), "socketcan:can0")]
DOWN = DoctorFinding(
    "SocketCAN can1", Health.WARNING, "it exists, but is DOWN", ("sudo ip link set can1 up", "another way"), "socketcan:can1"
)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    monkeypatch.setattr(command, "check_realtime", list)
    return runner(capsys, monkeypatch, tmp_path)


def test_all_is_well(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "examine", lambda: WELL)
    outcome = run("doctor")
    assert outcome.status == 0
    assert outcome.out == "ok      SocketCAN can0: up, 500kbit/s\n"
    assert "canopen doctor -b socketcan:can0" in outcome.err


def test_something_is_to_be_done(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "examine", lambda: [DOWN])
    outcome = run("doctor")
    assert outcome.status == 1
    assert outcome.out.splitlines() == [
        "warning SocketCAN can1: it exists, but is DOWN",
        "        try: sudo ip link set can1 up",
        "        or:  another way",
    ]
    outcome = run("doctor", "--json")
    assert outcome.status == 1
    assert outcome.json[0] == {
        "subject": "SocketCAN can1",
        "health": "warning",
        "seen": "it exists, but is DOWN",
        "try": ["sudo ip link set can1 up", "another way"],
        "bus": "socketcan:can1",
    }


def test_the_demonstrations_bus(run: Run) -> None:
    outcome = run("doctor", "-b", "demo", "--for", "1s")
    assert outcome.status == 0
    assert "nodes             3 (0x03), 4 (0x04), " in outcome.out
    assert "canopen scan -b demo" in outcome.out
    outcome = run("doctor", "-b", "demo", "--json")
    assert outcome.json["nodes"] == [3, 4, 5, 6, 7, 8]
    assert outcome.json["can_ids"]["703"] >= 2


def test_a_silent_bus(run: Run) -> None:
    outcome = run("doctor", "-b", "virtual:nobody")
    assert outcome.status == 5
    assert "0 frames in 2 s" in outcome.out
    assert "canopen sim --id 5 -b virtual:nobody" in outcome.out


@pytest.mark.parametrize(
    ("heard", "status", "texts"),
    [
        (Heard("can0@250k", False), 5, ["the bit rate (ours 250k)", "scan -b can0@250k"]),
        (Heard("pcan:PCAN_USBBUS1", True, faults=3), 4, ["opened to listen only", "error frames      3", "--bitrates"]),
        (Heard("can0", False, states=[(BusState.BUS_OFF, "it said so")], lost=2), 4, ["bus-off: it said so", "2 more lost"]),
    ],
)
def test_a_bus_that_is_not_well(run: Run, monkeypatch: pytest.MonkeyPatch, heard: Heard, status: int, texts: list[str]) -> None:
    async def listen(bus: str, seconds: float, each: object) -> Heard:
        await trio.lowlevel.checkpoint()
        return heard

    monkeypatch.setattr(command, "listen", listen)
    outcome = run("doctor", "-b", heard.locator)
    assert outcome.status == status
    assert all(text in outcome.out for text in texts), outcome.out


def test_many_ids_are_cut(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    heard = Heard("can0", False, frames=20)
    heard.ids.update(range(20))

    async def listen(bus: str, seconds: float, each: object) -> Heard:
        await trio.lowlevel.checkpoint()
        return heard

    monkeypatch.setattr(command, "listen", listen)
    assert "and 8 more" in run("doctor", "-b", "can0").out


def test_bit_rates_need_a_bus_that_can_be_listened_to(run: Run) -> None:
    assert run("doctor", "--bitrates").status == 2
    outcome = run("doctor", "--bitrates", "-b", "can0")
    assert outcome.status == 3
    assert "listen-only on && canopen doctor -b can0" in outcome.err
    assert run("doctor", "--bitrates", "-b", "virtual:x").status == 3


@pytest.mark.parametrize("found", [Heard("pcan:PCAN_USBBUS1@250k", True, frames=5), None])
def test_the_bit_rate_that_was_found(run: Run, monkeypatch: pytest.MonkeyPatch, found: Heard | None) -> None:
    async def find(bus: str, seconds: float, told: object) -> Heard | None:
        assert callable(told)
        told(Heard("pcan:PCAN_USBBUS1@1M", True, faults=7))
        await trio.lowlevel.checkpoint()
        return found

    monkeypatch.setattr(command, "find_bitrate", find)
    outcome = run("doctor", "--bitrates", "-b", "pcan:PCAN_USBBUS1")
    assert outcome.status == (0 if found else 1)
    assert "pcan:PCAN_USBBUS1@1M: 0 frames, 7 errors" in outcome.err
    assert ("@250k" in outcome.out) == (found is not None)
    assert (run("doctor", "--bitrates", "-b", "pcan:PCAN_USBBUS1", "--json").json is None) == (found is None)
