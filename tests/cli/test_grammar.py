"""One grammar for all commands: the verb before the node, an object at its node, how long, and words that were meant."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest

from canopen_cli import app
from canopen_cli.shared.problem import ExitCode
from tests.cli.cli_support import Run

DEMO = ("-b", "demo")


def commands(command: click.Command, context: click.Context) -> Iterator[click.Context]:
    """The contexts of all commands of the tree."""
    if not isinstance(command, click.Group):
        yield context
        return
    for name in command.list_commands(context):
        found = command.get_command(context, name)
        assert found is not None
        yield from commands(found, click.Context(found, info_name=name, parent=context))


def all_commands() -> list[click.Context]:
    return list(commands(app.cli, click.Context(app.cli, info_name="canopen")))


@pytest.mark.parametrize("words", ["state 3", "units 3", "mode 3", "move 3 --relative -- 100", "stop 3"])
def test_the_verb_comes_before_the_node_and_the_order_of_old_says_the_same(run: Run, words: str) -> None:
    verb, node, *others = words.split()
    new = run("drive", verb, node, *DEMO, "--json", *others)
    old = run("drive", node, verb, *DEMO, "--json", *others)
    assert new.status == ExitCode.OK, new.err
    assert (old.status, old.json) == (new.status, new.json)


def test_the_help_of_a_verb_needs_no_node(run: Run) -> None:
    assert "Usage: canopen drive move [OPTIONS] NODE POSITION" in run("drive", "move", "--help").out
    assert run("drive", "3", "move", "--help").out == run("drive", "move", "--help").out


def test_a_drive_without_a_verb_says_what_could_be_done(run: Run) -> None:
    outcome = run("drive", "3")
    assert outcome.status == ExitCode.USAGE
    assert "canopen drive state 3" in outcome.err
    assert run("drive", "state").status == ExitCode.USAGE
    assert "CO120" in run("drive", "state", "200", *DEMO).err


def test_an_object_stands_at_its_node(run: Run) -> None:
    apart = run("read", "3", "statusword", "6064", *DEMO, "--json")
    assert apart.status == ExitCode.OK
    assert run("read", "3:statusword", "6064", *DEMO, "--json").json == apart.json
    assert run("read", "3:1018:01", *DEMO, "--json").json["sub"] == 1
    assert run("write", "3:6081", "20000", *DEMO, "--json").json["value"] == 20000
    watched = run("watch", "3:6064", *DEMO, "--for", "0.3s")
    assert watched.status == ExitCode.OK, watched.err


@pytest.mark.parametrize("words", [("read", "3"), ("write", "3"), ("watch", "3")])
def test_an_object_that_is_missing_is_asked_for(run: Run, words: tuple[str, ...]) -> None:
    outcome = run(*words, *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "no object was named" in outcome.err
    assert f"canopen {words[0]} 3 statusword" in outcome.err


def test_how_long_is_one_option_everywhere() -> None:
    of_time = {}
    for context in all_commands():
        for option in context.command.params:
            if "--seconds" in option.opts or "--for" in option.opts:
                of_time[context.command_path] = option.opts
    assert len(of_time) >= 10
    assert {tuple(each) for each in of_time.values()} == {("--for", "--seconds")}


@pytest.mark.parametrize(("text", "is_right"), [("0.3", True), ("300ms", True), ("1s", True), ("soon", False), ("-1", False)])
def test_how_long_has_a_unit_or_is_in_seconds(run: Run, text: str, is_right: bool) -> None:
    outcome = run("monitor", *DEMO, "--for", text)
    assert (outcome.status == ExitCode.OK) is is_right, outcome.err
    assert is_right or outcome.status == ExitCode.USAGE


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("drve",), "canopen drive"),
        (("enable", "3"), "canopen drive enable"),
        (("drive", "mov", "3"), "canopen drive move"),
        (("eds", "shw"), "canopen eds show"),
        (("log", "decod"), "canopen log decode"),
        (("nothing-like-it",), "canopen --help"),
    ],
)
def test_a_word_that_is_no_command_is_answered_by_those_that_were_meant(run: Run, words: tuple[str, ...], meant: str) -> None:
    outcome = run(*words)
    assert outcome.status == ExitCode.USAGE
    assert meant in outcome.err.splitlines()[1]


def test_common_options_are_explained_once(run: Run) -> None:
    whole = run("--help").out
    for word in ("--bus", "--machine", "--eds", "--overlay", "--encoding", "--timeout", "--trace", "--no-color"):
        assert word in whole
    lines = common = 0
    for context in all_commands():
        page = context.command.get_help(context)
        lines += len(page.splitlines())
        common += page.count("Common options: see")
        assert "--encoding" not in page, context.command_path
    assert common <= lines / 15
