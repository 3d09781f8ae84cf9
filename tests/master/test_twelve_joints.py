"""12 joints at 4 ms on one bus of 1 Mbit/s, with bit times and arbitration: a path of a minute, and what it needs of the bus.

Every day the path takes 2 s; with `--hypothesis-profile=full`, a minute.
"""

from __future__ import annotations

import math

import pytest

from canopen_master import ChainSettings, open_master, standard_drives
from canopen_master.bus_timing import OtherTraffic, bus_timing
from canopen_master.exchanges import exchange_of_plans
from canopen_proto.drives.trajectory import from_function
from canopen_proto.frame_bits import least_bits, worst_bits
from canopen_proto.machine import SECOND
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from canopen_transports import WireTransport
from tests.examples import takes_all
from tests.loops import loop
from tests.master.path_world import AXIS, COUNTS, RAMPS
from tests.master.world import drives, simulated, virtual_time

JOINTS = 12
CYCLE = 0.004
BITRATE = 1_000_000
LAG = 0.005
"""Seconds: the time constant with which the simulated joints follow their demand."""
DRIVE = DriveSettings(position=0.0, track=Track(negative_limit=-math.inf, positive_limit=math.inf), lag=round(LAG * SECOND))
BACKGROUND = OtherTraffic(heartbeat=0, sdo=0, emcy=0)
"""While the joints move there is nothing but the cycle, and the heartbeat of the master each 100 ms."""


@pytest.mark.timeout(1200)  # with all examples it is a minute of 15,000 cycles, each of 25 frames
def test_twelve_joints_follow_a_path_within_the_bound_and_the_bus_has_the_planned_load() -> None:
    """The bounds, by how set-points travel (docs/move-an-arm.md, "What is sent"), for a path whose fastest joint has the speed v.

    The set-point sent behind SYNC n is reached by the drive's demand u at SYNC n + 2, in a straight line, so |u'| <= v. The axis
    y follows with a time constant: y' = (u - y) / LAG. So e = u - y has e' + e / LAG = u', from rest e(t) is u' weighted by
    exp(-(t - s) / LAG), and |e| <= LAG v: that is the following error of a chain, which compares values of one instant. Two
    roundings to counts come on top, one of the set-point and one of the position. At a speed that changes slowly it is reached.

    What a program sees is later: the set-points that the next SYNC takes along (n + 1) and the last position heard (sampled at
    SYNC n - 1, where the demand was at the set-point sent behind SYNC n - 3) are four cycles apart, so |s - y| <= v (4 CYCLE +
    LAG).
    """
    duration = 60.0 if takes_all() else 2.0

    def positions(time: float) -> list[float]:
        swell = 0.5 * (1 - math.cos(2 * math.pi * time / duration))  # from rest to rest
        return [0.4 * swell * math.sin(0.8 * time + 0.3 * joint) for joint in range(JOINTS)]

    path = from_function(positions, duration, 0.05)
    samples = [path.at(number * CYCLE) for number in range(round(duration / CYCLE) + 1)]
    fastest = max(abs(speed) for sample in samples for speed in sample.velocities)

    @virtual_time
    async def run() -> None:
        bus = "virtual:twelve?bitrate=1M"
        async with (
            simulated(bus=bus, makers=standard_drives(*range(1, JOINTS + 1), settings=DRIVE)) as host,
            open_master(buses={"can0": bus}, dictionary=drive_dictionary()) as master,
        ):
            for node in drives(host):
                node.values.store.update(RAMPS)
            text = "arm " + " ".join(f"j{node} can0 {node}" for node in range(1, JOINTS + 1))
            arm = master.load_chains(text=text, settings=ChainSettings(cycle_time=CYCLE, own_pdos=True), axes=AXIS)["arm"]
            await arm.initialise()
            await arm.follow()
            transport = master.bus().transport
            assert isinstance(transport, WireTransport)
            transport.bus.wire.begin_load(host.now())
            begun, behind = loop.current_time(), 0.0

            async def watch() -> None:
                nonlocal behind
                async for progress in arm.progress():
                    behind = max(behind, *map(abs, map(float.__sub__, progress.set_points, progress.positions)))

            async with loop.open_nursery() as nursery:
                nursery.start_soon(watch)
                await arm.follow(path)
            load, took = transport.bus.load(), loop.current_time() - begun
            assert duration <= took < 1.1 * duration + 0.5
            assert arm.missed_cycles == arm.skipped_cycles == 0
            assert arm.sync_cycles == pytest.approx(took / CYCLE, abs=3)

            rounding = 2 / COUNTS
            furthest = max(joint.largest_following_error for joint in arm.devices)
            assert 0.9 * LAG * fastest < furthest <= LAG * fastest + rounding
            assert 0.5 * 4 * CYCLE * fastest < behind <= (4 * CYCLE + LAG) * fastest + rounding

            plans = [joint.plan for joint in arm.devices if joint.plan is not None]
            exchanges = [exchange_of_plans(f"node {each.node_id}", [each]).exchange for each in plans]
            planned = bus_timing("can0", exchanges, round(CYCLE * SECOND), BITRATE, BACKGROUND)
            heartbeats = worst_bits(1) / (0.1 * BITRATE)
            without_stuff_bits = (least_bits(0) + JOINTS * (least_bits(6) + least_bits(7))) / (CYCLE * BITRATE)
            assert planned.fits
            assert without_stuff_bits < load < planned.load + heartbeats
            print(
                f"\n{JOINTS} joints at {1000 * CYCLE:g} ms for {took:.1f} s: {arm.sync_cycles} cycles, none missed; following"
                f" error {furthest:.6f} of {LAG * fastest:.6f}; behind {behind:.6f} of {(4 * CYCLE + LAG) * fastest:.6f};"
                f" load {load:.1%}, planned {planned.load:.1%} at worst and {planned.simulated_load:.1%} simulated"
            )

    run()
