"""`Supervision`: tells a chain which of its joints has failed, and why.

From the end of `initialise` to `shut_down` it reports a joint that falls into fault, is reset, no longer sends its heartbeat, or
no longer answers node guarding. While set-points are followed, it also reports every finding of
`canopen_proto.drives.axis.following`, which judges the values of each cycle.

Objects that a joint does not send at SYNCs are read by SDO beside the cycle: with the PDOs of the manual's arm the mode of
operation (0x6061). The joints take turns, one request behind each SYNC, and none waits for another's answer. So a changed mode is
seen late: after a cycle for each joint of the chain (60 ms for six joints at 10 ms), and an SDO time-out for each lost answer of
this joint. An SDO transfer under way with a joint delays its reads, unless it has another SDO channel that is free. A joint that
could not be read for three SDO time-outs (1.5 s) has failed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from canopen_master.motion.chain_errors import FIND
from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import Followed
from canopen_master.motion.late_sync import RECENT, our_lateness
from canopen_master.participant.bus import Bus
from canopen_master.participant.participant import Participant, ProcedureSlot
from canopen_master.silence import lost_frames
from canopen_proto.drives.axis.axis import AxisStateChanged
from canopen_proto.drives.axis.following import FollowingLost
from canopen_proto.drives.axis.following_procedures import read_unsent
from canopen_proto.drives.axis.reasons import Reason
from canopen_proto.drives.axis.slow_position import feed_targets
from canopen_proto.drives.axis.view import view_of
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.frame import NMT, SDO_CLIENT_TO_SERVER, SYNC
from canopen_proto.guarding import NodeGuardingLost
from canopen_proto.heartbeat import HeartbeatLost, NodeBooted
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.procedures.steps import all_of

_SLOW: Final = Mode.PROFILE_POSITION

SILENT: Final = (
    "its power is off, its cable is loose, or it was stopped; or it does not send its PDO at each SYNC (then "
    "ChainSettings(define_pdos=True) tells it to); or the bus has no room for all frames"
)
_FULL: Final = "the bus has no room for all frames, or a computer on it is too slow"


class Supervision:
    """See this module's text. is_on: whether failures are reported."""

    def __init__(
        self, participant: Participant, devices: Sequence[Device], failed: Callable[[Device, str, Reason | None, bool], None]
    ) -> None:
        """failed: called in the pump's turn with the joint, what it did, such as "fell into fault", the likely cause, if known,
        and whether the joint still follows its set-points, if badly. It may be called several times for one failure.
        """
        self._participant = participant
        self._devices = devices
        self._failed = failed
        self._beside = ProcedureSlot(participant)  # what goes by SDO beside the cycle
        self._cycle_time: Time = 0
        self.is_on = False
        for device in devices:
            kinds = (AxisStateChanged, FollowingLost, HeartbeatLost, NodeGuardingLost, NodeBooted)
            device.node.watch(kinds, partial(self._on_event, device))

    def begin_following(self, followed: Sequence[Followed], silent_cycles: int, cycle_time: Time) -> None:
        """Watch joints that now follow set-points, and give the slow ones their targets. silent_cycles: see ChainSettings.
        followed: what `follow` returned, for each joint.

        cycle_time: ns from SYNC to SYNC.
        """
        self._cycle_time = cycle_time
        for device, (limit, mode, catches_up, _, slack) in zip(self._devices, followed, strict=True):
            device.following.begin(
                limit,
                mode,
                cyclic=device.cyclic,
                slack=slack,
                catches_up=catches_up,
                silent_syncs=silent_cycles,
                period=cycle_time,
            )
        slow = [device.following for device, each in zip(self._devices, followed, strict=True) if each.mode is _SLOW]
        reading = read_unsent([device.following for device in self._devices])
        self._beside.begin(all_of(reading, *map(feed_targets, slow)))

    def end_following(self) -> None:
        """Stop watching: the joints no longer follow set-points."""
        for device in self._devices:
            device.following.end()
        self._beside.take_back()

    def _on_event(
        self, device: Device, report: AxisStateChanged | FollowingLost | HeartbeatLost | NodeGuardingLost | NodeBooted
    ) -> None:
        if not self.is_on or (isinstance(report, AxisStateChanged | FollowingLost) and report.axis != device.axis.number):
            return
        bus = self._participant.bus(device.node.bus)
        beside = foreign_commands(device, bus)
        lost = lost_frames(bus.network, device.node.now(), RECENT).removeprefix("; ")
        is_silence = isinstance(report, HeartbeatLost | NodeGuardingLost) or (
            isinstance(report, FollowingLost) and report.is_silent
        )
        if is_silence and lost:
            beside = f"{lost}; or {beside}" if beside else lost
        cause = our_lateness(device, beside) or (Reason(beside, FIND) if beside else None)
        match report:
            case FollowingLost(cause=reason, is_silent=is_silent, still_follows=still_follows, late=cycles):
                likely = self._lateness(cycles) if cycles else Reason(SILENT, FIND) if is_silent else None
                self._failed(device, reason, cause or likely, still_follows)
            case AxisStateChanged() if device.has_fault:
                self._failed(device, "fell into fault", cause, False)
            case HeartbeatLost(timeout=timeout):
                self._node_failed(device, f"was lost: no heartbeat for {timeout / SECOND:g} s", cause)
            case NodeGuardingLost(life_time=life_time):
                self._node_failed(device, f"was lost: no answer to node guarding for {life_time / SECOND:g} s", cause)
            case NodeBooted():
                self._node_failed(device, "was reset, or lost its power: it has booted again", cause)

    def _lateness(self, late: int) -> Reason:
        """Say by how much positions come late, so that a drive only seems to be off its path. late: SYNCs."""
        time = late * self._cycle_time / MILLISECOND
        cycles = f"{late} cycles of {self._cycle_time / MILLISECOND:g} ms"
        what = f"its positions come {time:.3g} ms late ({cycles}: so many PDOs are missing), and it was on its path then: {_FULL}"
        return Reason(what, "look at the load (`canopen plan`); fewer TPDOs, a longer cycle_time, or a higher bit rate")

    def _node_failed(self, device: Device, reason: str, cause: Reason | None) -> None:
        """Report what happened to a node, and with it to all joints that are axes of it."""
        others = [each.name for each in self._devices if each.node is device.node and each is not device]
        self._failed(device, f"{reason}; and with it {', '.join(others)}, on the same node" if others else reason, cause, False)


def foreign_commands(device: Device, bus: Bus) -> str:
    """Commands of other masters heard lately, which may be why a joint does not follow, for people; "" if there are none."""
    node_id, now = device.node.node_id, device.node.now()
    keys = {"an NMT command": NMT, "an SDO request to it": SDO_CLIENT_TO_SERVER + node_id}
    if not bus.hears_own_sync:
        keys["a SYNC"] = SYNC
    for number, producer in device.node.remote.rpdos.items():
        if producer.key is not None:
            keys[f"its RPDO {number}"] = producer.key
    heard = []
    for what, key in keys.items():
        time = bus.network.last_heard_of(key)
        if time is not None and now - time <= RECENT:
            heard.append(f"{what} {(now - time) / MILLISECOND:.0f} ms ago")
    foreign = view_of(device.axis).foreign
    named = [] if foreign is None else [str(foreign)]
    return "; ".join((*named, f"somebody else commands this bus: {', '.join(heard)}")) if heard else "".join(named)
