"""Whatever fails becomes one screen, one JSON object, one exit status."""

from __future__ import annotations

import io
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest
import trio

from canopen_cli import entry
from canopen_cli.app import main
from canopen_cli.shared.failures import in_words_of_files, problem_of
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.running import all_stand, first_error, notes_of
from canopen_cli.shared.screen import Screen
from canopen_data import DataError
from canopen_data.findings import DictionaryError, Finding, Severity
from canopen_data.named_files import UnusableFileError
from canopen_gateway.errors import (
    BridgeRefusedError,
    DoorError,
    FleetError,
    GatewayFullError,
    GatewayRefusedError,
    HistoryError,
    HistoryQueryError,
    LeaseError,
    NoGatewayError,
    NotAllowedError,
    NotOverTextError,
)
from canopen_master import errors
from canopen_master.claims.channel_claim import ChannelTakenError
from canopen_master.motion.record_files import RecordError
from canopen_master.motion.set_point_check import FASTER, NO_SCALE
from canopen_master.simulation.hooks import ScriptError
from canopen_master.simulation.parameter_keeper import StateFileError
from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import ValueRangeError
from canopen_proto.drives.axis import DriveInFaultError, HomingError, ModeUnsupportedError
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.machine import LocalProtocolError, Outbox
from canopen_proto.manager.programs.download import ProgramDownload, ProgramDownloadError
from canopen_proto.procedures.objects import UnexpectedLengthError
from canopen_proto.procedures.steps import ProcedureError, SdoTransferError
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoAborted
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_transports import TransportError
from canopen_transports.log_files import LogFileError
from tests.cli.cli_support import TWO_JOINTS

AXIS = Axis(RemoteNode(Outbox(), 5, drive_dictionary()))


def aborted(origin: AbortOrigin, code: int = AbortCode.READ_ONLY) -> SdoAborted:
    return SdoAborted(5, 1, 0x6041, 0, code, origin)


