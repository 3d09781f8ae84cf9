"""Simulated arms on one or two buses that move along paths, and the record of what their drives did.

A unit of a joint is a million counts, so that rounding does not disturb speed, acceleration and jerk computed from positions.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from itertools import pairwise

from canopen_master import AxisSettings, Chain, ChainSettings, Host, Master, open_master, standard_drives
from canopen_master.simulation.host import DeviceMaker
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.trajectory import JointLimits, Path, Segment
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from canopen_transports import open_transport
from tests.master.loops import loop
from tests.master.world import drives, simulated

COUNTS = 1e6
CYCLE = 0.01
AXIS = AxisSettings(counts_per_unit=COUNTS, max_speed=1.0, max_acceleration=4.0, max_jerk=40.0)
LIMITS = JointLimits(speed=1.0, acceleration=4.0, jerk=40.0)
DRIVE = DriveSettings(position=0.0, track=Track(negative_limit=-math.inf, positive_limit=math.inf), lag=0)
RAMPS = {0x6065_00: 100_000, 0x6085_00: 10_000_000, 0x6084_00: 10_000_000}
OPTIONS = {0x605D_00: 1}
"""A drive that may be 0.1 units off, and stops by itself within 0.05 s from full speed: at 10 units per second²."""


class Record:
    """The motion of the drives: their positions (demanded) at each SYNC, in units of so many counts; a column for each joint.

    times: of the SYNCs.
    """

    def __init__(self, hosts: Sequence[Host], counts: float = COUNTS) -> None:
        self.hosts = hosts
        self.counts = counts
        self.times: list[float] = []
        self.rows: list[list[float]] = []

    def take(self) -> None:
        self.times.append(loop.current_time())
        self.rows.append([position / self.counts for host in self.hosts for position in demands(host)])

    def derivatives(self, order: int) -> list[list[float]]:
        """The differences of this order over one cycle each, a row for each time."""
        rows = self.rows
        for _ in range(order):
            rows = [[(b - a) / CYCLE for a, b in zip(before, after, strict=True)] for before, after in pairwise(rows)]
        return rows

    def largest(self, order: int) -> float:
        return max((abs(value) for row in self.derivatives(order) for value in row), default=0.0)


def demands(host: Host) -> list[float]:
    """Where the drives want to be now, in counts."""
    positions = []
    for node in drives(host):
        node.drive.refresh(host.now())
        positions.append(node.drive._servo.demand_position)
    return positions


@asynccontextmanager
async def arms(
    *joints: int,
    axis: AxisSettings | Mapping[str, AxisSettings] = AXIS,
    counts: float = COUNTS,
    drive: DriveSettings = DRIVE,
    mode: Mode = Mode.INTERPOLATED_POSITION,
    settings: ChainSettings | None = None,
    makers: Callable[..., list[DeviceMaker]] = standard_drives,
) -> AsyncIterator[tuple[Master, list[Chain], Record]]:
    """A chain of so many joints on each bus, initialised; and the record, which goes on as long as the block.

    axis: of all joints, or of each one by its name: "j01" is node 1 on the bus 0. counts: of a unit.
    """
    dictionary = drive_dictionary()
    async with AsyncExitStack() as stack:
        buses = {f"can{number}": f"virtual:bus{number}" for number in range(len(joints))}
        hosts = []
        for count, bus in zip(joints, buses.values(), strict=True):
            host = await stack.enter_async_context(simulated(bus=bus, makers=makers(*range(1, count + 1), settings=drive)))
            for node in drives(host):
                node.values.store.update({mux: round(value * counts / COUNTS) for mux, value in RAMPS.items()} | OPTIONS)
            hosts.append(host)
        record = Record(hosts, counts)
        spy = await open_transport("virtual:bus0")
        nursery = await stack.enter_async_context(loop.open_nursery())

        async def listen() -> None:
            while True:
                frame, _ = await spy.receive()
                if frame.can_id == 0x80:
                    record.take()

        nursery.start_soon(listen)
        stack.callback(nursery.cancel_scope.cancel)
        master = await stack.enter_async_context(open_master(buses=buses, dictionary=dictionary))
        chains = []
        for number, (count, bus) in enumerate(zip(joints, buses, strict=True)):
            text = f"arm{number} " + " ".join(f"j{number}{node} {bus} {node}" for node in range(1, count + 1))
            chosen = settings or ChainSettings(cycle_time=CYCLE, own_pdos=True, mode=mode)
            chains.append(master.load_chains(text=text, settings=chosen, axes=axis)[f"arm{number}"])
        for chain in chains:
            await chain.initialise()
        yield master, chains, record


def swing(*ways: float, duration: float = 2.0) -> Path:
    """A path from 0 that goes each of these ways and rests at its end: the smoothest polynomial of degree 5."""
    t = duration
    return Path([[Segment(t, (0.0, 0.0, 0.0, 10 * way / t**3, -15 * way / t**4, 6 * way / t**5))] for way in ways])
