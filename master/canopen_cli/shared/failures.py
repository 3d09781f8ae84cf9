"""Turn the exceptions of all layers below into Problems.

Most exceptions bring their own words (`TransportError`, `MasterError`, `DataError`, ...). `problem_of` is the one table that
gives each its exit status, and a message to those without one. It stands apart from problem.py because it imports all layers, and
`canopen --help` needs none of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Final

import click

from canopen_cli.shared.importing import library_missing
from canopen_cli.shared.options import DEMO
from canopen_cli.shared.problem import NO_ROOM, CommandError, ExitCode, usage
from canopen_gateway import errors as gateway_errors
from canopen_master import errors
from canopen_master.silence import LONGER, SCAN
from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import ValueRangeError
from canopen_proto.dictionary import ConstantNotFoundError, NotInDictionaryError, ObjectNotFoundError
from canopen_proto.drives.axis import DriveError, DriveInFaultError, HomingError, ModeUnsupportedError
from canopen_proto.drives.cia402.states import State
from canopen_proto.explained import Explained
from canopen_proto.machine import LocalProtocolError
from canopen_proto.manager.programs.download import ProgramDownloadError
from canopen_proto.procedures.objects import UnexpectedLengthError
from canopen_proto.procedures.steps import NOT_CONFIRMED, ProcedureError, SdoTransferError
from canopen_transports import TransportError
from canopen_transports.errors import BAD_LOCATOR, CANNOT_OPEN, NO_PERMISSION
from canopen_transports.locator import nearest


def problem_of(error: BaseException) -> CommandError:
    """Return the CommandError for an exception. An exception that nobody foresaw is CO900: our own mistake."""
    if isinstance(error, CommandError):
        error.also += [note for note in getattr(error, "__notes__", ()) if note not in error.also]
        return error
    if isinstance(error, BaseExceptionGroup):
        return _of_group(error)
    problem = _of_expected(error)
    if problem is not None:
        problem.seen, problem.cause = in_words_of_files(problem.seen), in_words_of_files(problem.cause)
        problem.tries = tuple(map(in_words_of_files, problem.tries))
    else:
        problem = CommandError(
            ExitCode.INTERNAL,
            "CO900",
            f"this should not happen: {type(error).__name__}: {error}",
            cause="a mistake in this program, not yours",
            tries=("the same with -vv, and report what it shows",),
        )
    problem.also += getattr(error, "__notes__", [])
    problem.__cause__ = error
    return problem


def _of_group(group: BaseExceptionGroup[BaseException]) -> CommandError:
    """Return the CommandError for the first error that matters, and mention the others in it."""
    problems = sorted((problem_of(each) for each in group.exceptions), key=lambda each: each.exit_code is ExitCode.INTERNAL)
    first, rest = problems[0], problems[1:]
    first.also += [f"{each.code}: {each.failed}" for each in rest if each.failed != first.failed]
    return first


def _of_expected(error: BaseException) -> CommandError | None:
    match error:
        case TransportError():
            return _what_was_meant(_spoken(error, _of_bus(error.code)), error.locator)
        case errors.BusError():
            return _what_was_meant(_spoken(error, _of_bus(error.code)), error.bus)
        case errors.SdoTimeoutError() | errors.NodeSilentError() | errors.CallTimeoutError():
            return _spoken(error, ExitCode.NO_ANSWER)
        case errors.SdoError():
            return _spoken(error, ExitCode.SDO_ABORT)
        case errors.ChainFileError() | errors.NoDriveInFileError():
            return _spoken(error, ExitCode.BAD_FILE)
        case (
            errors.UnknownChainError()
            | errors.SetPointRefusedError()
            | errors.PlanRefusedError()
            | errors.PackageMissingError()
            | errors.DeviceRefusedError()
            | errors.DemonstrationRefusedError()
        ):
            return _spoken(error, ExitCode.USAGE)
        case errors.RealtimeRefusedError():
            return _spoken(error, ExitCode.PERMISSION)
        case errors.NodeError():
            return _spoken(error, ExitCode.SDO_ABORT)
        case errors.MasterError():
            return _of_chain(error)
        case gateway_errors.GatewayError():
            return _of_gateway(error)
        case Explained():  # of a file: DataError, DictionaryError, LogFileError, ScriptError, StateFileError
            return _spoken(error, ExitCode.BAD_FILE)
        case SdoTransferError():
            return _of_sdo(error)
        case ProcedureError():
            return _of_procedure(error)
        case NotInDictionaryError():
            failed, _, hint = str(error).partition("; ")
            return usage("CO302", failed, tries=(hint,) if hint else _KEYS.get(type(error), ()))
        case ValueRangeError():
            return usage("CO304", str(error), seen="nothing was sent")
        case LocalProtocolError():
            return usage("CO120", str(error), seen="nothing was sent")
        case OSError(errno=number) if number in NO_ROOM:
            return CommandError(
                ExitCode.BAD_FILE, "CO341", f"cannot write: {error.strerror}", tries=("make room, or write elsewhere",)
            )
        case ModuleNotFoundError():  # python-can is imported where a bus or a log needs it
            return _of_missing(error)
        case PermissionError():
            return CommandError(ExitCode.PERMISSION, "CO109", str(error))
        case click.UsageError():
            return _of_usage(error)
        case click.ClickException():
            return usage("CO001", error.format_message())
    return None


def _of_missing(error: ModuleNotFoundError) -> CommandError | None:
    missing = library_missing(error)
    if missing is None:
        return None
    failed, _, step = str(missing).partition(".\nTry: ")
    return CommandError(ExitCode.CANNOT_OPEN, CANNOT_OPEN, failed, tries=(step,))


_KEYS: Final[dict[type[NotInDictionaryError], tuple[str, ...]]] = {
    ObjectNotFoundError: ("an index, such as 6041 or 6041:00, or a name",),
    ConstantNotFoundError: ("a number, such as 100 or 0x64",),
}
"""What names an object, and a value, where nothing like what was typed is known."""
_KINDS: Final = {
    "is not a valid float.": "is not a number",
    "is not a valid float range.": "is not a number",
    "is not a valid integer.": "is not a whole number",
    "is not a valid integer range.": "is not a whole number",
}
"""What click says of a value, in plainer words."""
_WRONG_CHOICE: Final = re.compile(r": '([^']*)' is not one of (.*)")
_WITH_UNIT: Final = re.compile(r"'([-+.0-9]+) ?([A-Za-z]+)' is not a number")
_EXTRA: Final = re.compile(r"Got unexpected extra argument \((\S+)\)")


def _example_of(error: click.UsageError) -> list[str]:
    """Return the first example on a command's page, if the user has left something out."""
    if not isinstance(error, click.MissingParameter) or error.ctx is None:
        return []
    lines = map(str.strip, (error.ctx.command.help or "").splitlines())
    found = [line.partition("    ")[0] for line in lines if line.startswith(f"{error.ctx.command_path} ")]
    return [f"{each}    (an example)" for each in found[:1]]


