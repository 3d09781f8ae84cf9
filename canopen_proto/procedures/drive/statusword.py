"""Statusword and controlword of a drive: read the one, wait for the one, bring the other to the drive.

Commands take the way that `Axis` describes (the live RPDO, else SDO). A wait for the statusword takes what a TPDO brought within
the last 100 ms, else polls by SDO every 10 ms, since a drive whose SYNC is not running sends no TPDO.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from canopen_proto.cia402.axis import Axis
from canopen_proto.cia402.states import State, state_of
from canopen_proto.machine import MILLISECOND, SECOND, Event, Time
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.procedures.objects import read_if_present, read_int, write
from canopen_proto.procedures.steps import Procedure, ProcedureError, StepTimeout, Wait, act, current_time
from canopen_proto.sync import SyncReceived, SyncSent

POLL_INTERVAL: Final = 10 * MILLISECOND
"""Between two SDO reads of an object that is waited for, as the manual's library polled."""

SYNC_ALIVE: Final = 500 * MILLISECOND
"""SYNC counts as running when one was sent or heard within this time; it is also what a command waits for the next one."""


class DriveFault(ProcedureError):
    """The drive is in Fault, or fell into it while something else was awaited."""


def name_of(axis: Axis) -> str:
    """The drive in messages."""
    return f"drive {axis.node.node_id}"


def read_statusword(axis: Axis) -> Procedure[int]:
    """The present statusword: what was heard no longer than 100 ms ago, else read by SDO."""
    now = yield from current_time()
    statusword = axis.fresh_statusword(now)
    if statusword is None:
        statusword = yield from read_int(axis.node, "0x6041")
    return statusword


def wait_for_statusword(
    axis: Axis, done: Callable[[int], bool], timeout: Time, goal: str, *, accept_fault: bool = False
) -> Procedure[int]:
    """Wait until done(statusword), at most `timeout` ns; the statusword. What was heard before the wait does not count.

    Raises DriveFault as soon as the drive shows one (unless accept_fault), StepTimeout that names `goal` and what was seen last.
    """
    node = axis.node

    def is_news(report: Event) -> bool:
        return isinstance(report, PdoReceived) and report.node_id == node.node_id

    not_before = yield from current_time()
    deadline = not_before + timeout
    while True:
        now = yield from current_time()
        statusword = axis.fresh_statusword(now, not_before)
        if statusword is None:
            statusword = yield from read_int(node, "0x6041")
            now = yield from current_time()
            not_before = now + 1  # only a TPDO's value may serve for more than one look
        if done(statusword):
            return statusword
        if not accept_fault and state_of(statusword) in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            raise (yield from fault_of(axis, f"while waiting for {goal}"))
        if now >= deadline:
            raise StepTimeout(f"{name_of(axis)} did not reach {goal} within {timeout / SECOND:g} s: {axis.describe()}")
        yield Wait(min(POLL_INTERVAL, deadline - now), node, is_news)


def fault_of(axis: Axis, when: str) -> Procedure[DriveFault]:
    """What to raise for a drive in fault: with its error code (0x603F), which is read first, and its last EMCY."""
    try:
        yield from read_if_present(axis.node, "0x603F")
    except ProcedureError as error:
        when = f"{when} (its error code could not be read: {error})"
    return DriveFault(f"{name_of(axis)} is in fault {when}: {axis.describe()}. Try: find the cause, then reset the fault")


def command(axis: Axis, controlword: int) -> Procedure[None]:
    """Bring a controlword to the drive: by the live RPDO that carries it, else by SDO, confirmed.

    By a synchronous RPDO it waits for the SYNC that takes it along, so that two commands in a row are two PDOs and an edge is an
    edge. Where SYNC is not running such an RPDO would never leave, and SDO is used. Raises SdoFailed.
    """
    producer = axis.node.rpdo_of(0x6040)
    if producer is not None and not producer.is_synchronous:
        yield from act(lambda now: axis.set_controlword(controlword, now))
        return
    last_sync = axis.node.last_sync
    if producer is not None and last_sync is not None and (yield from current_time()) - last_sync <= SYNC_ALIVE:
        yield from act(lambda now: axis.set_controlword(controlword, now))
        for _ in range(max(1, producer.transmission_type)):  # one of type n goes at every n-th SYNC
            if (yield Wait(SYNC_ALIVE, axis.node, lambda report: isinstance(report, SyncSent | SyncReceived))) is None:
                break
        else:
            return
    yield from write(axis.node, "0x6040", controlword)
