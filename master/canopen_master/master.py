"""`Master`: what a user of one or several CAN buses holds: their nodes, the drives on these, and chains of drives.

Made by `open_master` (session.py). A node is (bus, node-ID): the same node-ID may stand on two buses.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from canopen_data import load_dictionary
from canopen_master.motion.device import Device
from canopen_master.motion.halting import Halt, halt_node
from canopen_master.node import Node
from canopen_master.participant.bus import Bus
from canopen_master.participant.participant import Participant
from canopen_master.participant.subscription import Subscription
from canopen_master.seconds import nanoseconds
from canopen_master.watchdog import NodeWatchdog, Watchdogs
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives.axis.axis import Axis, AxisSettings
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, Watchdog
from canopen_proto.machine import Event, LocalProtocolError
from canopen_proto.procedures.steps import all_of
from canopen_proto.remote_node import RemoteNode
from canopen_transports import Transport
from canopen_transports.loop import CancelScope, protected
from canopen_transports.realtime import Measure

if TYPE_CHECKING:
    from canopen_master.machine_file.model import MachineFile
    from canopen_master.motion.chain import Chain, ChainSettings
    from canopen_master.motion.chain_file import ChainDescription
    from canopen_master.motion.member import Member

E = TypeVar("E", bound=Event)

SDO_TIMEOUT = 0.5
"""Seconds that a device may take for each answer."""

_LOOK = 0.01
"""Seconds between two looks, on the way out, whether chains still brake along their paths."""


class Master(Participant):
    """See this module's text. Participant says what it does on its buses.

    devices: the drives by node and axis. chains: those made so far, by name. nodes, joints: those of the machine file, by name.
    machine: that file, as it was read; None without one. halts: once the master was left, the halts of its drives. realtime: what
    the operating system was asked for. Times are in seconds here.
    """

    def __init__(
        self,
        transports: Mapping[str, Transport],
        *,
        aliases: Mapping[str, str] | None = None,
        sdo_timeout: float = SDO_TIMEOUT,
        heartbeat_timeout: float = 0.0,
        dictionary: ObjectDictionary | None = None,
        watchdog: Watchdog | None = DEFAULT_WATCHDOG,
    ) -> None:
        """transports: open ones, by name. aliases: more names for them. For the rest, see `open_master`."""
        super().__init__(transports, aliases)
        self._sdo_timeout = nanoseconds("sdo_timeout", sdo_timeout, above_zero=True)
        self._heartbeat_timeout = nanoseconds("heartbeat_timeout", heartbeat_timeout)
        self._dictionary = dictionary
        self._nodes: dict[tuple[Bus, int], Node] = {}
        self._files: dict[str, ObjectDictionary] = {}
        self.devices: dict[tuple[Node, int], Device] = {}
        self.chains: dict[str, Chain] = {}
        self.nodes: dict[str, Node] = {}
        self.joints: dict[str, Device] = {}
        self.machine: MachineFile | None = None
        self.halts: list[Halt] = []
        self.realtime: tuple[Measure, ...] = ()
        self.watchdogs = Watchdogs(self, watchdog)

    @property
    def dictionary(self) -> ObjectDictionary:
        """The dictionary of nodes that are given none: that of `open_master`, or else that of the data files."""
        if self._dictionary is None:
            self._dictionary, _ = load_dictionary()
        return self._dictionary

    @property
    def dictionaries(self) -> tuple[ObjectDictionary, ...]:
        """The dictionaries at hand: that of nodes that are given none, then those of all nodes so far, each once."""
        found = {id(each): each for each in (self.dictionary, *(node.dictionary for node in self._nodes.values()))}
        return tuple(found.values())

    @protected
    def node(
        self,
        node_id: int,
        dictionary: ObjectDictionary | str | Path | None = None,
        *,
        bus: str | None = None,
        pdos: bool | None = None,
    ) -> Node:
        """Return the node with this ID on a bus; the same object each time.

        dictionary: the path of the device's EDS, DCF, XDD or XDC file, or a sample's name, or a dictionary; None = that of the
        data files. pdos: exchange the node's PDOs; None = if `dictionary` is a file. The device is asked for its PDO settings,
        and PdoReceived follows; see `Node.start` and node_pdos.py. Without PDOs nothing is sent.

        Raises LocalProtocolError for an ID outside 1..127, for no bus name if there are several buses, and for another dictionary
        than the first time; DataError, DictionaryError for a file that cannot be read.
        """
        self.check_open()
        where = self.bus(bus)
        if has_file := isinstance(dictionary, str | Path):
            if str(dictionary) not in self._files:
                from canopen_data.descriptions import load_description_with_names

                self._files[str(dictionary)] = load_description_with_names(dictionary).dictionary
            dictionary = self._files[str(dictionary)]
        if dictionary is not None and not isinstance(dictionary, ObjectDictionary):
            raise LocalProtocolError(f"dictionary {dictionary!r} is none; give the path of a file, or an ObjectDictionary")
        known = self._nodes.get((where, node_id))
        if known is not None:
            if dictionary is not None and dictionary is not known.dictionary:
                has, wanted = (each.source or "a dictionary of the program" for each in (known.dictionary, dictionary))
                failed = f"node {node_id} on {where.name} is in use with another dictionary: {has}"
                yours = "yours" if has == wanted else wanted
                raise LocalProtocolError(f"{failed}; give {yours} at the first call of `node`, and none at later ones")
            return known
        remote = RemoteNode(
            where.network.out,
            node_id,
            self.dictionary if dictionary is None else dictionary,
            sdo_timeout=self._sdo_timeout,
            heartbeat_timeout=self._heartbeat_timeout,
        )
        where.network.attach(remote)
        node = self._nodes[where, node_id] = Node(self, where, remote, self.watchdogs)
        where.renew_filters()
        if has_file if pdos is None else pdos:
            node.keep_pdos()
        return node

    @protected
    def device(self, node: Node, name: str = "", settings: AxisSettings | None = None, *, axis: int = 0) -> Device:
        """Return the drive on a node; the same object each time. If it is enabled when the master is left, it is halted.

        name: for people, by default "node 12". axis: 0..7, of a node with several drives: the objects of axis k are those
        of the first one plus k * 0x800; its dictionary must have them. settings: units and habits of the drive; by
        default those of CiA 402, or those of Schunk's joints if the vendor-ID is Schunk's. Sends nothing. Raises
        LocalProtocolError if the drive is in use with other settings (it names the differences), for a node that is no drive by
        its dictionary, and for an axis that the dictionary does not have.
        """
        if not isinstance(node, Node):
            raise LocalProtocolError(f"node {node!r} is no node of this master; give one, as master.node(3)")
        device = self.devices.get((node, axis))
        if device is None:
            drive = Axis(node.remote, AxisSettings() if settings is None else settings, axis)
            drive.watchdog = NodeWatchdog(self.watchdogs, node, axis)
            device = self.devices[node, axis] = Device(name, node, drive)
        else:
            if settings is not None:
                device.axis.check_settings(settings)
            device.name = name
        return device

    def chain(
        self,
        description: ChainDescription,
        settings: ChainSettings | None = None,
        *,
        axes: AxisSettings | Mapping[str, AxisSettings] | None = None,
        dictionary: ObjectDictionary | None = None,
    ) -> Chain:
        """Make the chain of a description. axes: the settings of all joints, or by joint; by default as in `device`.

        Raises UnknownChainError if the description names a bus that this master does not have, LocalProtocolError for a drive
        that is in use with other settings, and for a name that another chain has.
        """
        from canopen_master.motion.chain import Chain, ChainSettings  # only here: most commands read, and move nothing

        if description.name in self.chains:
            raise LocalProtocolError(f"this master has a chain {description.name!r} already")
        devices = []
        for joint in description.joints:
            axis = axes.get(joint.name) if isinstance(axes, Mapping) else axes
            node = self.node(joint.node_id, dictionary, bus=joint.bus)
            devices.append(self.device(node, joint.name, axis, axis=joint.axis))
        settings = ChainSettings() if settings is None else settings
        chain = Chain(self, description.name, devices, settings, self._heartbeat_timeout, self.chains.values())
        self.chains[chain.name] = chain
        return chain

    def load_chains(
        self,
        path: str | Path = "",
        *,
        text: str | None = None,
        settings: ChainSettings | None = None,
        axes: AxisSettings | Mapping[str, AxisSettings] | None = None,
        dictionary: ObjectDictionary | None = None,
    ) -> dict[str, Chain]:
        """Make the chains of a file (see chain_file.py), or of a text in that form, by their names. Sends nothing. path: of the
        file, or the name of one of the data files. axes: the settings of all joints, or by their names. settings, dictionary: as
        of `chain`.

        A bus that the file names must be one of this master. If both have only one bus, its name does not matter. Raises
        ChainFileError with every problem found, DataError if the file cannot be read.
        """
        from canopen_master.motion.chain_file import on_buses, parse_chains, read_chains

        if text is None and not path:
            raise LocalProtocolError("load_chains: chains of which file? Give its path, or the chains as `text`")
        chains = read_chains(path) if text is None else parse_chains(text)
        placed = on_buses(chains, {name: bus.name for name, bus in self.buses.items()})
        return {each.name: self.chain(each, settings, axes=axes, dictionary=dictionary) for each in placed}

    @protected
    def events(self, *kinds: type[E], node: Node | None = None, bus: str | None = None) -> Subscription[E]:
        """Return an async iterator over all events of these kinds from now on: `with master.events(HeartbeatLost) as events:
        ...`.

        node, bus: only events of this one. The queue is bounded: see Subscription. `Event` as a kind means all.
        """
        return node.events(*kinds) if node is not None else self.subscribe(kinds, None if bus is None else self.bus(bus))

    @protected
    async def halt_and_flush(self, scope: CancelScope, longest: float, in_a_hurry: Callable[[], bool]) -> None:
        """Take no new commands, end everything that runs, halt all drives that are enabled, and send what is queued.

        scope, longest, in_a_hurry: see `finish`. Afterwards `halts` tells which drives did not confirm that they stand. May be
        cancelled: what was sent stays sent.
        """
        await self._brake_along_paths(scope, in_a_hurry)
        self.end_all()
        self.halts.extend(self._halts_needed())
        halted: dict[Node, list[Halt]] = defaultdict(list)
        for halt in self.halts:
            halted[halt.node].append(halt)
        disabled = [node for node in self.watchdogs.drives_held() if node not in halted and not node.bus_has_failed]
        halts = (halt_node(each, self.watchdogs) for node, each in halted.items() if not node.bus_has_failed)
        self.launch(all_of(*halts, *map(self.watchdogs.let_go, disabled)))
        await self.finish(scope, longest, in_a_hurry)

    async def _brake_along_paths(self, scope: CancelScope, in_a_hurry: Callable[[], bool]) -> None:
        """Let chains that move along a path come to rest on it first, unless somebody is in a hurry. No command comes between.

        Drives that no chain leads are halted meanwhile. Those of a chain that follows set-points have got their last one.
        """
        self.is_closed = True
        if not self.chains:
            return
        from canopen_master.motion.member import LEADING  # imported long ago, as a chain was made
        from canopen_master.motion.path_motion import LONGEST_STOP

        if self._brakes_along_paths():
            led = [device for chain in self.chains.values() if chain.state in LEADING for device in chain.devices]
            others = (each for each in self._halts_needed() if each.device not in led and not each.node.bus_has_failed)
            self.launch(all_of(*(each.run() for each in others)))
        left, end = scope.deadline - self._loop.current_time(), self._loop.current_time() + LONGEST_STOP
        scope.deadline += LONGEST_STOP
        while self.failure is None and self._brakes_along_paths():
            if in_a_hurry() or self._loop.current_time() > end:
                break
            await self._loop.sleep(_LOOK)
        scope.deadline = self._loop.current_time() + left
        self._abandon_motions()

    def _brakes_along_paths(self) -> bool:
        """Let all chains brake along their paths; return whether one of them does."""
        return True in [member.brake_along_path() for member in self._members()]

    def on_failure(self, bus: Bus | None, error: Exception) -> None:
        """See Participant. Motions end at once: what moves on that bus cannot be told to brake."""
        super().on_failure(bus, error)
        self._abandon_motions()

    def _abandon_motions(self) -> None:
        for member in self._members():
            member.abandon()

    def _members(self) -> Iterator[Member]:
        for chain in self.chains.values():
            yield from chain.members

    def _halts_needed(self) -> Iterator[Halt]:
        """Return the halts of all drives that move, or that a command under way may enable, even if enabled by hand."""
        for node in self._nodes.values():
            for axis in sorted({*node.axes, *node.axes_enabled}):
                was_enabled = node.was_axis_enabled(axis)
                try:
                    device = self.device(node, axis=axis) if was_enabled else self.devices.get((node, axis))
                except LocalProtocolError:  # its dictionary has none of what a drive has
                    device = None
                if was_enabled or (device is not None and (device.may_move or device.may_be_enabled)):
                    yield Halt(node, device)
