"""Wait for a drive: one kind of wait for all procedures, which ends as soon as its goal is reached or out of reach.

A `DriveWait` looks at the statusword, and at the other objects it was given, whenever a value comes. A value comes by TPDO, which
serves for 100 ms, else by SDO, 10 ms after the last answer. The reads run beside the wait: a TPDO, a lost heartbeat or a boot-up
ends it while an answer is still awaited. Values heard before the wait began do not count.

Each look checks in this order: is the drive in fault, did it leave the state that it has to stay in, does it show another mode
(0x6061), and last the judge: is the goal reached? The mode-specific bits mean something else in each mode. So if a mode has to
stay, the judge's result counts only once 0x6061 was heard after the judge first gave one: from the TPDO that carries it, else by
one more read. During the wait, a mode that no TPDO carries is read every 100 ms. If the drive refuses 0x6061, it is not read
again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Generic, TypeVar

from canopen_proto.abort import AbortOrigin
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.failures import (
    as_drive_errors,
    fault_of,
    is_loss_of,
    late,
    mode_lost,
    node_lost,
    state_lost,
    taken_down,
)
from canopen_proto.drives.axis.view import is_taken_down
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import FAULT_STATES, State, state_of
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, Outcome, RequestId, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.procedures.objects import read_int, value_of
from canopen_proto.procedures.steps import Cancelled, Procedure, SdoTransferError, Wait, current_time
from canopen_proto.remote_node import FRESH
from canopen_proto.sdo.client import SdoAborted, SdoUploaded

T = TypeVar("T")

POLL_INTERVAL: Final = 10 * MILLISECOND
"""From the answer of an SDO read to the next read of the same object, as the manual's library polled."""

_MODE: Final = objects.MODES_OF_OPERATION_DISPLAY


@as_drive_errors
def read_statusword(axis: Axis) -> Procedure[int]:
    """Return the present statusword: as heard within the last 100 ms, else read by SDO."""
    now = yield from current_time()
    statusword = axis.fresh_statusword(now)
    if statusword is None:
        statusword = yield from read_int(axis.node, objects.STATUSWORD)
    axis.was_enabled = axis.was_enabled or state_of(statusword) is State.OPERATION_ENABLED
    return statusword


@as_drive_errors
def read_position(axis: Axis) -> Procedure[float]:
    """Read the actual position (0x6064) by SDO; return it in the user's unit."""
    return axis.scale.from_counts((yield from read_int(axis.node, objects.POSITION_ACTUAL_VALUE)))


@as_drive_errors
def wait_for_statusword(
    axis: Axis,
    done: Callable[[int], bool],
    timeout: Time,
    goal: str,
    *,
    accept_fault: bool = False,
    mode: int | None = None,
    stays: State | None = None,
    looks: bool = True,
) -> Procedure[int]:
    """Wait until done(statusword) is true, at most `timeout` ns; return that statusword. It must be heard during the wait.

    mode: the mode that 0x6061 must show meanwhile; stays: the state that the drive must stay in; None: any. looks: before a
    time-out is raised, read what tells why; a halt has no time for that. Raises DriveInFaultError (unless accept_fault),
    DriveLostError, StateLostError or ModeLostError as soon as it is seen; DriveTimeoutError, which names `goal` and the obstacle;
    SdoTransferError if the statusword cannot be read.
    """
    watch: DriveWait[int] = DriveWait(axis, goal, accept_fault=accept_fault, mode=mode, stays=stays, looks=looks)
    return (yield from watch.until(lambda statusword, heard_at: statusword if done(statusword) else None, timeout))


