"""Send a controlword or a mode of operation to a drive: by an RPDO that carries it, or by SDO.

**One controlword image per axis.** It is the node's own image of 0x6040, from which RPDOs are built. While a live RPDO carries
0x6040, a command goes into the image, and that PDO sends it. Otherwise the command goes by SDO. A confirmed SDO write sets the
image too: else the next RPDO would send a stale 0 and take the drive out of operation.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.abort import AbortOrigin
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.failures import as_drive_errors, is_loss_of, node_lost, taken_down
from canopen_proto.drives.axis.view import is_taken_down
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import ModeControl
from canopen_proto.drives.cia402.states import Command, State, enables_operation
from canopen_proto.machine import MILLISECOND, Event, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.objects import urgent_request, write
from canopen_proto.procedures.steps import Procedure, SdoTransferError, Wait, act, current_time, sleep
from canopen_proto.sdo.contention import SPREAD
from canopen_proto.sdo.events import SdoAborted
from canopen_proto.sync import SyncReceived, SyncSent

SYNC_ALIVE: Final = 500 * MILLISECOND
"""SYNC counts as running if one was sent or heard within this time. A command waits no longer than this for the next one."""

TRIES: Final = 2
"""How often a word that stops is sent to a drive that does not confirm it. Each try takes at most one SDO time-out."""

STAYS: Final = {
    State.SWITCH_ON_DISABLED: Command.DISABLE_VOLTAGE,
    State.READY_TO_SWITCH_ON: Command.SHUTDOWN,
    State.SWITCHED_ON: Command.SWITCH_ON,
    State.QUICK_STOP_ACTIVE: Command.QUICK_STOP,
    State.FAULT_REACTION_ACTIVE: Command.DISABLE_VOLTAGE,
    State.FAULT: Command.DISABLE_VOLTAGE,
}
"""State -> the command that leaves a drive there. In all of these states the drive follows no set-points."""


@as_drive_errors
def insist(axis: Axis, controlword: int) -> Procedure[None]:
    """Send a controlword that stops the drive, as `command` does; if it is not confirmed send it again, TRIES times in all.

    A write that is not confirmed is otherwise never repeated. A word that stops may be: it does no more the second time. Another
    SDO client that disturbs it may keep the drive from hearing it, too; so its exchange gets SPREAD to end before the next try.
    By SDO the word goes before all queued requests of the node, and ends a transfer that keeps it waiting (`urgent_request`).
    """
    for left in reversed(range(TRIES)):
        try:
            yield from command(axis, controlword, urgent=True)
            return
        except SdoTransferError as failed:
            if failed.origin not in (AbortOrigin.TIMEOUT, AbortOrigin.CONTESTED) or not left:
                raise
            is_disturbed = failed.origin is AbortOrigin.CONTESTED
        if is_disturbed:
            yield from sleep(SPREAD)


def insist_and_look(axis: Axis, controlword: int) -> Procedure[None]:
    """`insist`, where the caller awaits that the drive shows the effect: so an answer that another SDO client has disturbed is no
    failure. Most drives have heard the word all the same."""
    try:
        yield from insist(axis, controlword)
    except SdoTransferError as failed:
        if failed.origin is not AbortOrigin.CONTESTED:
            raise


@as_drive_errors
def command(axis: Axis, controlword: int, *, urgent: bool = False) -> Procedure[None]:
    """Send a controlword to the drive: by the live RPDO that carries it, else by confirmed SDO.

    A synchronous RPDO leaves behind a SYNC, and the drive takes it at the next SYNC (CiA 301 v4.2.0, 7.5.2.35). The command waits
    for that SYNC. So two commands in a row are two PDOs, the drive sees each edge, and what it shows from then on is its answer.
    SDO is used if SYNC is not running (such an RPDO would never leave), or if the RPDO is not sent (or no longer). If the drive
    then still holds an RPDO for a SYNC, that RPDO is first replaced by one with this word (`RemoteNode.write`). urgent: an SDO
    write goes as an `urgent_request`. Raises SdoTransferError, DriveLostError; StateLostError, with nothing sent, for a word of a
    motion that would enable a drive which somebody else has disabled.
    """
    is_of_motion = axis.occupancy.is_inside and axis.occupancy.occupant is not None and not urgent
    if is_of_motion and enables_operation(controlword) and is_taken_down(axis):
        raise taken_down(axis)
    is_start = bool(controlword & ~axis.controlword & ModeControl.NEW_SET_POINT)
    if is_start:
        axis.started_at = (yield from current_time()) + SYNC_ALIVE  # at the latest, if this is cancelled on the way
    axis.commanded_at = yield from current_time()
    axis.commanded = controlword & 0xFFFF
    yield from bring(axis, objects.CONTROLWORD, controlword & 0xFFFF, urgent=urgent)
    if is_start:
        axis.started_at = yield from current_time()


def bring(axis: Axis, mux: Mux, value: int, *, urgent: bool = False) -> Procedure[None]:
    """Bring the value of an object to the drive, as `command` brings a controlword.

    urgent: as of `command`. From then on the object is ours (`RemoteNode.commanded`): its image keeps this value whatever is
    read, and a write of it by SDO is not undone by an RPDO that the drive holds. Raises ValueRangeError, with nothing sent, for a
    value that does not fit.
    """
    node = axis.node
    node.dictionary.variable(mux).encode(value)
    node.keep_commanded(mux)
    producer = node.rpdo_of(mux)
    if producer is not None and not producer.is_synchronous:
        yield from act(lambda now: put(axis, mux, value, now))
        return
    last_sync = axis.remote.last_sync
    if producer is not None and last_sync is not None and (yield from current_time()) - last_sync <= SYNC_ALIVE:
        yield from act(lambda now: put(axis, mux, value, now))
        # An RPDO of transmission type n leaves at every n-th SYNC.
        if (yield from syncs_passed(axis, max(1, producer.transmission_type) + 1)):
            return
    if not urgent:
        yield from write(node, mux, value)
        return
    outcome = yield from urgent_request(node, lambda now: node.write(mux, value, now, urgent=True))
    if isinstance(outcome, SdoAborted):
        raise SdoTransferError(outcome, "writing")


def put(axis: Axis, mux: Mux, value: int, now: Time) -> None:
    """Put a value into the image of an object. An event-driven RPDO sends it at once, a synchronous one behind the next SYNC.

    Without a live RPDO that carries the object nothing is sent.
    """
    axis.node.values.store[mux] = value
    producer = axis.node.rpdo_of(mux)
    if producer is not None:
        producer.trigger(now)


def command_held(axis: Axis, controlword: int) -> Procedure[None]:
    """Put a controlword into each RPDO that the drive holds for a SYNC. Sends nothing if it holds none.

    This is for a drive that `command` does not command, or not yet: no SYNC that comes makes an older word act.
    """
    yield from act(lambda now: axis.node.replace_held(objects.CONTROLWORD, controlword, now))


def syncs_passed(axis: Axis, count: int) -> Procedure[bool]:
    """Wait for `count` SYNCs; return False if one does not come within SYNC_ALIVE."""
    node = axis.node

    def concerns(report: Event) -> bool:
        return isinstance(report, SyncSent | SyncReceived) or is_loss_of(node, report)

    for _ in range(count):
        report = yield Wait(SYNC_ALIVE, node, concerns)
        if report is None:
            return False
        if is_loss_of(node, report):
            raise node_lost(axis, report, "the SYNC that takes a command along")
    return True
