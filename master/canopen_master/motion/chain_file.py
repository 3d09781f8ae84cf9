"""Chain files: which joints make up a chain, and on which bus and node-ID each joint is.

One line per chain: its name, then for each joint its name, its bus and its node-ID, separated by white space:

    # the manual's example, and a chain over two buses
    chain1 joint1 /dev/pcan32 12
    arm    joint1 can0 3  joint2 can0 4  joint3 can1 3

The bus is a locator (see canopen_transports.locator), or any name that the caller maps to one. Node-IDs are decimal, or with 0x
hexadecimal. Text after a # is a comment. All problems of a file are reported at once, each with line and column.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from canopen_data import read_chain_file
from canopen_master.errors import ChainFileError
from canopen_proto.frame import MAX_NODE_ID

_WORD: Final = re.compile(r"\S+")
_NODE_ID: Final = re.compile(r"0[xX][0-9A-Fa-f]+|[0-9]+")
_Word = tuple[int, str]  # column, text


@dataclass(frozen=True, slots=True)
class JointDescription:
    """One joint of a chain. bus: as the file names it. line, column: its place in the file, 0 without a file.

    axis: of the node, 0 for its first one; a chain file knows no other.
    """

    name: str
    bus: str
    node_id: int
    line: int = 0
    column: int = 0
    axis: int = 0


@dataclass(frozen=True, slots=True)
class ChainDescription:
    """One chain of a file. source: the file, for messages."""

    name: str
    joints: tuple[JointDescription, ...]
    source: str = ""

    @property
    def buses(self) -> tuple[str, ...]:
        """The names of its buses, each once."""
        return tuple(dict.fromkeys(joint.bus for joint in self.joints))


def read_chains(path: str | Path, folder: str | Path | None = None) -> tuple[ChainDescription, ...]:
    """The chains of a file: a path, or the name of one of the data files ("single_device.csv"; see canopen_data). folder: of the
    user's data files, see `canopen_data.user_folder`.

    Raises ChainFileError, and DataError if the file cannot be read.
    """
    file = read_chain_file(path, folder)
    return parse_chains(file.text, file.source)


def parse_chains(text: str, source: str = "chains") -> tuple[ChainDescription, ...]:
    """The chains of a file's text. source: its name in messages. Raises ChainFileError with every problem."""
    problems: list[tuple[int, int, str]] = []
    chains: list[ChainDescription] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = [(match.start() + 1, match[0]) for match in _WORD.finditer(line.partition("#")[0])]
        if not words:
            continue
        (column, name), rest = words[0], words[1:]
        if name in (chain.name for chain in chains):
            problems.append((number, column, f"there is a chain {name!r} already"))
        joints: list[JointDescription] = []
        for joint in _joints(number, name, rest, len(line) + 1, problems):
            if joint.name in (other.name for other in joints):
                problems.append((number, joint.column, f"chain {name} has a joint {joint.name!r} already"))
            joints.append(joint)
        chains.append(ChainDescription(name, tuple(joints), source))
    if not chains:
        problems.append((1, 1, "the file has no chain"))
    problems += same_nodes(chains)
    if problems:
        raise ChainFileError(source, sorted(problems))
    return tuple(chains)


def on_buses(chains: Sequence[ChainDescription], buses: Mapping[str, str]) -> list[ChainDescription]:
    """The chains with the file's bus names replaced by ours. buses: our name of each bus, by all of its names.

    If the file and we have only one bus each, its name does not matter. Raises ChainFileError for a bus that is not open, and if
    two joints are one drive.
    """
    named = {joint.bus: joint for chain in reversed(chains) for joint in reversed(chain.joints)}  # its first place
    real = dict(buses)
    if len(named) == 1 and len(set(buses.values())) == 1:
        real |= dict.fromkeys(named, next(iter(buses.values())))
    unknown = [(each.line, each.column, each.bus) for name, each in named.items() if name not in real]
    problems = [(line, column, f"bus {bus!r} is not open; open are {', '.join(buses)}") for line, column, bus in unknown]
    problems = problems or same_nodes(chains, real)
    if problems:
        raise ChainFileError(chains[0].source, sorted(problems))
    return [replace(each, joints=tuple(replace(joint, bus=real[joint.bus]) for joint in each.joints)) for each in chains]


def same_nodes(chains: Iterable[ChainDescription], real_names: Mapping[str, str] | None = None) -> list[tuple[int, int, str]]:
    """A problem for each joint whose node another joint has already: two joints would move one drive.

    real_names: the bus by its name in the file, if several names mean one bus.
    """
    problems = []
    taken: dict[tuple[str, int, int], str] = {}
    for chain in chains:
        for joint in chain.joints:
            place = ((real_names or {}).get(joint.bus, joint.bus), joint.node_id, joint.axis)
            if place in taken:
                text = f"node {joint.node_id} on {joint.bus} is {taken[place]} already"
                problems.append((joint.line, joint.column, text))
            taken.setdefault(place, f"{joint.name} of {chain.name}")
    return problems


def _joints(
    line: int, chain: str, words: list[_Word], end: int, problems: list[tuple[int, int, str]]
) -> Iterator[JointDescription]:
    """The joints of a line. A joint that is wrong is left out and added to `problems`."""
    if not words:
        problems.append((line, end, f"chain {chain} has no joints"))
    for start in range(0, len(words), 3):
        triple = words[start : start + 3]
        if len(triple) < 3:
            missing = "bus and node-ID" if len(triple) == 1 else "node-ID"
            problems.append((line, end, f"{missing} of {triple[0][1]!r} missing: a joint is NAME BUS NODE-ID"))
            return
        (column, name), (_, bus), (id_column, text) = triple
        if not _NODE_ID.fullmatch(text):
            problems.append((line, id_column, f"{text!r} is not a node-ID (1..{MAX_NODE_ID}); a joint is NAME BUS NODE-ID"))
            return  # what follows would be read as the wrong columns
        node_id = int(text, 16) if text[:2] in ("0x", "0X") else int(text)
        if not 1 <= node_id <= MAX_NODE_ID:
            problems.append((line, id_column, f"node-ID {text} is outside 1..{MAX_NODE_ID}"))
            continue
        yield JointDescription(name, bus, node_id, line, column)
