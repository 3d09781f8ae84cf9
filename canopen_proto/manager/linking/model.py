"""The words of PDO linking: the nodes and links that are given, and the plan that comes out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_proto.compiling import mypyc_attr
from canopen_proto.dictionary import Direction, Key, ObjectDictionary
from canopen_proto.dictionary.download_order import Write
from canopen_proto.machine import MILLISECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.pdo.settings import INHIBIT_UNIT, PdoSettings, cob_id_step
from canopen_proto.pdo.slots import PdoSlot

MASTER: Final = "master"
"""The name of the master at an end of a link. No node has it."""

MAX_EVERY: Final = 240
"""The greatest number of SYNCs between two PDOs (CiA 301 v4.2.0, 7.5.2.37)."""

MAX_COUNT: Final = 0xFFFF
"""The greatest inhibit time and event timer, in their units: both are UNSIGNED16."""


@dataclass(frozen=True, slots=True)
class KnownNode:
    """A node on the bus whose file is known.

    granularity: bits; each mapped object has a multiple of them, 0: the file does not say. dummies: the data types that the
    device takes as dummy entries (CiA 306-1, DummyUsage). used: PDOs that somebody else sets up, such as a chain of joints: they
    stay as they are. commanded: objects by which somebody else commands the node, in PDOs or not: no link may feed them.
    """

    name: str
    node_id: int
    dictionary: ObjectDictionary
    granularity: int = 0
    dummies: frozenset[int] = frozenset()
    used: tuple[PdoSettings, ...] = ()
    commanded: frozenset[Mux] = frozenset()


class End(NamedTuple):
    """One object of one node. key: as the dictionary takes it; not used if the node is MASTER."""

    node: str
    key: Key = ""

    def __str__(self) -> str:
        return f"{self.node} {self.key}".strip()


@dataclass(frozen=True, slots=True)
class Timing:
    """When a link's PDO is sent. every: at every n-th SYNC, 1..240; 0: event-driven. inhibit_time, event_timer: ns, for
    event-driven ones; 0: as the file has them. timeout: ns within which the next PDO has to come, else the receivers report an
    error (deadline monitoring, RPDO subindex 5); 0: as the file has it.

    Raises LocalProtocolError for a value out of range, and for one that a device could not keep exactly.
    """

    every: int = 1
    inhibit_time: Time = 0
    event_timer: Time = 0
    timeout: Time = 0

    def __post_init__(self) -> None:
        if not 0 <= self.every <= MAX_EVERY:
            raise LocalProtocolError(f"every {self.every}: a PDO is sent at every n-th SYNC, n = 1..{MAX_EVERY}")
        if self.every and (self.inhibit_time or self.event_timer):
            raise LocalProtocolError("inhibit time and event timer are for event-driven PDOs; this one is sent at SYNCs")
        times = (
            ("inhibit time", self.inhibit_time, INHIBIT_UNIT, "0.1 ms"),
            ("event timer", self.event_timer, MILLISECOND, "1 ms"),
        )
        for name, time, unit, text in (*times, ("timeout", self.timeout, MILLISECOND, "1 ms")):
            if time % unit or not 0 <= time <= MAX_COUNT * unit:
                most = f"{MAX_COUNT * unit / MILLISECOND:g} ms at most"
                raise LocalProtocolError(f"{name} {time / MILLISECOND:g} ms: a device counts it in {text}, {most}")

    @property
    def is_event_driven(self) -> bool:
        """Whether the PDO is sent when its sender wants to, not at SYNCs."""
        return not self.every

    def __str__(self) -> str:
        if self.every:
            when = "each SYNC" if self.every == 1 else f"every {self.every} SYNCs"
        else:
            when = "event-driven"
        times = (("inhibit", self.inhibit_time), ("timer", self.event_timer), ("timeout", self.timeout))
        return ", ".join([when, *(f"{name} {time / MILLISECOND:g} ms" for name, time in times if time)])


@dataclass(frozen=True, slots=True)
class Link:
    """One wish. name: for errors. It is one of three:

    - one source and its targets: the source's object feeds each of the targets' objects;
    - sources, and MASTER as the only target: the master wants these objects;
    - MASTER as the only source, and targets: the master sends these objects.

    Raises LocalProtocolError if it is none of them.
    """

    name: str
    sources: tuple[End, ...]
    targets: tuple[End, ...]
    timing: Timing = Timing()

    def __post_init__(self) -> None:
        from_master, to_master = self.is_from_master, self.is_to_master
        if not self.sources or not self.targets:
            raise LocalProtocolError(f"{self.name}: a link has a source and a target")
        if from_master and to_master:
            raise LocalProtocolError(f"{self.name}: from the master to the master: one end has to be an object of a node")
        if (from_master and len(self.sources) > 1) or (to_master and len(self.targets) > 1):
            raise LocalProtocolError(f"{self.name}: the master is the only one at its end; write a link for each of the others")
        if len(self.sources) > 1 and not to_master:
            raise LocalProtocolError(f"{self.name}: {len(self.sources)} objects cannot feed the same one; write a link for each")
        if to_master and self.timing.timeout:
            raise LocalProtocolError(f"{self.name}: the timeout is one of a node that receives; the master watches by itself")
        if from_master and (self.timing.inhibit_time or self.timing.event_timer):
            raise LocalProtocolError(
                f"{self.name}: inhibit time and event timer are those of a node that sends, not of the master"
            )

    @property
    def is_from_master(self) -> bool:
        """Whether the master is a source."""
        return any(end.node == MASTER for end in self.sources)

    @property
    def is_to_master(self) -> bool:
        """Whether the master is a target."""
        return any(end.node == MASTER for end in self.targets)

    def __str__(self) -> str:
        ends = (", ".join(map(str, self.sources)), ", ".join(map(str, self.targets)))
        return f"{self.name} ({' -> '.join(ends)})"


class LinkProblem(NamedTuple):
    """Why a link cannot be. link: its name. node, object: "" if it is not about one of them. text: the reason, for people."""

    link: str
    node: str
    object: str
    text: str

    def __str__(self) -> str:
        return f"{self.link}: {self.text}"


@mypyc_attr(native_class=False)
class LinkError(LocalProtocolError):
    """These links cannot be. problems: all that were found."""

    def __init__(self, problems: Sequence[LinkProblem]) -> None:
        super().__init__("; ".join(map(str, problems)))
        self.problems = tuple(problems)


@dataclass(frozen=True, slots=True)
class LinkedPdo:
    """One PDO of one node, as the links want it. settings: COB-ID with its flags, entries with dummies, and the times that are
    not as the file has them. slot: the PDO by the file. is_shared: somebody else sets it up (`used`); nothing is written."""

    member: KnownNode
    settings: PdoSettings
    slot: PdoSlot
    is_shared: bool = False

    @property
    def node(self) -> str:
        """The name of its node."""
        return self.member.name

    @property
    def name(self) -> str:
        """The PDO for people: "RPDO 2"."""
        return self.settings.name

    @property
    def lost(self) -> tuple[Mux, ...]:
        """The objects that the file maps to it, and that it does not carry any longer."""
        was = self.slot.pdo
        kept = self.settings.muxes if self.settings.is_valid else set()
        return tuple(sorted(was.muxes - kept)) if was.is_valid else ()

    def steps(self) -> list[Write]:
        """Return the downloads that set it up, in the order of `PdoSettings.steps`; only its COB-ID if it is to be destroyed.

        Objects that cannot be written are left out: the PDO was chosen because they hold the right value.
        """
        was, dictionary = self.slot.pdo, self.member.dictionary
        if not self.settings.is_valid:
            return [cob_id_step(self.settings)]
        steps = self.settings.steps(was.cob_id if was.is_valid else None)
        return [step for step in steps if (found := dictionary.get(step[0], step[1])) is not None and found.access.writable]


class LinkTransfer(NamedTuple):
    """One PDO on the bus. can_id: 11 bits. sender, receivers: its ends; the master has none. objects: what it carries, as the
    node has them that the file describes: of the sender, or of the receiver if the master sends. links: whose it is."""

    can_id: int
    timing: Timing
    sender: LinkedPdo | None
    receivers: tuple[LinkedPdo, ...]
    to_master: bool
    links: tuple[str, ...]

    @property
    def size(self) -> int:
        """Its bytes."""
        pdo = self.sender if self.sender is not None else self.receivers[0]
        return pdo.settings.size


@dataclass(frozen=True, slots=True)
class LinkPlan:
    """The PDOs for the links of one bus. transfers: by their CAN-IDs. destroyed: PDOs by the files that have to go, because they
    would set an object that a link feeds. notes: what is allowed, and worth a look; for people."""

    members: tuple[KnownNode, ...]
    transfers: tuple[LinkTransfer, ...]
    destroyed: tuple[LinkedPdo, ...]
    notes: tuple[str, ...]

    def pdos_of(self, node: str) -> list[LinkedPdo]:
        """Return the PDOs of a node that the links set up, RPDOs first."""
        ends = [pdo for each in self.transfers for pdo in (*each.receivers, each.sender) if pdo is not None]
        ours = [pdo for pdo in ends if pdo.node == node and not pdo.is_shared]
        return sorted(ours, key=lambda pdo: (pdo.settings.direction is Direction.TPDO, pdo.settings.number))

    def writes_of(self, node: str) -> list[Write]:
        """Return the downloads that set up the PDOs of a node, in order; none if no link needs the node. `pack_concise` makes a
        concise DCF of them.

        The first ones destroy PDOs that contradict a link. The others destroy each PDO of a link, map it anew and create it (CiA
        301 v4.2.0, 7.5.2.36). The node should be Pre-operational. Nothing is stored (0x1010).
        """
        gone = [pdo for pdo in self.destroyed if pdo.node == node]
        return [step for pdo in (*gone, *self.pdos_of(node)) for step in pdo.steps()]

    @property
    def changed(self) -> list[str]:
        """The nodes that have writes, in their order."""
        return [each.name for each in self.members if self.writes_of(each.name)]
