"""`ProgramWorld`: a World with devices made of their files, buses with bit timing, and programs in trio and asyncio, unchanged.

    world = ProgramWorld(seed=7)
    world.device("drive.eds", node_id=5)
    world.run(main)                      # trio: `main` opens its master, on whatever bus, and sleeps as it likes
    world.run_asyncio(main)              # asyncio

**trio.** The world is the clock: `trio.run(main, clock=world)` is the same as `world.run(main)`. When no task can run, the world
goes to its next happening, or to the deadline of a task, whichever comes first. trio's order of tasks is drawn with the seed.

**asyncio.** The loop (world_loop.py) does the same.

**Buses.** Every bus that a program opens by canopen_master or canopen_transports is the bus of the world with that name, the
channel of its locator: `socketcan:can0` and `virtual:can0` are both `can0`. Frames also come by python-can,
`can.Bus(interface="canopen_world", channel="can0")` (can_bus.py), and by `World.listener`.

**What runs in real time is told.** While a program runs, `time.sleep` raises WallClockWaitError, and a thread of its own
ThreadStartedError (real_time.py). While a thread works whose result the program awaits (`trio.to_thread`, `asyncio.to_thread`),
time stands still; after WORKING it is named in a DidNotHappenError. With `allows_threads` none of this holds for threads. A
program that waits for what never comes ends with DidNotHappenError, after `limit` of the world's time, or after IN_EARNEST if
nothing more will happen. It is cancelled, and has CLEAN_UP of the world's time for what it does then: a drive is stopped, a bus
is closed.
"""

from __future__ import annotations

import asyncio
import inspect
import math
from collections.abc import Awaitable, Callable
from functools import partial
from os import PathLike
from types import TracebackType
from typing import Any, Final, TypeVar

import trio

from canopen_master.errors import DeviceRefusedError
from canopen_master.simulation.device_files import models_of
from canopen_master.simulation.plant import DeviceEntry
from canopen_proto.declared import DeclaredDevice
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import NEVER, SECOND, LocalProtocolError, Time, check_node_id
from canopen_proto.testing import DidNotHappenError, World, WorldBus
from canopen_proto.testing.times import nanoseconds
from canopen_proto.testing.world import LIMIT, NodeMaker
from canopen_testing.present import present
from canopen_testing.trio_order import seed_order, waits_for_idle
from canopen_testing.waiting import WaitingTasks, asyncio_waits, trio_waits
from canopen_testing.working_threads import WorkingThreads, watch_threads
from canopen_testing.world_line import WorldLine
from canopen_testing.world_loop import WorldLoop
from canopen_transports import virtual
from canopen_transports.wire import Wire, WireSettings

T = TypeVar("T")

DAY: Final = 24 * 3600 * SECOND
"""How long a program may run in the world's time, unless it is told."""
CLEAN_UP: Final = 60 * SECOND
"""The most that a cancelled program may take of the world's time."""
IN_EARNEST: Final = 1.0
"""Seconds of real time for a file or a process that a program waits for, when nothing will happen in the world."""
WORKING: Final = 10.0
"""Seconds of real time for a thread whose result a program awaits."""
_LOOK: Final = 0.02
_AT_ONCE: Final = 1e-9
"""More than 0: so trio lets tasks run that wait for all others. It costs a millisecond, the least that the kernel waits."""


class _Steps(trio.abc.Instrument):
    """Tells whether a task has run since the loop was last idle, and whether one runs now. Keeps trio's order that of a seed, and
    an eye on its threads."""

    def __init__(self, seed: int, on_end: Callable[[], None]) -> None:
        self._give_back_order = seed_order(seed)
        self._on_end = on_end
        self.threads = WorkingThreads()
        self._give_back_threads = watch_threads(self.threads)
        self.is_idle = False
        self.in_task = False

    def before_task_step(self, task: trio.lowlevel.Task) -> None:
        self.is_idle = False
        self.in_task = True

    def after_task_step(self, task: trio.lowlevel.Task) -> None:
        self.in_task = False

    def after_run(self) -> None:
        self._give_back_order()
        self._give_back_threads()
        self._on_end()


def check_main(main: object, run: str) -> None:
    """Look whether this is a function to be awaited. Raises LocalProtocolError."""
    __tracebackhide__ = True
    if not callable(main):
        if inspect.iscoroutine(main):
            main.close()
        raise LocalProtocolError(
            f"{run} calls the program itself: give the function, as in {run}(main) or {run}(main, 5), not the coroutine of main()"
        )