def _of_usage(error: click.UsageError) -> CommandError:
    command = error.ctx.command_path if error.ctx is not None else "canopen"
    if isinstance(error, click.NoSuchOption):  # click compares them with their hyphens, so that --method is near to --eds
        near = get_close_matches(error.option_name.strip("-"), [each.strip("-") for each in error.possibilities or ()])
        error = click.NoSuchOption(error.option_name, possibilities=[f"--{each}" for each in near], ctx=error.ctx)
    tries = [*_example_of(error), f"{command} --help"]
    if isinstance(error, click.NoSuchOption) and re.match(r"-[0-9.]", error.option_name):
        tries.insert(0, f"negative numbers behind `--`: {command} ... -- {error.option_name}")
    elif isinstance(error, click.NoSuchOption) and error.ctx is not None and isinstance(error.ctx.command, click.Group):
        tries.insert(0, f"{error.option_name} behind the command: {command} COMMAND ... {error.option_name}")
    text = error.format_message()
    if isinstance(error, click.MissingParameter):
        text = text.replace("\n\t", " ")  # click lists the choices in lines of their own
    for kind, words in _KINDS.items():
        text = text.replace(kind, words)
    wrong = _WRONG_CHOICE.search(text)
    if wrong is not None:
        near = get_close_matches(wrong[1].lower(), re.findall("'([^']+)'", wrong[2]), 2)
        tries[:0] = [f"did you mean {' or '.join(near)}?"] if near else []
    united = _WITH_UNIT.search(text)
    if united is not None and error.ctx is not None and any("--in" in each.opts for each in error.ctx.command.params):
        tries.insert(0, f"{united[1]} --in {united[2]}")
    extra = _EXTRA.search(text)
    if (
        extra is not None
        and not extra[1].isdecimal()
        and error.ctx is not None
        and any("--bus" in each.opts for each in error.ctx.command.params)
    ):
        tries.insert(0, f"-b {extra[1]}    (if it is a bus)")
    return usage("CO001", text, tries=tries)


