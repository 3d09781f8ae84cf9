"""Async tests of a user's who has pytest-trio, pytest-asyncio or anyio: their runner or ours, the time is the world's.

These packages are not among ours. Install them in an environment of its own, and this file runs.
"""

from __future__ import annotations

import importlib.util

import pytest

pytest_plugins = "pytester"

HEAD = """
import asyncio
import pytest
import trio
from canopen_proto import SECOND
"""

SUITES = {
    "pytest_trio": """
@pytest.fixture
async def own():
    await trio.sleep(1)
    yield trio.current_time()
    await trio.sleep(1)

@pytest.mark.trio
async def test_with_a_fixture_of_its_own(own, canopen_master, sim_drive):
    sim_drive(5)
    await trio.sleep(100)
    assert own == pytest.approx(1)
    assert await canopen_master.node(5).read_int("device_type")

@pytest.mark.trio
async def test_with_the_world(canopen_world):
    await trio.sleep(100)
    assert canopen_world.now >= 100 * SECOND
""",
    "pytest_asyncio": """
@pytest.mark.asyncio
async def test_it(canopen_world, canopen_master, sim_drive):
    sim_drive(5)
    await asyncio.sleep(1000)
    await canopen_master.node(5).write("producer_heartbeat_time", 100)
    assert canopen_world.now >= 1000 * SECOND
""",
    "anyio": """
import anyio

@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio", "trio", ("trio", {})])
async def test_it(anyio_backend, canopen_world, canopen_master, sim_drive):
    sim_drive(5)
    await anyio.sleep(1000)
    assert canopen_world.now >= 1000 * SECOND
""",
}
COUNTS = {"pytest_trio": 2, "pytest_asyncio": 1, "anyio": 3}
MISSING = [name for name in SUITES if importlib.util.find_spec(name) is None]


@pytest.mark.skipif(bool(MISSING), reason="pytest-trio, pytest-asyncio and anyio are not installed")
@pytest.mark.parametrize("plugin", SUITES)
def test_plugin(pytester: pytest.Pytester, plugin: str) -> None:
    pytester.makeini("[pytest]\nasyncio_default_fixture_loop_scope = function\n")
    pytester.makepyfile(HEAD + SUITES[plugin])
    pytester.runpytest_subprocess().assert_outcomes(passed=COUNTS[plugin])
