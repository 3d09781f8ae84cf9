"""A driver of our Network with one thread and a lock, over a python-can bus: the core needs no event loop and no trio.

Real threads and real time; limits are generous, and nothing here says how long anything takes.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

import can

from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.machine import Event, Machine, Outbox, Outcome, RequestId, Time
from canopen_proto.network import Network
from canopen_proto.procedures.runner import ProcedureFinished
from canopen_proto.procedures.steps import Procedure

E = TypeVar("E", bound=Event)
M = TypeVar("M", bound=Machine)
R = TypeVar("R")

LIMIT = 60.0  # seconds; what takes longer than this has failed: a busy computer that measures coverage is slow
LONGEST_NAP = 0.005


class Driver:
    """Runs a Network on a channel of python-can's virtual interface until `close`. Leave it by `with`."""

    def __init__(self, channel: str) -> None:
        self.network = Network()
        self.events: list[Event] = []
        self.failure: BaseException | None = None
        self.on_events: Callable[[], object] | None = None  # a host; called in the driver's thread when there is news
        self._bus = can.Bus(interface="virtual", channel=channel)
        self._changed = threading.Condition(threading.RLock())
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="driver")

    def __enter__(self) -> Driver:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing = True
        self._thread.join(LIMIT)
        self._bus.shutdown()
        assert not self._thread.is_alive()
        if self.failure is not None:
            raise self.failure

    @staticmethod
    def now() -> Time:
        return time.monotonic_ns()

    def do(self, command: Callable[[Time], R]) -> R:
        """Give a command to a machine, and put on the bus what follows."""
        with self._changed:
            result = command(self.now())
            self._pump()
            return result

    def add(self, make: Callable[[Outbox], M]) -> M:
        """Make a machine and attach it. Not without the lock: the thread may be at the network."""
        with self._changed:
            machine = make(self.network.out)
            self.network.attach(machine)
            return machine

    def wait(self, condition: Callable[[], R]) -> R:
        """Wait until what the condition returns is true; that."""
        end = time.monotonic() + LIMIT
        with self._changed:
            while not (result := condition()):
                assert self.failure is None, self.failure
                assert time.monotonic() < end, f"not within {LIMIT} s; events: {self.events[-10:]}"
                self._changed.wait(0.05)
            return result

    def event(self, kind: type[E], match: Callable[[E], bool] = lambda _: True) -> E:
        """Wait for an event; it and those before it are taken."""

        def find() -> list[E]:
            for position, report in enumerate(self.events):
                if isinstance(report, kind) and match(report):
                    del self.events[: position + 1]
                    return [report]
            return []

        return self.wait(find)[0]

    def outcome(self, command: Callable[[Time], RequestId]) -> Outcome:
        """Give a command that has an outcome, and wait for it."""
        request_id = self.do(command)
        return self.event(Outcome, lambda outcome: outcome.request_id == request_id)

    def run(self, procedure: Procedure[Any]) -> Any:
        """Run a procedure to its end; its result."""
        outcome = self.outcome(lambda now: self.network.run(procedure, now))
        assert isinstance(outcome, ProcedureFinished), outcome
        return outcome.result

    def _run(self) -> None:
        try:
            while not self._closing:
                with self._changed:
                    now = self.now()
                    if self.network.next_deadline() <= now:
                        self.network.handle_timeout(now)
                    self._pump()
                    nap = min((self.network.next_deadline() - now) / 1e9, LONGEST_NAP)
                message = self._bus.recv(max(nap, 0.0))  # without the lock: commands may come meanwhile
                if message is not None:
                    with self._changed:
                        self.network.receive(_frame_of(message), self.now(), int(message.timestamp * 1e9))
                        self._pump()
        except BaseException as error:
            self.failure = error
            raise

    def _pump(self) -> None:
        frames, events = self.network.drain(self.now())
        for frame in frames:
            self._bus.send(_message_of(frame))
        if events:
            self.events += events
            self._changed.notify_all()
            if self.on_events is not None:
                self.on_events()


def _frame_of(message: can.Message) -> Frame:
    flags = EXTENDED * message.is_extended_id | REMOTE * message.is_remote_frame
    return Frame(message.arbitration_id, bytes(message.data), flags, message.dlc)


def _message_of(frame: Frame) -> can.Message:
    return can.Message(
        arbitration_id=frame.can_id,
        data=frame.data,
        is_extended_id=bool(frame.flags & EXTENDED),
        is_remote_frame=bool(frame.flags & REMOTE),
        dlc=frame.dlc,
    )
