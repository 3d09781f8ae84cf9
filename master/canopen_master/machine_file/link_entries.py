"""`[[links]]` of a machine file: "this object feeds that one", as `Link`s of canopen_proto.manager.linking.

An end is a text: the name of a node (or of a joint), a blank, and an object of it; or "master" alone. Names have no blanks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from canopen_data.toml_file import TomlReading, TomlTable, table_of
from canopen_master.machine_file.keys import KEYS
from canopen_master.machine_file.model import JointEntry, NodeEntry
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.machine import LocalProtocolError
from canopen_proto.manager.linking import MASTER, End, Link, Timing

LINKS: Final = "links"
_TIMES: Final = ("inhibit_time", "event_timer", "timeout")


def take_links(
    reading: TomlReading, top: TomlTable, nodes: Mapping[str, NodeEntry], joints: Mapping[str, JointEntry]
) -> tuple[Link, ...]:
    """Return the links of a file. Those with errors are left out; the errors stay in the reading."""
    entries = top.take(LINKS) or []
    if entries and MASTER in nodes:
        reading.error(
            f"nodes.{MASTER}", f"a link's {MASTER!r} is the master itself: this node needs another name", ("nodes", MASTER)
        )
    found = []
    for number, entry in enumerate(entries, start=1):
        table = TomlTable(reading, name_of(number), entry, KEYS[LINKS], (LINKS, str(number)))
        link = _Link(table, nodes, joints).link()
        if link is not None:
            found.append(link)
    return tuple(found)


def name_of(number: int) -> str:
    """Return the name of the n-th link, for errors."""
    return f"{LINKS}[{number}]"


class _Link:
    """Reads one link."""

    def __init__(self, table: TomlTable, nodes: Mapping[str, NodeEntry], joints: Mapping[str, JointEntry]) -> None:
        self._table = table
        self._nodes = nodes
        self._joints = joints

    def link(self) -> Link | None:
        table = self._table
        sources, targets = self._ends("from"), self._ends("to")
        try:
            timing = self._timing()
            if not sources or not targets or timing is None:
                return None
            link = Link(table.place, sources, targets, timing)
        except LocalProtocolError as error:
            table.error(str(error).removeprefix(f"{table.place}: "))
            return None
        buses = {self._nodes[end.node].bus for end in (*sources, *targets) if end.node != MASTER}
        if len(buses) > 1:
            table.error(f"its nodes are on several buses ({', '.join(sorted(buses))}); a PDO stays on one")
            return None
        return link

    def _timing(self) -> Timing | None:
        table = self._table
        every, event_driven = table.take("every"), table.take("event_driven")
        times = table.take_all(_TIMES)
        if event_driven and table.has("every"):
            table.error("it is sent at SYNCs or event-driven: every, or event_driven", "event_driven")
            return None
        return Timing(0 if event_driven else every or 1, **times)

    def _ends(self, key: str) -> tuple[End, ...]:
        """Return the ends of one side; none if one of them is wrong."""
        table = self._table
        if not table.has(key):
            table.error(f"it has no {key!r}")
        ends = [self._end(key, str(each)) for each in table.take(key) or ()]
        found = [end for end in ends if end is not None]
        return tuple(found) if len(found) == len(ends) else ()

    def _end(self, key: str, said: str) -> End | None:
        name, _, target = said.strip().partition(" ")
        if name == MASTER:
            if target:
                self._table.error(f"{said!r}: the master has no objects; it is {MASTER!r} alone", key)
            return None if target else End(MASTER)
        joint = self._joints.get(name)
        node = name if joint is None else joint.node
        if node not in self._nodes:
            self._table.error(f"there is no node {name!r}{did_you_mean(name, [*self._nodes, *self._joints])}", key)
            return None
        if joint is not None and joint.axis:
            self._table.error(f"{name!r} is axis {joint.axis} of {node!r}: name the node, and the object of that axis", key)
            return None
        if not target.strip():
            self._table.error(f'which object of {name!r}? "{name} position_actual_value", or "{name} 6064"', key)
            return None
        return End(node, target.strip())


def link_table(link: Link) -> dict[str, Any]:
    """Return a link as a file has it."""
    timing = link.timing
    table: dict[str, Any] = {"from": _text(link.sources), "to": _text(link.targets)}
    if timing.is_event_driven:
        table["event_driven"] = True
    times = _TIMES if timing.is_event_driven else ("every", *_TIMES)
    return table | table_of({key: KEYS[LINKS][key] for key in times}, timing, Timing())


def _text(ends: Sequence[End]) -> str | list[str]:
    listed = [str(end) for end in ends]
    return listed[0] if len(listed) == 1 else listed
