"""The checks of `canopen doctor` about real time: what keeps this computer from an exact cycle, and how to mend it.

They look only. Nothing of it is needed to move slowly and safely: a late SYNC makes no joint jump, and a path waits. So no check
is a warning.

Source: sched(7), mlock(2), prctl(2), limits.conf(5); the kernel's admin guide on cpufreq and on PREEMPT_RT.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from canopen_transports import realtime
from canopen_transports.doctor import DoctorFinding, Health
from canopen_transports.realtime import LIMITS, PRIORITY, TIMER_SLACK, UNLIMITED, System

FEW_CORES: Final = 2


def check_realtime(root: Path = Path("/"), system: System | None = None) -> Iterator[DoctorFinding]:
    """Run all checks. root: of the files to read; a test passes a folder of its own."""
    system = realtime.System() if system is None else system
    if not system.is_linux:
        yield DoctorFinding("real time", Health.NOTE, "this is not Linux: a cycle may be late by 10 ms and more at any time")
        return
    policy, priority = system.scheduler()
    names = {os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR", os.SCHED_OTHER: "SCHED_OTHER"}
    allowed = system.is_root() or system.limit("RLIMIT_RTPRIO") == UNLIMITED or system.limit("RLIMIT_RTPRIO") >= PRIORITY
    seen = f"{names.get(policy, f'policy {policy}')}{f' {priority}' if priority else ''}"
    if allowed:
        yield DoctorFinding(
            "real time: scheduler", Health.OK, f"{seen}; SCHED_FIFO {PRIORITY} may be asked for: open_master(realtime=True)"
        )
    else:
        seen += f"; RLIMIT_RTPRIO is {system.limit('RLIMIT_RTPRIO')}, so that other programs may delay SYNC"
        yield DoctorFinding("real time: scheduler", Health.NOTE, seen, (f"{_line('rtprio', PRIORITY)}   (then log in again)",))
    locked = system.limit("RLIMIT_MEMLOCK")
    if system.is_root() or locked == UNLIMITED:
        yield DoctorFinding("real time: memory", Health.OK, "it may be locked in RAM: open_master(realtime=True)")
    else:
        seen = f"RLIMIT_MEMLOCK is {locked // 1024} KiB: the process may wait for memory that was swapped out"
        yield DoctorFinding("real time: memory", Health.NOTE, seen, (f"{_line('memlock', 'unlimited')}   (then log in again)",))
    slack = system.timer_slack()
    yield DoctorFinding("real time: timer slack", Health.OK if slack <= TIMER_SLACK else Health.NOTE, f"{slack / 1000:g} us",
                  () if slack <= TIMER_SLACK else ("open_master(realtime=True) sets it; it needs no permission",))  # fmt: skip
    yield from _governors(root)
    yield _kernel(root)
    cores = system.cores()
    few = cores < FEW_CORES
    tries = ("a computer with two processors or more",) if few else ()
    yield DoctorFinding("real time: processors", Health.NOTE if few else Health.OK, f"{cores} for this process", tries)


def _line(what: str, value: object) -> str:
    return f"echo '{os.environ.get('USER', '*')} - {what} {value}' | sudo tee -a {LIMITS}"


def _governors(root: Path) -> Iterator[DoctorFinding]:
    files = sorted(root.glob("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor"))
    found = sorted({file.read_text(encoding="ascii").strip() for file in files})
    if not found:
        yield DoctorFinding(
            "real time: CPU governor", Health.NOTE, "the kernel tells none (a virtual machine, or a fixed frequency)"
        )
    elif found == ["performance"]:
        yield DoctorFinding("real time: CPU governor", Health.OK, "performance")
    else:
        seen = f"{', '.join(found)}: the processor takes time to become fast"
        yield DoctorFinding("real time: CPU governor", Health.NOTE, seen, ("sudo cpupower frequency-set -g performance",))


def _kernel(root: Path) -> DoctorFinding:
    told = root / "sys/kernel/realtime"
    if told.exists() and told.read_text(encoding="ascii").strip() == "1":
        return DoctorFinding("real time: kernel", Health.OK, "PREEMPT_RT")
    seen = "not PREEMPT_RT: drivers may delay a cycle by some ms; enough for cycles of 10 ms"
    return DoctorFinding("real time: kernel", Health.NOTE, seen, ("a kernel with PREEMPT_RT, for cycles below some ms",))
