"""`Occupancy`: the one motion command that an axis executes, and the stops that run on it. See exclusive_motion.py."""

from __future__ import annotations


class Occupant:
    """A command that moves an axis. name: for messages, as "move_to" or "chain arm". is_ending: it failed or was cancelled, and
    halts the axis. taken_over_by: the stop that ended it; "" if none did.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.is_ending = False
        self.taken_over_by = ""


class Occupancy:
    """See this module's text. occupant: None if nothing moves the axis. stops: how many run. stops_begun: how many have begun so
    far; last_stop: the name of the last one. is_inside: whether code of one of these procedures runs at this moment, so that
    those it calls are parts of it.
    """

    def __init__(self) -> None:
        self.occupant: Occupant | None = None
        self.stops = self.stops_begun = 0
        self.last_stop = ""
        self.is_inside = False

    @property
    def is_being_stopped(self) -> bool:
        """Whether a stop runs, or has taken over from what moves the axis: nothing else may command it."""
        return self.stops > 0 or (self.occupant is not None and bool(self.occupant.taken_over_by))

    def occupy(self, name: str) -> Occupant:
        """Note what moves the axis from now on, for longer than a procedure: `release` ends it. The caller looks at
        `taken_over_by`. name: of the command, for error texts."""
        self.occupant = Occupant(name)
        return self.occupant

    def release(self, occupant: Occupant | None) -> None:
        """End it. Does nothing if another one occupies the axis, or None is given. occupant: what `occupy` returned."""
        if occupant is not None and self.occupant is occupant:
            self.occupant = None

    def take_over(self, name: str) -> bool:
        """Note a stop that begins. Tell the occupant that it ends it; return whether there is one that has not been told. name:
        of the stop, for error texts."""
        self.stops_begun, self.last_stop = self.stops_begun + 1, name
        occupant = self.occupant
        if occupant is None or occupant.taken_over_by:
            return False
        occupant.taken_over_by, occupant.is_ending = name, True
        return True