@pytest.mark.parametrize(
    ("error", "status", "code"),
    [
        (TransportError("CO100", "x", "the bus 'x' is not a valid locator"), ExitCode.CANNOT_OPEN, "CO100"),
        (TransportError("CO101", "x", "cannot open x"), ExitCode.CANNOT_OPEN, "CO101"),
        (TransportError("CO102", "x", "cannot open x"), ExitCode.PERMISSION, "CO102"),
        (TransportError("CO110", "x", "nothing acknowledged our frames"), ExitCode.BUS_FAULT, "CO110"),
        (errors.BusError("x", TransportError("CO111", "x", "the bus is gone")), ExitCode.BUS_FAULT, "CO111"),
        (LogFileError("cannot read x", "no such file", "", ()), ExitCode.BAD_FILE, "CO342"),
        (errors.NodeSilentError("CO210", 5, "x", "node 5 did not boot"), ExitCode.NO_ANSWER, "CO210"),
        (errors.UnexpectedAnswerError("CO204", 5, "x", "node 5 answered with 3 bytes"), ExitCode.SDO_ABORT, "CO204"),
        (ChannelTakenError("CO208", 5, "x", "another program uses it"), ExitCode.SDO_ABORT, "CO208"),
        (NotAllowedError("motion", "writing 0x6040:00"), ExitCode.PERMISSION, "CO150"),
        (GatewayFullError("clients", 16), ExitCode.SDO_ABORT, "CO151"),
        (LeaseError("somebody moves this machine"), ExitCode.SDO_ABORT, "CO152"),
        (NoGatewayError("there is no text gateway"), ExitCode.CANNOT_OPEN, "CO153"),
        (GatewayRefusedError("refused", abort_code=AbortCode.READ_ONLY), ExitCode.SDO_ABORT, "CO154"),
        (GatewayRefusedError("silent", abort_code=AbortCode.TIMED_OUT, node_id=5), ExitCode.NO_ANSWER, "CO154"),
        (GatewayRefusedError("silent", gateway_code=103), ExitCode.NO_ANSWER, "CO154"),
        (DoorError("cannot listen"), ExitCode.CANNOT_OPEN, "CO155"),
        (NotOverTextError("gw:x", "read"), ExitCode.USAGE, "CO156"),
        (FleetError("nobody answers"), ExitCode.CANNOT_OPEN, "CO160"),
        (BridgeRefusedError("refused", abort_code=AbortCode.READ_ONLY), ExitCode.SDO_ABORT, "CO161"),
        (BridgeRefusedError("silent", abort_code=AbortCode.TIMED_OUT), ExitCode.NO_ANSWER, "CO161"),
        (HistoryError("half a file"), ExitCode.BAD_FILE, "CO163"),
        (HistoryQueryError("no SELECT"), ExitCode.USAGE, "CO164"),
        (errors.ChainFileError("my.csv", [(1, 2, "wrong")]), ExitCode.BAD_FILE, "CO320"),
        (errors.UnknownChainError("CO322", "no chain"), ExitCode.USAGE, "CO322"),
        (errors.PlanRefusedError("joint 1 cannot go to 95", joint=1, value=95.0, limit=90.0), ExitCode.USAGE, "CO323"),
        (errors.PackageMissingError("ruckig", "motion", "planning", ImportError("No module")), ExitCode.USAGE, "CO141"),
        (errors.ChainError("CO401", "arm", "could not home"), ExitCode.DRIVE_FAULT, "CO401"),
        (errors.ChainError("CO404", "arm", "is not ready"), ExitCode.DRIVE_FAULT, "CO404"),
        (errors.ChainHaltedError("CO403", "arm", "it was halted"), ExitCode.DRIVE_FAULT, "CO403"),
        (errors.ChainError(errors.NO_ANSWER, "arm", "no answer"), ExitCode.NO_ANSWER, "CO201"),
        (errors.ChainError(errors.REFUSED, "arm", "refused"), ExitCode.SDO_ABORT, "CO202"),
        (errors.ChainError(errors.GIVEN_UP, "arm", "given up"), ExitCode.SDO_ABORT, "CO203"),
        (errors.CallTimeoutError(2.0), ExitCode.NO_ANSWER, "CO143"),
        (errors.HaltNotConfirmedError("CO131", "one may move"), ExitCode.DRIVE_FAULT, "CO131"),
        (SdoTransferError(aborted(AbortOrigin.TIMEOUT), "reading"), ExitCode.NO_ANSWER, "CO201"),
        (SdoTransferError(aborted(AbortOrigin.PEER), "writing"), ExitCode.SDO_ABORT, "CO202"),
        (SdoTransferError(aborted(AbortOrigin.LOCAL), "reading"), ExitCode.SDO_ABORT, "CO203"),
        (SdoTransferError(aborted(AbortOrigin.CONTESTED), "reading"), ExitCode.SDO_ABORT, "CO206"),
        (SdoTransferError(aborted(AbortOrigin.TIMEOUT, AbortCode.CANNOT_TRANSFER), "reading"), ExitCode.SDO_ABORT, "CO203"),
        (UnexpectedLengthError("node 5: 0x1A00:00 came with 3 bytes, not 1"), ExitCode.SDO_ABORT, "CO204"),
        (DriveInFaultError(AXIS, "is in fault", reason="x", remedy="reset it"), ExitCode.DRIVE_FAULT, "CO402"),
        (HomingError(AXIS, "reports a homing error"), ExitCode.DRIVE_FAULT, "CO406"),
        (ModeUnsupportedError(AXIS, "does not support it"), ExitCode.DRIVE_FAULT, "CO405"),
        (ProcedureError("drive 5 did not: x"), ExitCode.DRIVE_FAULT, "CO407"),
        (ProgramDownloadError(5, ProgramDownload(1), "secured"), ExitCode.DRIVE_FAULT, "CO214"),
        (ProgramDownloadError(5, ProgramDownload(1), "other", is_mismatch=True), ExitCode.VERIFY_MISMATCH, "CO214"),
        (ProgramDownloadError(5, ProgramDownload(1), "silent", is_silent=True), ExitCode.NO_ANSWER, "CO214"),
        (DataError("there is no file", "name another"), ExitCode.BAD_FILE, "CO330"),
        (RecordError("CO344", "cannot read the recording x"), ExitCode.BAD_FILE, "CO344"),
        (UnusableFileError("x.eds describes no object", "CO301"), ExitCode.BAD_FILE, "CO301"),
        (errors.DeviceRefusedError("which node-ID is x.eds to have?"), ExitCode.USAGE, "CO127"),
        (errors.DemonstrationRefusedError("joint1 cannot swing by an angle"), ExitCode.USAGE, "CO123"),
        (errors.NodeIsNoDriveError(5, 0, 0x6041), ExitCode.SDO_ABORT, "CO408"),
        (errors.NoDriveInFileError("x.eds is no drive"), ExitCode.BAD_FILE, "CO332"),
        (ScriptError("animate.py:3", "ZeroDivisionError"), ExitCode.BAD_FILE, "CO331"),
        (StateFileError(Path("state.json"), "it is not JSON"), ExitCode.BAD_FILE, "CO333"),
        (ValueRangeError("too large"), ExitCode.USAGE, "CO304"),
        (LocalProtocolError("not like this"), ExitCode.USAGE, "CO120"),
        (PermissionError("no"), ExitCode.PERMISSION, "CO109"),
        (click.UsageError("no such option"), ExitCode.USAGE, "CO001"),
        (click.ClickException("hm"), ExitCode.USAGE, "CO001"),
        (ZeroDivisionError("division by zero"), ExitCode.INTERNAL, "CO900"),
    ],
)
def test_each_error_has_its_status(error: Exception, status: ExitCode, code: str) -> None:
    problem = problem_of(error)
    assert (problem.exit_code, problem.code) == (status, code)
    assert problem_of(problem) is problem
    assert str(problem).startswith(f"{code}: ")
    assert len(str(problem).splitlines()) < 20
    assert json.dumps(problem.as_json())


