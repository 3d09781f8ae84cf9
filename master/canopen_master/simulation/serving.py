"""Serve simulated drives for `canopen demo`, `-b demo` and `canopen sim`.

They run shielded until its block is left: on a Ctrl-C the master still has to halt the drives, and simulated ones must stay
alive meanwhile, as real ones would.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager
from functools import lru_cache, partial
from typing import Final

from canopen_data.configured import configure
from canopen_data.drive_from_file import drive_dictionary_of
from canopen_master.simulation.host import IN_PROCESS, DeviceMaker, Host
from canopen_master.simulation.parameter_keeper import ParameterKeeper
from canopen_proto import indices
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.cia402.objects import VELOCITY_ACTUAL_VALUE
from canopen_proto.lss.messages import UNCONFIGURED
from canopen_proto.machine import Event, LocalProtocolError, Time
from canopen_proto.multiplexer import mux
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from canopen_transports import Transport, open_transport
from canopen_transports.loop import CancelScope, Nursery, TaskStatus, current_loop
from canopen_transports.loop.beside import beside
from canopen_transports.tracing import for_devices

DEMO_LOCATOR: Final = "virtual:demo"
DEMO_NODES: Final = tuple(range(3, 9))
"""The joints of the installed multiple_devices.csv."""
HEARTBEAT_MS: Final = 500
"""Simulated drives send a heartbeat, so that a scan hears them and their NMT state is known."""
BOOT_TIME: Final = 0.05
"""Seconds from power-on until the boot-up frames are sent: an earlier request would be lost, as with a real drive."""

SERIAL: Final = 4
"""The subindex of the serial number in 0x1018."""

# The joints' positions at power-on, in counts (millidegrees). They differ, so that homing is worth watching.
_POSITIONS: Final = (-14_000, 9_000, 21_000, -7_000, 16_000, -22_000)
_TRACK: Final = Track(home_switch=(0.0, math.inf))
"""The home switch is active from the middle to the positive end, as homing method 19 expects."""


@lru_cache(maxsize=128)
def _dictionary(shape: Shape, serial: int, node_id: int) -> ObjectDictionary:
    """Return the dictionary of a drive that has none of its own."""
    beats = standard_object(indices.PRODUCER_HEARTBEAT_TIME, HEARTBEAT_MS)
    return with_serial(drive_dictionary(shape).with_objects([beats]), serial, node_id)


def drive_maker(
    number: int,
    node_id: int,
    shape: Shape = Shape.SCHUNK_POWERBALL,
    dictionary: ObjectDictionary | None = None,
    sync_tolerance: Time = IN_PROCESS,
) -> DeviceMaker:
    """Return a function that makes a simulated drive.

    number: its place among them, from 0. dictionary: that of a device's own file, for which `drive_obstacle` finds no obstacle;
    by default that of the shape. sync_tolerance: see DriveSettings. The time of a drive in the process of its master waits for
    SYNC: else it would run beyond its path while this computer is busy.
    """
    is_own = dictionary is None
    if dictionary is None:
        dictionary = _dictionary(shape, number + 1, node_id)
    else:
        dictionary, _ = drive_dictionary_of(dictionary, shape)
    position = _POSITIONS[number % len(_POSITIONS)]
    settings = DriveSettings(
        shape=shape,
        position=position,
        track=_TRACK,
        stops_at_switches=is_own,
        sync_tolerance=sync_tolerance,
        waits_for_sync=sync_tolerance == IN_PROCESS,
    )
    return partial(DriveNode, node_id=node_id, settings=settings, dictionary=dictionary)


def virtual_buses(names: Iterable[str]) -> dict[str, str]:
    """Return a virtual bus in the place of each of these buses: its locator by the name. The first one is DEMO_LOCATOR."""
    return {name: f"{DEMO_LOCATOR}{number or ''}" for number, name in enumerate(names)}


def with_serial(dictionary: ObjectDictionary, serial: int, node_id: int) -> ObjectDictionary:
    """Return the dictionary with a serial number (0x1018:04), if it has that object: LSS tells devices apart by it."""
    if dictionary.get(indices.IDENTITY_OBJECT, SERIAL) is None:
        return dictionary
    return configure(dictionary, {mux(indices.IDENTITY_OBJECT, SERIAL): serial}, node_id)


class SimulatedDevices:
    """A set of simulated drives. hosts: one for each bus."""

    def __init__(self, hosts: Sequence[Host]) -> None:
        self.hosts = tuple(hosts)

    @property
    def drives(self) -> dict[int, DriveNode]:
        """The drives by node-ID; the first one if two buses have the same node-ID."""
        return {node.node_id: node for host in reversed(self.hosts) for node in host.nodes if isinstance(node, DriveNode)}

    @property
    def node_ids(self) -> list[int]:
        """The node-IDs of all devices."""
        return sorted({node.node_id for host in self.hosts for node in host.nodes})

    def raise_fault(self, node_id: int, error_code: int) -> None:
        """Let a drive break down. Raises KeyError if no drive has that node-ID. error_code: 0x603F and EMCY then have it."""
        self.change(node_id, lambda drive, now: drive.raise_fault(error_code, now))

    def change(self, node_id: int, change: Callable[[DriveNode, Time], object]) -> None:
        """Let something happen to a drive. Raises KeyError if no drive has that node-ID. change: called with the drive and the
        time, ns."""
        drive = self.drives[node_id]
        for host in self.hosts:
            if drive in host.nodes:
                change(drive, host.now())
                host.pump()

    @property
    def moving(self) -> list[int]:
        """The node-IDs of the drives that really move, whatever they report on the bus."""
        moving = []
        for host in self.hosts:
            for node in host.nodes:
                if isinstance(node, DriveNode):
                    node.drive.refresh(host.now())
                    if node.values[VELOCITY_ACTUAL_VALUE]:
                        moving.append(node.node_id)
        return moving


@asynccontextmanager
async def simulated_drives(
    drives: Iterable[tuple[str, int]],
    shape: Shape = Shape.SCHUNK_POWERBALL,
    on_event: Callable[[Event], object] | None = None,
    *,
    make: Callable[[int, int], DeviceMaker] | None = None,
    keeper: ParameterKeeper | None = None,
) -> AsyncIterator[SimulatedDevices]:
    """Serve drives, each given as (locator, node-ID), while the block runs. Raises BusError, TransportError.

    keeper: as of `Host`. make: returns the maker of the drive for a place and a node-ID; by default drives of that shape.

    on_event: called with each event of the drives.
    """
    make = partial(drive_maker, shape=shape) if make is None else make
    makers: dict[str, list[DeviceMaker]] = {}
    places: set[tuple[str, int]] = set()
    for number, (locator, node_id) in enumerate(_pairs(drives)):
        if (locator, node_id) not in places or node_id == UNCONFIGURED:  # further axes are in the node of the first one
            places.add((locator, node_id))
            makers.setdefault(locator, []).append(make(number, node_id))
    async with simulated_devices(makers, on_event, keeper=keeper) as served:
        yield served


@asynccontextmanager
async def simulated_devices(
    makers: Mapping[str, Sequence[DeviceMaker]],
    on_event: Callable[[Event], object] | None = None,
    *,
    keeper: ParameterKeeper | None = None,
    say: Callable[[str], object] = lambda text: None,
) -> AsyncIterator[SimulatedDevices]:
    """Serve devices, by locator, while the block runs. keeper, say: as of `Host`. on_event: called with each event of the
    devices.

    Raises BusError, TransportError, ScriptError; LocalProtocolError for what is no locator, or makes no device, and for two
    devices of one bus that have one node-ID.
    """
    _check_makers(makers)

    def host_on(transport: Transport, each: Sequence[DeviceMaker]) -> Host:
        return Host(transport, each, on_event, keeper=keeper, say=say)

    async with beside(current_loop().open_nursery()) as nursery:
        serving = current_loop().cancel_scope()
        hosts = await _begun(nursery, makers, host_on, serving)
        serving.shield = True  # only from now on: a start that is cancelled waits for its tasks, which must end then
        try:
            await current_loop().sleep(BOOT_TIME)
            yield SimulatedDevices(hosts)
        finally:
            serving.cancel()


def _pairs(drives: Iterable[tuple[str, int]]) -> list[tuple[str, int]]:
    try:
        return [(locator, node_id) for locator, node_id in drives]
    except (TypeError, ValueError):
        raise LocalProtocolError(f'drives {drives!r}: give pairs of a locator and a node-ID, as [("virtual:demo", 3)]') from None


def _check_makers(makers: Mapping[str, Sequence[DeviceMaker]]) -> None:
    form = 'give the devices of each locator, as {"virtual:demo": [DeviceModel(dictionary, 5)]}'
    if not isinstance(makers, Mapping):
        raise LocalProtocolError(f"makers {makers!r}: {form}")
    for locator, each in makers.items():
        if not isinstance(locator, str):
            raise LocalProtocolError(f'locator {locator!r} is no text; give one as "virtual:demo"')
        if not isinstance(each, Sequence):
            raise LocalProtocolError(f"the devices of {locator} are no list: {each!r}; {form}")
        for make in each:
            if not callable(make):
                raise LocalProtocolError(f"{locator}: {make!r} makes no device; {form}")


async def _begun(
    nursery: Nursery,
    makers: Mapping[str, Sequence[DeviceMaker]],
    host_on: Callable[[Transport, Sequence[DeviceMaker]], Host],
    scope: CancelScope,
) -> list[Host]:
    """Begin to serve. Raises the one error that prevents it, and no group of the nurseries of `_serve`."""
    failure: BaseException
    try:
        hosts: list[Host] = await nursery.start(_serve, makers, host_on, scope)
    except ExceptionGroup as group:
        failure = group
    else:
        return hosts
    while isinstance(failure, ExceptionGroup) and len(failure.exceptions) == 1:
        failure = failure.exceptions[0]
    raise failure  # outside of the handler: the group would be its context


async def _serve(
    makers: Mapping[str, Sequence[DeviceMaker]],
    host_on: Callable[[Transport, Sequence[DeviceMaker]], Host],
    scope: CancelScope,
    task_status: TaskStatus[list[Host]],
) -> None:
    hosts: list[Host] = []
    with scope:
        async with current_loop().open_nursery() as nursery:
            for locator, each in makers.items():
                with for_devices():
                    transport = await open_transport(locator)
                hosts.append(await nursery.start(_serve_on, transport, each, host_on))
            task_status.started(hosts)


async def _serve_on(
    transport: Transport,
    makers: Sequence[DeviceMaker],
    host_on: Callable[[Transport, Sequence[DeviceMaker]], Host],
    task_status: TaskStatus[Host],
) -> None:
    try:
        await host_on(transport, makers).serve(task_status)
    finally:
        with current_loop().cancel_scope(shield=True):
            await transport.aclose()
