"""The key layout of a fleet on Zenoh, and the names in it. Pure: nothing here knows of a network.

    canopen/v1/SITE/BUS/alive               a liveliness token of the bridge: it serves this bus
    canopen/v1/SITE/BUS/NODE/alive          a liveliness token of a node: the bridge has heard of it lately
    canopen/v1/SITE/BUS/NODE/get/OBJECT     query: read an object; its bytes, as on the wire
    canopen/v1/SITE/BUS/NODE/set/OBJECT     query with a payload: write an object
    canopen/v1/SITE/BUS/NODE/command        query with a payload: an NMT command
    canopen/v1/SITE/BUS/NODE/nmt            published: the NMT state, when it changes
    canopen/v1/SITE/BUS/NODE/pdo/NUMBER     published: each PDO that the bridge takes
    canopen/v1/SITE/BUS/NODE/emcy           published: each emergency. Query: the last ones
    canopen/v1/SITE/BUS/NODE/pdos           query: what the PDOs carry, as JSON
    canopen/v1/SITE/BUS/NODE/objects        query: the objects that it has, by the bridge's dictionary, as JSON
    canopen/v1/SITE/BUS/status              published once a second. Query: the same
    canopen/v1/SITE/BUS/lease               query: who moves the machine, and intents to move it
    canopen/v1/SITE/BUS[/NODE]/halt         query: stop what moves

Where both sides are connected to two routers, everything comes twice. So beside a query stands a mark, and it is served once.
Beside a PDO stands its count (`count_bytes`), so whoever takes it knows what was lost on the way; beside an NMT state the time of
the bridge.

`get`, `set`, `command` and `lease` are keys of their own, since rules of access in Zenoh know keys and not payloads. All names
are ASCII and without wildcards, so a key is an MQTT topic, too. NODE is decimal.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

ROOT: Final = "canopen/v1"
NAME: Final = re.compile(r"[a-z0-9_-]{1,64}\Z")
"""What a site and a bus may be called."""
OBJECT: Final = re.compile(r"[A-Za-z0-9_.:()\[\]-]{1,200}\Z")
"""How an object stands in a key: `6041:00`, `6041`, or a name of the dictionary."""
ANY: Final = "*"
ALIVE: Final = "alive"
GET: Final = "get"
SET: Final = "set"
COMMAND: Final = "command"
NMT: Final = "nmt"
PDO: Final = "pdo"
EMCY: Final = "emcy"
PDOS: Final = "pdos"
OBJECTS: Final = "objects"
STATUS: Final = "status"
LEASE: Final = "lease"
HALT: Final = "halt"
MARK_BYTES: Final = 16
"""Beside a query stands a random mark: where it comes on two ways, the bridge serves it once."""
RUN_BYTES: Final = 8
"""By which a run of a bridge is told from the one before."""
_COUNT: Final = struct.Struct(f"<{RUN_BYTES}sQQ")
_NUMBER: Final = re.compile(r"[1-9][0-9]{0,2}\Z")


class FleetPlace(NamedTuple):
    """A bus of a fleet, or a node on it. site, bus: by their names; "*" in a pattern. node_id: 1..127; 0: the bus itself; -1:
    each node, in a pattern."""

    site: str
    bus: str
    node_id: int = 0

    def __str__(self) -> str:
        return "/".join((self.site, self.bus, *_node_words(self.node_id)))

    @property
    def bus_place(self) -> FleetPlace:
        """The bus."""
        return self._replace(node_id=0)

    def matches(self, pattern: FleetPlace) -> bool:
        """Return whether a pattern names this place."""
        return (
            pattern.site in (self.site, ANY)
            and pattern.bus in (self.bus, ANY)
            and (pattern.node_id == self.node_id or (pattern.node_id < 0 < self.node_id))
        )


def parse_place(text: str, *, node: bool = False) -> FleetPlace:
    """Return what a text such as "hall-2/arm/5" or "hall-2/arm" means; each part may be "*". node: it has to name a node. Raises
    ValueError."""
    words = text.split("/")
    if len(words) not in ((3,) if node else (2, 3)):
        wanted = "SITE/BUS/NODE, as hall-2/arm/5" if node else "SITE/BUS or SITE/BUS/NODE, as hall-2/arm/5"
        raise ValueError(f"{text!r} is no place in a fleet: {wanted}; * stands for each")
    for word in words[:2]:
        if word != ANY and not NAME.match(word):
            raise ValueError(f"{word!r} is no name of a site or a bus: small letters, digits, - and _")
    return FleetPlace(words[0], words[1], 0 if len(words) == 2 else _node_id(words[2], text))


def name_of_bus(locator: str) -> str:
    """Return the name that a bus gets in keys: of "socketcan:can0" it is socketcan-can0."""
    return re.sub(r"[^a-z0-9_-]+", "-", locator.lower()).strip("-")[:64] or "bus"


def check_name(what: str, name: str) -> str:
    """Return a name of a site or a bus. what: for the text. Raises ValueError."""
    if not NAME.match(name):
        raise ValueError(f"{what} {name!r}: a name has 1 to 64 small letters, digits, - and _")
    return name


def key_of(place: FleetPlace, *rest: str) -> str:
    """Return the key of something at a place; a place may be a pattern."""
    return "/".join((ROOT, place.site, place.bus, *_node_words(place.node_id), *rest))


def parse_key(key: str) -> tuple[FleetPlace, Sequence[str]] | None:
    """Return the place of a key and what stands behind it; None for one of another layout, and for one with "**"."""
    words = key.split("/")
    if words[:2] != ROOT.split("/") or len(words) < 5:
        return None
    site, bus, *rest = words[2:]
    if not all(word == ANY or NAME.match(word) for word in (site, bus)):
        return None
    node_id = 0
    if rest[0] == ANY or _NUMBER.match(rest[0]):
        try:
            node_id = _node_id(rest[0], key)
        except ValueError:
            return None
        rest = rest[1:]
    return (FleetPlace(site, bus, node_id), rest) if rest else None


class PdoCount(NamedTuple):
    """What stands beside a PDO. run: the bridge's, drawn at its start. number: of this PDO in that run, from 1. lost: PDOs of the
    bus so far that came faster than the bridge took them: of which node is not known."""

    run: bytes
    number: int
    lost: int


def count_bytes(run: bytes, number: int, lost: int) -> bytes:
    """Return a PdoCount as it stands beside a PDO."""
    return _COUNT.pack(run, number, lost)


def parse_count(data: bytes) -> PdoCount | None:
    """Return what stands beside a PDO; None if it is something else, or nothing."""
    return PdoCount(*_COUNT.unpack(data)) if len(data) == _COUNT.size else None


def _node_words(node_id: int) -> tuple[str, ...]:
    return () if node_id == 0 else (ANY if node_id < 0 else str(node_id),)


def _node_id(word: str, text: str) -> int:
    if word == ANY:
        return -1
    if not _NUMBER.match(word) or int(word) > 127:
        raise ValueError(f"{word!r} in {text!r} is no node-ID: 1 to 127, or *")
    return int(word)
