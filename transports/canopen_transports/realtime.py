"""`Grant`: ask the operating system to let this thread keep its cycle, say what it gave, and give that back.

A cycle of 10 ms is late when another program has the processor, when memory has to be fetched from a disk, or when the processor
sleeps deeply. Linux has an answer to each; a user needs permission for some of them. realtime_checks.py looks at all of them.

All calls of the operating system are in `System`, so that a test may stand in for them.

Source: sched(7), mlock(2), prctl(2) PR_SET_TIMERSLACK, capabilities(7), limits.conf(5).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from canopen_proto.machine import LocalProtocolError

UNLIMITED: Final = -1
"""A limit that is none."""
PRIORITY: Final = 50
"""Of SCHED_FIFO, 1..99: that of interrupt threads in a PREEMPT_RT kernel. Above it, a program could delay its own frames."""
TIMER_SLACK: Final = 1_000
"""ns by which a wake-up may be late so that others can share it; Linux has 50 000."""
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = 29, 30
LIMITS: Final = "/etc/security/limits.d/canopen.conf"


class System:
    """The calls of the operating system about the calling thread and its process. Each raises OSError, or where there is no such
    call AttributeError."""

    @property
    def is_linux(self) -> bool:
        """Whether these calls mean what this module says."""
        return sys.platform == "linux"

    def scheduler(self) -> tuple[int, int]:
        """Return policy (without SCHED_RESET_ON_FORK) and priority of this thread."""
        policy: int = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        return policy, os.sched_getparam(0).sched_priority

    def set_scheduler(self, policy: int, priority: int) -> None:
        """Set the scheduling policy and the priority of this thread; threads and processes that it starts are ordinary ones.
        policy: `os.SCHED_FIFO` and the like. priority: 1..99 for that."""
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))

    def limit(self, name: str) -> int:
        """Return the soft limit of a resource, such as "RLIMIT_RTPRIO"; UNLIMITED for none. name: of the resource."""
        import resource  # not on Windows

        soft, _ = resource.getrlimit(getattr(resource, name))
        return UNLIMITED if soft == resource.RLIM_INFINITY else soft

    def is_root(self) -> bool:
        """Whether limits do not count."""
        return os.geteuid() == 0

    def lock_memory(self) -> None:
        """Keep all memory of the process in RAM, also what it gets later."""
        _call("mlockall", _MCL_CURRENT | _MCL_FUTURE)

    def unlock_memory(self) -> None:
        """End that."""
        _call("munlockall")

    def timer_slack(self) -> int:
        """Return the timer slack of this thread, in ns."""
        return _call("prctl", _PR_GET_TIMERSLACK, 0, 0, 0, 0)

    def set_timer_slack(self, slack: int) -> None:
        """Set the timer slack of this thread. slack: ns."""
        _call("prctl", _PR_SET_TIMERSLACK, slack, 0, 0, 0)

    def cores(self) -> int:
        """Return how many processors this process may use."""
        return len(os.sched_getaffinity(0))


def _call(name: str, *arguments: int) -> int:
    import ctypes  # not for programs that ask for nothing

    result: int = getattr(ctypes.CDLL(None, use_errno=True), name)(*map(ctypes.c_long, arguments))
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result


# ---- asking for it ----


@dataclass(frozen=True, slots=True)
class Realtime:
    """What a master asks the operating system for. priority: of SCHED_FIFO, 1..99; 0: the scheduler is left alone. lock_memory:
    keep the memory of the process in RAM. timer_slack: ns; 0: left alone. required: an error if any of it is refused."""

    priority: int = PRIORITY
    lock_memory: bool = True
    timer_slack: int = TIMER_SLACK
    required: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.priority <= 99 or self.timer_slack < 0:
            raise LocalProtocolError("realtime: priority is 0..99, and timer_slack 0 or more")


@dataclass(frozen=True, slots=True)
class Measure:
    """One thing that was asked for. name: such as "SCHED_FIFO 50". refusal: why it was not given; "" if it was. remedy: what
    to do about that."""

    name: str
    refusal: str = ""
    remedy: str = ""


class Grant:
    """What the operating system gave to the calling thread, until `end`. measures: what was asked for, and whether it was given.

    Make it, and end it, in the thread that it is for.
    """

    def __init__(self, wanted: Realtime, system: System | None = None) -> None:
        """Ask for all that is wanted. Raises nothing: `measures` says what was refused."""
        self._system = system = System() if system is None else system
        self._restore: list[Callable[[], object]] = []
        self.measures: list[Measure] = []
        if not system.is_linux:
            self.measures.append(Measure("real time", "this is not Linux", "a computer with Linux"))
            return
        if wanted.lock_memory:
            self._try("memory locked", "RLIMIT_MEMLOCK", "memlock unlimited", self._lock)
        if wanted.timer_slack:
            self._try(f"timer slack {wanted.timer_slack} ns", "prctl", "", lambda: self._slack(wanted.timer_slack))
        if wanted.priority:
            how = f"rtprio {wanted.priority}"
            self._try(f"SCHED_FIFO {wanted.priority}", "RLIMIT_RTPRIO", how, lambda: self._schedule(wanted.priority))

    @property
    def refused(self) -> list[Measure]:
        """What was not given."""
        return [each for each in self.measures if each.refusal]

    def end(self) -> list[str]:
        """Give all back, the last one first. May be called twice. Returns what could not be given back, in words."""
        problems = []
        while self._restore:
            try:
                self._restore.pop()()
            except OSError as error:
                problems.append(str(error))
        return problems

    def _try(self, name: str, what: str, limit: str, ask: Callable[[], None]) -> None:
        try:
            ask()
        except (OSError, AttributeError, ValueError) as error:
            remedy = f"'* - {limit}' in {LIMITS}, then log in again" if limit else ""
            self.measures.append(Measure(name, f"{what}: {error}", remedy))
        else:
            self.measures.append(Measure(name))

    def _lock(self) -> None:
        system = self._system
        enough = system.is_root() or system.limit("RLIMIT_MEMLOCK") == UNLIMITED
        if not enough:  # MCL_FUTURE would let an allocation fail later, in the middle of a motion
            raise OSError(f"the limit is {system.limit('RLIMIT_MEMLOCK') // 1024} KiB, and must be unlimited")
        system.lock_memory()
        self._restore.append(system.unlock_memory)

    def _slack(self, slack: int) -> None:
        before = self._system.timer_slack()
        self._system.set_timer_slack(slack)
        self._restore.append(lambda: self._system.set_timer_slack(before))

    def _schedule(self, priority: int) -> None:
        policy, before = self._system.scheduler()
        self._system.set_scheduler(os.SCHED_FIFO, priority)
        self._restore.append(lambda: self._system.set_scheduler(policy, before))