def _of_bus(code: str) -> ExitCode:
    if code == NO_PERMISSION:
        return ExitCode.PERMISSION
    return ExitCode.CANNOT_OPEN if code in (BAD_LOCATOR, CANNOT_OPEN) else ExitCode.BUS_FAULT


def _what_was_meant(problem: CommandError, locator: str) -> CommandError:
    """Add what was perhaps meant by the name of a bus that is none: the demonstration, or a recording. Returns the problem."""
    if problem.code != BAD_LOCATOR:
        return problem
    name, *behind = re.split("[:@?]", locator, maxsplit=1)
    if nearest(name, (DEMO,)):
        problem.tries = (f"-b {DEMO}", *problem.tries)
        if behind:
            problem.seen = f"{DEMO} is six simulated drives in this process: nothing stands behind its name"
    if ":" in locator:
        return problem
    if not (suffix := Path(locator).suffix.lower()):
        return problem
    from canopen_transports.log_files import LOSSES  # formats of logs need long to import

    if suffix in (*LOSSES, ".txt"):
        watching = "monitor, top, watch, emcy watch"
        problem.tries = (f"--log {locator}    (a recording, in place of a bus: {watching})", f"canopen log decode {locator}")
    return problem


def advice(steps: Iterable[str]) -> list[str]:
    """Translate what the library advises its callers into commands and options."""
    chosen = []
    for step in steps:
        longer, _, limit = step.partition(": ")
        if longer == LONGER:
            chosen.append(f"--timeout {limit.replace(' ', '')}" if limit else "a longer --timeout")
        elif not step.startswith("await "):
            chosen.append(step.partition(", then await ")[0])
    return chosen


_SETTING = re.compile(
    r"(?P<what>Axis|Chain)Settings(?:\((?P<key>[\w.]+)(?:=(?P<value>[^()]*))?\)|\.(?P<name>\w+))(?: in `axes`)?"
)
_OF_PYTHON = {
    " or open_master(..., watchdog=Watchdog(node_id=...))": "",
    "; `set_max_speed` of `direct`": "",
    "180_000 / math.pi for millidegrees on the wire": "or its unit",
    "math.inf": "inf",
    'profile = "none"': "--profile none",
    "DemonstrationTask.scale = math.degrees(1000)": "--counts-per-degree 1000",
    "DemonstrationTask.chain = ": "--chain ",
}


def in_words_of_files(text: str) -> str:
    """Translate settings of the library into keys of the machine file: AxisSettings(max_speed=...) into max_speed = ..."""
    for words, others in _OF_PYTHON.items():
        text = text.replace(words, others)
    return _SETTING.sub(_as_key, text)


def _as_key(setting: re.Match[str]) -> str:
    entry = "joint" if setting["what"] == "Axis" else "chain"
    if setting["name"] is not None:
        return f"{setting['name']} of its {entry} in the machine file"
    if setting["value"] is None:
        return f"{setting['key']} of its {entry} in the machine file"
    value = {"True": "true", "False": "false"}.get(setting["value"], setting["value"])
    if value.startswith("State."):
        value = repr(State[value.removeprefix("State.")].value)
    return f"{setting['key']} = {value} of its {entry} in the machine file"


def _spoken(error: Explained, exit_code: ExitCode) -> CommandError:
    """Return the CommandError for an error that brings its own words."""
    return CommandError(
        exit_code,
        error.code,
        error.failed,
        seen=error.seen,
        cause=error.cause,
        also=error.also,
        tries=advice(error.tries),
        node=getattr(error, "node_id", None),
        index=getattr(error, "index", None),
        subindex=getattr(error, "subindex", None),
        abort=getattr(error, "abort_code", None),
    )


_OF_GATEWAY = {
    gateway_errors.DOOR_REFUSED: ExitCode.CANNOT_OPEN,
    gateway_errors.NO_GATEWAY: ExitCode.CANNOT_OPEN,
    gateway_errors.NO_BRIDGE: ExitCode.CANNOT_OPEN,
    gateway_errors.NOT_ALLOWED: ExitCode.PERMISSION,
    gateway_errors.NOT_OVER_TEXT: ExitCode.USAGE,
    gateway_errors.NO_HISTORY: ExitCode.BAD_FILE,
    gateway_errors.WRONG_QUERY: ExitCode.USAGE,
}


