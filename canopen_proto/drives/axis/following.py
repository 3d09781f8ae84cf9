"""`Following`: the master's watch on whether one drive follows its set-points, by what the drive sends each cycle.

A drive that stops following shows that in its next PDO, or sends none: the master has no other sign. `begin` starts the watch,
`end` ends it. In between, each value that comes, by PDO or SDO, is judged at once, and each SYNC judges what did not come:

    state              the statusword shows another state than Operation enabled
    mode               0x6061 shows another mode of operation
    bit 12             "interpolation active", or "follows the command", is 0
    bit 13             "following error" is 1
    bit 11             "internal limit" is 1 in two statuswords in a row: a drive may cut a single step; in more of them
                       (`catches_up`) if it limits its acceleration; not for CATCH_UP_TIME after a SYNC at the wrong time
    following error    the position is further off the set-points than the limit
    silence            a value sent at SYNCs did not come for SILENT_SYNCS of them in a row, and for SILENT_TIME at least
    NMT state          a heartbeat shows that the node is no longer Operational
    boot-up            the node was reset, or lost its power

The first of these is reported as `FollowingLost`, in words, and the watch is over. Bits 11 and 13 may be set when the watch
begins. Such a bit counts only after it was seen 0 (bit 13 is reserved in interpolated position mode; drives use it).

**Following error.** `error` is the set-point of a cycle minus the position of the same cycle: a set-point sent behind SYNC n is
reached at SYNC n + `lag`, whose PDO shows it. This pairing may be some cycles wrong: adapters hold frames back, and drives buffer
set-points. So the limit is compared with the distance from the position to the nearest set-point, up to UNCERTAIN cycles earlier
or later. A drive in profile position has a profile of its own, and may be further behind (`slack`): it is seen that much later
that such a drive has stopped.

Values that no PDO carries (`unsent`) must be read: `read_unsent` (unsent.py) does that. `following_limit` finds the limit.

**Late SYNC.** A drive that gets its SYNC late, because the computer that sends it was busy, may stop following for no other
reason. `late_sync` tells by how much SYNC was late, so that an error
can name that cause first.

**Late positions.** On a bus without room, positions come late, and look like a following error: answer_delay.py tells them apart.

    limit = yield from following_limit(axis, (yield from read_limits(axis)))
    yield from start_interpolation(axis, cycle_time)
    following.begin(limit, Mode.INTERPOLATED_POSITION, cyclic={STATUSWORD: 1, POSITION_ACTUAL_VALUE: 1})
    network.run(read_unsent([following]), now)

Source: IEC 61800-7-201 (CiA 402-2): statusword, interpolated position mode, cyclic synchronous position mode, following error.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping
from typing import Final

from canopen_proto.drives.axis.answer_delay import AnswerDelay
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.bounds import MAX_MISSED, Bounds
from canopen_proto.drives.axis.failures import accounted
from canopen_proto.drives.axis.limits import DEFAULT_SPEED, Limit, SetPointLimits
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, ModeStatus, mode_name
from canopen_proto.drives.cia402.states import State, StatusBit
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, Time
from canopen_proto.multiplexer import Mux, index_of
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.objects import read_if_present
from canopen_proto.procedures.steps import (
    Procedure,
)

LAG: Final = 2
"""SYNCs from sending a set-point to reaching it: sent behind SYNC n, taken at n + 1, reached at n + 2, whose PDO shows it."""
UNCERTAIN: Final = 2
"""How many cycles earlier or later the set-point of a position may lie."""
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
_OWN_LIMITS: Final = "(position 0x607D, speed, torque or current)"
_NO_NEWS: Final = StatusBit.INTERNAL_LIMIT | ModeStatus.FOLLOWING_ERROR
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

    __slots__ = ("axis", "cause", "is_silent", "late", "still_follows")
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

    __slots__ = ("axis",)
    __match_args__ = ("node_id", "axis")

    def __init__(self, node_id: int, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis


class Following:
    """The watch on one drive; see this module's text. Each Axis has one, for its whole life.

    error: the following error as last seen, in the user's unit; 0 while the watch is off. largest_error: the largest so far; the
    caller may set it back to 0. late_sync: by how many ns SYNC was late, at most, within LATE_SYNC_TIME before the watch found
    something; 0: it was in time, or its period is not known. unsent: muxes of watched objects that the drive does not send at
    SYNCs.
    """

    __slots__ = (
        "_all_heard",
        "_axis",
        "_bounds",
        "_catches_up",
        "_cyclic",
        "_delay",
        "_flawless",
        "_forgiven",
        "_forgives",
        "_has_bit_12",
        "_is_answered",
        "_is_on",
        "_lag",
        "_last_sync",
        "_late_at",
        "_latest",
        "_limit",
        "_limited",
        "_mode",
        "_nmt_state",
        "_old_bits",
        "_pdo",
        "_period",
        "_points",
        "_silent_syncs",
        "_syncs_to_turn",
        "_turn_not_before",
        "_unanswered",
        "_watched",
        "error",
        "largest_error",
        "late_sync",
        "unsent",
    )

    def __init__(self, axis: Axis) -> None:
        self._axis = axis
        self._is_on = False
        self._mode = 0
        self._has_bit_12 = True
        self._bounds: Bounds | None = None
        self._watched: tuple[Mux, ...] = _WATCHED
        self._limit = Limit(0.0, "")
        self._lag = LAG
        self._points: deque[int] = deque()  # the set-points of the last cycles, in counts
        self._delay = AnswerDelay()
        self._cyclic: Mapping[Mux, int] = {}
        self._silent_syncs = SILENT_SYNCS
        self._pdo: Collection[Mux] | None = None  # the objects of a PDO that brings all expected ones
        self._is_answered = False  # all expected objects came since the last SYNC
        self._all_heard: tuple[int, Time] | None = None  # one SYNC, and its time: the last one with `_is_answered`
        self._unanswered: dict[Mux, tuple[int, Time]] = {}  # since then: SYNCs since a mux was heard, time of the first of them
        self._nmt_state: NmtState | None = None
        self._old_bits = 0
        self._flawless: int | None = None  # a statusword in which nothing was found
        self._limited = 0  # statuswords in a row with bit 11
        self._period, self._forgiven = 0, 0  # SYNCs until bit 11 counts again
        self._forgives = True
        self._latest: Time = 0  # the most by which a SYNC was late since `_late_at` - LATE_SYNC_TIME
        self._late_at: Time = 0
        self._last_sync: Time | None = None
        self._catches_up = 1
        self._syncs_to_turn = 0  # 0: no turn is awaited
        self._turn_not_before: Time = 0
        self.error = 0.0
        self.largest_error = 0.0
        self.late_sync: Time = 0
        self.unsent: set[Mux] = set()
        axis.node.add_listener(self._on_values, self._on_boot, self._on_sync)

    @property
    def axis(self) -> Axis:
        """The drive that is watched."""
        return self._axis

    @property
    def is_on(self) -> bool:
        """Whether the drive is watched, and has followed so far."""
        return self._is_on

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
        self._limit, self._lag, self._bounds, self._catches_up = limit, lag, None, catches_up
        self._begin(mode, cyclic, silent_syncs, _WATCHED)
        self._period, self._last_sync, self._forgives, self._latest = period, None, forgives, 0
        self._points = deque([self._axis.set_point_counts] * (lag + 1), maxlen=lag + slack + 1)

    def begin_within(
        self,
        bounds: Bounds,
        mode: int,
        *,
        cyclic: Mapping[Mux, int],
        silent_syncs: int = SILENT_SYNCS,
        max_missed: int = MAX_MISSED,
    ) -> None:
        """Watch a drive that follows velocities or torques (csv, cst) from now on; see bounds.py. `keep_within` halts it, too.

        It has no following error: its position and its speed must stay within `bounds`, and it must get a new set-point at each
        SYNC, or one of `max_missed` + 1 in a row. Bits 11 and 13 of its statusword are not judged: limits of torque and speed are
        what such a drive works against. Else as `begin`.
        """
        self._bounds, self._lag = bounds, LAG
        bounds.expect_set_points(mode, max_missed)
        self._begin(mode, cyclic, silent_syncs, (*_WATCHED, *bounds.watched))
        self._points = deque([self._axis.set_point_counts], maxlen=1)

    def _begin(self, mode: int, cyclic: Mapping[Mux, int], silent_syncs: int, watched: tuple[Mux, ...]) -> None:
        self._mode, self._silent_syncs, self._watched = mode, silent_syncs, watched
        # In profile position mode, bit 12 is part of a handshake
        self._has_bit_12 = mode != Mode.PROFILE_POSITION and self._axis.settings.shows_following
        self.expect(cyclic)
        self._nmt_state = self._axis.node.nmt_state
        self._old_bits = self._axis.statusword & _NO_NEWS
        self._flawless = None
        self._limited = self._forgiven = self._period = 0
        self.error = 0.0
        self._delay.begin(self._axis.set_point_counts)
        self._is_on = True

    def expect(self, cyclic: Mapping[Mux, int]) -> None:
        """Expect these objects at SYNCs: mux -> n for "at every n-th SYNC". Other watched objects that it has are `unsent`."""
        self._cyclic = cyclic
        self._pdo, self._is_answered, self._all_heard, self._unanswered = None, False, None, {}
        dictionary = self._axis.node.dictionary
        self.unsent = {mux for mux in self._watched if mux not in cyclic and mux in dictionary}

    @property
    def limit(self) -> Limit:
        """How far off its set-points the drive may be, in the user's unit, as `begin` was told."""
        return self._limit

    def _late_sync(self, now: Time) -> Time:
        """Return by how many ns SYNC was late, at most, within LATE_SYNC_TIME; one that is due and has not come is late, too."""
        if self._last_sync is None or not self._period:
            return 0
        waited = now - self._last_sync - self._period
        recent = self._latest if now - self._late_at <= LATE_SYNC_TIME else 0
        return max(recent, waited if waited > self._period // 4 else 0)

    def end(self) -> None:
        """End the watch: no more set-points follow."""
        self._is_on = False
        self.error = 0.0

    def lose(self, cause: str, *, is_silent: bool = False, still_follows: bool = False, late: int = 0) -> None:
        """End the watch with FollowingLost, if it is on: for a cause that only the caller can see."""
        if self._is_on:
            self._is_on = False
            node = self._axis.node
            self.late_sync = self._late_sync(max(node.heard_at.values(), default=self._last_sync or 0))
            node.out.events.append(FollowingLost(node.node_id, cause, is_silent, still_follows, self._axis.number, late))

    def await_turn(self, syncs: int, not_before: Time) -> None:
        """Report TurnToRead once: at the SYNC after `syncs` - 1 others, or at the first later one that comes `not_before` (ns).

        It is counted here, where each SYNC comes anyway, so that no procedure is asked about each SYNC.
        """
        self._syncs_to_turn, self._turn_not_before = syncs, not_before

    def _on_values(self, muxes: Collection[Mux], now: Time) -> None:
        if not self._is_on:
            return
        if muxes is self._pdo:
            self._is_answered = True
        elif len(muxes) >= len(self._cyclic) and self._cyclic.keys() <= set(muxes):
            self._pdo, self._is_answered = muxes, True
        if objects.MODES_OF_OPERATION_DISPLAY in muxes:
            self._judge_mode()
        if objects.STATUSWORD in muxes:
            self._judge_statusword()
        if self._bounds is not None:
            self._judge_bounds(self._bounds.judge())
        elif objects.POSITION_ACTUAL_VALUE in muxes:
            self._delay.on_position(muxes)
            self._judge_position()

    def _judge_mode(self) -> None:
        mode = self._axis.mode
        assert mode is not None  # it has just come
        if mode != self._mode:
            self.lose(f"changed its mode of operation: 0x6061 shows {mode_name(mode)}, not {mode_name(self._mode)}")

    def _judge_statusword(self) -> None:
        axis = self._axis
        word = axis.statusword
        if word == self._flawless:
            self._limited = 0
            return
        self._old_bits &= word
        news = word & ~self._old_bits if self._bounds is None else 0
        is_limited = bool(news & StatusBit.INTERNAL_LIMIT) and not self._forgiven
        if axis.state is not State.OPERATION_ENABLED:
            self.lose(f"left operation enabled by itself: {axis.state}")
        elif not word & _FOLLOWS and self._has_bit_12:
            self.lose("no longer follows its set-points: bit 12 of its statusword is 0 (missed one, halted, another mode)")
        elif news & ModeStatus.FOLLOWING_ERROR:
            self.lose("reports a following error: bit 13 of its statusword is 1", still_follows=True)
        elif is_limited and self._limited >= self._catches_up:
            self.lose(f"is held by a limit of its own: bit 11 of its statusword is 1 {_OWN_LIMITS}", still_follows=True)
        self._limited = self._limited + 1 if is_limited else 0
        self._flawless = None if news & StatusBit.INTERNAL_LIMIT else word

    def _judge_bounds(self, excess: str) -> None:
        if excess:
            self.lose(excess)

    def _judge_position(self) -> None:
        axis, points, limit = self._axis, self._points, self._limit.value
        counts = axis.position_counts
        assert counts is not None  # it has just come
        self.error = axis.way_from_counts(points[-1 - self._lag] - counts)
        distance = abs(self.error)
        if distance > self.largest_error:
            self.largest_error = distance
        if distance <= limit:
            return
        off = axis.amount_from_counts(max(min(points) - counts, counts - max(points)))
        if off > limit:
            position, wanted = axis.from_counts(counts), axis.from_counts(points[-1 - self._lag])
            self.lose(
                f"is {off:.4g} off its path: it is at {position:.4g} and should be at {wanted:.4g}; "
                f"the limit is {limit:.4g}, by {self._limit.source}",
                still_follows=True,
                late=self._delay.late(counts, self._lag, round(axis.counts_of_amount(limit))),
            )

    def _on_boot(self) -> None:
        self.lose("was reset, or lost its power")

    def _on_sync(self, now: Time) -> None:
        if not self._is_on:
            return
        state = self._axis.node.nmt_state
        if state is not NmtState.OPERATIONAL and state is not None and state is not self._nmt_state:
            self.lose(f"left NMT state Operational: {state.name}")
        if self._is_answered:
            self._is_answered, self._all_heard = False, (1, now)
            self._unanswered.clear()
        else:
            self._judge_silence(now)
        if self._period:
            self._judge_period(now)
        self._points.append(self._axis.set_point_counts)  # this SYNC takes it along
        self._delay.on_sync(self._points[-1])
        if self._bounds is not None:
            self._judge_bounds(self._bounds.on_sync())
        if self._syncs_to_turn > 1:
            self._syncs_to_turn -= 1
        elif self._syncs_to_turn and now >= self._turn_not_before:
            self._syncs_to_turn = 0
            self._axis.node.out.events.append(TurnToRead(self._axis.node.node_id, self._axis.number))

    def _judge_period(self, now: Time) -> None:
        """See whether the SYNC came at another time than the drive expects: it has to get back to its set-points then."""
        before, self._last_sync = self._last_sync, now
        late = 0 if before is None else now - before - self._period
        if abs(late) > self._period // 4:
            if late > 0 and late >= (self._latest if now - self._late_at <= LATE_SYNC_TIME else 0):
                self._latest, self._late_at = late, now
            self._forgiven = -(-CATCH_UP_TIME // self._period) if self._forgives else 0
        elif self._forgiven:
            self._forgiven -= 1

    def _judge_silence(self, now: Time) -> None:
        """Judge silence by unanswered SYNCs, not by time: if we stalled and sent none, the drive was not silent."""
        heard_at, just_begun = self._axis.node.heard_at, (1, now)
        for mux, every in self._cyclic.items():
            silence = self._unanswered.get(mux, self._all_heard)
            if silence is None or heard_at.get(mux, -NEVER) >= silence[1]:
                self._unanswered[mux] = just_begun
                continue
            unanswered, first = silence
            if unanswered >= self._silent_syncs * every and now - first >= SILENT_TIME:
                what, time = _NAMES.get(mux, f"0x{index_of(mux):04X}"), (now - first) / MILLISECOND
                cause = f"is silent: no PDO with its {what} for {time:.3g} ms, behind {unanswered} SYNCs"
                self.lose(cause, is_silent=True)
                return
            self._unanswered[mux] = unanswered + 1, first


DEFAULT_TIME: Final = 100 * MILLISECOND
"""How far behind a drive may be by default, at its top speed: position controllers without feed-forward lag by 10 to 50 ms."""
OFF: Final = 0x7FFF_FFFF
"""A window of 0x6065 that no INTEGER32 can leave; 0xFFFFFFFF switches the drive's own watch off."""


@accounted
def following_limit(axis: Axis, limits: SetPointLimits) -> Procedure[Limit]:
    """Return how far off its set-points a drive may be: by its settings, else by its window 0x6065, else by its speed limit.

    The drive's time-out 0x6066 is not awaited: after it, the drive would stop by itself. limits: of its set-points. By default a
    drive may be off by its way in DEFAULT_TIME at its speed limit (at DEFAULT_SPEED if the user lifted the limit). Raises
    SdoFailed.
    """
    limit = axis.settings.following_error_limit
    if limit is not None:
        return Limit(limit, "the settings (following_error_limit)")
    window = yield from read_if_present(axis.node, objects.FOLLOWING_ERROR_WINDOW)
    if isinstance(window, int) and 0 < window < OFF:
        return Limit(axis.amount_from_counts(window), "0x6065 of the drive")
    speed = limits.speed.value if math.isfinite(limits.speed.value) else axis.amount_from_counts(DEFAULT_SPEED)
    way = f"its way in {DEFAULT_TIME / SECOND:g} s at {speed:.4g} per second"
    source = f"default, {way}; following_error_limit of its settings raises it"
    return Limit(speed * DEFAULT_TIME / SECOND, source)
