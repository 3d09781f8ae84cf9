"""`canopen drive stop NODE|disable`: the first frame that is sent is one that stops; only then is anything read.

The controlword goes by SDO to each axis of the node, at once, and again without an answer. A node that does not answer may be in
NMT state Stopped, where it takes no SDO: it is made pre-operational, and told again. The last way is NMT `stop`, to which a drive
reacts as its 0x6007 says. Both NMT commands are announced. Then the drive is looked at: the command succeeds only if the drive
shows that it is stopped. After a quick stop the position (0x6064) of a drive without power must stay, too: its axis may coast.

Source: IEC 61800-7-201 (CiA 402-2), 0x6007, 0x605A; CiA 301 v4.2.0, 7.3.2.2.4 (which service lives in which NMT state).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import click

from canopen_cli.drive.session import AXIS, axis_of_command, command_drive, run_on_node, show_drive
from canopen_cli.shared.options import Settings, command, commanding
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.session import BusSession
from canopen_master.motion.single_drive import look_at_drive
from canopen_master.node import Node
from canopen_proto.abort import AbortOrigin
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.controlword import insist
from canopen_proto.drives.axis.halting import coast_down, halt
from canopen_proto.drives.axis.state import shut_down
from canopen_proto.drives.axis.view import DriveView, view_of
from canopen_proto.drives.axis.watching import read_statusword, wait_for_statusword
from canopen_proto.drives.cia402.axes import MAX_AXES, axes_of, swapped
from canopen_proto.drives.cia402.objects import CONTROLWORD, STATUSWORD
from canopen_proto.drives.cia402.states import POWERED, Command, State, state_of
from canopen_proto.multiplexer import split_mux
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoTransferError, act, all_of, download, upload

LOOKS: Final = 3
"""How often a drive that took the command is looked at, if an answer is lost."""


class Stop(NamedTuple):
    """A way to stop. word: the controlword that is sent first. complete: waits until the drive shows the end of it."""

    name: str
    word: Command
    complete: Callable[[Axis], Procedure[None]]


def _quick_stopped(axis: Axis) -> Procedure[None]:
    yield from wait_for_statusword(axis, _is_stopped, axis.settings.state_timeout, "a quick stop")
    yield from halt(axis)  # which sends nothing to a drive in Quick stop active, and waits until it stands
    if axis.state not in POWERED:
        yield from coast_down(axis)  # 0x605A = 0 takes the power away at once


def _is_stopped(statusword: int) -> bool:
    return state_of(statusword) in (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)


QUICK_STOP: Final = Stop("quick stop", Command.QUICK_STOP, _quick_stopped)
DISABLE: Final = Stop("disable voltage", Command.DISABLE_VOLTAGE, shut_down)


@command()
@commanding
def stop(settings: Settings, screen: Screen) -> None:
    """Command a quick stop, and wait until the drive stands. It brakes as 0x605A says; most drives have no power afterwards.

    The first frame that is sent is the stop. Without --axis all axes of the node are stopped. A node that does not answer is told
    by NMT too, which is announced.

    \b
    canopen drive stop 3 -b demo
    """
    _carry_out(settings, screen, QUICK_STOP)


@command()
@commanding
def disable(settings: Settings, screen: Screen) -> None:
    """Take the power from a drive. One that moves coasts, or is stopped as its maker chose.

    The first frame that is sent is the command. Without --axis all axes of the node lose their power. A node that does not answer
    is told by NMT too, which is announced.

    \b
    canopen drive disable 3 -b demo
    """
    _carry_out(settings, screen, DISABLE)


def _carry_out(settings: Settings, screen: Screen, way: Stop) -> None:
    if settings.dry_run:

        def rehearsed(axis: Axis) -> Procedure[None]:
            yield from insist(axis, int(way.word))
            yield from _see(axis, way)

        command_drive(settings, screen, rehearsed)
    number = axis_of_command(settings)
    machine = settings.machine_file()
    meta = click.get_current_context().meta
    is_chosen = meta.get(AXIS) is not None or (machine is not None and number > 0)

    def whole(session: BusSession, node: Node) -> Procedure[list[DriveView]]:
        numbers = (number,) if is_chosen else axes_of(node.dictionary) or (number,)
        axes = [
            session.master.device(node, settings=session.axis_settings(node.node_id, each), axis=each).axis for each in numbers
        ]
        yield from tell(node, axes, way, screen)
        if not is_chosen:
            yield from _tell_unknown(node, max(numbers) + 1, way, screen)
        views = []
        for axis in axes:
            yield from _see(axis, way)
            views.append((yield from _view(axis)))
        return views

    for each, view in enumerate(run_on_node(settings, screen, whole)):
        if each:
            screen.say(f"axis {each}: {view.state}")
        else:
            show_drive(settings, screen, view)


def tell(node: Node, axes: list[Axis], way: Stop, screen: Screen) -> Procedure[None]:
    """Send the command to all axes of a node, by every way that is left. Raises a CommandError if nobody confirms it."""
    outcomes = yield from all_of(*(_told(axis, way) for axis in axes))
    silent = _unheard(axes, outcomes)
    if silent and node.nmt_state in (None, NmtState.STOPPED):
        state = "it may be in" if node.nmt_state is None else "it is in"
        screen.say(
            f"[yellow]{_seen(*silent[0])}: {state} NMT state Stopped, where it takes no command. "
            f"NMT 'enter pre-operational' is sent to node {node.node_id}, and the {way.name} again[/]"
        )
        axes = [axis for axis, _ in silent]
        yield from act(lambda now: node.send_nmt(NmtCommand.ENTER_PRE_OPERATIONAL, now))
        outcomes = yield from all_of(*(_told(axis, way) for axis in axes))
        silent = _unheard(axes, outcomes)
    if silent:
        screen.say(
            f"[yellow]{_seen(*silent[0])}. The last way: NMT 'stop' is sent to node {node.node_id}, "
            "to which a drive reacts as its 0x6007 says[/]"
        )
        yield from act(lambda now: node.send_nmt(NmtCommand.STOP, now))
        axis, last = silent[0]
        reason = f"the {way.name} was sent, and NMT 'stop' too, and nothing confirms that it has arrived"
        raise _not_confirmed(axis, reason, last)
    for failed in outcomes:
        if failed is not None and failed.abort_code not in ABSENT:  # what is no drive is told by `look_at_drive`
            raise failed


def _told(axis: Axis, way: Stop) -> Procedure[SdoTransferError | None]:
    """Send the command to an axis; return how it failed. One axis keeps no other from being told.

    If another SDO client disturbs it, that is no silence of the drive. The drive is asked then, which waits for the end of the
    other's exchange, and told again if it answers. In the end `_see` tells whether it has stopped.
    """
    for _ in range(LOOKS):
        try:
            yield from insist(axis, int(way.word))
            return None
        except SdoTransferError as failed:
            if failed.origin is not AbortOrigin.CONTESTED:
                return failed
        try:
            yield from read_statusword(axis)
        except SdoTransferError as failed:
            return failed
    return None


def _unheard(axes: list[Axis], outcomes: list[SdoTransferError | None]) -> list[tuple[Axis, SdoTransferError]]:
    """Return the axes that may not have the command, and why that is not known."""
    return [(axis, failed) for axis, failed in zip(axes, outcomes, strict=True) if failed is not None and _is_silence(failed)]


def _seen(axis: Axis, failed: SdoTransferError) -> str:
    if failed.origin is AbortOrigin.CONTESTED:
        return f"{axis.title} cannot be understood: another SDO client on its channel {failed.aborted.others_doing}"
    return f"{axis.title} does not answer"


def _is_silence(failed: SdoTransferError) -> bool:
    return failed.origin is not AbortOrigin.PEER


def _tell_unknown(node: Node, first: int, way: Stop, screen: Screen) -> Procedure[None]:
    """Tell the further axes of a node that no file describes: those that show that they have power."""
    client = node.remote.sdo
    for number in range(first, MAX_AXES):
        try:
            word = int.from_bytes((yield from upload(client, *split_mux(swapped(STATUSWORD, number)))), "little")
            if state_of(word) in POWERED:
                yield from download(client, *split_mux(swapped(CONTROLWORD, number)), int(way.word).to_bytes(2, "little"))
                screen.say(f"axis {number} had power too, and was told the {way.name}: `--axis {number}` looks at it")
        except SdoTransferError as failed:
            if _is_silence(failed):
                screen.say(f"[yellow]whether drive {node.node_id} has an axis {number} is not known: it did not answer[/]")
            return


def _see(axis: Axis, way: Stop) -> Procedure[None]:
    """Bring a drive that took the command to the end of it. Raises a CommandError if it does not show that it is stopped."""
    for left in reversed(range(LOOKS)):
        try:
            yield from read_statusword(axis)
            yield from way.complete(axis)
            return
        except SdoTransferError as failed:
            if failed.abort_code in ABSENT:
                yield from look_at_drive(axis.node)
            if not _is_silence(failed):
                raise
            if not left:
                reason = f"the {way.name} was sent, and the drive does not show whether it has stopped"
                raise _not_confirmed(axis, reason, failed) from failed


def _view(axis: Axis) -> Procedure[DriveView]:
    """Return what the drive shows; what was heard before, if it does not answer any more."""
    try:
        return (yield from look_at_drive(axis.node))
    except ProcedureError:
        return view_of(axis)


def _not_confirmed(axis: Axis, failed: str, last: SdoTransferError) -> CommandError:
    """last: how the last try to hear of the drive failed."""
    number = axis.node.node_id
    cause = "wrong node-ID, no power, a loose cable, another bit rate; or only its answers are lost"
    if last.origin is AbortOrigin.CONTESTED:
        cause = f"another SDO client on its channel {last.aborted.others_doing}: end that program"
    return CommandError(
        ExitCode.NO_ANSWER,
        "CO411",
        f"{axis.title}: {failed}. IT MAY STILL MOVE",
        cause=cause,
        tries=(
            "press the emergency stop if it moves",
            f"canopen drive stop {number}    again",
            f"canopen drive state {number}    what it shows; after NMT 'stop' first: canopen nmt preop {number}",
        ),
        node=number,
    )