def test_a_chain_error_knows_what_its_cause_knows() -> None:
    error = errors.ChainError(errors.REFUSED, "arm", "joint1 refused")
    error.__cause__ = SdoTransferError(aborted(AbortOrigin.PEER), "reading")
    problem = problem_of(error)
    assert (problem.node, problem.index, problem.subindex, problem.abort) == (5, 0x6041, 0, AbortCode.READ_ONLY)


def test_a_chain_error_has_the_status_of_its_cause() -> None:
    error = errors.ChainError(errors.CHAIN_FAILED, "arm", "chain arm could not initialise: joint1")
    error.__cause__ = UnexpectedLengthError("node 5: 0x1A00:00 came with 3 bytes, not 1")
    problem = problem_of(error)
    assert (problem.exit_code, problem.code) == (ExitCode.SDO_ABORT, "CO204")


def test_the_first_error_of_a_group_keeps_its_cause() -> None:
    error = errors.ChainError(errors.PROCEDURE_FAILED, "arm", "the chain failed")
    error.__cause__ = errors.HaltNotConfirmedError(errors.HALT_NOT_CONFIRMED, "the joint may still move")

    async def fail() -> None:
        async with first_error(), trio.open_nursery() as nursery:
            nursery.start_soon(trio.sleep_forever)
            raise error

    with pytest.raises(errors.ChainError) as raised:
        trio.run(fail)
    assert raised.value is error
    assert isinstance(error.__cause__, errors.HaltNotConfirmedError)
    assert not all_stand(error)  # else the user would read that the drives were halted


def test_notes_are_told_too() -> None:
    error = ProcedureError("drive 5 did not: x")
    error.add_note("not confirmed to stand: joint1")
    assert problem_of(error).also == ["not confirmed to stand: joint1"]
    assert notes_of(ExceptionGroup("two", [error, ValueError()])) == ["not confirmed to stand: joint1"]
    assert notes_of(None) == []


def test_of_several_errors_the_one_that_is_not_ours_comes_first() -> None:
    group = ExceptionGroup("", [ZeroDivisionError("oops"), ExceptionGroup("", [DriveInFaultError(AXIS, "is in fault")])])
    problem = problem_of(group)
    assert problem.code == "CO402"
    assert "CO900" in problem.also[0]


def test_many_findings_are_cut() -> None:
    problem = problem_of(DictionaryError(Finding(Severity.ERROR, "x", f"wrong {n}", "a.csv", n, 1) for n in range(1, 40)))
    assert "a.csv:1:1" in problem.failed
    assert problem.also[-1] == "29 more errors"
    assert len(str(problem).splitlines()) < 14


def test_on_a_terminal_the_lines_are_wrapped_and_hang(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "60")
    problem = CommandError(ExitCode.NO_ANSWER, "CO201", "node 5 [0x05] did not answer", seen="word " * 30, tries=("this", "that"))
    Screen(color=False).problem(problem)
    lines = capsys.readouterr().err.splitlines()
    assert max(map(len, lines)) <= 90  # with its escapes
    assert "[0x05]" in lines[0]
    assert any("or:" in line and "that" in line for line in lines)


def test_a_traceback_comes_with_vv_only(capsys: pytest.CaptureFixture[str]) -> None:
    try:
        raise ZeroDivisionError("oops")
    except ZeroDivisionError as error:
        problem = problem_of(error)
    Screen(verbosity=1).problem(problem)
    assert "Traceback" not in capsys.readouterr().err
    Screen(verbosity=2).problem(problem)
    assert "Traceback" in capsys.readouterr().err


