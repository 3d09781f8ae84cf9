"""`Following`: the master's watch on whether one drive follows its set-points, by what the drive sends each cycle.

A drive that stops following shows that in its next PDO, or sends none: the master has no other sign. `begin` starts the watch,
`end` ends it. In between, each value that comes, by PDO or SDO, is judged at once, and each SYNC judges what did not come. RULES
has the rules. The first one that speaks is reported as `FollowingLost`, in words, and the watch is over.

    mode               0x6061 shows another mode of operation
    state              the statusword shows another state than Operation enabled
    bit 12             "interpolation active", or "follows the command", is 0
    bit 13             "following error" is 1
    bit 11             "internal limit" is 1 in two statuswords in a row: a drive may cut a single step; in more of them
                       (`catches_up`) if it limits its acceleration; not for CATCH_UP_TIME after a SYNC at the wrong time
    following error    the position is further off the set-points than the limit; see following_error.py
    bounds             position or speed left the limits, of a drive that is commanded no position; see bounds.py
    NMT state          a heartbeat shows that the node is no longer Operational
    silence            a value sent at SYNCs did not come for SILENT_SYNCS of them in a row, and for SILENT_TIME at least
    set-points         a drive that is commanded no position got no new set-point
    boot-up            the node was reset, or lost its power

Bits 11 and 13 may be set when the watch begins. Such a bit counts only after it was seen 0 (bit 13 is reserved in interpolated
position mode; drives use it). They do not count for a drive that follows velocities or torques: limits of torque and speed are
what such a drive works against.

**Late SYNC.** A drive that gets its SYNC late, because the computer that sends it was busy, may stop following for no other
reason. `late_sync` tells by how much SYNC was late, so that an error can name that cause first.

The procedures beside the watch are in following_procedures.py.

Source: IEC 61800-7-201 (CiA 402-2): statusword, interpolated position mode, cyclic synchronous position mode, following error.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Final, NamedTuple

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.bounds import MAX_MISSED, MotionBounds
from canopen_proto.drives.axis.following_error import LAG, UNCERTAIN, FollowingError
from canopen_proto.drives.axis.limits import Limit
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, ModeStatus, mode_name
from canopen_proto.drives.cia402.states import State, StatusBit
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, Time
from canopen_proto.multiplexer import Mux, index_of
from canopen_proto.nmt import NmtState

SILENT_SYNCS: Final = 3
"""More than one: a drive is not lost because a frame is."""
SILENT_TIME: Final = 20 * MILLISECOND
"""An adapter may hold frames back this long (a serial one over USB: 16 ms by default)."""
LATE_SYNC_TIME: Final = SECOND
"""A SYNC that was late within this time may be why a drive does not follow."""
CATCH_UP_TIME: Final = 200 * MILLISECOND
"""A drive that limits its speed gets back to its set-points in this time, if a SYNC came at the wrong time."""

_FOLLOWS: Final = ModeStatus.IP_MODE_ACTIVE
assert _FOLLOWS == ModeStatus.FOLLOWS_COMMAND  # bit 12 in interpolated position and in the cyclic synchronous modes alike
_COUNTED: Final = StatusBit.INTERNAL_LIMIT | ModeStatus.FOLLOWING_ERROR
_NAMES: Final[dict[Mux, str]] = {
    objects.STATUSWORD: "statusword",
    objects.MODES_OF_OPERATION_DISPLAY: "mode (0x6061)",
    objects.POSITION_ACTUAL_VALUE: "position",
    objects.VELOCITY_ACTUAL_VALUE: "velocity",
}
_WATCHED: Final = (objects.STATUSWORD, objects.MODES_OF_OPERATION_DISPLAY, objects.POSITION_ACTUAL_VALUE)


class FollowingLost(Event):
    """A drive no longer follows its set-points; reported once for each `Following.begin`.

    cause: in words, as "no longer follows ...". is_silent: its PDOs stopped coming. still_follows: the drive goes on to follow
    its set-points, though not as it should. axis: of the node. late: by how many SYNCs its positions come late, which is why it
    seems to be off its path; 0: they come in time.
    """

    __match_args__ = ("node_id", "cause", "is_silent", "still_follows", "axis", "late")

    def __init__(
        self, node_id: int, cause: str, is_silent: bool = False, still_follows: bool = False, axis: int = 0, late: int = 0
    ) -> None:
        self.node_id = node_id
        self.axis = axis
        self.cause = cause
        self.is_silent = is_silent
        self.still_follows = still_follows
        self.late = late


class TurnToRead(Event):
    """It is this drive's turn to have an object read: see `Following.await_turn`. axis: of the node."""

    __match_args__ = ("node_id", "axis")

    def __init__(self, node_id: int, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis


# ---- what the rules judge ----


class _Bits:
    """The bits of the statusword. word: the last one. news: its bits 11 and 13 that count, and were seen 0 before. limited:
    statuswords in a row with such a bit 11."""

    def begin(self, word: int, counted: int) -> None:
        """counted: those of bits 11 and 13 that count."""
        self.word = word
        self.news = self.limited = 0
        self._counted, self._old = counted, word
        self._judged: int | None = None  # a statusword in which nothing was found

    def on_word(self, word: int, forgiven: int) -> bool:
        """Take note of a statusword; return whether there is anything to judge. forgiven: unless 0, bit 11 does not count."""
        if word == self._judged:
            self.limited = 0
            return False
        self._old &= word
        self.word, self.news = word, word & ~self._old & self._counted
        has_limit = bool(self.news & StatusBit.INTERNAL_LIMIT)
        self.limited = self.limited + 1 if has_limit and not forgiven else 0
        self._judged = None if has_limit else word
        return True


class _Silence:
    """Which of the objects that are sent at SYNCs do not come. found: the one that is silent, for how many ms, behind how many
    SYNCs; None: none is. It is judged by unanswered SYNCs, not by time: if we stalled and sent none, the drive was not silent."""

    def __init__(self, axis: Axis) -> None:
        self.found: tuple[str, float, int] | None = None
        self.max_syncs = SILENT_SYNCS
        self._axis = axis
        self.expect({})

    def expect(self, cyclic: Mapping[Mux, int]) -> None:
        """As `Following.expect`."""
        self.found = None
        self._cyclic = cyclic
        self._pdo: Collection[Mux] | None = None  # the objects of a PDO that brings all expected ones
        self._is_answered = False  # all expected objects came since the last SYNC
        self._all_heard: tuple[int, Time] | None = None  # one SYNC, and its time: the last one with `_is_answered`
        self._unanswered: dict[Mux, tuple[int, Time]] = {}  # since then: SYNCs since a mux was heard, time of the first of them

    def on_values(self, muxes: Collection[Mux]) -> None:
        """Take note of objects that have come."""
        if muxes is self._pdo:
            self._is_answered = True
        elif len(muxes) >= len(self._cyclic) and self._cyclic.keys() <= set(muxes):
            self._pdo, self._is_answered = muxes, True

    def on_sync(self, now: Time) -> bool:
        """Take note of a SYNC, and see what did not come since the last ones; return whether all came since the last one."""
        if self._is_answered:
            self._is_answered, self._all_heard = False, (1, now)
            self._unanswered.clear()
            return True
        heard_at, just_begun = self._axis.node.heard_at, (1, now)
        for mux, every in self._cyclic.items():
            silence = self._unanswered.get(mux, self._all_heard)
            if silence is None or heard_at.get(mux, -NEVER) >= silence[1]:
                self._unanswered[mux] = just_begun
                continue
            unanswered, first = silence
            if unanswered >= self.max_syncs * every and now - first >= SILENT_TIME:
                self.found = _NAMES.get(mux, f"0x{index_of(mux):04X}"), (now - first) / MILLISECOND, unanswered
                break
            self._unanswered[mux] = unanswered + 1, first
        return False


class _SyncTiming:
    """Whether SYNC comes when the drive expects it. forgiven: SYNCs for which the drive may still need to get back to its
    set-points, behind one that came at another time."""

    def begin(self, period: Time, *, forgives: bool) -> None:
        """period: ns from SYNC to SYNC; 0: not known, and nothing is judged."""
        self._period, self._forgives = period, forgives
        self._quarter = period // 4  # what comes this much later or earlier is in time
        self.forgiven = 0
        self._latest: Time = 0  # the most by which a SYNC was late since `_late_at` - LATE_SYNC_TIME
        self._late_at: Time = 0
        self._last: Time | None = None

    def on_sync(self, now: Time) -> None:
        """Take note of a SYNC."""
        if not self._period:
            return
        before, self._last = self._last, now
        late = 0 if before is None else now - before - self._period
        if not -self._quarter <= late <= self._quarter:
            if late > 0 and late >= (self._latest if now - self._late_at <= LATE_SYNC_TIME else 0):
                self._latest, self._late_at = late, now
            self.forgiven = -(-CATCH_UP_TIME // self._period) if self._forgives else 0
        elif self.forgiven:
            self.forgiven -= 1

    def late(self, now: Time | None) -> Time:
        """Return by how many ns SYNC was late, at most, within LATE_SYNC_TIME; one that is due and has not come is late, too.
        now: None: when the last SYNC came."""
        if self._last is None:
            return 0
        now = self._last if now is None else now
        waited = now - self._last - self._period
        recent = self._latest if now - self._late_at <= LATE_SYNC_TIME else 0
        return max(recent, waited if waited > self._quarter else 0)


# ---- the watch ----


class Following:
    """The watch on one drive; see this module's text. Each Axis has one, for its whole life.

    axis: the drive. is_on: whether it is watched, and has followed so far. deviation: its following error. late_sync: by how many
    ns SYNC was late, at most, within LATE_SYNC_TIME before the watch found something; 0: it was in time, or its period is not
    known. unsent: muxes of watched objects that the drive does not send at SYNCs. The other attributes are for RULES.
    """

    def __init__(self, axis: Axis) -> None:
        self.axis = axis
        self.is_on = False
        self.deviation = FollowingError(axis)
        self.late_sync: Time = 0
        self.unsent: set[Mux] = set()
        self.mode = 0
        self.has_bit_12 = True
        self.catches_up = 1
        self.bits = _Bits()
        self.silence = _Silence(axis)
        self._timing = _SyncTiming()
        self.bounds: MotionBounds | None = None  # of a drive that follows velocities or torques
        self.nmt_state: NmtState | None = None  # when the watch began
        self._syncs_to_turn = 0  # 0: no turn is awaited
        self._turn_not_before: Time = 0
        axis.node.add_listener(self._on_values, self._on_boot, self._on_sync)

    @property
    def error(self) -> float:
        """The following error as last seen, in the user's unit; 0 while the watch is off."""
        return self.deviation.present

    @property
    def largest_error(self) -> float:
        """The largest absolute following error so far; the caller may set it back to 0."""
        return self.deviation.largest

    @largest_error.setter
    def largest_error(self, error: float) -> None:
        self.deviation.largest = error

    @property
    def limit(self) -> Limit:
        """How far off its set-points the drive may be, in the user's unit, as `begin` was told."""
        return self.deviation.limit

    def begin(
        self,
        limit: Limit,
        mode: int,
        *,
        cyclic: Mapping[Mux, int],
        lag: int = LAG,
        slack: int = UNCERTAIN,
        catches_up: int = 1,
        silent_syncs: int = SILENT_SYNCS,
        period: Time = 0,
        forgives: bool = True,
    ) -> None:
        """Watch the drive from now on. It must already follow set-points (bit 12), and stand at the present one.

        limit: of the following error, in the user's unit. mode: the mode of operation that 0x6061 has to show. cyclic: as for
        `expect`. lag: SYNCs from sending a set-point to reaching it. slack: further SYNCs that the drive may be behind;
        more than UNCERTAIN for a drive with a profile of its own. catches_up: statuswords in a row in which bit 11 is no finding.
        silent_syncs: unanswered SYNCs in a row that make the drive count as silent. period: ns from SYNC to SYNC; 0: not known.
        forgives: behind a SYNC that comes at another time, bit 11 is no finding for CATCH_UP_TIME.
        """
        self.bounds, self.catches_up = None, catches_up
        self.deviation.begin(limit, lag, slack)
        self._timing.begin(period, forgives=forgives)
        self._begin(mode, cyclic, silent_syncs)

    def begin_with_bounds(
        self,
        bounds: MotionBounds,
        mode: int,
        *,
        cyclic: Mapping[Mux, int],
        silent_syncs: int = SILENT_SYNCS,
        max_missed: int = MAX_MISSED,
    ) -> None:
        """Watch a drive that follows velocities or torques (csv, cst) from now on; see bounds.py. `watch_bounds` halts it, too.

        It has no following error: its position and its speed must stay within `bounds`, and it must get a new set-point at each
        SYNC, or one of `max_missed` + 1 in a row. mode, cyclic, silent_syncs: as of `begin`.
        """
        self.bounds = bounds
        bounds.expect_set_points(mode, max_missed)
        self._timing.begin(0, forgives=False)
        self._begin(mode, cyclic, silent_syncs)

    def _begin(self, mode: int, cyclic: Mapping[Mux, int], silent_syncs: int) -> None:
        self.mode = mode
        # In profile position mode, bit 12 is part of a handshake
        self.has_bit_12 = mode != Mode.PROFILE_POSITION and self.axis.settings.shows_following
        self.silence.max_syncs = silent_syncs
        self.expect(cyclic)
        self.nmt_state = self.axis.node.nmt_state
        self.bits.begin(self.axis.statusword, 0 if self.bounds else _COUNTED)
        self.deviation.present = 0.0
        self.is_on = True

    def expect(self, cyclic: Mapping[Mux, int]) -> None:
        """Expect objects at SYNCs. Other watched objects that the drive has are `unsent`.

        cyclic: mux -> n for "at every n-th SYNC".
        """
        self.silence.expect(cyclic)
        watched = (*_WATCHED, *(self.bounds.watched if self.bounds else ()))
        self.unsent = {mux for mux in watched if mux not in cyclic and mux in self.axis.node.dictionary}

    def end(self) -> None:
        """End the watch: no more set-points follow."""
        self.is_on = False
        self.deviation.present = 0.0

    def lose(self, cause: str, *, is_silent: bool = False, still_follows: bool = False, late: int = 0) -> None:
        """End the watch with FollowingLost, if it is on: for a cause that only the caller can see.

        cause, is_silent, still_follows, late: as of FollowingLost.
        """
        if self.is_on:
            self.is_on = False
            node = self.axis.node
            self.late_sync = self._timing.late(max(node.heard_at.values(), default=None))
            node.out.events.append(FollowingLost(node.node_id, cause, is_silent, still_follows, self.axis.number, late))

    def await_turn(self, syncs: int, not_before: Time) -> None:
        """Report TurnToRead once: at the SYNC after `syncs` - 1 others, or at the first later one that comes `not_before` (ns).

        It is counted here, where each SYNC comes anyway, so that no procedure is asked about each SYNC.
        """
        self._syncs_to_turn, self._turn_not_before = syncs, not_before

    def _judge(self, looked_at: Mux | str) -> None:
        """Report the first rule that speaks."""
        for rule in _RULES_FOR[looked_at]:
            values = rule.speaks(self)
            if values is not None:
                late = self.deviation.late() if looked_at == objects.POSITION_ACTUAL_VALUE else 0
                self.lose(rule.text.format(*values), is_silent=rule.is_silent, still_follows=rule.still_follows, late=late)
                return

    def _on_values(self, muxes: Collection[Mux], now: Time) -> None:
        if not self.is_on:
            return
        self.silence.on_values(muxes)
        if _MODE in muxes:
            self._judge(_MODE)
        if _WORD in muxes and self.bits.on_word(self.axis.statusword, self._timing.forgiven):
            self._judge(_WORD)
        if self.bounds is not None:
            self._judge(_BOUNDS)
        elif objects.POSITION_ACTUAL_VALUE in muxes and self.deviation.on_position(muxes):
            self._judge(objects.POSITION_ACTUAL_VALUE)

    def _on_boot(self) -> None:
        self._judge(_BOOT_UP)

    def _on_sync(self, now: Time) -> None:
        if not self.is_on:
            return
        if not self.silence.on_sync(now) or self.axis.node.nmt_state is not NmtState.OPERATIONAL:
            self._judge(_SYNC)
        if self.bounds is not None:
            self._judge(_SET_POINTS)
        else:
            self._timing.on_sync(now)
            self.deviation.on_sync()
        if self._syncs_to_turn > 1:
            self._syncs_to_turn -= 1
        elif self._syncs_to_turn and now >= self._turn_not_before:
            self._syncs_to_turn = 0
            self.axis.node.out.events.append(TurnToRead(self.axis.node.node_id, self.axis.number))


# ---- the rules ----

_MODE: Final = objects.MODES_OF_OPERATION_DISPLAY
_WORD: Final = objects.STATUSWORD
_BOUNDS: Final = "position and speed"
_SYNC: Final = "SYNC"
_SET_POINTS: Final = "set-points"
_BOOT_UP: Final = "boot-up"
_BIT_12: Final = "no longer follows its set-points: bit 12 of its statusword is 0 (missed one, halted, another mode)"
_BIT_11: Final = "is held by a limit of its own: bit 11 of its statusword is 1 (position 0x607D, speed, torque or current)"
_OFF: Final = "is {:.4g} off its path: it is at {:.4g} and should be at {:.4g}; the limit is {:.4g}, by {}"
_SILENT: Final = "is silent: no PDO with its {} for {:.3g} ms, behind {} SYNCs"


class FollowingRule(NamedTuple):
    """A rule of the watch.

    name: as in this module's text. looks_at: the object that it judges when its value comes, or what else it judges. speaks:
    returns the values for the text if the drive breaks the rule, else None. text: what the drive did, in words. still_follows,
    is_silent: as of FollowingLost.
    """

    name: str
    looks_at: Mux | str
    speaks: Callable[[Following], tuple[object, ...] | None]
    text: str
    still_follows: bool = False
    is_silent: bool = False


def _other_mode(watch: Following) -> tuple[str, str] | None:
    shown = watch.axis.mode
    return None if shown == watch.mode else (mode_name(shown or 0), mode_name(watch.mode))


def _other_state(watch: Following) -> tuple[State] | None:
    state = watch.axis.state
    return None if state is State.OPERATION_ENABLED else (state,)


def _bit_12_is_0(watch: Following) -> tuple[()] | None:
    return None if watch.bits.word & _FOLLOWS or not watch.has_bit_12 else ()


def _bit_13_is_1(watch: Following) -> tuple[()] | None:
    return () if watch.bits.news & ModeStatus.FOLLOWING_ERROR else None


def _bit_11_is_1(watch: Following) -> tuple[()] | None:
    return () if watch.bits.limited > watch.catches_up else None


def _left_operational(watch: Following) -> tuple[str] | None:
    state = watch.axis.node.nmt_state
    return None if state in (None, NmtState.OPERATIONAL, watch.nmt_state) else (state.name,)


def _out_of_bounds(watch: Following) -> tuple[str] | None:
    words = watch.bounds.judge() if watch.bounds else ""
    return (words,) if words else None


def _no_set_point(watch: Following) -> tuple[str] | None:
    words = watch.bounds.on_sync() if watch.bounds else ""
    return (words,) if words else None


RULES: Final = (
    FollowingRule("mode", _MODE, _other_mode, "changed its mode of operation: 0x6061 shows {}, not {}"),
    FollowingRule("state", _WORD, _other_state, "left operation enabled by itself: {}"),
    FollowingRule("bit 12", _WORD, _bit_12_is_0, _BIT_12),
    FollowingRule("bit 13", _WORD, _bit_13_is_1, "reports a following error: bit 13 of its statusword is 1", still_follows=True),
    FollowingRule("bit 11", _WORD, _bit_11_is_1, _BIT_11, still_follows=True),
    FollowingRule(
        "following error", objects.POSITION_ACTUAL_VALUE, lambda watch: watch.deviation.excess(), _OFF, still_follows=True
    ),
    FollowingRule("bounds", _BOUNDS, _out_of_bounds, "{}"),
    FollowingRule("NMT state", _SYNC, _left_operational, "left NMT state Operational: {}"),
    FollowingRule("silence", _SYNC, lambda watch: watch.silence.found, _SILENT, is_silent=True),
    FollowingRule("set-points", _SET_POINTS, _no_set_point, "{}"),
    FollowingRule("boot-up", _BOOT_UP, lambda watch: (), "was reset, or lost its power"),
)
_RULES_FOR: Final = {each.looks_at: tuple(rule for rule in RULES if rule.looks_at == each.looks_at) for each in RULES}
