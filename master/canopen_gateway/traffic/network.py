"""The network of a bus as plain data: who sends which PDO to whom, how often it came, how much of the bus each node takes.

What is known of a node's PDOs comes from four places, the surer one first:

    the device      it was asked (`GatewayService.read_pdos`)
    this master     has set it up, or exchanges it
    machine file    a link of it; `canopen net boot` writes it to the device
    file            the device's own file: what it has when it is delivered

and a frame that nothing of this explains is told by its CAN-ID alone. Nothing is sent for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, TypedDict

from canopen_gateway.traffic.pdos import exchanged_pdos, nodes_of
from canopen_gateway.traffic.traffic import KeyRate, NetTraffic
from canopen_master import Master, Node
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.machine_file.links import linked_buses, plan_bus
from canopen_master.monitor_words import SERVICES
from canopen_master.pdo_reading import type_text
from canopen_master.plain_text import clean
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.frame import KEY_EXTENDED, RoutingKey, can_id_of
from canopen_proto.manager.linking import LinkPlan
from canopen_proto.pdo.consistency import PdoEnd, flows_of
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.pdo.slots import pdos_on_bus, shown_entries

MASTER_NAME: Final = "this master"
DEVICE, SET_UP, LINK, FILE, HEARD = "the device", "this master", "machine file", "its file", "its frames"
MOST_PDOS: Final = 512
"""PDOs of a bus that are told; further ones are counted."""
MOST_TEXT: Final = 400
"""Characters of the objects of a PDO."""

_NO_PDOS: Final = frozenset(SERVICES)


class PdoEndData(TypedDict):
    """An end of a PDO. node: 0 for this master. pdo: "TPDO 1"; "" for the master, and where only frames tell of it. known: what
    tells of it."""

    node: int
    name: str
    pdo: str
    known: str


class PdoData(TypedDict):
    """A PDO of a bus. can_id: as "0x183". bytes: of its objects; null if they are not known. sent: when it is sent, in words.
    load: share of the bus that it takes, 0 to 1; null if nobody tells the bit rate. links: of the machine file."""

    can_id: str
    senders: list[PdoEndData]
    receivers: list[PdoEndData]
    bytes: int | None
    objects: str
    sent: str
    frames_per_second: int
    bits_per_second: int
    load: float | None
    links: list[str]


class NodeLoadData(TypedDict):
    """What a node takes of the bus: what it sends, and what is sent to it alone. node: one of the machine, or one that has sent
    a frame; 0 for all other frames. load: 0 to 1; null if nobody tells the bit rate. pdos: what tells of its PDOs; "" if nothing
    does. read_age: seconds since the device was asked for them; null if it was not."""

    node: int
    name: str
    frames_per_second: int
    bits_per_second: int
    load: float | None
    pdos: str
    read_age: float | None


class NetworkData(TypedDict):
    """A bus. load: share of the bit rate in the last second, 0 to 1; null if nobody tells it. lost: frames that were lost before
    they came here. dropped: frames that were not looked at in time. notes: what is left out, or cannot be told."""

    net: int
    name: str
    bitrate: int | None
    load: float | None
    frames_per_second: int
    bits_per_second: int
    syncs: int
    lost: int
    dropped: int
    nodes: list[NodeLoadData]
    pdos: list[PdoData]
    notes: list[str]


def planned_links(master: Master, net: str) -> LinkPlan | None:
    """Return the PDOs for the links of the machine file on a bus; None if there are none. It reads the files of the devices.
    Raises DictionaryError, DataError for links or files that cannot be used."""
    machine = master.machine
    if machine is None or net not in linked_buses(machine):
        return None
    return plan_bus(machine, net, Dictionaries(machine, master.dictionary))


def network_data(
    master: Master, traffic: NetTraffic, net: str, number: int, names: Mapping[int, str], plan: LinkPlan | None, problem: str = ""
) -> NetworkData:
    """Return the network of a bus. number: of the bus, from 1. names: of all nodes that are known there, by node-ID. plan: of the
    links. problem: why there is no plan."""
    known = _KnownPdos(master, traffic, net, names, plan)
    figures, bitrate = traffic.figures(), master.bus(net).bitrate
    # A request to a node-ID is no sign of a node there: after a search all of them were asked
    loads = {each.node_id: each for each in figures.nodes if each.node_id in names or each.last_heard is not None}
    watchdog = master.watchdogs.settings
    if watchdog is not None:
        names = {watchdog.node_id: MASTER_NAME, **names} if watchdog.node_id in loads else names
    nodes: list[NodeLoadData] = []
    rest_frames, rest_bits = figures.frames_per_second, figures.bits_per_second
    for node_id in sorted({*names, *loads}):
        load = loads.get(node_id)
        frames, bits = (0, 0) if load is None else (load.frames_per_second, load.bits_per_second)
        rest_frames -= frames
        rest_bits -= bits
        read = traffic.pdos_read.get(node_id)
        nodes.append(
            {
                "node": node_id,
                "name": names.get(node_id, ""),
                "frames_per_second": frames,
                "bits_per_second": bits,
                "load": bits / bitrate if bitrate else None,
                "pdos": ", ".join(dict.fromkeys(known.known.get(node_id, {}).values())),
                "read_age": None if read is None else round((master.now() - read.time) / 1e9, 1),
            }
        )
    rest_frames, rest_bits = max(0, rest_frames), max(0, rest_bits)
    nodes.append(
        {
            "node": 0,
            "name": "to all: SYNC, NMT, and what nobody has told of",
            "frames_per_second": rest_frames,
            "bits_per_second": rest_bits,
            "load": rest_bits / bitrate if bitrate else None,
            "pdos": "",
            "read_age": None,
        }
    )
    pdos = known.pdos(bitrate)
    notes = [*known.notes, *([problem] if problem else [])]
    if len(pdos) > MOST_PDOS:
        notes.append(f"{len(pdos) - MOST_PDOS} further PDOs are left out here")
    if traffic.failure is not None:
        notes.append("what passes is not understood any more: the gateway's log says why")
    return {
        "net": number,
        "name": net,
        "bitrate": bitrate,
        "load": figures.load,
        "frames_per_second": figures.frames_per_second,
        "bits_per_second": figures.bits_per_second,
        "syncs": figures.syncs,
        "lost": traffic.lost,
        "dropped": traffic.dropped,
        "nodes": nodes,
        "pdos": pdos[:MOST_PDOS],
        "notes": notes,
    }


class _KnownPdos:
    """What is known of the PDOs of a bus. known: by node-ID, direction and number of a PDO, what tells of it."""

    def __init__(self, master: Master, traffic: NetTraffic, net: str, names: Mapping[int, str], plan: LinkPlan | None) -> None:
        self.known: dict[int, dict[tuple[Direction, int], str]] = {}
        self.notes: list[str] = []
        self._settings: dict[int, dict[tuple[Direction, int], PdoSettings]] = {}
        self._dictionaries: dict[int, ObjectDictionary] = {}
        self._names = names
        self._default = master.dictionary
        self._links: dict[RoutingKey, list[str]] = {}
        self._for_master: dict[RoutingKey, str] = {}  # what tells that this master takes it
        self._from_master: dict[RoutingKey, str] = {}
        self._rates = traffic.rates()
        nodes = nodes_of(master, net)
        for node in nodes.values():
            self._dictionaries[node.node_id] = node.dictionary
            if node.dictionary is not master.dictionary:
                self._add(node.node_id, FILE, pdos_on_bus(node.dictionary, node.node_id))
        if plan is not None:
            self._add_plan(plan)
        for node in nodes.values():
            self._add_exchanged(node)
        for node_id, read in traffic.pdos_read.items():
            self._settings[node_id], self.known[node_id] = {}, {}
            self._add(node_id, DEVICE, [each.settings for each in read.pdos if each.settings is not None])
            self.notes += [f"node {node_id} {each.name}: {clean(each.remark)}" for each in read.pdos if each.remark]

    def _add(self, node_id: int, known: str, pdos: Iterable[PdoSettings]) -> None:
        for pdo in pdos:
            self._settings.setdefault(node_id, {})[pdo.place] = pdo
            self.known.setdefault(node_id, {})[pdo.place] = known

    def _add_plan(self, plan: LinkPlan) -> None:
        ids = {member.name: member.node_id for member in plan.members}
        for member in plan.members:
            self._dictionaries.setdefault(member.node_id, member.dictionary)
        for transfer in plan.transfers:
            ends = [*([] if transfer.sender is None else [transfer.sender]), *transfer.receivers]
            for end in ends:
                self._add(ids[end.node], LINK, [end.settings])
            key = ends[0].settings.key
            self._links.setdefault(key, []).extend(transfer.links)
            if transfer.to_master:
                self._for_master[key] = LINK
            if transfer.sender is None:
                self._from_master[key] = LINK

    def _add_exchanged(self, node: Node) -> None:
        for pdo in exchanged_pdos(node):
            (self._for_master if pdo.direction is Direction.TPDO else self._from_master)[pdo.key] = SET_UP
            self._add(node.node_id, SET_UP, [pdo])

    def pdos(self, bitrate: int | None) -> list[PdoData]:
        """Return all PDOs, in the order of their CAN-IDs."""
        flows = flows_of({node_id: list(pdos.values()) for node_id, pdos in self._settings.items()})
        rows = {flow.key: self._row(flow.key, flow.senders, flow.receivers, bitrate) for flow in flows}
        for key, rate in self._rates.items():
            if key not in rows and rate.service.lower() not in _NO_PDOS:
                rows[key] = self._row(key, (), (), bitrate)
        return [rows[key] for key in sorted(rows)]

    def _row(self, key: RoutingKey, senders: tuple[PdoEnd, ...], receivers: tuple[PdoEnd, ...], bitrate: int | None) -> PdoData:
        rate = self._rates.get(key, KeyRate(0, 0, False, "", 0))
        froms, tos = [*map(self._end, senders)], [*map(self._end, receivers)]
        if rate.is_sent or key in self._from_master:
            froms.append({"node": 0, "name": MASTER_NAME, "pdo": "", "known": self._from_master.get(key, HEARD)})
        if key in self._for_master:
            tos.append({"node": 0, "name": MASTER_NAME, "pdo": "", "known": self._for_master[key]})
        if not senders and not receivers and rate.node_id:
            name = self._names.get(rate.node_id, "")
            ends = tos if rate.service.upper().startswith("RPDO") else froms
            ends.append({"node": rate.node_id, "name": name, "pdo": clean(rate.service), "known": HEARD})
        first = next(iter((*senders, *receivers)), None)
        digits = 8 if key & KEY_EXTENDED else 3
        sent = type_text(senders[0].pdo) if senders and self._is_own(senders[0]) else ""
        return {
            "can_id": f"0x{can_id_of(key):0{digits}X}",
            "senders": froms,
            "receivers": tos,
            "bytes": None if first is None else first.pdo.size,
            "objects": "" if first is None else self._objects(first),
            "sent": sent,
            "frames_per_second": rate.frames,
            "bits_per_second": rate.bits,
            "load": rate.bits / bitrate if bitrate else None,
            "links": [clean(each) for each in self._links.get(key, ())],
        }

    def _is_own(self, end: PdoEnd) -> bool:
        """Return whether the transmission type of a PDO is the device's: our end of a TPDO takes it at once, whatever that is."""
        return self.known[end.node_id][end.pdo.place] != SET_UP

    def _end(self, end: PdoEnd) -> PdoEndData:
        known = self.known[end.node_id][end.pdo.place]
        return {"node": end.node_id, "name": self._names.get(end.node_id, ""), "pdo": end.pdo.name, "known": known}

    def _objects(self, end: PdoEnd) -> str:
        return clean(shown_entries(self._dictionaries.get(end.node_id, self._default), end.pdo.entries), MOST_TEXT)
