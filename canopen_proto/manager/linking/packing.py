"""Feeds into PDOs: which objects travel together, and how each receiver maps a PDO of which it wants only a part.

All feeds of a PDO have one sender and one timing. Those with the same receivers go together, in the order of the links. Then PDOs
of different receivers become one while it has room, and while each receiver can leave out what is not for it: by dummy entries
(CiA 301 v4.2.0, 7.4.7.1), as far as its file allows them. So a bus carries few frames and a device needs few PDOs. A receiver
maps all bytes of a PDO, also those behind the last one that it wants, because a length that differs from its mapping is an error
(7.5.2.36). A PDO of the master goes to one node.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from canopen_proto.datatypes import bit_length_of
from canopen_proto.manager.linking.feeds import Feed
from canopen_proto.manager.linking.model import MASTER, KnownNode, Timing
from canopen_proto.multiplexer import mapped, mapping_entry, mux
from canopen_proto.pdo.mapping import DUMMY_TYPES, MAX_BITS

DUMMY_WIDTHS: Final = tuple(
    sorted(((bit_length_of(each) or 0, index) for index, each in DUMMY_TYPES.items() if index <= 0x07), reverse=True)
)
"""Width and index of the dummy entries that DummyUsage names, the widest first. CiA 306-1"""


@dataclass(slots=True)
class Bundle:
    """The feeds of one PDO, in its order. sender: the name of a node, or MASTER. layout: entries of a fixed mapping in place of
    the feeds' own: what the sender maps between them."""

    sender: str
    timing: Timing
    feeds: list[Feed]
    layout: tuple[int, ...] = ()

    @property
    def receivers(self) -> frozenset[str]:
        """The names of all that receive it."""
        return frozenset().union(*(feed.receivers for feed in self.feeds))

    @property
    def bits(self) -> int:
        """The bits of its feeds together."""
        return sum(feed.bits for feed in self.feeds)

    def sent_entries(self) -> tuple[int, ...]:
        """Return the mapping of its sender, a node."""
        if self.layout:
            return self.layout
        return tuple(feed.source.entry for feed in self.feeds if feed.source is not None)

    def received_entries(self, member: KnownNode) -> tuple[int, ...] | None:
        """Return the mapping of a receiver, with dummy entries for what is not for it; None if its dummies do not fit."""
        entries: list[int] = []
        gap = 0
        for bits, feed in self._parts():
            target = None if feed is None else feed.target_on(member.name)
            if target is None:
                gap += bits
                continue
            if (dummies := dummy_entries(gap, member.dummies)) is None:
                return None
            entries += [*dummies, target.entry]
            gap = 0
        dummies = dummy_entries(gap, member.dummies)
        return None if dummies is None else (*entries, *dummies)

    def _parts(self) -> Iterable[tuple[int, Feed | None]]:
        """Return its parts in order: bits, and the feed, if it is one."""
        if not self.layout:
            return [(feed.bits, feed) for feed in self.feeds]
        left = list(self.feeds)
        parts: list[tuple[int, Feed | None]] = []
        for entry in self.layout:
            found = next((feed for feed in left if feed.source is not None and feed.source.entry == entry), None)
            if found is not None:
                left.remove(found)
            parts.append((mapped(entry)[2], found))
        return parts


def dummy_entries(bits: int, allowed: frozenset[int]) -> list[int] | None:
    """Return dummy entries of so many bits together, as few as possible; None if these data types cannot fill them. allowed: the
    indices of these types, such as 0x0005."""
    entries: list[int] = []
    for width, index in DUMMY_WIDTHS:
        while index in allowed and width <= bits:
            entries.append(mapping_entry(mux(index), width))
            bits -= width
    return None if bits else entries


def bundles_of(feeds: Sequence[Feed], members: Mapping[str, KnownNode], room: Mapping[str, int]) -> list[Bundle]:
    """Return the PDOs that carry these feeds; see this module's text.

    room: by node, the most entries that one of its RPDOs has.

    members: the nodes, by name.
    """
    groups: dict[tuple[str, Timing], list[Bundle]] = {}
    for feed in feeds:
        sender = MASTER if feed.source is None else feed.source.member.name
        key = (sender, feed.timing)
        for bundle in groups.setdefault(key, []):
            if bundle.receivers == feed.receivers and bundle.bits + feed.bits <= MAX_BITS and _is_single(bundle, feed):
                bundle.feeds.append(feed)
                break
        else:
            groups[key].append(Bundle(sender, feed.timing, [feed]))
    found: list[Bundle] = []
    for (sender, _), bundles in groups.items():
        found += bundles if sender == MASTER else _merged(bundles, members, room)
    return found


def _is_single(bundle: Bundle, feed: Feed) -> bool:
    """Return whether a PDO lacks the object that a feed takes: no PDO maps an object of its sender twice."""
    return all(other.source is None or feed.source is None or other.source.mux != feed.source.mux for other in bundle.feeds)


def _merged(bundles: Sequence[Bundle], members: Mapping[str, KnownNode], room: Mapping[str, int]) -> list[Bundle]:
    """Return fewer PDOs, as far as their receivers can leave out parts of them."""
    kept: list[Bundle] = []
    for bundle in bundles:
        for place, other in enumerate(kept):
            both = Bundle(other.sender, other.timing, [*other.feeds, *bundle.feeds])
            if (
                both.bits <= MAX_BITS
                and all(_is_single(other, feed) for feed in bundle.feeds)
                and _can_receive(both, members, room)
            ):
                kept[place] = both
                break
        else:
            kept.append(bundle)
    return kept


def _can_receive(bundle: Bundle, members: Mapping[str, KnownNode], room: Mapping[str, int]) -> bool:
    for name in bundle.receivers - {MASTER}:
        entries = bundle.received_entries(members[name])
        if entries is None or len(entries) > room[name]:
            return False
    return True
