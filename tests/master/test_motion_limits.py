"""Whatever chains are told, at any moment: no drive exceeds a limit of its joint, and the joints can still be moved afterwards.

Moves, blends, paths, streams of targets, jogs, overrides, pauses, halts and cancellations follow each other at random moments,
for 1 to 12 joints with limits of their own, on one bus or two. The oracle is the simulator's own record: differences of the
positions that the drives had at each SYNC.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from contextlib import suppress
from typing import TypeAlias

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_master import AxisSettings, ChainError, ChainHaltedError, MotionReplacedError, PlanRefusedError, together
from canopen_master.motion.moving import Moving
from canopen_proto.drives.trajectory import Path, Segment
from canopen_transports.loop import CancelScope, Nursery
from tests.examples import examples
from tests.loops import loop
from tests.master.path_world import CYCLE, Record, arms, swing
from tests.master.world import virtual_time

pytest.importorskip("ruckig")

COUNTS = 1e7
FARTHEST = 0.8
"""The position limits, on both sides."""
ROUNDING = (2e-7, 1e-7 / CYCLE, 4e-7 / CYCLE**2, 8e-7 / CYCLE**3)
"""The most that positions in whole counts add to a position and its differences."""

Command: TypeAlias = tuple[str, list[float], float]
"""The command; a value for each joint, -1 to 1, from which its numbers are made; the seconds until the next command."""

KINDS = (*["move"] * 4, "move slowly", *["follow", "stream", "jog", "override"] * 2, "pause", "resume", "halt", "cancel")


def random_limits(rng: random.Random) -> AxisSettings:
    """Return a joint that has its full acceleration within 0.03 to 0.2 s, and with that its full speed within 0.1 to 0.35 s."""
    speed = rng.uniform(0.3, 3.0)
    acceleration = speed / rng.uniform(0.1, 0.35)
    return AxisSettings(
        counts_per_unit=COUNTS,
        min_position=-FARTHEST,
        max_position=FARTHEST,
        max_speed=speed,
        max_acceleration=acceleration,
        max_jerk=acceleration / rng.uniform(0.03, 0.2),
    )


def random_command(rng: random.Random, joints: int) -> Command:
    return rng.choice(KINDS), [rng.uniform(-1.0, 1.0) for _ in range(joints)], rng.choice((1.0, 0.3, 0.02)) * rng.random()


class Script:
    """Gives commands to joints, each as a task of its own."""

    def __init__(self, arm: Moving, nursery: Nursery) -> None:
        self._arm = arm
        self._nursery = nursery
        self._scope = loop.cancel_scope()

    def _path(self, ways: Sequence[float]) -> Path:
        """Return a path from where the joints stand that uses 60 % of a limit. Of each joint, the polynomial of `swing`."""
        here = [position for chain in self._arm.members for position in chain.desired]
        duration = 0.1
        for way, limit in zip(ways, self._arm.path_limits, strict=True):
            assert limit.speed is not None
            assert limit.acceleration is not None
            assert limit.jerk is not None
            most = (1.875 / limit.speed, 5.78 / limit.acceleration, 60.0 / limit.jerk)
            duration = max(duration, *((abs(way) / 0.6 * each) ** (1 / order) for order, each in enumerate(most, start=1)))
        rows = swing(*ways, duration=duration).segments
        return Path([[Segment(duration, (begin, *row[0].coefficients[1:]))] for begin, row in zip(here, rows, strict=True)])

    async def give(self, command: Command) -> None:
        kind, given, seconds = command
        match kind:
            case "override":
                self._arm.override = abs(given[0])
            case "pause":
                self._arm.pause()
            case "resume":
                self._arm.resume()
            case "halt":
                await self._arm.halt()  # type: ignore[attr-defined]  # of a chain, and of several together
                await self._arm.follow()
            case "cancel":
                self._scope.cancel()
            case _:
                self._scope = loop.cancel_scope()
                self._nursery.start_soon(self._move, kind, given, seconds, self._scope)
        await loop.sleep(seconds)

    async def _move(self, kind: str, given: Sequence[float], seconds: float, scope: CancelScope) -> None:
        """End with what a motion may end with: another one, a halt, a blend that has no room."""
        with scope, suppress(MotionReplacedError, ChainHaltedError, PlanRefusedError):
            if kind == "stream":
                async with self._arm.stream() as targets:
                    for part in (0.6, -0.4, 0.9):
                        targets.aim_at(scaled(given, part * FARTHEST))
                        await loop.sleep(seconds / 2)
            elif kind == "jog":
                async with self._arm.jog() as jog:
                    for part in (1.0, -0.3, 2.0):
                        jog.velocity(scaled(given, part))
                        await loop.sleep(seconds / 2)  # 0.2 s are too long for its dead man's switch
            elif kind == "follow":
                with suppress(ChainError):  # the joints move already
                    await self._arm.follow(self._path(scaled(given, 0.3)))
            else:
                await self._arm.move(scaled(given, 0.95 * FARTHEST), speed=0.3 if kind == "move slowly" else 1.0)


def scaled(values: Sequence[float], factor: float) -> list[float]:
    return [factor * value for value in values]


def assert_within(record: Record, axes: Sequence[AxisSettings]) -> None:
    for order in range(4):
        rows = record.derivatives(order)
        for joint, axis in enumerate(axes):
            limit = (axis.max_position, axis.max_speed, axis.max_acceleration, axis.max_jerk)[order]
            assert limit is not None
            largest = max(abs(row[joint]) for row in rows)
            assert largest <= limit * (1 + 1e-6) + ROUNDING[order], (joint, order, largest / limit)


@examples(60, least=3, part=20)
@given(st.integers(0, 100_000))
def test_no_motion_exceeds_a_limit_whatever_comes(seed: int) -> None:
    rng = random.Random(seed)
    on_buses = rng.choice(([rng.randint(1, 12)], [rng.randint(1, 6), rng.randint(1, 6)]))
    names = [f"j{bus}{node}" for bus, count in enumerate(on_buses) for node in range(1, count + 1)]
    axes = {name: random_limits(rng) for name in names}
    script = [random_command(rng, len(names)) for _ in range(rng.randint(3, 10))]

    @virtual_time
    async def run() -> None:
        async with arms(*on_buses, axis=axes, counts=COUNTS) as (_, chains, record):
            arm = chains[0] if len(chains) == 1 else together(*chains)
            await arm.follow()
            async with loop.open_nursery() as nursery:
                player = Script(arm, nursery)
                for command in script:
                    await player.give(command)
                nursery.cancel_scope.cancel()
            arm.override = 1.0
            goal = [rng.uniform(-0.7, 0.7) for _ in names]
            await arm.move(goal)
            await loop.sleep(2 * CYCLE)
            assert record.rows[-1] == pytest.approx(goal, abs=3 / COUNTS)
            assert_within(record, list(axes.values()))

    run()
