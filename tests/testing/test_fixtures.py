"""Each fixture in a plain, a trio and an asyncio test; in any order, with xdist and without; and what a failure shows."""

from __future__ import annotations

import asyncio
import random
import re
from pathlib import Path

import pytest
import trio

from canopen_check.catalogue import BY_NUMBER, CASES
from canopen_data.descriptions import load_description
from canopen_proto.machine import MILLISECOND, LocalProtocolError
from canopen_proto.testing import nmt
from canopen_proto.verdict import Result
from canopen_testing import ProgramWorld
from canopen_testing.async_tests import hosted
from canopen_testing.conformance_fixture import RealDevice, check_on_bus
from tests.testing import typed_suite

pytest_plugins = "pytester"

EACH = """
import asyncio, time

import pytest
import trio

from canopen_proto import MILLISECOND, SECOND, NmtCommand
from canopen_proto.testing import Lose, World, heartbeat, nmt
from canopen_master import Master


def test_canopen_world(canopen_world):
    canopen_world.advance(3600 * SECOND)
    assert canopen_world.now == 3600 * SECOND

async def test_canopen_world_trio(canopen_world):
    await trio.sleep(3600)
    assert canopen_world.now == 3600 * SECOND

@pytest.mark.asyncio
async def test_canopen_world_asyncio(canopen_world):
    await asyncio.sleep(3600)
    assert canopen_world.now == 3600 * SECOND


def beat(drive):
    drive.set_value(0x1017, 0, 100, 0)

def test_canopen_bus(canopen_bus, canopen_world, sim_drive):
    beat(sim_drive(5))
    canopen_world.advance(SECOND)
    canopen_bus.saw(heartbeat(5)).times(10)

async def test_canopen_bus_trio(canopen_bus, sim_drive):
    beat(sim_drive(5))
    await trio.sleep(1)
    canopen_bus.saw(heartbeat(5)).times(10)

@pytest.mark.asyncio
async def test_canopen_bus_asyncio(canopen_bus, sim_drive):
    beat(sim_drive(5))
    await asyncio.sleep(1)
    canopen_bus.saw(heartbeat(5)).times(10)


def test_sim_node(sim_node, canopen_master):
    sim_node("sample_io.eds", node_id=5)
    assert canopen_master.read(5, "manufacturer_device_name") == "Sample I/O"
    canopen_master.write(5, "producer_heartbeat_time", 250)

async def test_sim_node_trio(sim_node, canopen_master):
    sim_node("sample_io.eds", node_id=5)
    node = canopen_master.node(5, "sample_io.eds")
    assert await node.read_str("manufacturer_device_name") == "Sample I/O"
    await node.write("producer_heartbeat_time", 250)

@pytest.mark.asyncio
async def test_sim_node_asyncio(sim_node, canopen_master):
    sim_node("sample_io.eds", node_id=5)
    assert isinstance(canopen_master, Master)
    node = canopen_master.node(5, "sample_io.eds")
    assert await node.read_str("manufacturer_device_name") == "Sample I/O"
    await node.write("producer_heartbeat_time", 250)


def test_sim_drive(sim_drive, canopen_world):
    drive = sim_drive(3)
    canopen_world.bus().send("000#0100")
    canopen_world.advance(MILLISECOND)
    assert drive.state == 5

@pytest.mark.trio
async def test_sim_drive_trio(sim_drive, canopen_master):
    drive = sim_drive(3)
    await canopen_master.node(3).start()
    await trio.sleep(0.001)
    assert drive.state == 5

@pytest.mark.asyncio
async def test_sim_drive_asyncio(sim_drive, canopen_master):
    drive = sim_drive(3)
    await canopen_master.node(3).start()
    await asyncio.sleep(0.001)
    assert drive.state == 5


class TestMarked:
    pytestmark = pytest.mark.canopen_faults(Lose(heartbeat(5), nth=1))

    @pytest.mark.canopen_faults(Lose(heartbeat(5), nth=2), seed=77)
    def test_faults(self, canopen_world, sim_drive):
        beat(sim_drive(5))
        canopen_world.advance(SECOND)
        canopen_world.bus().saw(heartbeat(5)).times(8)
        assert canopen_world.seed == 77

    async def test_faults_trio(self, sim_drive, canopen_bus):
        beat(sim_drive(5))
        await trio.sleep(1)
        canopen_bus.saw(heartbeat(5)).times(9)

    @pytest.mark.asyncio
    async def test_faults_asyncio(self, sim_drive, canopen_bus):
        beat(sim_drive(5))
        await asyncio.sleep(1)
        canopen_bus.saw(heartbeat(5)).times(9)


@pytest.mark.parametrize("kind", ["plain"])
def test_a_wait_in_real_time(canopen_world, kind):
    with pytest.raises(RuntimeError, match="waits in real time"):
        time.sleep(1)
"""
COUNT = 16