# ---- real processes: signals and pipes ----

COMMAND = (sys.executable, "-c", "import sys; from canopen_cli.app import main; sys.exit(main())")


def started(own_files: Path, *arguments: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(each for each in sys.path if each), "COLUMNS": "120"}
    environment["CANOPEN_DATA"] = str(own_files)
    return subprocess.Popen(
        [*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, encoding="utf-8"
    )


@pytest.mark.skipif(sys.platform == "win32", reason="SIGINT to one process")
def test_ctrl_c_in_a_real_process(tmp_path: Path) -> None:
    with started(tmp_path, "demo", "--seconds", "60", "--cycle", "20ms", "--timeout", "20s", *TWO_JOINTS) as process:
        assert process.stderr is not None
        told = ""
        give_up = time.monotonic() + 60
        while "✔ home" not in told and time.monotonic() < give_up:
            told += process.stderr.readline()
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=60)
    assert process.returncode == ExitCode.INTERRUPTED
    assert "interrupted by Ctrl-C" in rest
    assert "halted: joint1, joint2\n" in rest
    assert "STILL MOVING" not in rest
    assert "Traceback" not in rest


def test_a_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    with started(tmp_path, "--help") as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait(60) == 141


@pytest.mark.skipif(sys.platform == "win32", reason="SIGPIPE")
def test_readers_of_both_streams_that_go_away_while_the_arm_moves(tmp_path: Path) -> None:
    with started(tmp_path, "demo", "--seconds", "1", *TWO_JOINTS) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stderr.readline()
        process.stdout.close()
        process.stderr.close()
        assert process.wait(60) == 141


def test_what_cannot_be_parsed_is_json_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scan", "--bogus", "--json"]) == ExitCode.USAGE
    assert json.loads(capsys.readouterr().err)["code"] == "CO001"


def test_the_choices_of_a_missing_argument_stand_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["nmt"]) == ExitCode.USAGE
    assert "Choose from: start, stop, preop, reset, reset-comm" in " ".join(capsys.readouterr().err.split())


@pytest.mark.thorough(5)
@pytest.mark.skipif(sys.platform == "win32", reason="a POSIX shell")
@pytest.mark.parametrize(("redirection", "status"), [(">&-", 0), (">&- 2>&-", 0), (">/dev/full", ExitCode.BAD_FILE)])
def test_output_that_goes_nowhere(tmp_path: Path, redirection: str, status: int) -> None:
    if "full" in redirection and not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(each for each in sys.path if each), "CANOPEN_DATA": str(tmp_path)}
    command = shlex.join([*COMMAND, "read", "3", "statusword", "-b", "demo"])
    ended = subprocess.run(f"{command} {redirection}", shell=True, stderr=subprocess.PIPE, text=True, env=environment, timeout=60)
    assert ended.returncode == status, ended.stderr
    assert "CO900" not in ended.stderr
    assert "Exception ignored" not in ended.stderr


@pytest.mark.thorough(2)
@pytest.mark.parametrize("missing", ["trio", "click", "rich"])
def test_an_install_without_the_extras_says_which_one(missing: str) -> None:
    program = f"import sys; sys.modules[{missing!r}] = None; from canopen_cli.entry import main; sys.exit(main())"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(each for each in sys.path if each)}
    command = [sys.executable, "-c", program, "scan"]
    ended = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60)
    assert ended.returncode == ExitCode.CANNOT_OPEN
    assert ended.stderr == (
        f"canopen: the command line needs {missing}, which is not installed.\nTry: pip install 'canopen-proto[master]'\n"
    )


@pytest.mark.parametrize(("bus", "status"), [("pcan:PCAN_USBBUS1", ExitCode.CANNOT_OPEN), ("demo", ExitCode.OK)])
def test_without_python_can_only_its_own_buses_cannot_be_opened(bus: str, status: ExitCode) -> None:
    program = "import sys; sys.modules['can'] = None; from canopen_cli.entry import main; sys.exit(main())"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(each for each in sys.path if each)}
    command = [sys.executable, "-c", program, "read", "3", "1000", "-b", bus]
    ended = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60)
    assert ended.returncode == status
    if status is not ExitCode.OK:
        assert ended.stderr.startswith("error CO101: the command line needs can, which is not installed\n")
        assert "pip install 'canopen-proto[master]'" in ended.stderr


