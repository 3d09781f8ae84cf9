"""`DirectDrive`: one drive as the direct half of the blocking API uses it. Runs in the master's thread.

Commands go by SDO ("all these commands and checks are performed by SDO communication"). Set-points go by the manual's rPDO, and
the drive takes them at the next SYNC: the user alternates send_pos and send_sync, and nothing else sends either. `give` leaves a
set-point for the SYNC of `HandSync`, which sends it right before; `send_position` sends it at that very moment. So the rPDO has a
producer of its own here: the producers of the RemoteNode follow the SYNC. The rPDO is built from the node's one image, which also
holds each confirmed command; so it always carries the controlword last commanded.

A drive keeps an rPDO until the next SYNC, whoever sends it. An rPDO sent before a halt or the brake was commanded, and not taken
yet, would undo that command. So while the drive may hold one, the rPDO is sent once more before each command, with the
controlword of that command: whenever the SYNC comes, it brings the same as the SDO. `RemoteNode.write` does so for every command.

**How fast a set-point is.** Within `interval`, the time written to 0x60C2, the drive goes to the set-point from the one of the
last SYNC: that step must keep to its `limits`. If a SYNC comes early, the drive takes the next step all the same. So the way of
the last STEPS SYNCs together must keep to the limits too, by the clock. A pause makes no step larger. A drive that left its path
because a SYNC was late comes back to it slowly (late_sync.py): it is then sent elsewhere than the user wants it.

**SYNC.** `HandSync` sends it for a script, with the set-points of all its drives, in one hand-over to the master's thread. A
hand-over blocks the script until the master's thread has run, which a busy computer may delay by 10 ms or more. One for each
drive and one for SYNC would so make SYNC late. So `send_pos` checks its set-point in the script's own thread and leaves it with
the drive; `send_sync` sends all of them, then SYNC.

Set-points wait for `send_sync` only while the last SYNC on the bus was one of ours (`is_ours`). As soon as anybody else sends
SYNC, they are sent at once, and so are those that follow.

**A script that was stalled** sends its SYNC late. Then no drive may jump, nor go faster than it may:

- a drive that may be out of reach of its set-point is asked where it is, and stays there at this SYNC (late_sync.py); it comes
  back to the script's path from there. If that cannot be known, the drives are halted;
- the next SYNC comes an interval after the late one, whatever the phase was, or at most a part of ON_TIME earlier;
- while a drive comes back, SYNC is not early at all: its steps use its whole speed limit, in the interval that it was told.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Final, TypeVar

from canopen_master.errors import NOT_HEARD, NodeSilentError
from canopen_master.master import Master
from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import ensure_answers, failure_of, follow, stop
from canopen_master.motion.late_sync import GapGuard, WithinReach, our_lateness
from canopen_master.motion.set_point_check import check_limits
from canopen_master.participant.participant import ON_TIME, ProcedureSlot
from canopen_master.silence import missing_frame
from canopen_proto.dictionary import Direction, PdoDescription
from canopen_proto.drives import axis as procedures
from canopen_proto.drives.axis.axis import AxisSettings
from canopen_proto.drives.axis.following import FollowingLost
from canopen_proto.drives.axis.following_procedures import read_unsent
from canopen_proto.drives.axis.identity import identify
from canopen_proto.drives.axis.limits import read_limits
from canopen_proto.drives.axis.reasons import Reason
from canopen_proto.drives.axis.settings import HomingStyle
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.drives.trajectory import JointLimits
from canopen_proto.frame import routing_key
from canopen_proto.machine import MILLISECOND, SECOND, Event, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.nmt import NmtState
from canopen_proto.pdo.configure import define_pdo
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.pdo.producer import PdoProducer
from canopen_proto.pdo.settings import CYCLIC_TYPES
from canopen_proto.procedures.objects import ABSENT, unless_refused, write
from canopen_proto.procedures.steps import Procedure, ProcedureError
from canopen_proto.sync import SyncReceived, SyncSent
from canopen_transports.loop import CancelScope, current_loop

NEVER_SENT: Final = -1


class HandSync:
    """See this module's text. It is what a GapGuard guards. is_ours: whether the last SYNC was sent here."""

    def __init__(self, master: Master) -> None:
        self.is_ours = False
        self._master = master
        self._drives: list[DirectDrive] = []  # those that follow set-points
        self._guard = GapGuard(self, self._stop)
        self._sent_at: Time = NEVER_SENT
        self._interval: Time = 0  # from the last SYNC to the next one, as the script said
        self._is_sending = False
        master.watch((SyncSent, SyncReceived), self._on_sync)

    def begin(self, drive: DirectDrive) -> None:
        """Send the set-points of a drive from now on."""
        self._drives.append(drive)

    def end(self, drive: DirectDrive) -> None:
        """Send no more of them; does nothing if none are sent."""
        if drive in self._drives:
            self._drives.remove(drive)

    async def send(self, interval: Time) -> None:
        """Send the set-points that wait, then SYNC. interval: ns until the next one; 0: the script keeps the time.

        While drives follow, it waits first until most of the last interval is over, and until a drive that comes back to its
        path has had the whole interval that it was told. Raises BusError.
        """
        master = self._master
        if self._drives and self._sent_at != NEVER_SENT:
            whole = (drive.interval * MILLISECOND for drive in self._drives if drive.comes_back)
            earliest = self._sent_at + max(self._interval - self._interval // ON_TIME, *whole, 0)
            await current_loop().sleep(max(0, earliest - master.now()) / SECOND)
        for drive in self._drives:
            drive.take_given()
        late = self._late()
        look = self._guard.look_before_sync(late)
        if look is None:
            self._guard.before_late_sync(late)
        while look is not None:
            began = master.now()
            await master.run(look)
            look = self._guard.look_again(master.now() - began)
            if look is None:
                self._guard.before_late_sync(self._late())
        for drive in tuple(self._drives):
            drive.send_given()
        await master.pump.flush()  # a controller may send a SYNC before an RPDO that waits with it
        self._is_sending = True
        try:
            await master.send_sync()
        finally:
            self._is_sending = False
        self.is_ours, self._interval = True, interval

    def _late(self) -> Time:
        return 0 if self._sent_at == NEVER_SENT else max(0, self._master.now() - self._sent_at - self.period)

    def _stop(self, why: str) -> None:
        for drive in tuple(self._drives):
            drive.lose(f"was halted {why}")

    def _on_sync(self, report: SyncSent | SyncReceived) -> None:
        self._sent_at = self._master.now()
        if not self._is_sending and self.is_ours:
            self.is_ours = False
            for drive in tuple(self._drives):
                drive.take_given()
                drive.send_given()

    # ---- what the GapGuard needs: see `Guarded` ----

    @property
    def is_followed(self) -> bool:
        """Whether a drive follows."""
        return bool(self._drives)

    @property
    def period(self) -> Time:
        """ns from SYNC to SYNC: the shortest that a drive was told."""
        return min((drive.interval * MILLISECOND for drive in self._drives), default=0)

    def must_look(self, late: Time) -> bool:
        """Return whether a drive may be out of reach of the set-point that it would take at this SYNC. late: ns behind the time
        at which it was due."""
        return any(drive.must_look(late) for drive in self._drives)

    @property
    def limited(self) -> dict[Device, float]:
        """The drives whose speed their set-points limit, with the ways that they make in an interval at these limits."""
        return {drive.device: drive.way for drive in self._drives if drive.is_limited}

    def rest(self) -> None:
        """Do nothing: no velocities are fed forward."""

    def stand_at_images(self) -> None:
        """Go on from where the drives are, and have been told to be."""
        for drive in self._drives:
            if drive.is_limited:
                drive.stand_at_image()

    def before_late_sync(self, late: Time) -> None:
        """Do nothing: the next SYNC comes a whole interval later."""


T = TypeVar("T")

COUNTS: Final = AxisSettings(counts_per_unit=1.0)
"""Positions as they are on the wire: integers, millidegrees for the manual's arm."""

STEPS: Final = 50
"""Half a second at the manual's 10 ms: over that time a computer's timer is off by less than one step."""
SILENT_SYNCS: Final = 10
"""A drive that answered SYNC by its PDO, and then leaves so many SYNCs unanswered, is gone. More than in a chain: here the user's
loop keeps the time, and the user's threads may delay the one that hears the drive."""

STATUSWORD: Final = "0x6041"
_SYNC_TIME_OUT: Final = "0x200E"


class DirectDrive:
    """See this module's text. interval: ms between two SYNCs, as written to the drive. in_counts: whether positions are integers
    as on the wire. master: that it belongs to."""

    def __init__(
        self, master: Master, device: Device, rpdo: str, tpdo: str, in_counts: bool = True, hand_sync: HandSync | None = None
    ) -> None:
        """rpdo, tpdo: the PDOs of the dictionary that the drive comes with; an unknown name means none. in_counts: positions are
        integers as on the wire; False: in the unit of the machine file. hand_sync: sends what is left by `give`; None: one of its
        own, for this drive alone.
        """
        self.master = master
        self.device = device
        self._hand_sync = HandSync(master) if hand_sync is None else hand_sync
        self.axis = device.axis
        self.node = device.node
        self.interval = 10
        self.in_counts = in_counts
        self._producer: PdoProducer | None = None
        self._running: set[CancelScope] = set()  # its sequences
        self._is_following = False
        self._is_new = False  # the rPDO is to be sent before the next SYNC
        self.comes_back = False  # its last step, which the next SYNC ends, leads back to its path
        self._taken: deque[tuple[Time, float]] = deque(maxlen=STEPS)  # the set-points of the last SYNCs; at first: where it stood
        self._wanted = 0.0  # the set-point of the user; `_within` knows what is sent in its place behind a late SYNC
        self._within = WithinReach([0.0], [math.inf])
        self._given: deque[float] = deque(maxlen=1)  # what the next SYNC by hand takes along, and what the user's threads write
        self._every: dict[int, int] = {}  # number of a tPDO -> at every how many SYNCs it should come
        self._cyclic: dict[Mux, int] = {}  # the same by object, of those that came
        self._lost: FollowingLost | None = None  # why it stopped following, for the next send_position
        self._reading = ProcedureSlot(master)  # the procedure that reads what no PDO brings
        # The manual's PDOs carry the objects of the first axis
        descriptions = {} if self.axis.number else {each.name: each for each in self.node.dictionary.pdos}
        if rpdo in descriptions:
            self._use(descriptions[rpdo], descriptions[rpdo].number)
        if tpdo in descriptions and not self.node.remote.tpdos:
            self._every[self.node.remote.add_pdo(descriptions[tpdo], master.now()).number] = 1
        bus = master.bus(self.node.bus)
        master.watch((PdoReceived,), self._on_pdo, bus, self.node.node_id)
        master.watch((FollowingLost,), self._on_lost, bus, self.node.node_id)
        master.watch((SyncSent, SyncReceived), self._on_sync, bus)

    async def reset_fault(self) -> None:
        """Reset a fault, as canopen_proto.drives.axis.reset_fault does. Start the node first if a program has left it stopped."""
        if STATUSWORD in self.node.dictionary:
            await self._run(ensure_answers(self.node, STATUSWORD))
        await self._run(procedures.reset_fault(self.axis))

    async def change_state(self, state: State) -> None:
        """Lead the drive to a state, up or down. In any state but Operation enabled it stops following set-points."""
        if state is State.OPERATION_ENABLED:
            if self._is_following and self.axis.state is state:
                return
            await self._run(identify(self.axis))
        else:
            self._end_following()
        await self._run(procedures.change_state(self.axis, state))

    async def home(self, method: int | None = None) -> None:
        """Home the drive, in its own way: see `identify`. method: of this homing, for a drive that has methods."""
        self._end_following()
        await self._run(identify(self.axis))
        settings = self.axis.settings
        if method is not None and settings.homing is not HomingStyle.SCHUNK:
            self.axis.settings = replace(settings, homing_method=method)
        try:
            await self._run(procedures.home(self.axis))
        finally:
            self.axis.settings = settings

    @property
    def limits(self) -> JointLimits:
        """The limits of the joint's motions, as `follow` has read them."""
        return self.device.limits.of_paths

    async def set_mode(self, mode: int) -> None:
        """Select a mode of operation."""
        self._end_following()
        await self._run(procedures.set_mode(self.axis, mode))

    async def follow(self) -> None:
        """Let the drive follow set-points in interpolated position mode, from where it stands."""
        self._require_first_axis("enable_ip_mode")
        if self._producer is None:
            raise LocalProtocolError(
                f"the dictionary has no rPDO for set-points of node {self.node.node_id}; declare one by define_pdo"
            )
        self._end_following()
        followed = await self._run(follow(self.device, "enable_ip_mode", self.interval * MILLISECOND, sends_itself=True))
        following = self.device.following
        following.begin(
            followed.limit,
            followed.mode,
            cyclic=self._cyclic,
            lag=1,
            catches_up=followed.catches_up,
            silent_syncs=SILENT_SYNCS,
            period=self.interval * MILLISECOND,
            forgives=False,
        )
        ranges = self.limits.lowest, self.limits.highest
        self._within = WithinReach([self.axis.set_points.position], [followed.speed * self.interval / 1000], [ranges])
        self._stand_at(self.axis.set_points.position)
        self._given.clear()
        self._is_following, self._lost = True, None
        self._hand_sync.begin(self)
        self._reading.begin(read_unsent([following]))

    async def halt(self) -> None:
        """Stop the drive, and end its running commands; it stays enabled."""
        self._end_following()
        for scope in self._running:
            scope.cancel()
        await self.master.run(procedures.halt(self.axis))

    async def shut_down(self) -> None:
        """Take the drive's power away."""
        self._end_following()
        await self._run(procedures.shut_down(self.axis))

    async def set_interval(self, milliseconds: int) -> None:
        """Write the time between two SYNCs to the drive, and switch off its watch over SYNC (Schunk's 0x200E = 0). milliseconds:
        1 to 255 (0x60C2)."""
        await self._run(self._set_interval(milliseconds))
        self.interval = milliseconds

    async def set_max_speed(self, speed: float) -> None:
        """Allow set-points this fast, in counts (or the joint's unit) per second, whatever the drive says. speed: above 0, else
        LocalProtocolError."""
        await self._run(identify(self.axis))
        self.axis.settings = replace(self.axis.settings, max_speed=speed)
        self.device.limits = await self._run(read_limits(self.axis))

    async def wait_for(self, constant: str, timeout: Time) -> None:
        """Wait until the statusword bears a constant; StepTimeoutError after `timeout` ns."""
        wanted = self.node.dictionary.constant("statusword", constant)
        # The constant waited for may be that of a fault.
        waiting = procedures.wait_for_statusword(self.axis, wanted.is_in, timeout, constant, accept_fault=True)
        await self._run(waiting)

    async def define(self, description: PdoDescription, number: int | None, transmission_type: int) -> None:
        """Declare a PDO to the device, and use it. An operational node is pre-operational meanwhile, as devices require. number:
        1..512; None: that of the predefined connection set. transmission_type: 0..255."""
        self._require_first_axis("define_pdo")
        number = number or description.number
        state = self.node.nmt_state
        if description.direction is Direction.RPDO:
            self._end_following()
        if state is NmtState.OPERATIONAL:
            await self.master.nmt_enter_pre_operational(self.node.node_id, bus=self.node.bus)
        try:
            await self._run(define_pdo(self.node.remote, description, number=number, transmission_type=transmission_type))
        finally:
            if state is NmtState.OPERATIONAL:
                await self.master.nmt_start(self.node.node_id, bus=self.node.bus)
            if description.direction is Direction.RPDO and number is not None:
                self.node.remote.remove_pdo(Direction.RPDO, number)  # we send it by hand, not behind the SYNC
        if description.direction is Direction.TPDO and number is not None:
            self._every.pop(number, None)
            if transmission_type in CYCLIC_TYPES:
                self._every[number] = transmission_type
        self._use(description, number, transmission_type)

    async def _run(self, procedure: Procedure[T]) -> T:
        """Run a sequence to its end. Raises as `until_halted` does."""
        return await self.until_halted(lambda: self.master.run(procedure))

    async def until_halted(self, function: Callable[[], Awaitable[T]]) -> T:
        """Call a function, and return its result. Raises ProcedureError if `halt` ended it before."""
        with current_loop().cancel_scope() as scope:
            self._running.add(scope)
            try:
                return await function()
            finally:
                self._running.remove(scope)
        raise ProcedureError(f"drive {self.node.node_id} was halted meanwhile")

    async def send_position(self, position: float) -> None:
        """Send the rPDO with this set-point now. Raises if the drive would not follow it; see Session.send_pos. position: counts,
        or the joint's unit; see `in_counts`."""
        chain = next((each for each in self.master.chains.values() if self.device in each.devices), None)
        if chain is not None and self.axis.node.rpdo_of(objects.INTERPOLATION_SET_POINT) is not None:
            at = {device: device.desired_position for device in chain.devices} | {self.device: position}
            chain.set_positions(list(at.values()))  # the master's next cycle takes it along
            return
        lost, self._lost = self._lost, None
        if lost is not None:
            raise await self._why(lost)
        node_id = self.node.node_id
        if not self._is_following:
            raise LocalProtocolError(f"node {node_id} does not follow set-points: enable_ip_mode({node_id}) first")
        self._given.append(self._checked(position))
        self.take_given()
        self.send_given()
        self.master.pump.pump()

    # ---- by hand: see HandSync ----

    def give(self, position: float) -> bool:
        """Leave a set-point for the next SYNC by hand; return False, and do nothing, if `send_position` has to take it. position:
        counts, or the joint's unit; see `in_counts`.

        May be called in any thread. Raises as `send_position` does for a set-point that the drive cannot take.
        """
        if not (self._hand_sync.is_ours and self._is_following) or self._lost or self.master.sync_period:
            return False
        self._given.append(self._checked(position))
        return True

    @property
    def is_limited(self) -> bool:
        """Whether set-points have to keep its speed limit."""
        return math.isfinite(self.way)

    @property
    def way(self) -> float:
        """The way that it makes in an interval at its speed limit; inf without one."""
        return self._within.ways[0]

    @property
    def is_on_path(self) -> bool:
        """Whether it is sent where the user wants it: it is not on its way back there, behind a late SYNC."""
        return self._within.is_on_path

    def take_given(self) -> None:
        """Let the next SYNC take what was given."""
        self.comes_back = not self.is_on_path
        self._is_new = bool(self._given) or self.comes_back
        if self._given:
            self._wanted = self._given.popleft()
        if self._is_new:
            (to,) = self._within.next([self._wanted])
            self.axis.set_points.set_position_counts(self.axis.scale.to_counts(to))

    def send_given(self) -> None:
        """Send the rPDO, if the next SYNC shall take something new."""
        producer, is_new = self._producer, self._is_new
        self._is_new = False
        if is_new and producer is not None and self._is_following:
            self.node.remote.send_rpdo(producer, self.master.now())

    def must_look(self, late: Time) -> bool:
        """Return whether it may be out of reach of its next set-point. late: ns by which SYNC is late."""
        return self._within.must_look_ahead(late / (self.interval * MILLISECOND))

    def stand_at_image(self) -> None:
        """Go on from the set-point in the image: the drive is there, and was told to stay at the next SYNC."""
        self._within.stand_at([self.axis.set_points.position], [self._wanted])
        self._is_new = True

    def lose(self, cause: str) -> None:
        """Stop it; the next `send_position` says why. cause: for its text."""
        self.device.following.lose(cause)
        self.master.pump.pump()

    async def go_to(self, position: float) -> None:
        """Send a set-point, then SYNC. Raises as `send_position` and `HandSync.send` do. position: as of `give`."""
        if not self.give(position):
            await self.send_position(position)
        await self._hand_sync.send(0)

    def stay(self) -> float:
        """Go on from the set-point that was sent last, and return it: the drive does not come back to the path before it."""
        self._stand_at(self.axis.set_points.position)
        return self._wanted

    def _stand_at(self, position: float) -> None:
        self._wanted = position
        self.comes_back = False
        self._within.stand_at([position], [position])
        self._taken = deque([(self.master.now(), position)], maxlen=STEPS)

    def _checked(self, position: float) -> float:
        """Return a set-point that the drive can take, in the unit of its axis.

        Raises ValueRangeError or SetPointRefusedError for one that the drive cannot hold, or that is beyond its limits.
        """
        counts = position if self.in_counts else self.axis.scale.to_counts(position)
        self.node.dictionary.variable(objects.INTERPOLATION_SET_POINT).encode(counts)
        interval = self.interval * MILLISECOND
        (since, start), (_, last) = self._taken[0], self._taken[-1]
        check_limits(self.device, last, position, interval)
        if abs(position - start) > abs(last - start):  # standing and coming back must always be possible
            check_limits(self.device, start, position, self.master.now() - since + interval)
        return self.axis.scale.from_counts(int(counts))

    def _on_sync(self, report: Event) -> None:
        if self.device.taken_over_by:  # by a command of the master's, past this drive
            self._end_following()
        self._taken.append((self.master.now(), self._wanted))
        self._within.on_sent()

    def _end_following(self) -> None:
        self._is_following = self._is_new = False
        self._given.clear()
        self._hand_sync.end(self)
        self.device.release()
        self.device.following.end()
        self._reading.take_back()

    def _on_lost(self, report: FollowingLost) -> None:
        """Stop the drive: it does not follow its set-points. The next send_position says why."""
        if self.axis.is_told_by(report) and self._is_following and not self.master.is_closed:
            self._end_following()
            self._lost = report
            self.master.launch(failure_of(self.device, stop(self.device)))

    async def _why(self, lost: FollowingLost) -> Exception:
        """Return the error to raise."""
        likely = our_lateness(self.device)
        if self.device.has_fault:
            beside = f", and {likely.what}" if likely else ""
            return await self.master.run(procedures.fault_of(self.axis, f"while it followed set-points{beside}"))
        failed = f"drive {self.node.node_id} {lost.cause}"
        if not lost.is_silent:
            reason, remedy, _ = likely or Reason("", "")
            return procedures.DriveError(self.axis, lost.cause, reason=reason, remedy=remedy)
        cause, tries = "its power is off, its cable is loose, or it was stopped", ["look at the drive and its cable"]
        if likely:
            cause, tries = f"{likely.what}; or {cause}", [likely.remedy, *tries]
        network = self.master.bus(self.node.bus).network
        known = missing_frame(network, self.node.remote, self.master.now(), cause, tries, pdo=True)
        return NodeSilentError(NOT_HEARD, self.node.node_id, self.node.bus, failed, **known._asdict())

    def _require_first_axis(self, function: str) -> None:
        """Raise LocalProtocolError for a further axis of a node: no PDO of PDOs.csv carries its set-points."""
        if self.axis.number:
            raise LocalProtocolError(
                f"{function} is for the first axis of a node, and this is {self.axis.title}. Try: a chain, in a machine file"
            )

    def _use(self, description: PdoDescription, number: int | None, transmission_type: int = 1) -> None:
        mapping = Mapping.from_description(description)
        if description.direction is Direction.TPDO or mapping.find_component(objects.INTERPOLATION_SET_POINT) is None:
            return
        remote = self.node.remote
        key = routing_key(description.can_id(self.node.node_id))
        store = remote.values.store
        self._producer = PdoProducer(remote.out, remote.node_id, number or 0, key, mapping, store, transmission_type)
        self._producer.set_enabled(True, self.master.now())

    def _set_interval(self, milliseconds: int) -> Procedure[None]:
        remote = self.axis.node
        yield from write(remote, objects.INTERPOLATION_TIME_INDEX, -3)
        yield from write(remote, objects.INTERPOLATION_TIME_UNITS, milliseconds)
        if _SYNC_TIME_OUT in remote.dictionary:
            yield from unless_refused(write(remote, _SYNC_TIME_OUT, 0), ABSENT)

    def _on_pdo(self, report: PdoReceived) -> None:
        every = self._every.get(report.number)
        if every is not None and not self._cyclic.keys() >= set(report.mapping.muxes):
            self._cyclic = {**self._cyclic, **dict.fromkeys(report.mapping.muxes, every)}
            if self._is_following:
                self.device.following.expect(self._cyclic)