class DriveWait(Generic[T]):
    """One wait for a drive; see this module's text. Used once."""

    def __init__(
        self,
        axis: Axis,
        goal: str,
        *,
        accept_fault: bool = False,
        mode: int | None = None,
        stays: State | None = None,
        reads: Mapping[Mux, Time] | None = None,
        looks: bool = True,
    ) -> None:
        """Prepare a wait. goal: its name in messages. mode, stays, accept_fault, looks: as in `wait_for_statusword`.

        reads: the other objects that the judge looks at, mux -> ns between two reads; the drive's dictionary must have them.
        """
        self.axis = axis
        self.goal = goal
        self.began: Time = NEVER
        self._accept_fault = accept_fault
        self._mode = mode
        self._stays = stays
        self._looks = looks
        self._pauses: dict[Mux, Time] = {objects.STATUSWORD: POLL_INTERVAL, **(reads or {})}
        if mode is not None:
            self._pauses.setdefault(_MODE, FRESH)
        self._due: dict[Mux, Time] = {}  # mux -> when to read it by SDO
        self._open: dict[RequestId, tuple[Mux, Time]] = {}  # the reads under way: mux, and when it was requested
        self._timed_out: set[Mux] = set()  # muxes whose last read was not answered
        self._refused: dict[int, SdoTransferError] = {}
        self._mode_seen: Time = -NEVER  # the mode known from 0x6061 was in force at this time or later
        self._reached_at: Time | None = None  # since when the judge gives a result

    def heard(self, mux: Mux) -> Time | None:
        """Return when the drive last sent the value of an object, since the wait began; None: not yet."""
        heard_at = self.axis.node.heard_at.get(mux)
        return heard_at if heard_at is not None and heard_at >= self.began else None

    def refusal(self, mux: Mux) -> SdoTransferError | None:
        """Return the error with which the drive refused to have an object read; None if it did not."""
        return self._refused.get(mux)

    def until(self, judge: Callable[[int, Time], T | None], timeout: Time) -> Procedure[T]:
        """Wait until judge(statusword, time it was heard) gives a result, at most `timeout` ns; return that result.

        The judge is called at each look, and may raise. Else as `wait_for_statusword`.
        """
        axis, node = self.axis, self.axis.node
        self.began = yield from current_time()
        deadline = self.began + timeout
        for mux, pause in self._pauses.items():
            known_at = node.heard_at.get(mux, -NEVER) if mux == _MODE and self._mode is not None else -NEVER
            self._due[mux] = max(self.began, known_at + pause)
        try:
            while True:
                now = yield from current_time()
                result = yield from self._look(judge, now)
                if result is not None:
                    return result
                if now >= deadline and self.heard(objects.STATUSWORD) is not None:
                    self._take_back(now)
                    failed = f"did not reach {self.goal} within {timeout / SECOND:g} s"
                    raise (yield from late(axis, failed, looks=self._looks))
                self._ask(now)
                wake = min(time for time in (deadline, *self._due.values(), NEVER) if time > now)
                report = yield Wait(wake - now, node, self._concerns)
                if report is not None:
                    self._take(report, (yield from current_time()))
        except (Cancelled, Exception):
            self._take_back((yield from current_time()))
            raise

    def _look(self, judge: Callable[[int, Time], T | None], now: Time) -> Procedure[T | None]:
        axis = self.axis
        heard_at = self.heard(objects.STATUSWORD)
        if heard_at is None:
            return None
        statusword = axis.statusword
        state = state_of(statusword)
        axis.was_enabled = axis.was_enabled or state is State.OPERATION_ENABLED
        if state in FAULT_STATES and not self._accept_fault:
            raise (yield from fault_of(axis, f"while waiting for {self.goal}"))
        if self._stays is not None and state is not self._stays:
            if state is State.UNKNOWN:
                return None  # no state at all: the next statusword will show one
            raise state_lost(axis, state, self.goal)
        if self._stays is State.OPERATION_ENABLED and axis.occupancy.occupant is not None and is_taken_down(axis):
            raise taken_down(axis)  # a word of ours may have crossed the other master's on the bus, and have enabled it again
        if self._mode is not None and _MODE in axis.node.heard_at and axis.mode != self._mode:
            raise mode_lost(axis, self._mode, self.goal)
        result = judge(statusword, heard_at)
        if result is None:
            self._reached_at = None
        elif self._mode is not None and _MODE not in self._refused:
            if self._reached_at is None:
                self._reached_at = now
            if self._mode_seen < self._reached_at:
                self._due[_MODE] = min(self._due[_MODE], now)
                return None
        return result

    def _ask(self, now: Time) -> None:
        """Read by SDO each object that is due."""
        node = self.axis.node
        for mux, due in self._due.items():
            if due <= now:
                # Urgent: a wait for a drive must not queue behind a backup of it.
                request_id = node.read(mux, now, urgent=True)
                self._open[request_id] = (mux, now)
                self._due[mux] = NEVER

    def _concerns(self, report: Event) -> bool:
        """Return whether the wait has to look at an event."""
        if isinstance(report, Outcome):
            return report.request_id in self._open
        node = self.axis.node
        return is_loss_of(node, report) or (isinstance(report, PdoReceived) and report.node_id == node.node_id)

    def _take(self, report: Event, now: Time) -> None:
        match report:
            case PdoReceived(mapping=mapping):
                on_device = self.axis.node.on_device
                for mux, due in self._due.items():
                    if due != NEVER and on_device(mux) in mapping.muxes:
                        self._due[mux] = now + FRESH
                if on_device(_MODE) in mapping.muxes:
                    self._mode_seen = now
            case SdoUploaded() | SdoAborted():
                mux, asked_at = self._open.pop(report.request_id)
                self._take_answer(report, mux, asked_at, now)
            case _:
                raise node_lost(self.axis, report, self.goal)

    def _take_answer(self, report: SdoUploaded | SdoAborted, mux: Mux, asked_at: Time, now: Time) -> None:
        node = self.axis.node
        self._due[mux] = now + self._pauses[mux]
        if isinstance(report, SdoUploaded):
            value_of(node, node.dictionary.variable(mux), report)
            self._timed_out.discard(mux)
            if mux == _MODE:
                self._mode_seen = asked_at
        elif mux == objects.STATUSWORD or mux in self._timed_out:
            raise SdoTransferError(report, "reading")
        elif report.origin is AbortOrigin.PEER:
            self._refused[mux] = SdoTransferError(report, "reading")
            self._due[mux] = NEVER
        else:
            self._timed_out.add(mux)  # a single frame may have been lost

    def _take_back(self, now: Time) -> None:
        """Cancel the reads under way, so that what follows, perhaps a halt, does not wait for them."""
        for request_id in self._open:
            self.axis.node.cancel(request_id, now)
        self._open.clear()
