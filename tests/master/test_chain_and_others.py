"""A chain in motion, and somebody else who speaks to one of its drives: all joints stand in the end, and the error says why.

The other program is a service tool, or a second one of ours. It speaks once the joints move.
"""

from __future__ import annotations

import random
from typing import Final

import pytest

from canopen_master import Chain, ChainError, open_master
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_transports import open_transport
from tests.examples import takes_all
from tests.loops import loop
from tests.master.path_world import arms
from tests.master.world import assert_all_stand, drives, virtual_time

DISABLES: Final = {f"commands 0x{word:02X}": [f"601#2B406000{word:02X}000000"] for word in (0x00, 0x02, 0x06, 0x07)}
OTHERS: Final = {
    **DISABLES,
    "commands a halt": ["601#2B4060000F010000"],
    "selects pv": ["601#2F60600003000000"],
    "reads": ["601#4041600000000000"],
    "aborts": ["601#8040600000000405"],
    "sends SYNC": ["080#"],
    "sends SYNC three times": ["080#"] * 3,
    "sends pre-operational": ["000#8001"],
    "resets the node": ["000#8101"],
    "is of ours, too, and disables the drive": [],
}
NAMED: Final = (*DISABLES, "commands a halt", "selects pv")
STOPS: Final = (*DISABLES, "resets the node", "is of ours, too, and disables the drive")


async def move(arm: Chain) -> None:
    await arm.move([1.0, -1.0])


async def jog(arm: Chain) -> None:
    async with arm.jog() as jog:
        for _ in range(30):
            jog.velocity([0.5, -0.5])
            await loop.sleep(0.05)


MOTIONS: Final = {"move": move, "jog": jog}


async def disturbed(motion: str, kind: str, after: float) -> list[str]:
    """Run a motion with one disturbance; return what must never happen."""
    async with arms(2) as (_, [arm], record):
        (host,) = record.hosts
        device = drives(host)[0]
        line = await open_transport("virtual:bus0")
        error = ""

        async def speak() -> None:
            await loop.sleep(after)
            for each in OTHERS[kind]:
                await line.send(Frame.parse(each))
            if not OTHERS[kind]:
                async with open_master("virtual:bus0") as other:
                    await other.run(drive.shut_down(other.device(other.node(1, dictionary=drive_dictionary()), "j").axis))

        async with loop.open_nursery() as nursery:
            nursery.start_soon(speak)
            try:
                await MOTIONS[motion](arm)
            except ChainError as failed:
                error = str(failed)
        await loop.sleep(1)
        await assert_all_stand(host)
        await line.aclose()
        found = []
        if kind in STOPS and device.drive.state is State.OPERATION_ENABLED:
            found.append(f"it is enabled again: {error}")
        if kind in NAMED and "another master" not in error:
            found.append(f"the error does not name the other master: {error}")
        return [f"{motion}, {kind} after {after}: {each}" for each in found]


@pytest.mark.parametrize("motion", MOTIONS)
def test_whoever_speaks_to_a_joint_the_chain_stands_and_the_error_names_him(motion: str) -> None:
    draws = random.Random(motion)
    found: list[str] = []

    @virtual_time
    async def run() -> None:
        for kind in OTHERS if takes_all() else draws.sample(sorted(OTHERS), 6):
            found.extend(await disturbed(motion, kind, draws.uniform(0.2, 1.3)))

    run()
    assert found == []
