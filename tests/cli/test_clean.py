"""Strings of others on a terminal: no command lets a control character of a device, a file or a driver through."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_cli import app
from canopen_cli.shared import session
from canopen_data.configured import with_configured
from canopen_data.describing import describe
from canopen_data.description import Commissioning, DeviceInfo, FileInfo
from canopen_data.eds.writer import write_eds
from canopen_master.plain_text import clean, clean_lines, json_text
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_transports import TransportError
from tests.cli.backup_world import Lasting, answering, lasting
from tests.cli.cli_support import Run, runner_in_folder
from tests.core.devices import TEXT
from tests.examples import examples
from tests.manager.restore_bench import GAIN, device

EVIL = "\x1b]0;gone\x07\x1b[2J\x9b31m\x08\x7f\u202e[bold]x[/]"
"""A title, a cleared screen, colours, a step back, text from right to left; and markup of the library that draws."""
EVIL_TEXT = EVIL.encode().decode("latin-1")
"""The same as a device sends it, in UTF-8."""
MARKED = "\x1b[bold]x[/]"
"""A name without blanks."""
DEMO = ("-b", "demo")
TIMING = ("--cycle", "10ms", "--bitrate", "500k")
NAMED_EDS, NAMED_DCF = f"{EVIL[:-3]}.eds", f"{EVIL[:-3]}.dcf"
"""Files that are called so: device.eds and device.dcf."""


def evil_device() -> tuple[Object, ...]:
    return (
        Object.of(f"name {EVIL}", [Variable(0x1008, 0, f"name {EVIL}", DataType.VISIBLE_STRING, Access.CONST)]),
        Object.of(f"own {EVIL}", [Variable(0x2300, 0, f"own {EVIL}", DataType.VISIBLE_STRING, default=f"a{EVIL[:-12]}z")]),
        Object.of(f"wide {EVIL}", [Variable(0x2301, 0, f"wide {EVIL}", DataType.UNICODE_STRING, default=f"a{EVIL}z")]),
    )


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


RECORDED = {
    "version": 1,
    "chain": EVIL,
    "cycle_time": 0.01,
    "begun": "",
    "joints": [{"name": EVIL, "unit": EVIL, "node": EVIL}],
}
"""The head of a recording whose chain, joint, unit and node have such names."""


@functools.cache
def described() -> ObjectDictionary:
    return device(200, *evil_device())


LINKED = '[buses.can0]\n[nodes.a]\nid = 5\nfile = "device.eds"\n[[links]]\nfrom = "a 2300"\nto = "master"\n'


@functools.cache
def evil_files() -> dict[str, str]:
    """Files of all kinds whose strings are EVIL."""
    texts = DeviceInfo(vendor_name=EVIL, product_name=EVIL, order_code=EVIL)
    info = FileInfo(file_name=EVIL, description=EVIL, created_by=EVIL, eds_version="4.0")
    whole = describe(described(), device_info=texts, file_info=info)
    eds = write_eds(replace(whole, comments=(EVIL, EVIL)))
    dcf = with_configured(whole, {TEXT << 8: f"other {EVIL_TEXT}", GAIN << 8: 9.5}, Commissioning(5, node_name=EVIL))
    keys = ("ParameterName", "DataType", "AccessType", "DefaultValue")
    lines = f"[{EVIL}]\nwhat={EVIL}\n[2012sub1]\n" + "".join(f"{key}={EVIL}\n" for key in keys) + f"{EVIL}\n"
    return {
        "device.eds": eds,
        "device.dcf": write_eds(dcf),
        NAMED_EDS: eds,
        NAMED_DCF: write_eds(dcf),
        "odd.eds": eds + lines,
        "odd.log": f"(1.0) can0 705#05\n{EVIL}\n(1.1) {EVIL} 705#05\n(1.2) can0 585#430810001B5D303B\n",
        "good.log": "(1.0) can0 585#430810001B5D303B\n",
        "odd.csv": f"chain1{EVIL} joint1{EVIL} bus{EVIL} 5 joint2 bus{EVIL} 5 {EVIL}\n",
        "odd_path.csv": f"time,joint1{EVIL}\n0,{EVIL}\n1,1\n",
        "odd_run.csv": f"# canopen recording\n# {json.dumps(RECORDED)}\ncycle,time,{EVIL}\n0,0,{EVIL}\n",
        "good.csv": f"chain1{EVIL} joint1{EVIL} bus{EVIL} 5\n",
        "units.toml": '[objects.2003]\nunit = "\\u001b[2J"\naliases = ["\\u001b[2J"]\ndescription = "\\u009b"\n',
        "odd.toml": '[objects."\\u001b[2J"]\nunit = "\\u001b"\n[objects.2003]\n"\\u001b" = 1\n',
        "odd_cell.toml": '[buses."\\u001b[2J"]\nlocator = "\\u009b"\n[nodes.a]\nid = 5\nfile = "\\u001b.eds"\n"\\u001b" = 1\n',
        "named.toml": f"[buses.can0]\n[nodes.{json.dumps(MARKED)}]\nid = 5\nfile = 'device.eds'\nboot = {{ vendor = 1 }}\n",
        "odd_links.toml": LINKED.replace("master", "\\u001b[2J 5"),
        "linked.toml": LINKED,
        "odd.yaml": 'name: "\\e[2J"\nnodes: {"\\e[1m": {id: 5, "\\e]0": 1, pos_to_device: "\\e[2J", eds_file: "\\e.eds"}}\n',
        "odd.py": f"raise ValueError({EVIL!r})\n",
    }


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch, run: Run) -> Lasting:
    """A device whose strings are all EVIL, and such files."""
    for name, text in evil_files().items():
        Path(name).write_text(text)
    held = lasting(monkeypatch, described())
    held.values = {0x1008_00: EVIL_TEXT, TEXT << 8: EVIL_TEXT, 0x2300_00: EVIL_TEXT}
    held.prepare = lambda node: answering(node, {0x2301: AbortCode.DEVICE_STATE})
    return held


COMMANDS = [
    ("scan", "--ids", "5", *DEMO),
    ("tui", "--allow", MARKED, *DEMO),
    ("info", "5", *DEMO),
    ("info", "5", "-e", "device.eds", *DEMO),
    ("read", "5", "1008", "2003", "2300", "-e", "device.eds", *DEMO),
    ("read", "5", "2003", "-e", "device.eds", "--overlay", "units.toml", *DEMO),
    ("read", "5", "2003", "-e", "device.eds", "--overlay", "odd.toml", *DEMO),
    ("read", "5", EVIL, "-e", "device.eds", *DEMO),
    ("read", "5", "2300", "-o", f"{EVIL[:-3]}.bin", "-e", "device.eds", *DEMO),
    ("write", "5", "2300", EVIL[:5], "-e", "device.eds", *DEMO, "--verify"),
    ("write", "5", "2301", "x", "-e", "device.eds", *DEMO),
    ("backup", "5", "-e", "device.eds", *DEMO, "-o", "new.dcf", "-v"),
    ("dump", "5", "-e", "device.eds", *DEMO),
    ("dump", "5", "--walk", "1000-1020,2300", *DEMO),
    ("compare", "5", "device.dcf", *DEMO),
    ("compare", "device.eds", "device.dcf", "--defaults", "--process-data"),
    ("restore", "5", "device.dcf", *DEMO, "--dry-run", "-v"),
    ("restore", "5", "device.dcf", *DEMO, "--yes", "--verify"),
    ("restore", "6", NAMED_DCF, *DEMO, "--yes"),
    ("flash", "5", EVIL, "--yes", *DEMO),
    ("check", NAMED_EDS),
    ("check", "odd.eds"),
    ("check", "5", "-e", "device.eds", *DEMO, "--case", "1", "--case", "4", "--case", "9.1", "--yes"),
    ("nmt", "start", "5", "-b", "broken:x"),
    ("completion", EVIL),
    ("store", "5", "--group", EVIL, "--yes", *DEMO),
    ("reset-defaults", "5", "--group", EVIL, "--yes", *DEMO),
    ("sync", "--yes", "-b", "broken:x"),
    ("time", "-b", "broken:x"),
    ("bus", "serve", "--bind", EVIL, "--yes", "--seconds", "0"),
    ("serve", "ascii", "--bind", EVIL, "--reachable", "--seconds", "0", *DEMO),
    ("data", "init", "-o", EVIL[:-3]),
    ("sim", NAMED_EDS, "--id", "5", "--seconds", "0.2", "-b", "virtual:x"),
    ("sim", "odd.eds", "--id", "5", "--seconds", "0.2", "-b", "virtual:x", "--script", "odd.py"),
    ("plan", "--chains", "good.csv", *TIMING),
    ("plan", "--chains", "odd.csv", *TIMING),
    ("plan", "--chains", "good.csv", *TIMING, "-e", f"5={NAMED_EDS}"),
    ("demo", "--chains", "odd.csv"),
    ("demo", "--chains", "good.csv", "--seconds", "0.5"),
    ("demo", "--eds", NAMED_EDS, "--seconds", "0.5"),
    ("home", "5", *DEMO, "-e", NAMED_EDS),
    ("drive", "5", "home", *DEMO, "-e", NAMED_EDS),
    *[("drive", "5", word, "-e", "device.eds", "--overlay", "odd.toml", *DEMO) for word in ("state", "units")],
    *[
        ("drive", "5", word, "-e", "device.eds", "--overlay", "odd.toml", *DEMO)
        for word in ("fault-reset", "disable", "stop", "mode")
    ],
    ("drive", "5", "enable", "--seconds", "1", "-e", "device.eds", "--overlay", "odd.toml", *DEMO),
    ("drive", "5", "move", "5", "-e", "device.eds", "--overlay", "odd.toml", *DEMO),
    ("drive", "5", "velocity", "5", "--seconds", "1", "-e", NAMED_EDS, "-b", "broken:x"),
    ("drive", "5", "torque", "5", "--seconds", "1", "-e", NAMED_EDS, "-b", "broken:x"),
    *[("drive", "5", word, "-e", NAMED_EDS, *DEMO) for word in ("probe", "plan")],
    *[("drive", "5", word, "-e", EVIL, *DEMO) for word in ("inputs", "outputs")],
    ("lss", "scan", "-b", EVIL),
    ("lss", "identify", "--vendor", EVIL, *DEMO),
    *[("lss", word, EVIL, *DEMO) for word in ("inquire", "store", "set-bitrate")],
    ("lss", "set-id", EVIL, "5", *DEMO),
    ("lss", "assign", "--table", EVIL, *DEMO),
    ("net", "init", "-o", "net.toml", "-e", EVIL, *DEMO),
    ("net", "init", "-o", "net.toml", "-e", "odd.eds", "-e", "5=odd.eds", "-b", "broken:x"),
    ("net", "check", "named.toml", *DEMO),
    ("net", "boot", "named.toml", "--yes", *DEMO),
    ("net", "watch", EVIL, "--yes", *DEMO),
    ("ros", "init", "new_package", "-m", "odd_cell.toml"),
    ("drive", "5", "commission", "--yes", "-e", NAMED_EDS, "--name", EVIL, *DEMO),
    ("drive", "5", "commission", "--yes", "-e", NAMED_EDS, *DEMO),
    ("move", "odd_cell.toml", "--to", "5"),
    ("move", *DEMO, "--to", f"{EVIL}=5"),
    ("move", *DEMO, "odd_path.csv"),
    ("move", *DEMO, f"{EVIL}.csv"),
    ("jog", "odd_cell.toml"),
    ("jog", *DEMO, "--chain", EVIL),
    ("plot", "odd_path.csv"),
    ("plot", "odd_run.csv"),
    ("plot", EVIL),
    ("machine", "check", "odd_cell.toml"),
    ("node", "list", "odd_cell.toml"),
    ("node", "list", "named.toml", *DEMO),
    ("pdo", "show", EVIL, *DEMO),
    ("pdo", "show", "5", "-e", NAMED_EDS, "-b", "broken:x"),
    ("pdo", "map", "5", "tpdo2", EVIL, "--yes", "-e", "device.eds", *DEMO),
    ("pdo", "check", "-b", EVIL),
    ("emcy", "watch", "--log", EVIL),
    ("emcy", "history", EVIL, *DEMO),
    ("emcy", "clear", EVIL, *DEMO),
    *[("net", "links", name) for name in ("odd_cell.toml", "odd_links.toml", "linked.toml")],
    ("machine", "from-chains", "odd.csv", "-o", "new_cell.toml"),
    ("machine", "from-chains", "good.csv", "-o", f"{EVIL[:-3]}.toml"),
    ("machine", "import", EVIL),
    ("machine", "import", "odd.yaml", "-o", "odd_import.toml"),
    ("ros", "init", EVIL),
    ("scan", "-m", "odd_cell.toml"),
    ("device", "new", EVIL),
    ("device", "describe", "odd.py", "-o", "new.eds"),
    ("device", "describe", "odd.py", "-o", EVIL),
    ("eds", "show", "device.eds"),
    ("eds", "show", "odd.eds", "2300"),
    ("eds", "show", "device.dcf", "2300", "2003"),
    ("eds", "lint", "device.eds"),
    ("eds", "lint", "odd.eds"),
    ("eds", "fix", NAMED_EDS, "--dry-run"),
    ("eds", "diff", "device.eds", "device.dcf"),
    ("eds", "doc", "odd.eds"),
    ("eds", "doc", "device.dcf", "--form", "md"),
    ("eds", "stubs", NAMED_EDS, "-o", f"{EVIL[:-3]}.py"),
    ("eds", "stubs", "odd.eds", "-o", "odd_stubs.py", "--class", EVIL),
    ("eds", "to-dcf", "device.eds", "--id", "5", "--set", f"2300={EVIL[:4]}", "-o", "new.dcf"),
    ("eds", "to-dcf", "device.eds", "--id", "5", "--set", f"{EVIL}=1", "-o", "new.dcf"),
    ("eds", "to-dbc", NAMED_DCF, "--id", "5", "-o", f"{EVIL[:-3]}.dbc"),
    ("eds", "to-cdcf", NAMED_DCF, "-o", f"{EVIL[:-3]}.bin", "-v"),
    ("log", "decode", "odd.log"),
    ("log", "decode", "odd.log", "-e", "5=device.eds"),
    ("log", "stats", "odd.log", "-e", "5=device.eds"),
    ("log", "check", "odd.log", "-e", "5=device.eds"),
    ("log", "convert", "odd.log", "new.trc"),
    ("log", "record", EVIL, *DEMO),
    ("run", "odd.py", *DEMO),
    ("shell", EVIL, *DEMO),
    ("log", "export", "odd.log", "-o", f"{EVIL[:-3]}.csv", "-e", "5=device.eds"),
    ("log", "plot", "odd.log", EVIL),
    ("log", "diff", "good.log", "odd.log", "-e", "5=device.eds"),
    ("log", "replay", "odd.log", "-b", "virtual:x"),
    ("watch", "5", "1008", "2003", "2300", "2301", "-e", "device.eds", *DEMO, "--seconds", "2"),
    ("watch", "5", "2003", "2300", "-e", "device.eds", *DEMO, "--seconds", "2", "--csv", f"{EVIL[:-3]}.csv", "--json"),
    ("watch", "5", "1008", "--log", "odd.log", "--channel", EVIL),
    ("watch", "5", EVIL, *DEMO),
    ("top", "--log", "odd.log", "-e", "5=device.eds"),
    ("top", "--log", "odd.log", "--json"),
    ("top", EVIL),
    ("log", "decode", "good.log"),
    ("monitor", "--log", "odd.log", "-e", "5=device.eds"),
    ("monitor", "--log", "good.log", "--json"),
    ("listen", "-b", EVIL),
    ("monitor", EVIL),
    ("monitor", "--log", "good.log", "--object", EVIL),
    ("monitor", "--log", "good.log", "--service", EVIL),
    ("monitor", "-b", EVIL),
    ("log", "decode", EVIL),
    ("scan", "-b", EVIL),
    ("scan", "-b", "broken:x"),
    ("doctor", "-b", EVIL),
    ("read", "5", "1000", *DEMO, "--trace", f"{EVIL[:-3]}.log"),
    (EVIL,),
    ("read", EVIL, "1000"),
    ("store", "5", "--yes", "-b", EVIL),
    ("store", "5", "--group", EVIL, *DEMO),
    ("reset-defaults", "5", "--yes", "-b", EVIL),
    ("sync", "--yes", "-b", EVIL),
    ("time", "-b", EVIL),
    ("completion", EVIL),
    ("serve", "zenoh", "--site", EVIL, *DEMO),
    ("serve", "web", "-b", EVIL),
    ("serve", "mcp", "-b", EVIL),
    ("serve", "mqtt", "--site", "hall", "--broker", EVIL, *DEMO),
    ("fleet", "ls", "--zenoh", EVIL),
    ("fleet", "read", EVIL, "1008"),
    ("fleet", "watch", EVIL),
    ("fleet", "halt", EVIL),
    ("fleet", "web", "--zenoh", EVIL),
    ("fleet", "record", "history", EVIL),
    ("fleet", "query", EVIL),
    ("fleet", "router", "--listen", EVIL),
]


AS_JSON = [(*command, "--json") for command in COMMANDS if command[0] in ("info", "read", "compare", "eds") or "-o" in command]
LOST = re.compile(r"gone(?!\\+(x07|u0007))|202e(?!\\*\[bold\\*\]x)")
"""EVIL, with something missing: a control code that was dropped, markup that was obeyed."""


def broken(*arguments: object, **options: object) -> None:
    raise TransportError("CO101", "broken:x", f"cannot open: {EVIL}", seen=EVIL, cause=EVIL, tries=(EVIL,))


@pytest.mark.thorough(8)
@pytest.mark.parametrize("command", [*COMMANDS, *AS_JSON], ids=lambda command: clean(" ".join(command))[:40])
def test_no_control_character_reaches_a_terminal(
    run: Run, world: Lasting, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    if "broken:x" in command:
        monkeypatch.setattr(session, "open_master", broken)
    outcome = run(*command)
    assert outcome.status != 10
    for text in (outcome.out, outcome.err):
        assert [each for each in text if not each.isprintable() and each != "\n"] == []
    shown = "".join((outcome.out + outcome.err).split())
    assert r"\x1b" in shown or r"\u001b" in shown  # else nothing of theirs came so far
    assert LOST.search(shown) is None, shown


def test_every_command_is_among_these() -> None:
    covered = {command[:length] for command in COMMANDS for length in (1, 2)}
    covered |= {command[::2][:2] for command in COMMANDS if command[0] == "drive"}  # the node stands between
    assert set(paths(app.cli)) - covered == set()


def paths(command: click.Command, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """The words by which each command is called."""
    if not isinstance(command, click.Group):
        yield path
        return
    context = click.Context(command)
    for name in command.list_commands(context):
        found = command.get_command(context, name)
        assert found is not None
        yield from paths(found, (*path, name))


def test_a_long_string_is_cut_and_says_so(run: Run, world: Lasting) -> None:
    world.values[TEXT << 8] = "x" * 5_000
    shown = run("read", "5", "2003", "-e", "device.eds", *DEMO).out
    assert len(shown) < 3000
    assert "characters)" in shown
    assert run("read", "5", "2003", "-e", "device.eds", *DEMO, "--json").json["value"] == "x" * 5_000


def test_how_characters_are_shown() -> None:
    assert clean("plain ü 設") == "plain ü 設"
    assert clean("\x1b[1m\n\t\x9b\u202e") == "\\x1b[1m\\n\\t\\x9b\\u202e"
    assert clean("a\u00a0b") == "a b"
    assert clean("abc", 2) == "ab ... (3 characters)"
    assert clean_lines("one\x1b\ntwo") == "one\\x1b\ntwo"
    assert json_text(["\x1b\x9b\u202e", "ü"]) == '["\\u001b\\u009b\\u202e", "ü"]'


DOCUMENTS: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@examples(50)
@given(DOCUMENTS)
def test_whatever_a_document_holds_it_is_json(document: Any) -> None:
    def as_text(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: as_text(each) for key, each in value.items()}
        return [as_text(each) for each in value] if isinstance(value, list) else str(value)

    def no_json(text: str) -> None:
        raise AssertionError(text)

    text = json_text(document)
    assert as_text(json.loads(text, parse_constant=no_json)) == as_text(document)


def test_a_number_that_is_none_is_text_in_json(run: Run, world: Lasting) -> None:
    Path("volt.toml").write_text('[objects.2012]\nunit = "V"\n')
    command = ("read", "5", "2012", "-e", "device.eds", "--overlay", "volt.toml", *DEMO, "--json")
    for value in ("nan", "inf", "-inf"):
        world.values[GAIN << 8] = float(value)
        reading = run(*command).json
        assert (reading["value"], reading["physical"]) == (value, value)
    world.values[GAIN << 8] = 1.5
    assert (run(*command).json["value"], run(*command).json["physical"]) == (1.5, 1.5)
