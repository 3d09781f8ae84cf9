"""Chains move along paths: what their drives did, in the simulator's own record."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_master import AxisSettings, ChainHaltedError, ChainState, together
from canopen_master.motion.moving import Moving
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.trajectory import Path
from tests.examples import examples
from tests.loops import loop
from tests.master.path_world import COUNTS, CYCLE, arms, swing
from tests.master.world import drives, virtual_time


@virtual_time
async def test_a_chain_follows_a_path_from_its_start_to_its_end() -> None:
    async with arms(2) as (_, [arm], record):
        path = swing(0.5, -0.25)
        await arm.follow(path)
        assert arm.state is ChainState.FOLLOWING
        assert arm.desired_positions == pytest.approx([0.5, -0.25], abs=1e-6)
        assert record.rows[-1] == pytest.approx([0.5, -0.25], abs=1e-6)
        # the drives were on the path, all at one time of it
        begin = next(number for number, row in enumerate(record.rows) if row[0] > 1e-9) - 1
        for number in range(begin, len(record.rows)):
            assert record.rows[number] == pytest.approx(path.at((number - begin) * CYCLE).positions, abs=3e-6)


def distance_from(path: Path, point: Sequence[float]) -> float:
    """How far a point is at most from a path on which joint 0 moves one way: from the place where joint 0 is there."""
    early, late = 0.0, path.duration
    for _ in range(40):
        middle = 0.5 * (early + late)
        early, late = (middle, late) if path.at(middle).positions[0] < point[0] else (early, middle)
    return max(abs(a - b) for a, b in zip(path.at(early).positions, point, strict=True))


WAYS = (0.5, -0.25, 0.1, 0.4, -0.5, 0.3, 0.2, -0.1, 0.45, 0.15, -0.35, 0.05)
ON_PATH = 3e-6
"""Three counts: positions on the wire are whole counts, at each end of a step."""
WITHIN = 1.01
"""Of a limit: what the differences of rounded positions add."""
Stop = Callable[[Moving, float, Path], Awaitable[None]]


async def by_halt(arm: Moving, seconds: float, path: Path) -> None:
    async with loop.open_nursery() as nursery:

        async def follow() -> None:
            with pytest.raises(ChainHaltedError, match="by halt()"):
                await arm.follow(path)

        nursery.start_soon(follow)
        await moved(arm, seconds)
        await arm.halt()
    assert {chain.state for chain in arm.members} == {ChainState.HALTED}


async def by_cancel(arm: Moving, seconds: float, path: Path) -> None:
    async with loop.open_nursery() as nursery:
        nursery.start_soon(arm.follow, path)
        await moved(arm, seconds)
        nursery.cancel_scope.cancel()
    assert {chain.state for chain in arm.members} == {ChainState.FOLLOWING}


async def by_failing_caller(arm: Moving, seconds: float, path: Path) -> None:
    async def fail() -> None:
        await moved(arm, seconds)
        raise KeyError("a bug of the user's")

    with pytest.raises(ExceptionGroup) as caught:
        async with loop.open_nursery() as nursery:
            nursery.start_soon(arm.follow, path)
            nursery.start_soon(fail)
    assert caught.group_contains(KeyError)
    assert {chain.state for chain in arm.members} == {ChainState.FOLLOWING}


async def by_next_command(arm: Moving, seconds: float, path: Path) -> None:
    """Another command that needs joints at rest."""
    async with loop.open_nursery() as nursery:

        async def follow() -> None:
            with pytest.raises(ChainHaltedError, match="to follow set-points"):
                await arm.follow(path)

        nursery.start_soon(follow)
        await moved(arm, seconds)
        await arm.follow()
    assert {chain.state for chain in arm.members} == {ChainState.FOLLOWING}


async def moved(arm: Moving, seconds: float) -> None:
    async for progress in arm.progress():
        if progress.time >= seconds:
            break


STOPS = (by_halt, by_cancel, by_failing_caller, by_next_command)


@pytest.mark.thorough(5)
@pytest.mark.parametrize("stop", STOPS)
@example(seconds=0.37, joints=(6, 6))
@examples(12, least=2)
@given(
    seconds=st.floats(0.01, 0.99),
    joints=st.one_of(st.tuples(st.integers(1, 6), st.integers(1, 6)), st.tuples(st.integers(2, 12))),
)
def test_any_stop_at_any_moment_is_on_the_path_and_within_the_limits(stop: Stop, seconds: float, joints: tuple[int, ...]) -> None:
    @virtual_time
    async def run() -> None:
        async with arms(*joints) as (_, chains, record):
            path = swing(*WAYS[: sum(joints)], duration=1.0)
            moving = chains[0] if len(chains) == 1 else together(*chains)
            await stop(moving, seconds, path)
            await loop.sleep(0.5)
            assert max(distance_from(path, row) for row in record.rows) < ON_PATH
            assert record.rows[-1] == pytest.approx(record.rows[-20], abs=1e-9)
            assert record.largest(1) <= 1.0
            assert record.largest(2) <= 4.0 * WITHIN
            assert record.largest(3) <= 40.0 * WITHIN + 4.0

    run()


@pytest.mark.parametrize("mode", [Mode.INTERPOLATED_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION])
@virtual_time
async def test_a_joint_that_may_not_brake_so_hard_as_it_accelerates_stays_within_its_limits(mode: Mode) -> None:
    """0x60C6 below 0x60C5: a path that brakes by the latter would lead the drive beyond its end, and beyond the limit there."""
    pytest.importorskip("ruckig")
    axis = AxisSettings(counts_per_unit=COUNTS, max_speed=1.0, max_position=1.0)
    async with arms(1, axis=axis, mode=mode) as (_, [arm], record):
        (node,) = drives(record.hosts[0])
        node.values.store.update({objects.MAX_ACCELERATION: 4_000_000, objects.MAX_DECELERATION: 1_000_000})
        await arm.initialise()
        await arm.move([0.99])
        await loop.sleep(1.0)
        assert max(row[0] for row in record.rows) < 0.99 + ON_PATH
        assert record.rows[-1] == pytest.approx([0.99], abs=ON_PATH)