class ProgramWorld(World, trio.abc.Clock):
    """See this module's text.

    limit: how long a program may run, ns, unless `run` is told. allows_threads: let threads of a program run beside the world's
    time, unseen and in no order.
    """

    limit: Time = DAY
    allows_threads = False
    _steps: _Steps
    _until: Time = 0  # when the program has run for its limit
    _left = IN_EARNEST
    _left_working = WORKING
    _program = ""
    _waits: Callable[[], WaitingTasks]
    _cancel: Callable[[], object] | None = None  # ends the program, where that can be done from outside
    _stuck: DidNotHappenError | None = None
    _stuck_at: TracebackType | None = None

    # ---- what is in it ----

    def bus(self, name: str = "can0", *, bitrate: int = 0) -> WorldBus:
        """Return the bus of this name; it is made when it is first asked for.

        bitrate: bit/s: frames take the time of their bits, and the lowest identifier goes first; 0: any time, as the seed draws.
        Raises LocalProtocolError if the bus has another bit rate already, or if frames are under way on it.
        """
        __tracebackhide__ = True
        there = super().bus(name)
        if not isinstance(bitrate, int) or bitrate < 0:
            raise LocalProtocolError(f"a bit rate is bit/s, such as 125_000, not {bitrate!r}")
        if bitrate and bitrate != there.bitrate:
            there.use_cable(Wire(WireSettings(bitrate=bitrate, seed=self.seed, acknowledge=False), self.now), bitrate)
        return there

    def device(
        self,
        made_of: ObjectDictionary | type[DeclaredDevice] | NodeMaker | str | PathLike[str],
        node_id: int = 0,
        *,
        bus: str = "can0",
    ) -> LocalNode:
        """Switch on a device of a file (EDS, DCF, XDD, Python, or a sample's name), of a dictionary, of a class, or of your own
        making; return it.

        A file of a CiA 402 drive makes a drive that moves. node_id: 0 with a file: the one that it names.
        Raises what `canopen_master.simulation.device_files.models_of` does, and as `World.device`.
        """
        __tracebackhide__ = True
        if isinstance(made_of, str | PathLike):
            try:
                (made_of,) = models_of([DeviceEntry(str(made_of), (check_node_id(node_id),) if node_id else ())])
            except DeviceRefusedError as error:
                if not node_id:  # what it says to try is for a command
                    error.tries = (f'sim_node("{made_of}", node_id=5), or world.device("{made_of}", 5)',)
                raise
        return super().device(made_of, node_id, bus=bus)

    # ---- programs ----

    def run(self, main: Callable[..., Awaitable[T]], *args: object, limit: Time | float | None = None) -> T:
        """Run a trio program to its end in this world; return its result, or raise its error.

        Raises DidNotHappenError if it takes longer than `limit` (ns of the world), or waits for what never comes; it is cancelled
        then.
        """
        __tracebackhide__ = True
        check_main(main, "world.run")
        self._begin("await trio.sleep", limit, trio_waits)
        try:
            with present(self):
                return trio.run(partial(self.watched, main, *args), clock=self)
        except trio.TrioInternalError as error:
            if self._stuck is None or not isinstance(error.__cause__, DidNotHappenError):
                raise
            self._steps.after_run()  # which trio has left out
            raise error.__cause__ from self._stuck  # it was cancelled, and went on for longer than CLEAN_UP
        finally:
            self._end()

    async def watched(self, main: Callable[..., Awaitable[T]], *args: object) -> T:
        """Await a trio program within a `trio.run` whose clock is this world; return its result, or raise its error.

        Raises DidNotHappenError as `run` does. Without this, the error comes out of trio's loop, as a TrioInternalError.
        """
        __tracebackhide__ = True
        with trio.CancelScope() as scope:
            self._cancel = scope.cancel
            return await main(*args)
        assert self._stuck is not None
        raise self._stuck.with_traceback(self._stuck_at)

    def run_asyncio(self, main: Callable[..., Any], *args: object, limit: Time | float | None = None) -> Any:
        """Run an asyncio program to its end in this world; return its result, or raise its error. Raises as `run` does."""

        async def watched() -> Any:
            __tracebackhide__ = True
            self.take_buses()
            task = asyncio.current_task()
            assert task is not None
            self._cancel = task.cancel
            try:
                return await main(*args)
            except asyncio.CancelledError:
                if self._stuck is None:
                    raise
                raise self._stuck from None

        __tracebackhide__ = True
        check_main(main, "world.run_asyncio")
        self._begin("await asyncio.sleep", limit, asyncio_waits)
        try:
            with present(self), asyncio.Runner(loop_factory=lambda: WorldLoop(self)) as runner:
                return runner.run(watched())
        except DidNotHappenError as error:
            if self._stuck is None:  # it is of the program itself
                raise
            raise error.with_traceback(self._stuck_at) from error.__cause__  # where it waits, and not within asyncio
        finally:
            self._end()

    def take_buses(self) -> None:
        """Let every bus that is opened in this run of a loop be one of the world."""
        virtual.stand_in(lambda name: WorldLine(self, name))

    def _begin(self, program: str, limit: Time | float | None, waits: Callable[[], WaitingTasks]) -> None:
        """A program begins. program: how it lets time pass. waits: returns where its tasks wait."""
        __tracebackhide__ = True
        if self._program:
            raise LocalProtocolError("a program runs in this world already: await main() in it")
        self._program, self._waits = program, waits
        self._until = self.now + (self.limit if limit is None else nanoseconds(limit, "limit"))
        self._stuck, self._left, self._left_working = None, IN_EARNEST, WORKING

    def _end(self) -> None:
        self._cancel, self._program = None, ""

    def advance(self, duration: Time | float) -> None:
        __tracebackhide__ = True
        self._check_no_program()
        super().advance(duration)

    def run_until(self, condition: Any, limit: Time | float = LIMIT, *, told: str = "") -> None:
        __tracebackhide__ = True
        self._check_no_program()
        super().run_until(condition, limit, told=told)

    def _check_no_program(self) -> None:
        __tracebackhide__ = True
        if self._program:
            raise LocalProtocolError(f"in a program of the world time passes where it awaits: {self._program}")

    def pass_time(self, end: Time, threads: WorkingThreads) -> float:
        """Go to the next happening, or to `end` (ns) if nothing happens before. For the loops of programs.

        Returns how long to wait in earnest, in seconds: 0, unless a thread works or nothing will happen. If that took too long,
        the program is cancelled. Raises DidNotHappenError if that cannot be done, or has not ended it.
        """
        try:
            if not self.allows_threads and (names := threads.names):
                return self._wait_for(names)
            self._left_working = WORKING
            return 0.0 if threads.take_news() else self._pass_time(end)
        except DidNotHappenError as stuck:
            if self._cancel is None or self._stuck is not None:
                raise
            self._stuck = stuck
            self._until, self._left, self._left_working = self.now + CLEAN_UP, IN_EARNEST, WORKING
            self._cancel()
            return 0.0

    def _wait_for(self, names: list[str]) -> float:
        """Give threads of the program time to work, while the world's time stands still. names: of the threads, for the error.

        Returns the seconds of real time that the loop has to wait. Raises once they have worked for WORKING.
        """
        self._left_working -= _LOOK
        if self._left_working > 0:
            return _LOOK
        raise self._told(
            f"the program waits for the thread of {', '.join(names)}, which works for {WORKING:g} s of real time. Meanwhile the "
            f"world's time stands still, at {self.now / SECOND:g} s; with `world.allows_threads = True` it goes on."
        )

    def _pass_time(self, end: Time) -> float:
        if self.now >= self._until:
            raise self._told(f"the program has run for its limit, until {self.now / SECOND:g} s of the world.")
        latest = min(end, self._until)
        has_happened = self.step(latest)
        if not has_happened and (end < NEVER or self.next_time() < NEVER):
            self.now, has_happened = latest, True
        if has_happened:
            self._left = IN_EARNEST
            return 0.0
        self._left -= _LOOK
        if self._left > 0:
            return _LOOK
        raise self._told(
            f"the program waits for what never comes: at {self.now / SECOND:g} s of the world nothing more will happen, and "
            f"nothing came from a file or a process for {IN_EARNEST:g} s of real time."
        )

    def _told(self, why: str) -> DidNotHappenError:
        """Return the error about a program that is stuck: why, where it waits, and the last frames."""
        lines, self._stuck_at = self._waits()
        where = ["The program waits here:", *lines] if lines else []
        return DidNotHappenError("\n".join([why, *where, *(bus.observer.tail(self.now) for bus in self.buses.values())]))

    # ---- trio's clock ----

    def start_clock(self) -> None:
        """Let every bus of this run be one of the world."""
        self._steps = _Steps(self.seed, self._end)
        if not self._program:  # by `trio.run`, not by `run`
            self._begin("await trio.sleep", None, trio_waits)
        trio.lowlevel.add_instrument(self._steps)
        self.take_buses()

    def current_time(self) -> float:
        """Return the world's time in seconds."""
        return self.now / SECOND

    def deadline_to_sleep_time(self, deadline: float) -> float:
        """Let time pass. Called by trio's loop when no task can run."""
        steps = self._steps
        if steps.in_task:
            return 0.0 if deadline <= self.current_time() else _AT_ONCE  # somebody asks whether this clock is real
        if not steps.is_idle:
            steps.is_idle = True
            return _AT_ONCE if waits_for_idle() else 0.0
        end = NEVER if deadline == math.inf else max(math.ceil(deadline * SECOND), self.now + 1)
        return self.pass_time(end, steps.threads)
