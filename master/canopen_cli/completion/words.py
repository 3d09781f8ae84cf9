"""The words that a shell completes: buses, nodes, objects and constants, without importing the command that takes them.

click asks each command for its options, which imports it: half a second. Words that depend on files are found here in a quarter
of that. What this module does not know, click does: names of commands, options, their values.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from click.shell_completion import CompletionItem, ShellComplete, get_completion_class

from canopen_cli.shared.chosen_machine import BUS_VARIABLE, MACHINE_VARIABLE
from canopen_cli.shared.configuration import Configuration, read_configuration
from canopen_cli.shared.options import DEMO, Settings
from canopen_cli.shared.problem import CommandError

if TYPE_CHECKING:
    from canopen_proto.dictionary import ObjectDictionary

VARIABLE: Final = "_CANOPEN_COMPLETE"
"""Set by a shell's script when it asks for words: "bash_complete"."""

BUSES: Final = {
    DEMO: "six simulated drives",
    "tcp": "the bus of `canopen bus serve`",
    "socketcan:can0": "Linux",
    "pcan:PCAN_USBBUS1@500k": "PEAK adapters",
    "slcan:/dev/ttyACM0@250k": "adapters on a serial line",
    "kvaser:0@1M": "Kvaser adapters",
    "virtual:demo": "inside one process",
}
"""Buses that are offered besides those that this computer and the machine file have."""
INTERFACES: Final = Path("/sys/class/net")
CAN_INTERFACE: Final = "280"
"""The type of a CAN interface there (ARPHRD_CAN)."""
DEMO_NODES: Final = range(3, 9)

OF_FILES: Final = ("-e", "--eds", "-m", "--machine", "--overlay", "--trace", "--log", "-o", "--output")
OF_OBJECTS: Final = ("--object", "--read", "--skip")
"""Options that take an object, which may have its node before it."""
WITH_VALUE: Final = (*OF_FILES, *OF_OBJECTS, "-b", "--bus", "--encoding", "--timeout")
"""Common options that take a value. Commands have others, whose values may be taken for words: then click answers."""
NODE_FIRST: Final = (
    "info",
    "read",
    "write",
    "watch",
    "dump",
    "backup",
    "restore",
    "store",
    "reset-defaults",
    "flash",
    "drive",
    "pdo",
    "emcy",
    "nmt",
)
VERB_FIRST: Final = ("drive", "pdo", "emcy", "nmt")
"""Groups whose commands have the node behind the verb."""
_NUMBER: Final = re.compile(r"(0x)?(?:[0-9][0-9a-f]{0,3}|[0-9a-f]{4}:)", re.IGNORECASE)
"""How the number of an object begins: names begin with a letter."""
_INDEX: Final = re.compile(r"(?:0x)?[0-9a-f]{4}:", re.IGNORECASE)
"""An index, which is longer than a node-ID."""
OBJECTS: Final = {"read": None, "watch": None, "write": 2}
"""Commands that take objects behind the node; and how many words `write` has before its value."""


FILE_GROUPS: Final = ("log", "eds", "net", "machine")
"""Groups whose commands take files behind the verb."""
FILE_FIRST: Final = ("plan", "plot", "jog", "move", "sim", "run")
"""Commands that take files."""
OBJECTS_OF_FILES: Final = (("log", "plot"), ("eds", "show"))
"""Commands that take objects behind a file."""


def complete(cli: click.Command, instruction: str) -> int:
    """Answer a shell: print its script ("bash_source"), or the words for its line ("bash_complete"). Returns an exit status."""
    shell, _, wanted = instruction.partition("_")
    kind = get_completion_class(shell)
    if kind is None:
        return 1
    answer = kind(cli, {"obj": Settings()}, "canopen", VARIABLE)
    if wanted == "source":
        click.echo(script(answer), nl=False)
        return 0
    words, begun = answer.get_completion_args()
    found = known_words(words, begun)
    items = answer.get_completions(words, begun) if found is None else list(found)
    click.echo("\n".join(answer.format_completion(item) for item in items))
    return 0


