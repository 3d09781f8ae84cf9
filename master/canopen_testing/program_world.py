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

**Waiting in earnest is an error.** `time.sleep` raises WallClockWaitError while a program runs (wall_clock.py). A program that
waits for what never comes ends with DidNotHappenError, after `limit` of the world's time, or after IN_EARNEST if nothing more
will happen. It is cancelled, and has CLEAN_UP of the world's time for what it does then: a drive is stopped, a bus is closed.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from functools import partial
from os import PathLike
from typing import Any, Final, TypeVar

import trio

from canopen_master.simulation.device_files import models_of
from canopen_master.simulation.plant import DeviceEntry
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import NEVER, SECOND, LocalProtocolError, Time
from canopen_proto.testing import DidNotHappenError, World, WorldBus
from canopen_proto.testing.world import LIMIT, NodeMaker
from canopen_testing.present import present
from canopen_testing.trio_order import seed_order, waits_for_idle
from canopen_testing.world_line import WorldLine
from canopen_testing.world_loop import WorldLoop
from canopen_transports import virtual
from canopen_transports.wire import Wire, WireSettings

T = TypeVar("T")

DAY: Final = 24 * 3600 * SECOND
"""The most that a program may take of the world's time, unless it is told."""
CLEAN_UP: Final = 60 * SECOND
"""The most that a cancelled program may take of the world's time."""
IN_EARNEST: Final = 1.0
"""Seconds of real time for a thread or a file that a program waits for, when nothing will happen in the world."""
_LOOK: Final = 0.02
_AT_ONCE: Final = 1e-9
"""More than 0: so trio lets tasks run that wait for all others. It costs a millisecond, the least that the kernel waits."""


class _Steps(trio.abc.Instrument):
    """Tells whether a task has run since the loop was last idle, and whether one runs now. Keeps trio's order that of a seed."""

    def __init__(self, seed: int, on_end: Callable[[], None]) -> None:
        self._give_back_order = seed_order(seed)
        self._on_end = on_end
        self.is_idle = False
        self.in_task = False

    def before_task_step(self, task: trio.lowlevel.Task) -> None:
        self.is_idle = False
        self.in_task = True

    def after_task_step(self, task: trio.lowlevel.Task) -> None:
        self.in_task = False

    def after_run(self) -> None:
        self._give_back_order()
        self._on_end()


class ProgramWorld(World, trio.abc.Clock):
    """See this module's text."""

    _steps: _Steps
    _limit: Time = 0  # until when the program may run
    _left = IN_EARNEST
    _program = ""
    _cancel: Callable[[], object] | None = None  # ends the program, where that can be done from outside
    _stuck: DidNotHappenError | None = None

    # ---- what is in it ----

    def bus(self, name: str = "can0", *, bitrate: int = 0) -> WorldBus:
        """Return the bus of this name; it is made when it is first asked for.

        bitrate: bit/s: frames take the time of their bits, and the lowest identifier goes first; 0: any time, as the seed draws.
        Raises LocalProtocolError if the bus is there already, with another bit rate or with devices.
        """
        if not bitrate:
            return super().bus(name)
        settings = WireSettings(bitrate=bitrate, seed=self.seed, acknowledge=False)
        return self._new_bus(name, Wire(settings, self.now))

    def device(
        self, made_of: ObjectDictionary | NodeMaker | str | PathLike[str], node_id: int = 0, *, bus: str = "can0"
    ) -> LocalNode:
        """Switch on a device of a file (EDS, DCF, XDD, or a sample's name), of a dictionary, or of your own making; return it.

        A file of a CiA 402 drive makes a drive that moves. node_id: 0 with a file: the one that it names.
        Raises what `canopen_master.simulation.device_files.models_of` does, and as `World.device`.
        """
        if isinstance(made_of, str | PathLike):
            (made_of,) = models_of([DeviceEntry(str(made_of), (node_id,) if node_id else ())])
        return super().device(made_of, node_id, bus=bus)

    # ---- programs ----

    def run(self, main: Callable[..., Awaitable[T]], *args: object, limit: Time = DAY) -> T:
        """Run a trio program to its end in this world; return its result, or raise its error.

        Raises DidNotHappenError if it takes longer than `limit` (ns of the world), or waits for what never comes; it is cancelled
        then.
        """
        self._begin("await trio.sleep", limit)
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
        with trio.CancelScope() as scope:
            self._cancel = scope.cancel
            return await main(*args)
        assert self._stuck is not None
        raise self._stuck

    def run_asyncio(self, main: Callable[..., Any], *args: object, limit: Time = DAY) -> Any:
        """Run an asyncio program to its end in this world; return its result, or raise its error. Raises as `run` does."""

        async def watched() -> Any:
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

        self._begin("await asyncio.sleep", limit)
        try:
            with present(self), asyncio.Runner(loop_factory=lambda: WorldLoop(self)) as runner:
                return runner.run(watched())
        finally:
            self._end()

    def take_buses(self) -> None:
        """Let every bus that is opened in this run of a loop be one of the world."""
        virtual.stand_in(lambda name: WorldLine(self, name))

    def _begin(self, program: str, limit: Time) -> None:
        """A program begins. program: how it lets time pass."""
        self._program, self._limit = program, self.now + limit
        self._stuck, self._left = None, IN_EARNEST

    def _end(self) -> None:
        self._cancel, self._program = None, ""

    def advance(self, duration: Time) -> None:
        self._check_no_program()
        super().advance(duration)

    def run_until(self, condition: Any, limit: Time = LIMIT) -> None:
        self._check_no_program()
        super().run_until(condition, limit)

    def _check_no_program(self) -> None:
        if self._program:
            raise LocalProtocolError(f"in a program of the world time passes where it awaits: {self._program}")

    def pass_time(self, end: Time) -> float:
        """Go to the next happening, or to `end` (ns) if nothing happens before. For the loops of programs.

        Returns how long to wait in earnest, in seconds: 0, unless nothing will happen. If that took too long, the program is
        cancelled. Raises DidNotHappenError if that cannot be done, or has not ended it.
        """
        try:
            return self._pass_time(end)
        except DidNotHappenError as stuck:
            if self._cancel is None or self._stuck is not None:
                raise
            self._stuck = stuck
            self._limit, self._left = self.now + CLEAN_UP, IN_EARNEST
            self._cancel()
            return 0.0

    def _pass_time(self, end: Time) -> float:
        if self.now >= self._limit:
            raise DidNotHappenError(
                f"the program has run for its limit, until {self.now / SECOND:g} s of the world.\n{self._tails()}"
            )
        latest = min(end, self._limit)
        has_happened = self.step(latest)
        if not has_happened and (end < NEVER or self.next_time() < NEVER):
            self.now, has_happened = latest, True
        if has_happened:
            self._left = IN_EARNEST
            return 0.0
        self._left -= _LOOK
        if self._left > 0:
            return _LOOK
        raise DidNotHappenError(
            f"the program waits for what never comes: at {self.now / SECOND:g} s of the world nothing more will happen, and "
            f"nothing came from a thread or a file for {IN_EARNEST:g} s of real time.\n{self._tails()}"
        )

    def _tails(self) -> str:
        return "\n".join(bus.observer.tail(self.now) for bus in self.buses.values())

    # ---- trio's clock ----

    def start_clock(self) -> None:
        """Let every bus of this run be one of the world."""
        self._steps = _Steps(self.seed, self._end)
        if not self._program:  # by `trio.run`, not by `run`
            self._begin("await trio.sleep", DAY)
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
        return self.pass_time(end)