FAILING = """
import pytest
from canopen_proto import SECOND
from canopen_proto.testing import emcy

def test_it(canopen_world, sim_drive):
    sim_drive(5).set_value(0x1017, 0, 100, 0)
    canopen_world.advance(SECOND)
    canopen_world.bus().send("705#00")
    canopen_world.run_until(emcy(5), limit=SECOND)

async def test_in_trio(sim_drive, canopen_bus):
    sim_drive(5)
    canopen_bus.saw(emcy(5))

def test_in_a_fixture(broken):
    pass

@pytest.fixture
def broken(canopen_bus):
    canopen_bus.send("605#4000100000000000")
    raise RuntimeError
"""


def traces(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.thorough
def test_each_fixture_in_each_kind_of_test_in_any_order_with_xdist_too(suite: pytest.Pytester) -> None:
    suite.makepyfile(EACH)
    suite.runpytest("--canopen-trace", "plain").assert_outcomes(passed=COUNT)
    plain = traces(suite.path / "plain")
    assert len(plain) == COUNT
    suite.makeconftest("def pytest_collection_modifyitems(items): items.reverse()")
    suite.runpytest_subprocess("-p", "xdist", "-n2", "--canopen-trace", "other").assert_outcomes(passed=COUNT)
    assert traces(suite.path / "other") == plain
    order = random.Random(3).sample(range(COUNT), COUNT)
    suite.makeconftest(f"def pytest_collection_modifyitems(items): items[:] = [items[place] for place in {order}]")
    suite.runpytest("--canopen-trace", "third", "--canopen-seed", "0").assert_outcomes(passed=COUNT)
    assert traces(suite.path / "third") == plain
    suite.runpytest("--canopen-trace", "seeded", "--canopen-seed", "1").assert_outcomes(passed=COUNT)
    assert traces(suite.path / "seeded") != plain


def test_the_suite_with_types(suite: pytest.Pytester) -> None:
    suite.makepyfile(Path(typed_suite.__file__).read_text(encoding="utf-8"))
    run = suite.runpytest("-k", "not a_case or 2.1-")
    run.assert_outcomes(passed=5, deselected=len(CASES) - 1)


def test_a_failure_ends_with_the_last_frames_and_what_was_wrong(suite: pytest.Pytester) -> None:
    suite.makepyfile(FAILING)
    run = suite.runpytest()
    run.assert_outcomes(failed=2, errors=1)
    text = run.stdout.str()
    assert "DidNotHappenError: an emergency of node 5 did not come since 1.000000 s: 1 s are over." in text
    assert text.count("CANopen: the last frames on can0") == 3
    assert "CANopen: what was wrong on can0" in text
    assert "boot-up: node 5: it boots in the middle of operation" in text
    assert not re.findall(r"\n\S*canopen_(?:proto|testing)/\S+:\d+", text), "our inside is not shown"


OF_FAULTS = """
import pytest
from canopen_proto import SECOND
from canopen_proto.testing import Lose, Pause, heartbeat, sdo_answer

@pytest.mark.canopen_faults(Lose(heartbeat(5), nth=(2, 3)), Lose(sdo_answer(5), nth=3), Pause(5, at=SECOND))
def test_it(canopen_world, sim_drive):
    sim_drive(5).set_value(0x1017, 0, 100, 0)
    canopen_world.advance(2 * SECOND)
    assert False
"""


def test_a_failure_tells_what_the_faults_have_done(suite: pytest.Pytester) -> None:
    suite.makepyfile(OF_FAULTS)
    text = suite.runpytest().stdout.str()
    lines = text.partition("CANopen: what the faults have done")[2].splitlines()[1:4]
    assert lines == [
        "never hit: Lose an SDO answer of node 5, nth=3",
        "Lose heartbeat of node 5, nth=(2, 3): 2 times, last at 0.200153 s",
        "Pause node 5, at=1 s: once at 1.000000 s",
    ]


LIMITED = """
import asyncio
import pytest
import trio
from canopen_proto import SECOND

async def waits():
    await trio.sleep(1000)  # for nothing

@pytest.mark.canopen_limit(5 * SECOND)
async def test_marked(canopen_world):
    await waits()

@pytest.mark.asyncio
async def test_by_option(canopen_world):
    await asyncio.sleep(1000)

@pytest.mark.canopen_limit(5)
async def test_in_seconds(canopen_world):
    pass
"""


def test_a_test_has_a_limit_and_shows_where_it_waits(suite: pytest.Pytester) -> None:
    suite.makepyfile(LIMITED)
    run = suite.runpytest("--canopen-limit", "7")
    run.assert_outcomes(failed=2, errors=1)
    text = run.stdout.str()
    assert "the program has run for its limit, until 5 s of the world." in text
    assert re.search(r"The program waits here:\nE +test_a\w+.py:7 in waits: await trio.sleep\(1000\)  # for nothing\n", text)
    assert "the program has run for its limit, until 7 s of the world." in text
    assert "await asyncio.sleep(1000)" in text
    assert "canopen_limit is 5: times are nanoseconds here; 5 seconds are 5 * SECOND" in text
    assert not re.findall(r"\n\S*canopen_(?:proto|testing)/\S+:\d+", text), "our inside is not shown"


def test_a_bit_rate_for_the_bus_of_the_fixtures(suite: pytest.Pytester) -> None:
    suite.makepyfile("""
        async def test_it(canopen_bus, canopen_master, canopen_world, sim_drive):
            canopen_world.bus("can0", bitrate=125_000)
            sim_drive(5)
            assert canopen_world.bus("can0", bitrate=125_000) is canopen_bus
            before = canopen_world.now
            assert await canopen_master.node(5).read((0x1018, 1)) is not None
            assert canopen_world.now - before > 1_500_000
    """)
    suite.runpytest().assert_outcomes(passed=1)


def test_the_traffic_can_be_read_again(suite: pytest.Pytester) -> None:
    suite.makepyfile("def test_it(canopen_world, sim_drive):\n    sim_drive(5)\n    canopen_world.drive(6, bus='can1')\n")
    suite.runpytest("--canopen-trace", "deep/er").assert_outcomes(passed=1)
    (path,) = (suite.path / "deep" / "er").iterdir()
    assert path.read_text() == "(0000000000.000000) can0 705#00 R\n(0000000000.000000) can1 706#00 R\n"


# ---- conformance ----

DEVICE = """
import pytest

@pytest.fixture
def canopen_device(sim_node):
    return sim_node("sample_io.eds", node_id=5)

def test_it(canopen_check):
    canopen_check()
"""


def test_the_conformance_cases_of_a_simulated_device(suite: pytest.Pytester) -> None:
    suite.makepyfile(DEVICE)
    run = suite.runpytest("-k", "2.", "--junitxml", "report.xml")
    counts = run.parseoutcomes()
    assert counts["passed"] > 20
    assert "failed" not in counts
    report = (suite.path / "report.xml").read_text()
    assert report.count("<testcase") == counts["passed"] + counts.get("skipped", 0)
    assert 'name="test_it[2.1-' in report


OWN_DEVICE = """
from canopen_proto import MILLISECOND, DataType
from canopen_proto.declared import DeclaredDevice, Nameplate, Tpdo, variable
from canopen_proto.dictionary import Access

class Thermometer(DeclaredDevice):
    nameplate = Nameplate("Thermometer")
    period = 10 * MILLISECOND
    temperature = variable(0x2000, "Temperature", DataType.REAL32, 20.0, access=Access.RO, pdo=True)
    row = variable(0x2001, "Row", DataType.UNSIGNED8, 40, access=Access.RO, pdo=True, low_limit=1, high_limit=40)
    fixed = variable(0x2002, "Fixed", DataType.UNSIGNED8, 1, access=Access.RO, pdo=True, low_limit=1, high_limit=1)
    pdos = (Tpdo(1, temperature), Tpdo(2, row), Tpdo(3, fixed))

    def step(self):
        self.temperature = 21.5
"""


@pytest.mark.parametrize("device", ["sample_drive.eds", "thermometer.py"])
def test_a_device_that_changes_its_values_itself_passes_each_case(suite: pytest.Pytester, device: str) -> None:
    (suite.path / "thermometer.py").write_text(OWN_DEVICE)
    suite.makepyfile(DEVICE.replace("sample_io.eds", device))
    suite.runpytest("-k", "3.4- or 3.5- or 3.7-").assert_outcomes(passed=3, deselected=len(CASES) - 3)


def test_a_device_that_does_wrong_fails_its_case(suite: pytest.Pytester) -> None:
    fault = "@pytest.mark.canopen_faults(Replace(heartbeat(5), data=b'\\x33'))"
    imports = "from canopen_proto.testing import Replace, heartbeat"
    suite.makepyfile(f"{imports}\n{DEVICE}".replace("def test_it", f"{fault}\ndef test_it"))
    run = suite.runpytest("-k", "heartbeat")
    assert run.parseoutcomes()["failed"] > 0
    assert "case " in run.stdout.str()


LOOSE = """
import pytest
from canopen_data.descriptions import load_description
from canopen_proto import LocalNode

class Loose(LocalNode):
    def read(self, index, subindex, now):
        return bytes(4) if (index, subindex) == (0x1018, 5) else super().read(index, subindex, now)

@pytest.fixture
def canopen_device(canopen_world):
    return canopen_world.device(lambda out: Loose(out, 5, load_description("sample_io.eds").dictionary))

def test_it(canopen_check):
    canopen_check()
"""


def test_a_strict_test_asks_for_more(suite: pytest.Pytester) -> None:
    suite.makepyfile(LOOSE)
    suite.runpytest("-k", "2.5-").assert_outcomes(passed=1, deselected=len(CASES) - 1)
    run = suite.runpytest("-k", "2.5-", "--canopen-strict")
    run.assert_outcomes(failed=1, deselected=len(CASES) - 1)
    assert "reading 0x1018:05 was not refused" in run.stdout.str()


@pytest.mark.parametrize("wrong", ["sed=3", "'lose'"])
def test_what_is_no_fault_is_refused_and_not_left_out(suite: pytest.Pytester, wrong: str) -> None:
    suite.makepyfile(f"import pytest\n@pytest.mark.canopen_faults({wrong})\ndef test_it(canopen_world): pass")
    run = suite.runpytest()
    run.assert_outcomes(errors=1)
    assert (
        f"canopen_faults takes faults of canopen_proto.testing, one by one, and seed=, not {wrong.partition('3')[0]}"
        in run.stdout.str()
    )


def test_a_device_on_a_bus_is_checked_and_reset() -> None:
    world = ProgramWorld()
    world.device("sample_io.eds", 5)
    device = RealDevice("socketcan:can0", 5, load_description("sample_io.eds"))
    assert world.run(check_on_bus, BY_NUMBER["2.1"], device).result is Result.PASSED
    world.advance(MILLISECOND)
    world.bus().saw(nmt("reset_node", 5)).times(2)


def test_without_options_it_says_what_is_missing(suite: pytest.Pytester) -> None:
    run = suite.runpytest("--pyargs", "canopen_testing.test_conformance", "-k", "2.1-", "--canopen-device", "5")
    assert "which device is to be checked? --canopen-bus, --eds is missing" in run.stdout.str()


# ---- what it costs others ----


SPARING = """
import sys

def test_it():
    print("loaded:", *sorted(name for name in sys.modules if name.partition(".")[0] in ("trio", "can") or "canopen" in name))
"""


def test_a_suite_that_does_not_use_it_loads_nothing_of_it(suite: pytest.Pytester) -> None:
    suite.makepyfile(SPARING)
    run = suite.runpytest_subprocess("-s", "-q", "-p", "no:anyio")  # that of anyio loads trio for itself
    assert "loaded: canopen_proto canopen_proto.lazy_names canopen_testing canopen_testing.plugin\n" in run.stdout.str()


def test_there_is_no_world_in_real_time() -> None:
    async def test() -> None:
        raise AssertionError("it is not reached")

    with pytest.raises(LocalProtocolError, match="this test runs in real time"):
        trio.run(hosted(test, ProgramWorld()))
    with pytest.raises(LocalProtocolError, match="this test runs in real time"):
        asyncio.run(hosted(test, ProgramWorld())())  # type: ignore[arg-type]
