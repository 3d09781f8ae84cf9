"""One motion command at a time on each axis: `moves` and `stops` wrap the procedures that command a drive.

**A motion** (`moves`: move_to, home, run_at, set_mode, enable ...) is refused with AxisBusyError, before anything is sent, while
another one is under way. It waits while the axis is being halted: by a stop, or as the clean-up of a motion that failed or was
cancelled. A stop that begins meanwhile ends it, too. A motion enables no drive that somebody else has disabled since it began.

**A stop** (`stops`: halt, quick_stop, and what leads a drive down) begins at once. The motion under way ends with TakenOverError
as soon as its present step ends (10 ms, or an answer), and sends no further controlword. A controlword of it that waits behind
another SDO transfer is given up: the stop goes before it, and would be undone by it. The stop is responsible for the axis from
then on: if it fails or is cancelled, the axis is halted.

A procedure that another one calls (`yield from`) is a part of it. A chain that follows set-points occupies its joints.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, Final, ParamSpec, TypeVar

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.failures import AxisBusyError, TakenOverError
from canopen_proto.drives.axis.occupancy import Occupant
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import MILLISECOND
from canopen_proto.procedures.steps import Cancelled, Procedure, act, current_time, sleep

T = TypeVar("T")
P = ParamSpec("P")

LOOK: Final = 10 * MILLISECOND
"""Between two looks whether a halt under way has ended."""


def moves(procedure: Callable[Concatenate[Axis, P], Procedure[T]]) -> Callable[Concatenate[Axis, P], Procedure[T]]:
    """Let a procedure be the only motion of its axis; see this module's text."""
    name = procedure.__name__.strip("_")

    @wraps(procedure)
    def run(axis: Axis, /, *args: P.args, **kwargs: P.kwargs) -> Procedure[T]:
        occupancy = axis.occupancy
        if occupancy.is_inside:
            return (yield from procedure(axis, *args, **kwargs))
        stops_before = occupancy.stops_begun
        while occupancy.stops or occupancy.occupant is not None:
            if occupancy.occupant is not None and not occupancy.occupant.is_ending:
                raise AxisBusyError(axis, name, occupancy.occupant.name)
            yield from sleep(LOOK)
            if occupancy.stops_begun != stops_before:
                raise TakenOverError(axis, name, occupancy.last_stop)
        occupant = occupancy.occupy(name)
        axis.was_enabled = axis.was_taken_down = False
        try:
            axis.motion_began = yield from current_time()
            return (yield from _inside(axis, procedure(axis, *args, **kwargs), occupant))
        finally:
            occupancy.release(occupant)

    return run


def stops(
    clean_up: Callable[[Axis, BaseException], Procedure[None]] | None,
) -> Callable[[Callable[Concatenate[Axis, P], Procedure[T]]], Callable[Concatenate[Axis, P], Procedure[T]]]:
    """Let a procedure take the place of any motion of its axis; see this module's text.

    clean_up: halts an axis whose motion was taken over by a stop that fails or is cancelled; None: the procedure does it itself.
    """

    def wrap(procedure: Callable[Concatenate[Axis, P], Procedure[T]]) -> Callable[Concatenate[Axis, P], Procedure[T]]:
        name = procedure.__name__.strip("_")

        @wraps(procedure)
        def run(axis: Axis, /, *args: P.args, **kwargs: P.kwargs) -> Procedure[T]:
            occupancy = axis.occupancy
            if occupancy.is_inside:
                return (yield from procedure(axis, *args, **kwargs))
            has_taken_over = occupancy.take_over(name)
            occupancy.stops += 1
            try:
                if occupancy.stops == 1:  # else what waits is another stop's
                    yield from act(lambda now: axis.node.drop_waiting(objects.CONTROLWORD, now))
                return (yield from _inside(axis, procedure(axis, *args, **kwargs), None))
            except (Cancelled, Exception) as cause:
                if has_taken_over and clean_up is not None:
                    yield from _inside(axis, clean_up(axis, cause), None)
                raise
            finally:
                occupancy.stops -= 1

        return run

    return wrap


def _inside(axis: Axis, procedure: Procedure[T], occupant: Occupant | None) -> Procedure[T]:
    """Run a procedure as `yield from` does. All that it calls is a part of it. An occupant that is taken over gets
    TakenOverError."""
    occupancy = axis.occupancy
    answer: object = None
    error: BaseException | None = None
    has_been_told = False
    while True:
        occupancy.is_inside = True
        try:
            step = procedure.send(answer) if error is None else procedure.throw(error)
        except StopIteration as stop:
            result: T = stop.value
            return result
        finally:
            occupancy.is_inside = False
        try:
            answer, error = (yield step), None
        except GeneratorExit:
            procedure.close()
            raise
        except (Cancelled, Exception) as raised:  # noqa: BLE001 - whatever a step raises is the procedure's to handle
            error = raised
        if occupant is not None and occupant.taken_over_by and not has_been_told and not isinstance(error, Cancelled):
            has_been_told = True
            error = TakenOverError(axis, occupant.name, occupant.taken_over_by)