INTERRUPTED_IMPORT = """
import os, signal, sys
from canopen_cli.entry import main
class Finder:
    def find_spec(self, *arguments):
        os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
sys.exit(main())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGINT to one process")
def test_ctrl_c_while_the_command_line_is_read_in() -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(each for each in sys.path if each)}
    program = [sys.executable, "-c", INTERRUPTED_IMPORT]
    ended = subprocess.run(program, capture_output=True, text=True, env=environment, timeout=60)
    assert ended.returncode == -signal.SIGINT  # which a shell calls 130
    assert ended.stderr == ""


def test_the_entry_runs_the_command_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["canopen", "--version"])
    assert entry.main() == 0
    assert capsys.readouterr().out.startswith("canopen, version")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_pipe_that_is_closed_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    from canopen_cli import app

    class Closed(io.StringIO):
        def flush(self) -> None:
            raise BrokenPipeError

        def fileno(self) -> int:
            raise io.UnsupportedOperation

    monkeypatch.setattr(sys, "stdout", Closed())
    assert app.main(["data", "--help"]) == app.CLOSED_PIPE


def test_an_interrupt_before_anything_has_begun(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from canopen_cli import app

    for error in (KeyboardInterrupt(), BaseExceptionGroup("", [KeyboardInterrupt()])):

        def interrupted(*arguments: object, error: BaseException = error, **options: object) -> None:
            raise error

        monkeypatch.setattr(app.cli, "main", interrupted)
        assert app.main([]) == ExitCode.INTERRUPTED
        assert "interrupted by Ctrl-C" in capsys.readouterr().err


def test_the_rest_is_not_swallowed(monkeypatch: pytest.MonkeyPatch) -> None:
    from canopen_cli import app

    def ended(*arguments: object, **options: object) -> None:
        raise BaseExceptionGroup("", [SystemExit(5)])

    monkeypatch.setattr(app.cli, "main", ended)
    with pytest.raises(BaseExceptionGroup):
        app.main([])


def test_an_error_beside_the_interruption_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from canopen_cli.shared.options import Settings
    from canopen_cli.shared.running import run

    async def command() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
            await trio.sleep(5)
        finally:
            raise DriveInFaultError(AXIS, "is in fault", reason="it burns", remedy="water")

    with pytest.raises(CommandError) as caught:
        run(Settings(), Screen(), command)
    problem = caught.value
    assert problem.exit_code is ExitCode.INTERRUPTED
    assert "CO402: drive 5 is in fault" in problem.also
    assert problem.cause == "it burns"
    assert problem.tries == ("water",)


@pytest.mark.parametrize(
    ("words", "others"),
    [
        (
            FASTER.format("AxisSettings(max_speed=...) in `axes`"),
            "a larger max_speed, if it may go as fast as that: max_speed = ... of its joint in the machine file",
        ),
        (
            NO_SCALE.format("AxisSettings(counts_per_unit=...) in `axes`"),
            "give its scale: counts_per_unit = ... of its joint in the machine file, or its unit",
        ),
        (
            "AxisSettings(keeps_reference=True) if it has one",
            "keeps_reference = true of its joint in the machine file if it has one",
        ),
        ("(AxisSettings.mode_change_state)", "(mode_change_state of its joint in the machine file)"),
        (
            "AxisSettings(mode_change_state=State.SWITCHED_ON)",
            "mode_change_state = 'switched on' of its joint in the machine file",
        ),
        ("ChainSettings(define_pdos=True) tells it to", "define_pdos = true of its chain in the machine file tells it to"),
        ("AxisSettings(max_position=...) in `axes`", "max_position = ... of its joint in the machine file"),
        ("above 0, math.inf for none", "above 0, inf for none"),
    ],
)
def test_advice_for_programs_is_told_in_the_words_of_the_machine_file(words: str, others: str) -> None:
    assert in_words_of_files(words) == others
    problem = problem_of(errors.SetPointRefusedError("a set-point was refused", "", words, (words,)))
    assert (problem.seen, tuple(problem.tries)) == (others, (others,))


def test_a_write_without_an_answer_keeps_its_whole_sentence() -> None:
    """It has a colon in it, at which other errors are parted into what failed and what was seen."""
    lost = SdoTransferError(SdoAborted(5, 1, 0x6040, 0, AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT, not_confirmed=True), "writing")
    problem = problem_of(lost)
    assert problem.failed == "node 5 did not answer writing 0x6040:00 (not confirmed: it may have been executed)"
    assert problem.exit_code == ExitCode.NO_ANSWER
