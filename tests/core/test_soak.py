"""The soak of benchmarks/soak.py runs, here for seconds, and sees what is not as it should be."""

from __future__ import annotations

import gc
import sys
from pathlib import Path

import pytest

from canopen_proto.frame import ERROR_CONTROL, RPDO1, SDO_SERVER_TO_CLIENT, TPDO1, Frame
from canopen_proto.machine import SECOND
from canopen_transports.wire import FaultRates

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import soak
from soak import Soak

NONE = FaultRates()
MANY = FaultRates(loss=0.1, corruption=0.02, repetition=0.02)


def soaked(run: Soak, rates: FaultRates = NONE, seconds: int = 2) -> Soak:
    """As the script does it."""
    run.run(SECOND)
    run.start()
    run.run(run.now + SECOND)
    run.master.judging, run.wire.rates = True, rates
    run.run(run.now + seconds * SECOND)
    run.wire.rates = FaultRates()
    run.run(run.now + soak.SETTLE)
    run.check()
    return run


@pytest.mark.thorough(2)
@pytest.mark.parametrize("seed", range(2))
def test_every_fault_is_noticed_and_nothing_else(seed: int) -> None:
    findings = soaked(Soak(125_000, seed), MANY, 6).findings
    assert findings.wrong == []
    assert min(findings.absent, findings.twice, findings.gaps, findings.repeats, findings.aborts, findings.transfers) > 0


class Tampered(Soak):
    """Frames of one service of axis 3 are tampered with behind the wire's back; once, or all of them."""

    def __init__(self, service: int, change: bytes | None) -> None:
        super().__init__(125_000, 1)
        self.can_id, self.change = service + 3, change

    def _deliver(self, frame: Frame, receivers: list[int], latency: int) -> None:
        if frame.can_id == self.can_id and self.master.judging:
            self.can_id = 0
            if self.change is None:
                return
            frame = Frame(frame.can_id, self.change)
        super()._deliver(frame, receivers, latency)


@pytest.mark.thorough(4)
@pytest.mark.parametrize(
    ("service", "change", "seen"),
    [
        (RPDO1, None, "targets missing: 1 were noticed, 0 there were"),
        (RPDO1, bytes(8), "axis 3 took the target 0, 00000000"),
        (TPDO1, None, "0 TPDOs of axis 3, not 1"),
        (TPDO1, bytes(8), "the master took 0, 00000000 from axis 3"),
        (ERROR_CONTROL, None, "heartbeats missing: 1 were noticed, 0 there were"),
        (SDO_SERVER_TO_CLIENT, None, "SDO: 1 aborts, but 0 of its frames were lost"),
    ],
)
def test_what_is_wrong_is_seen(service: int, change: bytes | None, seen: str) -> None:
    run = soaked(Tampered(service, change))
    assert run.can_id == 0
    assert any(seen in text for text in run.findings.wrong)


def test_the_script(capsys: pytest.CaptureFixture[str]) -> None:
    gc.freeze()  # it collects twenty times, and what other tests left is not its own
    assert soak.soak("125k:2", seed=1)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "125kbit/s, 2 s simulated, seed 1"
    assert lines[-1] == "  verdict    as it should be"
