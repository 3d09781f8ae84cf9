"""`Watchdogs`: the watchdog of a master. Each drive that the master enables watches over it, and stops when it falls silent.

Every command that enables a drive goes through `hold` first: a chain, a procedure of the
core with a Device's axis (`Axis.watchdog`), the blocking API, a controlword that is written by hand (`Node.write`, `write_bytes`,
`write_stream`). An RPDO or an MPDO that can enable a drive (`Node.enable_rpdo`, `Node.send_mpdo`), and a write of the core
(`node.remote.write`), cannot wait: the master takes hold of the drive beside them. On the bus of that drive the master then

- checks that no other node has its node-ID: it listens for two periods at least;
- sends its heartbeat from then on (`OwnHeartbeat`), and not before: a program that only reads must not keep the drives of a dead
  master alive;
- has the drive watch it (drives/axis/watchdog.py), and waits for the next heartbeat, with which the drive begins to watch: drives
  that are enabled together wait for the same one. A drive that boots forgets that; it is taken hold of again when it is enabled.

`let_go` restores the objects that `hold` changed, when the drive is shut down, or when the master is left and the drive stands or
was disabled by hand. The heartbeat ends with the last drive of its bus. A drive that did not confirm that it stands keeps
watching: the heartbeat ends with the master, and the drive stops by itself.

**Reports.** A drive that will not stop by itself is reported once: by an event `NotHeld` and by a warning of the logger
`canopen_master`, which Python shows on stderr unless logging is configured, and so does the command line. `Watchdog.required`
makes it an error. The logger also reports a foreign heartbeat with our node-ID (`ForeignHeartbeat`), and objects that could not
be restored.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from typing import Final

from canopen_master.participant.bus import Bus
from canopen_master.participant.participant import Participant
from canopen_master.participant.peer import Peer
from canopen_master.plain_text import clean
from canopen_proto.drives.axis.watchdog import Hold, Watchdog, not_held, release, take_hold
from canopen_proto.heartbeat import ForeignHeartbeat, OwnHeartbeat
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoTransferError, act, current_time, sleep

LOGGER: Final = logging.getLogger("canopen_master")
LOOK: Final = 10 * MILLISECOND
"""Between two looks whether another axis of the same node has been taken hold of."""
TRIES: Final = 3
"""How often a drive is taken hold of that boots meanwhile."""
PERIODS_HEARD: Final = 2
"""Another master with the same node-ID and period is heard within one."""


class NotHeld(Event):
    """A drive that was enabled will not stop by itself if this master falls silent. drive: its name. reason: what it lacks."""

    __match_args__ = ("node_id", "drive", "reason")

    def __init__(self, node_id: int, drive: str, reason: str) -> None:
        self.node_id = node_id
        self.drive = drive
        self.reason = reason


class NodeIdTakenError(ProcedureError):
    """Another node has the node-ID under which the master would send its heartbeat; nothing was enabled."""


class Watchdogs:
    """The watchdogs of one master, on all its buses; see this module's text. settings: None if drives shall not watch over it."""

    def __init__(self, participant: Participant, settings: Watchdog | None) -> None:
        self._participant = participant
        self.settings = settings
        self._opened_at = participant.now()
        self._heartbeats: dict[Bus, OwnHeartbeat] = {}
        self._holds: dict[Peer, Hold] = {}
        self._under_way: set[Peer] = set()
        self._untold: dict[str, list[str]] = defaultdict(list)  # reason -> drives
        self._told: set[Peer] = set()
        if settings is not None:
            for bus in dict.fromkeys(participant.buses.values()):
                heartbeat = self._heartbeats[bus] = OwnHeartbeat(bus.network.out, settings.node_id)
                bus.network.attach(heartbeat)
                participant.watch((ForeignHeartbeat,), lambda _, bus=bus: self._on_foreign(bus), bus)  # type: ignore[misc]

    def hold(self, node: Peer, axis: int = 0) -> Procedure[None]:
        """Have the drive on an axis of a node watch over this master. If it should do so already, its objects are read once more:
        its boot-up may have been lost. Ends with the next heartbeat, within one period after that.

        A drive that does not answer counts as one that cannot watch. Raises NodeIdTakenError; NotHeldError as `required` says.
        """
        settings = self.settings
        if settings is None:
            return
        hold = self._hold_of(node, axis)
        bus = self._participant.bus(node.bus)
        heartbeat = self._heartbeats[bus]
        if not heartbeat.period:
            yield from self._check_node_id(bus, settings)
        yield from self._turn_of(node)
        self._under_way.add(node)
        try:
            yield from act(lambda now: heartbeat.start(settings.period, now))
            for _ in range(TRIES):
                yield from take_hold(hold, settings)
                yield from _next_beat(heartbeat)
                if hold.is_taken:  # it has not booted meanwhile
                    break
            else:
                hold.gap = f"it booted {TRIES} times while it was told to watch"
                if settings.required:
                    raise not_held(hold)
        except SdoTransferError as failed:
            hold.gap = str(failed)
            if settings.required:
                raise not_held(hold) from failed
        finally:
            self._under_way.discard(node)
            self._tell(node, hold)

    def check(self, node: Peer) -> Procedure[None]:
        """Raise NodeIdTakenError if another node on this bus has the node-ID of our heartbeat. Nothing is sent."""
        bus = self._participant.bus(node.bus)
        if self.settings is not None and not self._heartbeats[bus].period:
            yield from self._check_node_id(bus, self.settings)

    def hold_beside(self, node: Peer, axis: int = 0) -> None:
        """Take hold of a drive that may be enabled at any moment; a failure is logged."""
        is_needed = self.settings is not None and not self._participant.is_closed  # the halts write controlwords, too
        if is_needed and not self.holds(node, axis) and (node not in self._under_way or axis not in self._holds[node].axes):
            self._participant.launch(self._hold_or_tell(node, axis))

    def _hold_or_tell(self, node: Peer, axis: int) -> Procedure[None]:
        try:
            yield from self.hold(node, axis)
        except ProcedureError as error:
            LOGGER.warning("%s", clean(str(error)))

    def holds(self, node: Peer, axis: int = 0) -> bool:
        """Return whether the drive on an axis of a node is held: `hold` was called, and no boot of it was heard since."""
        hold = self._holds.get(node)
        return hold is not None and hold.is_taken and axis in hold.axes

    def drives_held(self) -> list[Peer]:
        """Return the nodes with objects that are still to be restored."""
        return [node for node, hold in self._holds.items() if hold.before]

    def let_go(self, node: Peer, axis: int | None = None) -> Procedure[None]:
        """Restore the objects that `hold` changed, as far as the drive lets us; does nothing if the drive is not held.

        axis: the only one that is let go: nothing is restored while another axis of the node is held. None: all of them.
        """
        hold = self._holds.get(node)
        if hold is None:
            return
        hold.axes.difference_update(hold.axes.copy() if axis is None else {axis})
        yield from self._turn_of(node)
        if hold.axes:
            return
        try:
            yield from release(hold)
        except ProcedureError as error:
            left = ", ".join(f"0x{index:04X}:{subindex:02X}" for index, subindex in hold.before)
            LOGGER.warning("%s: %s could not be put back as it was: %s", clean(node.name), left, clean(str(error)))
            return
        bus = self._participant.bus(node.bus)
        watching = {each for each, other in self._holds.items() if other.is_taken or other.before} | self._under_way
        if not any(self._participant.bus(each.bus) is bus for each in watching):
            yield from act(self._heartbeats[bus].stop)

    def _turn_of(self, node: Peer) -> Procedure[None]:
        """Wait until no other procedure takes hold of a drive on this node."""
        while node in self._under_way:
            yield from sleep(LOOK)

    def _hold_of(self, node: Peer, axis: int) -> Hold:
        hold = self._holds.get(node)
        if hold is not None:
            hold.axes.add(axis)
        else:
            hold = self._holds[node] = Hold(node.remote, axis)
            node.remote.add_listener(on_boot=hold.forget)  # called before a procedure can enable the drive again
        return hold

    def _check_node_id(self, bus: Bus, settings: Watchdog) -> Procedure[None]:
        """Raise NodeIdTakenError if another node has our node-ID."""
        yield from sleep(max(0, self._opened_at + PERIODS_HEARD * settings.period - (yield from current_time())))
        node_id, heard = settings.node_id, bus.network.heard(settings.node_id)
        if heard.time is None or heard.service is None:
            return
        age = ((yield from current_time()) - heard.time) / SECOND
        raise NodeIdTakenError(
            f"this master cannot send its heartbeat as node {node_id} on {bus.name}, so no drive was enabled: "
            f"another node {node_id} was heard {age:.2g} s ago ({heard.service.value}). "
            "Try: another node-ID for the master, by --master-id or open_master(..., watchdog=Watchdog(node_id=...))"
        )

    def _on_foreign(self, bus: Bus) -> None:
        assert self.settings is not None  # its heartbeat heard it
        LOGGER.warning(
            "another node on %s sends heartbeats as node %d too: the drives there will not notice if this program ends",
            clean(bus.name),
            self.settings.node_id,
        )

    def _tell(self, node: Peer, hold: Hold) -> None:
        """Report once for each drive that is not held; drives taken hold of together are reported together."""
        if hold.gap and node not in self._told:
            self._told.add(node)
            name = clean(node.name)
            self._untold[hold.gap].append(name)
            node.remote.out.events.append(NotHeld(node.node_id, name, hold.gap))
        if not self._under_way:
            for gap, names in self._untold.items():
                who = "itself" if len(names) == 1 else "themselves"
                LOGGER.warning("%s will not stop by %s if this program dies: %s", ", ".join(names), who, clean(gap))
            self._untold.clear()


def _next_beat(heartbeat: OwnHeartbeat) -> Procedure[None]:
    """Wait for the next heartbeat, if one will be sent. None is sent out of turn: CiA 301 wants one in each producer time."""
    due = heartbeat.deadline
    while heartbeat.deadline == due < NEVER:
        yield from sleep(max(due - (yield from current_time()), MILLISECOND))


class NodeWatchdog:
    """The watchdog of one drive, as its Axis uses it; see canopen_proto.drives.axis.axis_node.AxisWatchdog."""

    def __init__(self, watchdogs: Watchdogs, node: Peer, axis: int) -> None:
        self._watchdogs = watchdogs
        self._node = node
        self._axis = axis

    def hold(self) -> Procedure[None]:
        return self._watchdogs.hold(self._node, self._axis)

    def let_go(self) -> Procedure[None]:
        return self._watchdogs.let_go(self._node, self._axis)