def _of_gateway(error: gateway_errors.GatewayError) -> CommandError:
    """Return the CommandError for what a gateway refuses, or another maker's has answered."""
    problem = _spoken(error, _OF_GATEWAY.get(error.code, ExitCode.SDO_ABORT))
    if isinstance(error, gateway_errors.GatewayRefusedError | gateway_errors.BridgeRefusedError) and error.is_silence:
        problem.exit_code = ExitCode.NO_ANSWER
    problem.node = problem.node or None
    return problem


_OF_CHAIN = {
    errors.NO_ANSWER: ExitCode.NO_ANSWER,
    errors.REFUSED: ExitCode.SDO_ABORT,
    errors.GIVEN_UP: ExitCode.SDO_ABORT,
}


def _of_chain(error: errors.MasterError) -> CommandError:
    """Return the CommandError for a chain. The error of the joint that caused it may know more."""
    problem = _spoken(error, _OF_CHAIN.get(error.code, ExitCode.DRIVE_FAULT))
    below = _of_expected(error.__cause__) if error.__cause__ is not None else None
    if below is not None:
        problem.exit_code, problem.code = below.exit_code, below.code
        problem.tries = problem.tries or below.tries
        problem.node = problem.node or below.node
        problem.index, problem.subindex, problem.abort = below.index, below.subindex, below.abort
    return problem


def _of_sdo(error: SdoTransferError) -> CommandError:
    silent = error.origin is AbortOrigin.TIMEOUT and error.abort_code != AbortCode.CANNOT_TRANSFER  # our own side ended it
    code = errors.NO_ANSWER if silent else _SDO_CODES.get(error.origin, errors.GIVEN_UP)
    text = error.failed if isinstance(error, DriveError) else str(error)
    whole = text.removesuffix(NOT_CONFIRMED)
    failed, _, seen = whole.partition(": ")
    return CommandError(
        ExitCode.NO_ANSWER if silent or error.not_confirmed else ExitCode.SDO_ABORT,
        code,
        failed + text[len(whole) :],
        seen=seen,
        cause="no device has this node-ID, its power is off, or it is stopped" if silent else "",
        tries=(SCAN, "a longer --timeout") if silent else (),
        node=error.node_id,
        index=error.index,
        subindex=error.subindex,
        abort=error.abort_code,
    )


_SDO_CODES: Final = {AbortOrigin.PEER: errors.REFUSED, AbortOrigin.CONTESTED: errors.CONTESTED}


def _of_flash(error: ProgramDownloadError) -> CommandError:
    failed = f'the program download to node {error.node_id} ended at "{error.so_far.step}"'
    status = ExitCode.NO_ANSWER if error.is_silent else ExitCode.DRIVE_FAULT
    return CommandError(
        ExitCode.VERIFY_MISMATCH if error.is_mismatch else status,
        "CO214",
        failed,
        seen=error.seen,
        also=(f"the device: {error.so_far.left}",),
        tries=error.remedy.split("; ") if error.remedy else (),
        node=error.node_id,
    )


_OF_DRIVE = {
    DriveInFaultError: errors.CHAIN_FAULT,
    HomingError: errors.HOMING_FAILED,
    ModeUnsupportedError: errors.MODE_UNSUPPORTED,
}


def _of_procedure(error: ProcedureError) -> CommandError:
    failed, _, hint = str(error).partition(". Try: ")
    what, _, seen = failed.partition(": ")
    tries = (hint,) if hint else ()
    match error:
        case ProgramDownloadError():
            return _of_flash(error)
        case UnexpectedLengthError():
            what, _, cause = failed.partition("; ")
            return CommandError(ExitCode.SDO_ABORT, errors.UNEXPECTED_ANSWER, what, cause=cause)
        case DriveError():
            code = next((code for kind, code in _OF_DRIVE.items() if isinstance(error, kind)), errors.PROCEDURE_FAILED)
            tries = (error.remedy,) if error.remedy else ()
            seen, cause = error.view.describe(), error.reason
            return CommandError(ExitCode.DRIVE_FAULT, code, error.failed, seen=seen, cause=cause, tries=tries, node=error.node_id)
    return CommandError(ExitCode.DRIVE_FAULT, errors.PROCEDURE_FAILED, what, seen=seen, tries=tries)
