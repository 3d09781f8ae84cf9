"""The watchdog for one drive: the drive watches its master, and stops by itself if the master falls silent.

`take_hold` sets two things in a drive before it is enabled. It writes by SDO to the objects of the standard, whatever the node's
dictionary says. Each object is read first, and read back after the write.

    the watch           0x1016: an entry with the master's node-ID and the time within which its heartbeat must come. An entry
                        with this node-ID is used again, else a free one; entries of other nodes stay. A drive without 0x1016,
                        or without a free entry, gets life guarding instead, if it has it: 0x1017 = 0, 0x100C and 0x100D. From
                        then on the master guards it by remote frames. Guarding counts once the drive has answered.
    the reaction        0x6007, the abort connection option code: 3, quick stop

The master's heartbeat has to run before that (`OwnHeartbeat`): a drive watches from the first heartbeat that it hears.

`Hold.before` keeps the old values. `release` writes them back, once the drive stands. If `take_hold` found an entry exactly as it
would write it, a master that died has left it, and `release` frees it. A drive that boots has its power-on values, and is no
longer held. Its boot-up may be lost. So `take_hold` runs each time that the drive is enabled, and writes only what the drive has
lost. A held drive that shows an old value again has booted unheard, and is taken for booted (`RemoteNode.assume_boot`).

Guarding that already runs was started elsewhere: its times are written to the drive, and the guarding stays as it is.

`Hold.gap` says why a drive will not stop by itself: it lacks these objects, refuses a write, or shows another value when it is
read back. This is no failure, unless `Watchdog.required` is set.

Source: CiA 301 v4.2.0, 7.5.2.19 (0x1016), 7.5.2.11 and 7.5.2.12 (guarding), 7.2.8.3.2; IEC 61800-7-201 (0x6007).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortOrigin
from canopen_proto.drives.cia402.axes import swapped
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.guarding import MAX_LIFE_TIME_FACTOR, GuardingAnswered
from canopen_proto.machine import MILLISECOND, LocalProtocolError, Time, check_node_id
from canopen_proto.multiplexer import index_of, mux
from canopen_proto.procedures.objects import unless_refused
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoTransferError, Wait, act, download, upload
from canopen_proto.remote_node import RemoteNode

ABORT_CONNECTION: Final = 0x6007
_NAMES: Final = {
    indices.CONSUMER_HEARTBEAT_TIME: "consumer heartbeat time",
    indices.PRODUCER_HEARTBEAT_TIME: "producer heartbeat time",
    indices.GUARD_TIME: "guard time",
    indices.LIFE_TIME_FACTOR: "life time factor",
    ABORT_CONNECTION: "abort connection option code",
}

QUICK_STOP: Final = 3
"""0x6007 as CiA 402 has it: 0 nothing, 1 fault, 2 disable voltage, 3 quick stop. Some makers swap 2 and 3."""
MIN_LIFE_TIME_FACTOR: Final = 3
"""One lost guarding answer counts as two: with 2 a single lost frame would stop a drive."""
MAX_CONSUMER_TIME: Final = 0xFFFF * MILLISECOND


@dataclass(frozen=True, slots=True)
class Watchdog:
    """The settings by which drives notice that their master is gone.

    node_id: 1..127, the master sends its heartbeat with it; no other node of the bus may have it. period: ns between two
    heartbeats, whole ms. timeout: ns, whole ms, at least two periods, at most 65.535 s; a drive that hears no heartbeat for this
    long stops. abort_connection: written to 0x6007; 3 is the quick stop of CiA 402, some makers use 2. required: do not enable a
    drive that will not stop by itself. Raises LocalProtocolError for other values.
    """

    node_id: int = 127
    period: Time = 100 * MILLISECOND
    timeout: Time = 500 * MILLISECOND
    abort_connection: int = QUICK_STOP
    required: bool = False

    def __post_init__(self) -> None:
        check_node_id(self.node_id)
        if self.period % MILLISECOND or self.timeout % MILLISECOND or self.period < MILLISECOND:
            raise LocalProtocolError(f"period {self.period} ns and timeout {self.timeout} ns have to be whole milliseconds")
        if not 2 * self.period <= self.timeout <= MAX_CONSUMER_TIME:
            raise LocalProtocolError(f"timeout {self.timeout} ns is below two periods of {self.period} ns, or above 65.535 s")
        if not -0x8000 <= self.abort_connection <= 0x7FFF:
            raise LocalProtocolError(f"0x6007 is an INTEGER16, which cannot be {self.abort_connection}")

    @property
    def entry(self) -> int:
        """The entry for 0x1016: node-ID << 16 | ms."""
        return self.node_id << 16 | self.timeout // MILLISECOND


DEFAULT_WATCHDOG: Final = Watchdog()


class NotHeldError(ProcedureError):
    """A drive will not stop by itself if its master is gone, although `Watchdog.required` demands it."""


class Hold:
    """The hold on the drives of one node. axes: those that react to a lost master. before: the old bytes of changed objects,
    by (index, subindex), in the order of the changes. gap: why the drive will not stop by itself; "" if it will.
    is_taken: `take_hold` has ended. guards: the guarding is ours."""

    def __init__(self, node: RemoteNode, axis: int = 0) -> None:
        self.node = node
        self.axes = {axis}
        self.before: dict[tuple[int, int], bytes] = {}
        self.gap = ""
        self.guards = False
        self.is_taken = False

    def forget(self) -> None:
        """Forget the old values: the drive has booted and lost what was set."""
        self.before.clear()
        self.gap = ""
        self.is_taken = False
        self.stop_guarding()

    def stop_guarding(self) -> None:
        """Stop the guarding, if it is ours."""
        if self.guards:
            self.guards = False
            self.node.stop_guarding()


class _Gap(Exception):
    """The drive cannot be held, and why; never leaves this module."""


def take_hold(hold: Hold, watchdog: Watchdog) -> Procedure[None]:
    """Make the drive stop by itself if the master's heartbeat (or its guarding) stays away. See this module's text.

    If the drive cannot, `hold.gap` says why. Raises SdoTransferError if the drive does not answer; NotHeldError if it cannot, and
    `watchdog.required` is set.
    """
    gaps = []
    for make in (_watch_master, _set_reaction):
        try:
            yield from make(hold, watchdog)
        except _Gap as gap:
            gaps.append(str(gap))
    hold.gap = "; ".join(gaps)
    hold.is_taken = not (hold.gap and watchdog.required)
    if not hold.is_taken:
        raise not_held(hold)


def not_held(hold: Hold) -> NotHeldError:
    """Return the error to raise for a drive with a gap."""
    return NotHeldError(f"drive {hold.node.node_id} would not stop by itself if this master fell silent: {hold.gap}")


def release(hold: Hold) -> Procedure[None]:
    """Write back the values that `take_hold` found, the last change first. The drive must stand: it no longer watches its master.

    Raises SdoTransferError if a write fails; the rest then stays in `hold.before`.
    """
    hold.is_taken = False
    yield from _put_back(hold)
    hold.forget()


def _watch_master(hold: Hold, watchdog: Watchdog) -> Procedure[None]:
    """Make the drive watch the master by its heartbeat, else by its guarding."""
    try:
        yield from _consume_heartbeat(hold, watchdog)
    except _Gap as no_heartbeat:
        try:
            yield from _be_guarded(hold, watchdog)
        except _Gap as no_guarding:
            raise _Gap(f"{no_heartbeat}, and {no_guarding}") from None


def _consume_heartbeat(hold: Hold, watchdog: Watchdog) -> Procedure[None]:
    count = yield from _read(hold, indices.CONSUMER_HEARTBEAT_TIME, 0)
    place, others = 0, []
    for subindex in range(1, (count & 0xFF) + 1):
        entry = yield from _read(hold, indices.CONSUMER_HEARTBEAT_TIME, subindex)
        node_id = entry >> 16 & 0xFF
        if not entry & 0xFFFF or not 1 <= node_id <= MAX_NODE_ID:
            place = place or subindex
        elif node_id == watchdog.node_id:
            place = subindex
            if entry == watchdog.entry:  # left by a master that died
                hold.before.setdefault((indices.CONSUMER_HEARTBEAT_TIME, subindex), bytes(4))
            break
        else:
            others.append(str(node_id))
    if not place:
        raise _Gap(f"all entries of 0x1016 are in use (node {', '.join(others)})" if others else "0x1016 has no entries")
    yield from _set(hold, indices.CONSUMER_HEARTBEAT_TIME, place, watchdog.entry, 4)


def _be_guarded(hold: Hold, watchdog: Watchdog) -> Procedure[None]:
    """Set up life guarding: the drive watches for the master's requests. If that fails, write back what was changed for it."""
    node, kept = hold.node, len(hold.before)
    factor = min(max(MIN_LIFE_TIME_FACTOR, -(-watchdog.timeout // watchdog.period)), MAX_LIFE_TIME_FACTOR)
    guard_time = max(1, watchdog.timeout // factor // MILLISECOND)
    is_guarded = bool(node.guarding.guard_time) and not hold.guards
    if is_guarded:  # guarding was started elsewhere
        guard_time, factor = -(-node.guarding.guard_time // MILLISECOND), MIN_LIFE_TIME_FACTOR
    try:
        yield from _read(hold, indices.LIFE_TIME_FACTOR, 0)
        period = yield from _read_if_present(hold, indices.PRODUCER_HEARTBEAT_TIME, 0)
        if period:  # else it has no heartbeat, or does not send it
            yield from _set(hold, indices.PRODUCER_HEARTBEAT_TIME, 0, 0, 2)
        yield from _set(hold, indices.GUARD_TIME, 0, guard_time, 2)
        yield from _set(hold, indices.LIFE_TIME_FACTOR, 0, factor, 1)
        if not (hold.guards or is_guarded):
            yield from act(lambda now: node.start_guarding(guard_time * MILLISECOND, factor, now))
            hold.guards = True
        patience = max(watchdog.timeout, 2 * node.guarding.guard_time)
        answer = yield Wait(patience, node, lambda each: isinstance(each, GuardingAnswered) and each.node_id == node.node_id)
        if answer is None:
            raise _Gap("it does not answer guarding (some adapters send no remote frames)")
    except _Gap:
        yield from act(lambda now: hold.stop_guarding())
        yield from _put_back(hold, kept)
        raise


def _set_reaction(hold: Hold, watchdog: Watchdog) -> Procedure[None]:
    for axis in sorted(hold.axes):
        yield from _set(hold, index_of(swapped(mux(ABORT_CONNECTION), axis)), 0, watchdog.abort_connection, 2)


def _set(hold: Hold, index: int, subindex: int, value: int, size: int) -> Procedure[None]:
    """Write an object if it has another value, read it back, and keep the old value."""
    key, label = (index, subindex), _label(index, subindex)
    wanted = value.to_bytes(size, "little", signed=value < 0)
    found = yield from unless_refused(upload(hold.node.sdo, index, subindex))
    if found is None:
        raise _Gap(f"no {label}")
    if found == wanted:
        return
    if hold.is_taken and found == hold.before.get(key):
        hold.node.assume_boot()  # which empties `before`: what it has now are its power-on values
    is_first = key not in hold.before
    if is_first:
        hold.before[key] = found  # before the write: a write without an answer may have been executed
    try:
        yield from download(hold.node.sdo, index, subindex, wanted)
    except SdoTransferError as failed:
        if failed.origin is not AbortOrigin.PEER:
            raise
        if is_first:
            del hold.before[key]
        raise _Gap(f"it refuses {_show(wanted)} in {label} (abort 0x{failed.abort_code:08X})") from None
    shown = yield from unless_refused(upload(hold.node.sdo, index, subindex))
    if shown != wanted:
        raise _Gap(f"its {label} shows {_show(shown)} after {_show(wanted)} was written")


def _put_back(hold: Hold, kept: int = 0) -> Procedure[None]:
    """Write back the old values, the last change first, except the first `kept` ones."""
    while len(hold.before) > kept:
        (index, subindex), data = next(reversed(hold.before.items()))
        yield from download(hold.node.sdo, index, subindex, data)
        hold.before.pop((index, subindex), None)  # a boot, or another release, may have emptied it meanwhile


def _read(hold: Hold, index: int, subindex: int) -> Procedure[int]:
    value = yield from _read_if_present(hold, index, subindex)
    if value is None:
        raise _Gap(f"no {_label(index, subindex)}")
    return value


def _read_if_present(hold: Hold, index: int, subindex: int) -> Procedure[int | None]:
    """Read a number; None if the drive does not have the object or does not show it."""
    data = yield from unless_refused(upload(hold.node.sdo, index, subindex))
    return None if data is None else int.from_bytes(data, "little")


def _show(data: bytes | None) -> str:
    return "nothing" if data is None else f"0x{int.from_bytes(data, 'little'):X}"


def _label(index: int, subindex: int) -> str:
    name = _NAMES.get(index, _NAMES[ABORT_CONNECTION])  # that of a further axis
    return f"0x{index:04X}:{subindex:02X} ({name})" if subindex else f"0x{index:04X} ({name})"