def script(answer: ShellComplete) -> str:
    """Return the script for a shell. In bash a colon is no longer the end of a word, since names of objects have colons."""
    source = answer.source()
    return f"COMP_WORDBREAKS=${{COMP_WORDBREAKS//:/}}\n{source}" if answer.name == "bash" else source


def known_words(words: Sequence[str], begun: str) -> Iterator[CompletionItem[str]] | None:
    """Return the words that may follow, or None if this module does not know. begun: the beginning of the word to complete."""
    if words and words[-1] in ("-b", "--bus"):
        return _items(buses(words), begun)
    if words and words[-1] in OF_FILES:
        return _files(begun)
    if words and words[-1] in OF_OBJECTS:
        return _items(_objects_at(words, begun) if _has_node(begun) else objects(words, "", begun), begun)
    if begun.startswith("-"):
        return None
    line = [
        word for place, word in enumerate(words) if not word.startswith("-") and (not place or words[place - 1] not in WITH_VALUE)
    ]
    if tuple(line[:2]) in OBJECTS_OF_FILES and len(line) > 2:
        named = ("-e", line[2]) if line[0] == "eds" else ()
        return _items(objects((*words, *named), "", begun), begun)
    if line and ((line[0] in FILE_GROUPS and len(line) > 1) or line[0] in FILE_FIRST):
        return None if words[-1].startswith("-") else _files(begun)  # an option of the command's, which may take a value
    if line[:1] and line[0] in OBJECTS and len(line) > 1 and ":" in line[1]:  # the object stands at its node
        line[1:2] = line[1].split(":", 1)
    if line[:2] == ["drive", "mode"] and len(line) == 3:
        return _items(modes(), begun)
    if line and line[0] in VERB_FIRST:
        return _items(nodes(words), begun) if len(line) == 2 else None
    if not line or line[0] not in NODE_FIRST:
        return None
    if line[0] in OBJECTS and len(line) == 1 and ":" in begun:
        return _items(_objects_at(words, begun), begun)
    if len(line) == 1:
        return _items(nodes(words), begun)
    if line[0] not in OBJECTS:
        return None
    before_value = OBJECTS[line[0]]
    if before_value is None or len(line) == before_value:
        return _items(objects(words, line[1], begun), begun)
    return _items(constants(words, line[1], line[2]), begun) if len(line) == before_value + 1 else None


def _items(found: dict[str, str], begun: str) -> Iterator[CompletionItem[str]]:
    return (CompletionItem(word, help=text) for word, text in found.items() if word.lower().startswith(begun.lower()))


def _files(begun: str) -> Iterator[CompletionItem[str]]:
    """Let the shell complete the name of a file."""
    return iter([CompletionItem(begun, type="file")])


def _has_node(begun: str) -> bool:
    """Return whether a word begins with a node, as "5:statusword" does; "1018:01" is an object alone."""
    return ":" in begun and _INDEX.match(begun) is None


def _objects_at(words: Sequence[str], begun: str) -> dict[str, str]:
    """Return the objects of a node as words such as "5:statusword". begun: the node, a colon, and the beginning of an object."""
    node, _, key = begun.partition(":")
    return {f"{node}:{name}": text for name, text in objects(words, node, key).items()}


def modes() -> dict[str, str]:
    """Return the short names of the modes of operation, with their long ones."""
    from canopen_proto.drives.cia402.modes import Mode, mode_name, short_name

    return {short_name(each): mode_name(each) for each in Mode if each}


def _values(words: Sequence[str], *options: str) -> list[str]:
    return [word for place, word in enumerate(words) if place and words[place - 1] in options]


