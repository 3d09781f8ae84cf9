"""`canopen move --dry-run`: the motion on likenesses of the drives, in virtual time: its check, and its first frames."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AsyncExitStack
from dataclasses import replace
from typing import Any

import trio.testing

from canopen_cli.motion.chain_session import ChosenChains, open_chains
from canopen_cli.motion.move_legs import legs_of, show_legs
from canopen_cli.shared.frames_shown import show_frames
from canopen_cli.shared.options import Settings
from canopen_cli.shared.rehearsal import Frames, Likeness, likeness_of, prepare
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen
from canopen_data.path_file import PathFile
from canopen_master.simulation.serving import simulated_devices
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import SYNC
from canopen_proto.machine import NEVER
from canopen_transports.tracing import recording


def rehearse_move(
    settings: Settings,
    screen: Screen,
    chosen: ChosenChains,
    targets: dict[str, float] | None,
    path: PathFile | None,
    override: float,
) -> None:
    """Read the drives, move simulated ones like them, and show the check and the first cycle. Raises what the motion raises."""
    likenesses: dict[str, list[Likeness]] = {}
    dictionaries: dict[tuple[str, int], ObjectDictionary] = {}

    async def look() -> None:
        async with open_chains(settings, chosen) as (master, arm):
            buses = {device.node: chosen.node_of(device.name).bus for device in arm.devices}  # each node once
            for node, bus in buses.items():
                dictionaries[bus, node.node_id] = node.dictionary
                likenesses.setdefault(bus, []).append(await master.run(likeness_of(node)))

    run(settings, screen, look)
    locators = {bus: f"virtual:dry-run{number}" for number, bus in enumerate(chosen.machine.buses)}
    apart = replace(settings, trace=None, clock=trio.testing.MockClock(autojump_threshold=0))
    elsewhere = replace(chosen, buses=locators, is_simulated=False)
    frames = Frames()

    async def perform() -> None:
        async with AsyncExitStack() as stack:
            await _simulate(stack, locators, likenesses)
            _, arm = await stack.enter_async_context(open_chains(apart, elsewhere))
            await arm.initialise()
            await arm.moving.follow()
            legs = await legs_of(arm, targets, path)
            await show_legs(screen, arm, legs)
            arm.moving.override = override
            frames.records.clear()
            for _, leg in legs:
                await arm.moving.follow(leg)

    with recording(frames) as trace:
        run(apart, screen, perform)
        names = {trace.channel_of(locator): bus for bus, locator in locators.items()}
    sent = [record._replace(channel=names[record.channel]) for record in frames.records if record.sent]
    # The set-points of the first cycle are sent behind the SYNC after it; SYNC goes to all buses at one instant
    begin, end = (*sorted({record.time for record in sent if record.frame.can_id == SYNC})[1:3], NEVER, NEVER)[:2]
    first = [record for record in sent if begin <= record.time < end]
    show_frames(settings, screen, first, lambda bus, node_id: dictionaries.get((bus, node_id)))
    screen.say("nothing of this was sent: simulated drives with the values of yours have moved. Yours may answer otherwise")


async def _simulate(stack: AsyncExitStack, locators: Mapping[str, str], likenesses: Mapping[str, list[Likeness]]) -> None:
    for bus, drives in likenesses.items():
        makers: dict[str, Any] = {locators[bus]: [each.make for each in drives]}
        prepare(await stack.enter_async_context(simulated_devices(makers)), drives)
