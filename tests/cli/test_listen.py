"""`canopen listen`: in virtual time. The search for the bit rate itself: tests/pcan/test_receive_test.py."""

from __future__ import annotations

import pytest
import trio

from canopen_cli.bus import doctor
from canopen_proto.frame import Frame
from canopen_transports import open_transport
from canopen_transports.receive_test import Each, Heard
from tests.cli.cli_support import Run

FOUND = "pcan:PCAN_USBBUS1@250k"


def test_who_is_on_the_bus(run: Run) -> None:
    outcome = run("listen", "-b", "demo", "--seconds", "1.2")
    assert outcome.status == 0
    assert "12 frames in 1.2 s" in outcome.out
    (node,) = [line.split() for line in outcome.out.splitlines() if line.startswith("5 (0x05)")]
    assert node[2] == "pre-operational"
    document = run("listen", "-b", "demo", "--seconds", "1.2", "--json").json
    assert (document["frames"], document["nodes"]) == (12, [3, 4, 5, 6, 7, 8])
    assert [each["state"] for each in document["figures"]["nodes"]] == ["pre-operational"] * 6


def test_nobody(run: Run) -> None:
    outcome = run("listen", "-b", "virtual:nobody")
    assert outcome.status == 5
    assert "0 frames in 2 s" in outcome.out
    assert run("listen").status == 2


def test_nothing_is_sent(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[str] = []

    async def hear(bus: str, seconds: float, each: Each) -> Heard:
        async with await open_transport(bus) as other, trio.open_nursery() as nursery:
            nursery.start_soon(listen_to, other)
            await trio.testing.wait_all_tasks_blocked()
            await other.send(Frame(0x705, b"\x05"))
            found = await real(bus, seconds, each)
            nursery.cancel_scope.cancel()
        return found

    async def listen_to(other: trio.abc.AsyncResource) -> None:
        heard.append(str(await other.receive()))  # type: ignore[attr-defined]

    real = doctor.hear
    monkeypatch.setattr("canopen_cli.live.listen.hear", hear)
    run("listen", "-b", "virtual:x")
    assert heard == []


@pytest.fixture
def adapter(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """An adapter at a bus of 250 kbit/s; returns the buses that were listened to."""
    buses: list[str] = []

    async def find(bus: str, seconds: float, told: object) -> Heard | None:
        assert callable(told)
        told(Heard("pcan:PCAN_USBBUS1@1M", True, faults=7))
        await trio.lowlevel.checkpoint()
        return Heard(FOUND, True, frames=5) if bus == "pcan:PCAN_USBBUS1" else None

    async def listen(bus: str, seconds: float, each: Each) -> Heard:
        buses.append(bus)
        for number in range(10):
            await trio.sleep(seconds / 10)
            each(Frame(0x705, b"\x05"), None)
            each(Frame(0x185, bytes([number])), None)
        return Heard(bus, bus.startswith("pcan"), frames=20)

    monkeypatch.setattr(doctor, "find_bitrate", find)
    monkeypatch.setattr(doctor, "listen", listen)
    return buses


def test_the_bit_rate_is_found_and_then_who_is_there(run: Run, adapter: list[str]) -> None:
    outcome = run("listen", "--bitrates", "-b", "pcan:PCAN_USBBUS1")
    assert (outcome.status, adapter) == (0, [FOUND])
    assert "pcan:PCAN_USBBUS1@1M: 0 frames, 7 errors" in outcome.err
    assert f"{FOUND}, opened to listen only" in outcome.out
    assert "of 250k" in outcome.out  # the load
    assert "5 (0x05) operational" in outcome.out
    assert "acknowledges" not in outcome.err


def test_no_bit_rate_is_found(run: Run, adapter: list[str]) -> None:
    outcome = run("listen", "--bitrates", "-b", "pcan:PCAN_USBBUS2")
    assert (outcome.status, adapter, outcome.out) == (1, [], "")
    assert run("listen", "--bitrates", "-b", "pcan:PCAN_USBBUS2", "--json").json is None


def test_an_adapter_that_is_not_silent_is_told_of(run: Run, adapter: list[str]) -> None:
    outcome = run("listen", "-b", "can0@500k")
    assert outcome.status == 0
    assert "the adapter acknowledges the frames of others" in outcome.err.replace("\n", " ")
    assert "sudo ip link set can0 down && sudo ip link set can0 up type can bitrate 500000 listen-only on" in outcome.err
