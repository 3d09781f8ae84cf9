"""The output of `canopen restore`: each write, old and new; what was left out; after a failure, what was written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final

from canopen_cli.node.backup_reading import both_notations
from canopen_cli.node.object_files import not_as_written
from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.frames_shown import frames_of
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.screen import Screen, counted, escape, node_text
from canopen_cli.shared.values import as_json, hex_text, object_json, place_text
from canopen_cli.shared.withholding import Unsent
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.manager.parameters.backup import ReadResult
from canopen_proto.manager.parameters.restore import PlannedWrite, Restoration, RestoreError, VerifyMismatchError
from canopen_proto.multiplexer import index_of, split_mux, subindex_of
from canopen_proto.nmt import NmtState

MISSING: Final = frozenset(str(each) for each in ReadResult if each.is_missing)
"""Remarks in a file about objects that a complete backup would have."""
MAX_NAMED: Final = 5
"""Objects named in one line; the rest is counted."""


def show(screen: Screen, so_far: Restoration, path: str, *, unsent: Unsent | None = None) -> None:
    """Show the writes with the old value of each object; for a dry run (unsent), the planned ones and their frames."""
    plan, dry_run = so_far.plan, unsent is not None
    frames = [] if unsent is None else frames_of(unsent.records, unsent.dictionary_of, gone_out=unsent.gone_out)[0]
    writes = plan.writes if dry_run else so_far.done
    if screen.json_output:
        screen.json(
            {
                "node": plan.node_id,
                "file": path,
                "dry_run": dry_run,
                "writes": [_as_json(each, not dry_run and number < so_far.written) for number, each in enumerate(plan.writes)],
                "equal": plan.equal,
                "left_out": [
                    {"index": index_of(key), "sub": subindex_of(key), "reason": why} for key, why in sorted(plan.left_out.items())
                ],
                "stored": so_far.stored and not dry_run,
                "state_before": so_far.state_before.name if so_far.state_before is not None else None,
                "done": so_far.is_done and not dry_run,
                **({"frames": [each.as_json() for each in frames]} if dry_run else {}),
            }
        )
        return
    for each in writes:
        screen.out.print(_line(each), soft_wrap=True)
    for key, why in sorted(plan.left_out.items()):
        screen.detail(f"left out: {index_of(key):04X}:{subindex_of(key):02X}, {why}")
    left = "; ".join(f"{number} {why}" for why, number in Counter(plan.left_out.values()).most_common())
    screen.say(f"{counted(plan.equal, 'object')} as in {escape(path)} already" + (f"; left out: {escape(left)}" if left else ""))
    who = node_text(plan.node_id)
    if dry_run:
        screen.say(f"{who}: {counted(len(writes), 'write')} to do; nothing was written (--dry-run)")
        for _, _, frame, service, text in frames:
            screen.out.print(f"[dim]{frame}  {escape(service)} {escape(text)}[/]", soft_wrap=True)
    elif so_far.is_done:
        screen.say(f"{who}: {counted(len(writes), 'write')} done{', and stored' if so_far.stored else ''}{_state_text(so_far)}")


def tell_unread(screen: Screen, dictionary: ObjectDictionary, so_far: Restoration) -> bool:
    """Name the objects that could not be read: in this device now, or in the file's device then. Return whether there are any in
    this device."""
    plan = so_far.plan
    unread = [dictionary.variable(split_mux(key)) for key in sorted(plan.unread) if key in plan.left_out]
    if unread:
        screen.say(f"[yellow]left alone, since it could not be read:[/] {escape(_places(unread))}")
    missing = [each for each in dictionary if each.not_read in MISSING]
    if missing:
        screen.say(f"[yellow]the file has no value, since it could not be read then:[/] {escape(_places(missing))}")
    return bool(unread)


def _state_text(so_far: Restoration) -> str:
    if so_far.state is None:
        return ""
    if so_far.state_before is None:
        back = f"canopen nmt start {so_far.plan.node_id}"
        return f". It has no heartbeat that shows in which state it was: it stays Pre-operational; {back}"
    return f". It is {so_far.state_before.name.replace('_', '-')}, as before"


def _line(write: PlannedWrite) -> str:
    old, new = (both_notations(write.variable, each) for each in (write.value_before, write.value))
    return f"{place_text(write.variable)} {escape(write.variable.name)}: {escape(old)} [bold]→ {escape(new)}[/]"


def _as_json(write: PlannedWrite, is_done: bool) -> dict[str, Any]:
    return object_json(write.variable) | {
        "before": None if write.value_before is None else as_json(write.variable, write.value_before),
        "value": as_json(write.variable, write.value),
        "hex": hex_text(write.variable, write.value) or None,
        "done": is_done,
    }


def story(so_far: Sequence[Restoration]) -> list[str]:
    """Tell what was done until a restore was interrupted or failed, line by line."""
    if not so_far or so_far[0].state is None:
        return ["nothing was written"]
    found = so_far[0]
    total = len(found.plan.writes)
    lines = [f"{found.written} of {counted(total, 'write')} were confirmed"]
    not_sent = [each.variable for each in found.open if each is not found.in_doubt]
    if found.in_doubt is not None:
        lines.append(f"not confirmed, so it may have been executed: {_places([found.in_doubt.variable])}; it is not sent again")
    if not_sent:
        lines.append(f"not written: {_places(not_sent)}")
    if found.pdos_off:
        lines.append(f"PDOs left disabled: {_places(found.pdos_off)}")
    if not found.open:
        stored = ", and perhaps stored" if found.store_in_doubt else ", and stored" if found.stored else ""
        lines.append(f"all of it is written{stored}")
    lines.append(f"{node_text(found.plan.node_id)} stays Pre-operational")
    return lines


def _places(variables: Sequence[Variable]) -> str:
    places = list(dict.fromkeys(f"{place_text(each)} ({each.name})" for each in variables))
    rest = f" and {len(places) - MAX_NAMED} more" if len(places) > MAX_NAMED else ""
    return ", ".join(places[:MAX_NAMED]) + rest


def told(error: Exception, so_far: Sequence[Restoration], path: str) -> CommandError:
    """Return the CommandError for a failure, with what was written before it."""
    if not isinstance(error, RestoreError):
        return problem_of(error)
    reason = error.__cause__ or error
    found = error.restoration
    node_id = found.plan.node_id
    if isinstance(reason, VerifyMismatchError):
        write = reason.write
        value = both_notations(write.variable, write.value)
        seen = f"bytes {reason.shown.hex(' ') or 'none'}, written were {write.data.hex(' ')}"
        problem = not_as_written(node_id, write.variable, value, "something else", seen=seen)
    else:
        problem = problem_of(reason)
    problem.also += story(so_far)
    begun = found.state is NmtState.PRE_OPERATIONAL
    tries = [f"canopen restore {node_id} {path} --dry-run    (what is still to be written)"] if begun else []
    if begun and problem.index is not None and problem.exit_code in (ExitCode.SDO_ABORT, ExitCode.VERIFY_MISMATCH):
        tries.append(f"--skip {problem.index:04X}:{problem.subindex or 0:02X}, if the device need not have it")
    if begun:
        tries.append(f"canopen nmt start {node_id}    (run it as it is now)")
    problem.tries = (*tries, *problem.tries)
    return problem
