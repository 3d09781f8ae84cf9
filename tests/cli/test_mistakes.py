"""What a new user types: each mistake is answered by what was meant."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from tests.cli.cli_support import Run
from tests.cli.test_grammar import all_commands

DEMO = ("-b", "demo")


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("scan demo", "-b demo    (if it is a bus)"),
        ("scan can0", "-b can0    (if it is a bus)"),
        ("move -b demo --to joint1=10deg", "joint1=NUMBER, in the joint's unit of the machine file"),
        ("scan -b dmeo", "try:   -b demo"),
        ("scan -b demo:3", "nothing stands behind its name"),
        ("scan -b demo@500k", "try:   -b demo"),
        ("drive diagnose 3 -b demo", "try:   canopen drive state"),
        ("drive 3 status -b demo", "try:   canopen drive state"),
        ("eds check a.eds", "try:   canopen eds lint"),
        ("version", "try:   canopen --version"),
        ("help", "try:   canopen --help"),
        ("help drive move", "try:   canopen drive move --help"),
        ("eds help", "try:   canopen eds --help"),
        ("set 3 6081 5 -b demo", "try:   canopen write"),
        ("stop 3 -b demo", "try:   canopen drive stop"),
        ("start 3 -b demo", "try:   canopen nmt start"),
        ("reset 3 -b demo", "try:   canopen nmt reset"),
        ("decode trace.log", "try:   canopen log decode"),
        ("drive 3 jog -b demo", "try:   canopen jog"),
        ("serve tcp -b demo", "try:   canopen serve ascii"),
        ("errors 3 -b demo", "try:   canopen emcy history"),
        ("halt -b demo", "try:   canopen drive stop"),
        ("estop -b demo", "try:   canopen drive stop"),
        ("drive 3 quickstop -b demo", "try:   canopen drive stop"),
        ("config set bus can0", "try:   canopen doctor -v"),
        ("heartbeat -b demo", "try:   canopen monitor --service heartbeat"),
        ("homing 3 -b demo", "try:   canopen home"),
        ("eds dbc a.eds", "try:   canopen eds to-dbc"),
        ("eds new a.eds", "try:   canopen device new"),
        ("drive get 3 6041 -b demo", "try:   canopen read"),
        ("read 3 heartbeat -b demo", "did you mean consumer_heartbeat_time:consumer_1 or producer_heartbeat_time?"),
        ("drive 3 -b demo", "try:   canopen drive state 3"),
        ("drive -b demo state 3", "-b behind the command: canopen drive COMMAND ... -b"),
        ("drive move 3 10deg -b demo", "try:   10 --in deg"),
        ("drive velocity 3 nan -b demo", "is not a finite number"),
        ("nmt start all -b demo", "try:   --all    (all nodes of the bus)"),
        ("write 3 1017 1e99999 -b demo", "1e99999 is too large"),
        ("write 3 5FFF 1e99999 --type f32 -b demo", "1e99999 is too large"),
        ("write 3 5FFF 1e-999 --type f64 -b demo", "1e-999 is too small: it would become 0"),
        ("write 3 5FFF 1e-50 --type f32 -b demo", "1e-50 is too small for"),
        ("sim 5 -b virtual:x", "canopen sim --id 5"),
        ("machine new cell.toml", "try:   canopen machine from-chains"),
        ("log replay nope.log -b demo", "-b tcp    the bus of `canopen bus serve`"),
        ("emcy watch trace.log", "--log trace.log    (if it is a recording)"),
        ("monitor -b trace.log", "--log trace.log    (a recording"),
        ("scan -b trace.log", "canopen log decode trace.log"),
        ("nmt strat 3 -b demo", "did you mean start?"),
        ("eds doc a.eds --form htm", "did you mean html?"),
        ("read statusword 3 -b demo", "canopen scan -b demo    (who is there?)"),
        ("read joint1 6041 -b demo", "-m FILE.toml    (a machine file gives nodes names)"),
        ("read 3 1018 -b demo", "1018:01    (a subindex of it)"),
        ("read 3 60xx -b demo", "an index, such as 6041 or 6041:00, or a name"),
        ("write 3 6081 abc -b demo", "a number, such as 100 or 0x64"),
        ("compare 3 4 -b demo", "canopen backup 4 -o node4.dcf -b demo"),
        ("drive home 3 99 -b demo", "the same without a method, or --style standard"),
        ("drive move 3 abc -b demo", "'abc' is not a number"),
        ("sync --count 1.5 -b demo", "'1.5' is not a whole number"),
    ],
)
def test_a_mistake_is_answered_by_what_was_meant(run: Run, line: str, told: str) -> None:
    outcome = run(*line.split())
    assert outcome.status in (ExitCode.USAGE, ExitCode.CANNOT_OPEN, ExitCode.DRIVE_FAULT), outcome.err
    assert told in outcome.err


@pytest.mark.parametrize(
    ("line", "never"),
    [
        ("nmt start 3 4 -b demo", "if it is a bus"),
        ("drive home 3 --method 99 -b demo", "--eds"),
        ("monitor --filter x -b demo", "--for"),
        ("log replay nope.log -b demo", "no interface"),
    ],
)
def test_what_nobody_can_have_meant_is_not_offered(run: Run, line: str, never: str) -> None:
    outcome = run(*line.split())
    assert outcome.status == ExitCode.USAGE
    assert never not in outcome.err


@pytest.mark.parametrize("line", ["emcy watch --for 0.2s", "log record new.log --for 0.2s", "monitor --for 0.2s"])
def test_silence_is_no_good_news(run: Run, line: str) -> None:
    outcome = run(*line.split(), "-b", "virtual:nobody")
    assert outcome.status == ExitCode.NO_ANSWER
    assert "no frame at all was heard" in outcome.err or "0 frames" in outcome.err


OF_STREAMS = (
    "monitor --log FILE",
    "top --log FILE",
    "watch 5 6041 --log FILE",
    "emcy watch --log FILE",
    "log decode FILE",
    "log check FILE",
    "log stats FILE",
    "log export FILE -o new.csv",
    "log plot FILE 6041 -o new.png",
)
OF_FILES = (
    "log convert FILE new.log",
    "log replay FILE -b virtual:x",
    "log replay FILE -b virtual:x --dry-run",
    "log diff FILE whole.log",
    "log diff whole.log FILE",
)
"""Commands that read a recording: from a file or standard input, from files alone."""


@pytest.mark.parametrize(
    ("content", "code", "seen"),
    [
        ("", "CO342", "there is no frame in a.log"),
        ("(1.0) can0 123##1AA\n", "CO342", "1 entry passed over, the last: a CAN FD frame"),
        ("(1.0) can0 12", "CO342", "a.log:1 is not understood"),
    ],
    ids=["empty", "no CAN frame", "cut"],
)
@pytest.mark.parametrize("line", [*OF_STREAMS, *OF_FILES])
def test_a_recording_without_a_frame_is_an_error_and_nothing_is_told_before_it(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, content: str, code: str, seen: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.log").write_text(content)
    Path("whole.log").write_text("(1.0) can0 705#05\n")
    outcome = run(*line.replace("FILE", "a.log").split())
    assert (outcome.status, outcome.out) == (ExitCode.BAD_FILE, "")
    assert outcome.err.startswith(f"error {code}: ")
    assert seen in outcome.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.log", "whole.log"]


@pytest.mark.parametrize("line", OF_STREAMS)
def test_so_is_an_empty_standard_input(run: Run, monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    with open(os.devnull, encoding="utf-8") as nothing:
        monkeypatch.setattr("sys.stdin", nothing)
        outcome = run(*line.replace("FILE", "-").split())
    assert (outcome.status, outcome.out) == (ExitCode.BAD_FILE, "")
    assert outcome.err.startswith("error CO342: there is no frame in standard input\n")


@pytest.mark.parametrize("command", ["listen", "doctor"])
def test_the_page_has_the_status_of_silence(run: Run, command: str) -> None:
    assert run(command, "--for", "0.2s", "-b", "virtual:nobody").status == ExitCode.NO_ANSWER
    page = " ".join(run(command, "--help").out.split())
    assert re.search(r"5 (none|nothing was heard)", page)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("log diff a.log", "canopen log diff before.log after.log    (an example)"),
        ("drive move 3 -b demo", "canopen drive move 3 2000 -b demo    (an example)"),
        ("net init -b demo", "canopen net init -o cell.toml"),
    ],
)
def test_what_is_missing_is_shown_by_an_example(run: Run, line: str, told: str) -> None:
    assert f"try:   {told}" in run(*line.split()).err


def test_every_page_of_a_command_has_an_example() -> None:
    for context in all_commands():
        lines = [line.strip() for line in (context.command.help or "").splitlines()]
        examples = [line for line in lines if re.search(rf"(^|[|] |   ){context.command_path}( |$)", line)]
        assert examples, context.command_path
