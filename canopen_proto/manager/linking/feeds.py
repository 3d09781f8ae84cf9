"""The objects that the links move, checked against the files of their nodes.

A `Feed` is one object of one sender and all that it feeds; several links may want the same object. The two ends of a link are
mapped in their full width, so they have the same number of bits: a PDO carries bits, and no device converts them. An object takes
its value from one link only.

Source: CiA 301 v4.2.0, 7.4.8.3 (access) and 7.5.2.36; CiA 306-1, PDOMapping and Granularity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from canopen_proto.datatypes import DataType, is_integer, is_signed
from canopen_proto.dictionary import Direction, Variable
from canopen_proto.dictionary.model import NotInDictionaryError, did_you_mean
from canopen_proto.manager.linking.model import MASTER, End, KnownNode, Link, LinkProblem, Timing
from canopen_proto.multiplexer import Mux, mapped
from canopen_proto.pdo.slots import entry_of


class Place(NamedTuple):
    """One object of one node, as a PDO carries it. entry: the value of the mapping parameter."""

    member: KnownNode
    variable: Variable
    entry: int

    @property
    def mux(self) -> Mux:
        """The object."""
        return self.variable.mux

    @property
    def bits(self) -> int:
        """Its bits in a PDO."""
        return mapped(self.entry)[2]

    def __str__(self) -> str:
        return f"{self.member.name} {self.variable.label}"


@dataclass(slots=True)
class Feed:
    """One object that a PDO carries. source: None: the master sends it. targets: at most one for each node."""

    timing: Timing
    source: Place | None
    bits: int
    links: list[str] = field(default_factory=list)
    targets: list[Place] = field(default_factory=list)
    to_master: bool = False

    @property
    def receivers(self) -> frozenset[str]:
        """The names of the nodes that receive it; MASTER is one of them if the master wants it."""
        names = [place.member.name for place in self.targets]
        return frozenset([*names, MASTER] if self.to_master else names)

    def target_on(self, node: str) -> Place | None:
        """Return the object that it feeds on a node."""
        return next((place for place in self.targets if place.member.name == node), None)


class Feeds:
    """Collects the feeds of links, and all problems with them. members: the nodes with a file."""

    def __init__(self, members: Sequence[KnownNode]) -> None:
        self._members = {member.name: member for member in members}
        self.problems: list[LinkProblem] = []
        self.notes: list[str] = []
        self._feeds: dict[tuple[Timing, str, Mux], list[Feed]] = {}
        self._fed: dict[tuple[str, Mux], Link] = {}

    @property
    def all(self) -> list[Feed]:
        """The feeds, in the order of the links."""
        return [feed for feeds in self._feeds.values() for feed in feeds]

    def add(self, link: Link) -> None:
        """Add what a link moves, or its problems."""
        sources = [] if link.is_from_master else self._places(link, link.sources, Direction.TPDO)
        targets = [] if link.is_to_master else self._places(link, link.targets, Direction.RPDO)
        if sources is None or targets is None:
            return
        targets = [place for place in targets if self._is_first(link, place)]
        if link.is_from_master:
            for place in targets:
                self._feed(link, None, place)
        elif link.is_to_master:
            for place in sources:
                self._feed(link, place, None)
        else:
            for place in targets:
                if self._fits(link, sources[0], place):
                    self._feed(link, sources[0], place)

    def _feed(self, link: Link, source: Place | None, target: Place | None) -> None:
        place = source if source is not None else target
        assert place is not None
        sender = MASTER if source is None else source.member.name
        key = link.timing, f"{sender} {place.member.name}", place.mux
        feeds = self._feeds.setdefault(key, [])
        # A second object of one receiver needs the value a second time: a PDO maps each of its bits to one object there.
        free = [feed for feed in feeds if target is None or feed.target_on(target.member.name) is None]
        if free:
            feed = free[0]
        else:
            feed = Feed(link.timing, source, place.bits)
            feeds.append(feed)
        if link.name not in feed.links:
            feed.links.append(link.name)
        if target is None:
            feed.to_master = True
        else:
            feed.targets.append(target)

    def _places(self, link: Link, ends: Sequence[End], direction: Direction) -> list[Place] | None:
        """Return the objects at one side of a link; None if there is a problem with one of them."""
        places = [self._place(link, end, direction) for end in ends]
        found = [place for place in places if place is not None]
        return found if len(found) == len(places) else None

    def _place(self, link: Link, end: End, direction: Direction) -> Place | None:
        member = self._members.get(end.node)
        if member is None:
            known = did_you_mean(end.node, self._members)
            self._problem(link, end.node, "", f"no file describes a node {end.node!r} on this bus{known}")
            return None
        try:
            variable = member.dictionary.variable(end.key)
        except NotInDictionaryError as error:
            self._problem(link, end.node, str(end.key), f"{end.node}: {error}")
            return None
        entry, reason = entry_of(member.dictionary, variable.mux, direction)
        if entry is None:
            self._problem(link, end.node, variable.label, f"{end.node}: {reason}")
            return None
        place = Place(member, variable, entry)
        if member.granularity and place.bits % member.granularity:
            text = f"{place} has {place.bits} bits; the device maps multiples of {member.granularity} bits only (Granularity)"
            self._problem(link, end.node, variable.label, text)
            return None
        return place

    def _is_first(self, link: Link, target: Place) -> bool:
        """Check that nothing else feeds an object."""
        first = self._fed.setdefault((target.member.name, target.mux), link)
        if first is not link:
            text = f"{target} is fed by {first} already: it can follow one of them only"
            self._problem(link, target.member.name, target.variable.label, text)
            return False
        for pdo in target.member.used:
            if pdo.direction is Direction.RPDO and target.mux in pdo.muxes:
                text = f"{target} is in {pdo.name} already, which its chain sends"
                self._problem(link, target.member.name, target.variable.label, text)
                return False
        if target.mux in target.member.commanded:
            text = f"{target} commands a drive that a chain moves; only its chain may do so"
            self._problem(link, target.member.name, target.variable.label, text)
            return False
        return True

    def _fits(self, link: Link, source: Place, target: Place) -> bool:
        """Check that two objects can have the same bits."""
        given, taken = source.variable.data_type, target.variable.data_type
        if source.member is target.member:
            text = f"{source} is on the same node as {target.variable.label}; a device does not receive its own PDOs"
        elif source.bits != target.bits:
            text = f"{source} has {source.bits} bits, {target} has {target.bits}; a PDO cannot convert"
        elif given != taken and not (is_integer(given) and is_integer(taken)):
            text = f"{source} is {given.name}, {target} is {taken.name}; a PDO cannot convert"
        else:
            self._compare(link, source, target, given, taken)
            return True
        self._problem(link, target.member.name, target.variable.label, text)
        return False

    def _compare(self, link: Link, source: Place, target: Place, given: DataType, taken: DataType) -> None:
        """Note where the same bits may mean another number, or another quantity."""
        if is_signed(given) != is_signed(taken):
            text = f"{source} is {given.name}, {target} is {taken.name}: values of {1 << source.bits - 1} and more differ by sign"
            self.notes.append(f"{link.name}: {text}")
        ours, theirs = source.variable, target.variable
        if ours.unit and theirs.unit and (ours.unit, ours.factor) != (theirs.unit, theirs.factor):
            counts = [f"{each.factor:g} {each.unit}" for each in (ours, theirs)]
            self.notes.append(f"{link.name}: {source} counts {counts[0]}, {target} {counts[1]}: the number is not converted")

    def _problem(self, link: Link, node: str, name: str, text: str) -> None:
        self.problems.append(LinkProblem(str(link), node, name, text))
