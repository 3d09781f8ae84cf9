"""The PDOs for the links of one bus, computed from the nodes' files alone. Nothing is sent.

    plan = plan_links(members, links)
    for node in plan.changed:
        concise = pack_concise(plan.writes_of(node))      # for 0x1F22 of a master (CiA 302-3), or write it by SDO

The steps: the objects of both ends are checked (feeds.py); they are put into PDOs (packing.py); each end gets a PDO of its device
(places.py); each PDO gets a CAN-ID (can_ids.py). RPDOs by the files that would set an object that a link feeds are destroyed, for
two masters of one set-point contradict each other.

A PDO at SYNCs has the type n, "at every n-th SYNC", at its sender. Its receivers take it at the next SYNC, all at one moment.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

from canopen_proto.dictionary import Direction
from canopen_proto.frame import COB_ID_NO_RTR
from canopen_proto.machine import LocalProtocolError
from canopen_proto.manager.linking.can_ids import CanIds
from canopen_proto.manager.linking.feeds import Feed, Feeds
from canopen_proto.manager.linking.model import (
    MASTER,
    KnownNode,
    Link,
    LinkedPdo,
    LinkError,
    LinkPlan,
    LinkProblem,
    LinkTransfer,
    Timing,
)
from canopen_proto.manager.linking.packing import Bundle, bundles_of
from canopen_proto.manager.linking.places import Places
from canopen_proto.multiplexer import Mux


def plan_links(members: Sequence[KnownNode], links: Sequence[Link], node_ids: Collection[int] = ()) -> LinkPlan:
    """Return the PDOs for these links; see this module's text.

    members: the nodes of the bus whose files are known, also those without links: their PDOs have CAN-IDs. node_ids: of other
    nodes on the bus. Raises LinkError with all problems that were found, each with its link, node and object; LocalProtocolError
    if two members have one name or node-ID.
    """
    for values in ([each.name for each in members], [each.node_id for each in members]):
        if len(set(values)) < len(values) or MASTER in values:
            raise LocalProtocolError(f"each node has a name and a node-ID of its own, and none is called {MASTER!r}: {values}")
    feeds = Feeds(members)
    for link in links:
        feeds.add(link)
    if feeds.problems:
        raise LinkError(feeds.problems)
    planner = _Planner(members, feeds.all, node_ids)
    transfers = planner.transfers()
    if planner.problems:
        raise LinkError(planner.problems)
    return LinkPlan(tuple(members), tuple(transfers), tuple(planner.destroyed), tuple(feeds.notes))


class _Ends(NamedTuple):
    """The PDOs that a bundle has in the devices. sender: None: the master."""

    bundle: Bundle
    sender: LinkedPdo | None
    receivers: list[LinkedPdo]


class _Planner:
    """One `plan_links` at work, from the feeds on."""

    def __init__(self, members: Sequence[KnownNode], feeds: Sequence[Feed], node_ids: Collection[int]) -> None:
        self._members = {member.name: member for member in members}
        self._feeds = feeds
        self._fed: dict[str, set[Mux]] = {}
        for feed in feeds:
            for place in feed.targets:
                self._fed.setdefault(place.member.name, set()).add(place.mux)
        self._places = Places(members, self._fed)
        self._can_ids = CanIds(members, node_ids)
        self.problems: list[LinkProblem] = []
        self.destroyed: list[LinkedPdo] = []

    def transfers(self) -> list[LinkTransfer]:
        """Return the PDOs on the bus. The problems are in `problems`, the PDOs that have to go in `destroyed`."""
        fixed = self._fixed_bundles()
        carried = [id(feed) for bundle, _ in fixed for feed in bundle.feeds]
        movable = [feed for feed in self._feeds if id(feed) not in carried]
        room = {name: self._places.room(name) for name in self._members}
        ends = [self._ends(bundle, sender) for bundle, sender in fixed]
        ends += [self._ends(bundle, None) for bundle in bundles_of(movable, self._members, room)]
        if self.problems:
            return []
        self._destroy()
        found = [transfer for each in ends if (transfer := self._transfer(each)) is not None]
        return sorted(found, key=lambda transfer: transfer.can_id)

    def _fixed_bundles(self) -> list[tuple[Bundle, LinkedPdo]]:
        """Return the PDOs that carry what is wanted, and stay as they are; see `Places.ready`."""
        groups: dict[tuple[str, Timing], list[Feed]] = {}
        for feed in self._feeds:
            if feed.source is not None:
                groups.setdefault((feed.source.member.name, feed.timing), []).append(feed)
        found = []
        for (name, timing), feeds in groups.items():
            entries = {feed.source.entry: feed for feed in reversed(feeds) if feed.source is not None}
            while (chosen := self._places.ready(self._members[name], set(entries), timing)) is not None:
                carried = [entries.pop(entry) for entry in chosen.settings.entries if entry in entries]
                found.append((Bundle(name, timing, carried, chosen.settings.entries), chosen))
        return found

    def _ends(self, bundle: Bundle, sender: LinkedPdo | None) -> _Ends:
        """Take the PDOs for a bundle."""
        if sender is None and bundle.sender != MASTER:
            sender = self._choose(bundle, bundle.sender, Direction.TPDO, bundle.sent_entries())
        receivers = []
        for name in sorted(bundle.receivers - {MASTER}):
            entries = bundle.received_entries(self._members[name])
            if entries is None:
                text = "its file (DummyUsage) allows no dummy entries for the parts of this PDO that are not for it"
                self._problem(bundle, name, f"{name} cannot receive from {bundle.sender}: {text}")
                continue
            if bundle.sender == MASTER:  # to which any order is as good
                entries = self._places.as_fixed(name, entries)
            if (chosen := self._choose(bundle, name, Direction.RPDO, entries)) is not None:
                receivers.append(chosen)
        return _Ends(bundle, sender, receivers)

    def _choose(self, bundle: Bundle, node: str, direction: Direction, entries: tuple[int, ...]) -> LinkedPdo | None:
        chosen = self._places.choose(self._members[node], direction, entries, bundle.timing)
        if isinstance(chosen, LinkedPdo):
            return chosen
        self._problem(bundle, node, f"{node} has no {direction} left for it: {chosen}")
        return None

    def _destroy(self) -> None:
        """Let go of the PDOs that would set an object that a link feeds, and keep the CAN-IDs of all others."""
        for name, member in self._members.items():
            for slot in (*self._places.free(name, Direction.RPDO), *self._places.free(name, Direction.TPDO)):
                pdo = slot.pdo
                fed = pdo.muxes & self._fed.get(name, set()) if pdo.direction is Direction.RPDO else set()
                if not pdo.is_valid or not fed:
                    self._can_ids.hold(member, pdo)
                elif slot.can_move:
                    self.destroyed.append(LinkedPdo(member, pdo.destroyed, slot))
                else:
                    feed = next(each for each in self._feeds if any(place.mux in fed for place in each.targets))
                    variable = member.dictionary.at(min(fed) >> 8, min(fed) & 0xFF)
                    text = f"{pdo.name} of {name} sets {variable.label} too, and cannot be switched off"
                    self.problems.append(LinkProblem(", ".join(feed.links), name, variable.label, text))

    def _transfer(self, ends: _Ends) -> LinkTransfer | None:
        """Return a PDO with its CAN-ID; None if there is a problem."""
        owner = ends.receivers[0] if ends.sender is None else ends.sender
        bundle, can_id = ends.bundle, self._can_ids.give(owner, ends.receivers)
        if isinstance(can_id, str):
            self._problem(bundle, owner.node, f"{owner.name} of {owner.node}: {can_id}")
            return None
        sender = None if ends.sender is None else _with_can_id(ends.sender, can_id)
        receivers = tuple(_with_can_id(each, can_id) for each in ends.receivers)
        links = tuple(dict.fromkeys(link for feed in bundle.feeds for link in feed.links))
        return LinkTransfer(can_id, bundle.timing, sender, receivers, MASTER in bundle.receivers, links)

    def _problem(self, bundle: Bundle, node: str, text: str) -> None:
        for link in dict.fromkeys(link for feed in bundle.feeds for link in feed.links):
            self.problems.append(LinkProblem(link, node, "", text))


def _with_can_id(pdo: LinkedPdo, can_id: int) -> LinkedPdo:
    """Return the PDO of a node with its CAN-ID; as it is if its COB-ID cannot be written."""
    if not pdo.slot.can_move:
        return pdo
    flags = COB_ID_NO_RTR if pdo.settings.direction is Direction.TPDO else 0
    return replace(pdo, settings=replace(pdo.settings, cob_id=can_id | flags))
