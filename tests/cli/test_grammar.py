"""One grammar for all commands: the verb before the node, an object at its node, how long, and words that were meant."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from canopen_cli import app
from canopen_cli.live.window import Moment
from canopen_cli.shared.options import CommonOption, Seconds
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


@pytest.mark.parametrize(
    "words",
    [
        "drive move 3 -500 --relative",
        "drive move --relative 3 -5e2 --limit 20s",
        "drive 3 move -500.0 --relative",
        "write 3 607A -0x1F4",
    ],
)
def test_a_number_below_0_is_an_argument_and_no_option(run: Run, words: str) -> None:
    outcome = run(*words.split(), *DEMO, "--json", "--timeout", "1s")
    assert outcome.status == ExitCode.OK, outcome.err
    document = outcome.json
    assert document["value" if "write" in words else "to"] - document.get("from", 0) == -500
    assert run(*words.replace("-5", "-x5").replace("-0", "-x0").split(), *DEMO).status == ExitCode.USAGE


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


def test_a_further_object_may_have_the_node_too_but_no_other_one(run: Run) -> None:
    both = run("read", "3:statusword", "3:6064", *DEMO, "--json")
    assert both.json == run("read", "3", "statusword", "6064", *DEMO, "--json").json
    outcome = run("read", "3:statusword", "4:6064", *DEMO)
    assert (outcome.status, "4:6064 is not of node 3" in outcome.err) == (ExitCode.USAGE, True)
    assert "canopen read 4:6064" in outcome.err
    assert run("read", "3", "1018:01", *DEMO, "--json").json["sub"] == 1


def test_a_command_about_a_node_says_so_if_it_gets_an_object(run: Run) -> None:
    assert "try:   3    (the node alone" in run("info", "3:6041", *DEMO).err


def test_a_node_of_a_fleet_has_its_object_the_same_way(run: Run) -> None:
    nobody = ("--connect", "tcp/127.0.0.1:9")
    assert "CO160" in run("fleet", "read", "hall/arm/3:statusword", *nobody).err
    outcome = run("fleet", "read", "hall/arm/3", *nobody)
    assert "canopen fleet read hall/arm/3 statusword" in outcome.err


def test_emergencies_of_one_node(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.log").write_text("(1.0) can0 085#1023010000000000\n(2.0) can0 086#1023010000000000\n")
    assert len(run("emcy", "watch", "--log", "a.log").out.splitlines()) == 2
    alone = run("emcy", "watch", "5", "--log", "a.log").out
    assert (len(alone.splitlines()), "node 5" in alone) == (1, True)
    assert run("emcy", "watch", "--node", "5", "--log", "a.log").out == alone


@pytest.mark.parametrize("words", [("read", "3"), ("write", "3"), ("watch", "3")])
def test_an_object_that_is_missing_is_asked_for(run: Run, words: tuple[str, ...]) -> None:
    outcome = run(*words, *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "no object was named" in outcome.err
    assert f"canopen {words[0]} 3 statusword" in outcome.err


def test_a_recording_in_place_of_a_bus_is_one_option_and_from_is_a_moment_everywhere() -> None:
    of_recordings, of_moments = {}, {}
    for context in all_commands():
        for option in context.command.params:
            if isinstance(option, click.Option) and "--log" in option.opts:
                of_recordings[context.command_path] = option.help
            if isinstance(option, click.Option) and "--since" in option.opts and isinstance(option.type, Moment):
                of_moments[context.command_path] = option.metavar
    assert list(of_recordings) == [f"canopen {name}" for name in ("emcy watch", "monitor", "top", "watch")]
    assert len(set(of_recordings.values())) == 1
    assert {path.split()[1] for path in of_moments} == {"log"}
    assert set(of_moments.values()) == {"MOMENT"}


TWO_MEANINGS = {
    "--bitrate": "of a bus, 500k; `eds to-dcf` takes those that CiA 306 has a key for",
    "--chain": "`move` takes several, which move as one",
    "--csv": "`watch` writes a file beside its picture; `fleet query` prints nothing else",
    "--every": "`watch` asks as often as milliseconds",
    "--id": "`sim` makes several devices, and such that have no node-ID yet",
    "--ids": "as --id, in `sim`",
    "--limit": "the most: of time, of a load, of rows",
    "--locator": "`machine from-chains` takes one for each name of a bus",
    "--name": "of a joint or a device; of a door, which has several",
    "--period": "of SYNC, in microseconds; of MQTT's messages",
    "--plot": "a picture as a file; `watch` draws on the terminal",
    "--revision": "a number; `lss identify` asks for a range",
    "--serial": "as --revision",
    "--since": "a moment of a recording, or of the past",
    "--speed": "a share of a speed; `log replay` knows max, too",
    "--type": "a data type; the transmission type of a PDO",
    "--until": "as --since",
}
"""Options whose values are read in more than one way, and why."""


def test_an_option_has_one_meaning_in_all_commands() -> None:
    kinds: dict[str, set[tuple[str, bool]]] = {}
    for context in all_commands():
        for option in context.command.params:
            if isinstance(option, click.Option) and not isinstance(option, CommonOption):
                names = {"String": "text", "Path": "text"}
                kind = type(option.type).__name__.removesuffix("ParamType")
                for name in option.opts:
                    kinds.setdefault(name, set()).add((names.get(kind, kind), option.multiple))
    assert {name for name, found in kinds.items() if len(found) > 1} == TWO_MEANINGS.keys()


def test_all_that_listens_takes_how_long_by_the_same_option() -> None:
    listening = {"scan", "doctor", "listen", "monitor", "top", "watch", "emcy watch", "log record", "fleet watch", "fleet record"}
    lasting = {
        context.command_path.removeprefix("canopen ")
        for context in all_commands()
        for option in context.command.params
        if isinstance(option.type, Seconds) and "--for" in option.opts
    }
    assert listening <= lasting


@pytest.mark.parametrize("words", ["monitor a.log", "top a.log"])
def test_a_recording_in_the_way_of_old_is_refused_with_the_new_one(run: Run, words: str) -> None:
    outcome = run(*words.split(), *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "--log a.log    (if it is a recording)" in outcome.err


def test_a_bus_without_its_option_is_told_both(run: Run) -> None:
    assert "-b can0    (if it is a bus)" in run("monitor", "can0").err
    assert "-b can0    (if it is a bus)" in run("top", "--log", "can0").err
    assert "Usage: canopen top [OPTIONS]\n" in run("top", "--help").out


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
