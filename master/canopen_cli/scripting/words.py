"""The words that `canopen shell` completes: names, attributes, nodes, objects inside a string, constants of an object."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from canopen_cli.scripting.namespace import Nodes
from canopen_master.node import Node
from canopen_proto.machine import LocalProtocolError

_DOTTED: Final = re.compile(r"([A-Za-z_][A-Za-z_0-9]*(?:\[[^\]\[]*\])?(?:\.[A-Za-z_][A-Za-z_0-9]*)*)\.([A-Za-z_0-9]*)\Z")
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z_0-9]*\Z")
_STRING: Final = re.compile(r"""([A-Za-z_][\w.\[\]'"]*?)(?:\.\w+\(|\[)\s*(?:["']([^"']*)["']\s*,\s*)?["']([^"']*)\Z""")
"""A string that is not closed, behind a call of a method, or an index, of something; perhaps its second argument."""
_PLOT: Final = re.compile(r"^\s*plot\s+(?:[^\s(]+\s+)*([^\s(\"']*)\Z")
_INDEX: Final = re.compile(r"nodes\[\s*([0-9]*)\Z")


def words_for(text: str, names: Mapping[str, Any]) -> tuple[str, list[str]]:
    """Return what the last word of a line is so far, and what it may become. Nothing of the line is called."""
    if found := _PLOT.search(text):
        return _plotted(found[1], names)
    if found := _INDEX.search(text):
        return found[1], [each for each in _node_ids(names) if each.startswith(found[1])]
    if found := _STRING.search(text):
        node = _value_of(found[1], names)
        if isinstance(node, Node):
            words = _objects(node) if found[2] is None else _constants(node, found[2])
            return found[3], sorted({each for each in words if each.lower().startswith(found[3].lower())})
        return found[3], []
    if found := _DOTTED.search(text):
        return found[2], _starting(found[2], _attributes(_value_of(found[1], names)))
    found = _NAME.search(text)
    begun = found[0] if found else ""
    return begun, _starting(begun, [*names, *keyword.kwlist]) if begun else []


def _plotted(begun: str, names: Mapping[str, Any]) -> tuple[str, list[str]]:
    """Return the words for an object that is to be drawn: "5:velocity", or "velocity" of `node`."""
    head, colon, rest = begun.partition(":")
    node = _value_of(f"nodes[{head}]", names) if colon and head.isdecimal() else names.get("node")
    before = f"{head}:" if colon and head.isdecimal() else ""
    wanted = (rest if before else begun).lower()
    objects = _objects(node) if isinstance(node, Node) else ()
    return begun, sorted({f"{before}{each}" for each in objects if each.lower().startswith(wanted)})


def _starting(begun: str, words: Iterable[str]) -> list[str]:
    return sorted({each for each in words if each.startswith(begun) and (begun.startswith("_") or not each.startswith("_"))})


def _value_of(expression: str, names: Mapping[str, Any]) -> Any:
    """Return what a name, or a node of `nodes`, with attributes behind it, stands for now; None if that is not known. A property
    of ours only looks: nothing is called that sends."""
    first, *rest = expression.split(".")
    head, _, index = first.partition("[")
    value = names.get(head)
    if index and isinstance(value, Nodes):
        try:
            value = value[index.rstrip("]").strip("\"' ")]
        except Exception:  # noqa: BLE001 - no node: the line will tell
            return None
    elif index:
        return None
    for name in rest:
        if _can_be_seen(value, name):
            value = getattr(value, name, None)
    return value


def _can_be_seen(value: Any, name: str) -> bool:
    """Return whether an attribute can be looked at without running code: it is none of a class's properties."""
    return not isinstance(getattr(type(value), name, None), property)


def _attributes(value: Any) -> Iterator[str]:
    return iter(dir(value)) if value is not None else iter(())


def _node_ids(names: Mapping[str, Any]) -> list[str]:
    nodes = names.get("nodes")
    return [str(each) for each in nodes] if isinstance(nodes, Nodes) else []


def _objects(node: Node) -> Iterator[str]:
    return (each.name for each in node.dictionary)


def _constants(node: Node, key: str) -> Iterator[str]:
    try:
        return (each.name for each in node.dictionary.constants_of(key))
    except LocalProtocolError:
        return iter(())