def machine_of(words: Sequence[str]) -> dict[str, object]:
    """Return the machine file of the line, or of the environment; empty if there is none that can be read."""
    named = [*_values(words, "-m", "--machine"), os.environ.get(MACHINE_VARIABLE, "")]
    by_file = "" if os.environ.get(BUS_VARIABLE) else _configuration().machine
    try:
        path = named[0] or by_file
        return tomllib.loads(Path(path).read_text(encoding="utf-8")) if path else {}
    except (OSError, ValueError, RecursionError):
        return {}  # the command will tell


def _configuration() -> Configuration:
    try:
        return read_configuration()
    except CommandError:
        return Configuration()  # the command will tell


def _table(machine: dict[str, object], name: str) -> dict[str, dict[str, object]]:
    table = machine.get(name)
    return {key: each for key, each in table.items() if isinstance(each, dict)} if isinstance(table, dict) else {}


def buses(words: Sequence[str]) -> dict[str, str]:
    """Return the buses: of the machine file, the CAN interfaces of this computer, and examples."""
    found = dict.fromkeys(_table(machine_of(words), "buses"), "of the machine file")
    for path in sorted(INTERFACES.glob("*/type")):
        try:
            if path.read_text(encoding="ascii").strip() == CAN_INTERFACE:
                found[path.parent.name] = "an interface of this computer"
        except OSError:
            continue  # it has just gone
    return found | {bus: text for bus, text in BUSES.items() if bus not in found}


def nodes(words: Sequence[str]) -> dict[str, str]:
    """Return the nodes that the line's files name: joints and nodes of the machine file, NODE=FILE of -e, those of the demo."""
    machine = machine_of(words)
    found = dict.fromkeys(_table(machine, "joints"), "joint")
    for name, node in _table(machine, "nodes").items():
        found.setdefault(name, f"node {node.get('id', '')}")
    found |= {node: file for node, equal, file in (each.partition("=") for each in _values(words, "-e", "--eds")) if equal}
    if DEMO in (_values(words, "-b", "--bus") or [os.environ.get(BUS_VARIABLE) or _configuration().bus or ""]):
        found |= {str(node): "simulated drive" for node in DEMO_NODES}
    return found


def dictionary_of(words: Sequence[str], node: str) -> ObjectDictionary:
    """Return the dictionary of a node: that of the file that the line or the machine file names; empty if that is bad."""
    from canopen_data import DataError, load_dictionary
    from canopen_proto.dictionary import ObjectDictionary
    from canopen_proto.machine import LocalProtocolError

    machine = machine_of(words)
    joint = _table(machine, "joints").get(node, {})
    entry = _table(machine, "nodes").get(str(joint.get("node", node)), {})
    files = [str(entry["file"])] if "file" in entry else []
    for each in _values(words, "-e", "--eds"):
        before, equal, file = each.partition("=")
        files += [file] if equal and before == node else [] if equal else [each]
    try:
        if files:
            from canopen_data.descriptions import load_description_with_names

            return load_description_with_names(files[0]).dictionary
        return load_dictionary()[0]
    except (DataError, LocalProtocolError):
        return ObjectDictionary([])  # the command will tell


def objects(words: Sequence[str], node: str, begun: str = "") -> dict[str, str]:
    """Return the names of a node's objects, with their numbers; where a number is begun, the numbers, with their names. A name
    that has blanks is left out for its alias."""
    number = _NUMBER.match(begun)
    if number is not None:
        prefix = number[1] or ""
        return {f"{prefix}{each.index:04X}:{each.subindex:02X}": each.name for each in dictionary_of(words, node)}
    found = {}
    for variable in dictionary_of(words, node):
        for name in (variable.name, *variable.aliases):
            if " " not in name:
                found[name] = f"{variable.index:04X}:{variable.subindex:02X}"
                break
    return found


def constants(words: Sequence[str], node: str, key: str) -> dict[str, str]:
    """Return the constants of an object, with their values."""
    from canopen_proto.machine import LocalProtocolError

    try:
        return {each.name: f"0x{each.value:X}" for each in dictionary_of(words, node).constants_of(key)}
    except LocalProtocolError:
        return {}
