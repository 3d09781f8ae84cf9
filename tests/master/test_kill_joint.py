"""A joint that dies stops its chain, in every mode of chains: the others stand within a named detection time and their ramp.

How the motion of the dead joint itself ends stands in tests/drives/test_kill_table.py.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from canopen_master import ChainFaultError
from canopen_proto.drives.cia402.states import State
from canopen_proto.nmt import NmtCommand
from tests.drives.drive_dictionaries import changed, empty_pdos, supports
from tests.loops import loop
from tests.master.cell import Joint, homed_arm
from tests.master.world import virtual_time

CYCLE = 0.04  # seconds, of homed_arm
SPEED = 0.01 / CYCLE * 180_000 / 3.14159  # counts per second
SILENCE = 3 * CYCLE
"""Missing PDOs after which a joint is lost (docs/limits.md)."""
TOLD = 0.0
"""An EMCY or a boot-up tells it."""
COMMAND = 2 * CYCLE
"""Until a halt by a synchronous PDO acts: it leaves behind a SYNC, and the drive takes it at the next one."""
PHASE = CYCLE
SLOW_DOWN = 100_000  # 0x6084 of the simulated drive
RAMP = SPEED / SLOW_DOWN


def cut_power(joint: Joint) -> None:
    joint._power.cancel()


def raise_fault(joint: Joint) -> None:
    joint.node.raise_fault(0x3210, joint.host.now())
    joint.host.pump()


def reset(joint: Joint) -> None:
    joint.node.execute(NmtCommand.RESET_NODE, joint.host.now())
    joint.host.pump()


KILLS: dict[str, tuple[Callable[[Joint], None], float]] = {
    "power": (cut_power, SILENCE),
    "cable": (Joint.pull_cable, SILENCE),
    "reset": (reset, TOLD),
    "fault": (raise_fault, TOLD),
}


def speed_of(joint: Joint) -> float:
    joint.node.drive.refresh(joint.host.now())
    return abs(joint.node.drive._servo.demand_velocity)


@pytest.mark.thorough(6)
@pytest.mark.parametrize("name", KILLS)
@pytest.mark.parametrize("mode", [8, 7, 1])
@virtual_time
async def test_the_other_joints_stand_within_the_detection_time_and_their_ramp(mode: int, name: str) -> None:
    """In csp, ip, and slowly in pp."""
    kill, detection = KILLS[name]
    async with homed_arm(3, 4, dictionary=changed({**supports(0x20 | 1 << (mode - 1)), **empty_pdos()})) as ((one, two), arm):
        times: list[float] = []

        async def stand() -> None:
            while speed_of(one) >= 1.0:
                await loop.sleep(0.005)
            times.append(loop.current_time())

        async with loop.open_nursery() as nursery:
            start = arm.positions
            with pytest.raises(ChainFaultError, match="joint2"):
                async for cycle in arm.cycles():
                    arm.set_positions([position + 0.01 * cycle.number for position in start])
                    if cycle.number == 20:
                        assert speed_of(one) >= 0.5 * SPEED
                        killed = loop.current_time()
                        kill(two)
                        nursery.start_soon(stand)
        assert times[0] - killed <= detection + PHASE + COMMAND + RAMP + 0.01
        await loop.sleep(2)
        assert speed_of(one) < 1.0
        assert one.state is State.OPERATION_ENABLED
        two.plug_cable()  # a master that is left names a joint that does not answer
        if name == "power":
            await two.switch_on()
