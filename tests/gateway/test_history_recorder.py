"""The recorder of a fleet: what was lost is recorded as lost, and what a stranger sends ends nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
import trio

from canopen_data.descriptions import load_description
from canopen_gateway.fleet import FleetEmcy, FleetPdo, FleetPlace, FleetState, PlaceAppeared, PlaceGone
from canopen_gateway.fleet.fleet import FleetValue
from canopen_gateway.fleet.keys import ANY, PdoCount
from canopen_gateway.fleet.news import FleetField
from canopen_gateway.history.query import open_history
from canopen_gateway.history.recorder import FleetRecorder, Recorded, record_fleet
from canopen_gateway.history.writer import HistoryWriter
from canopen_master import DeviceModel
from canopen_proto.datatypes import DataType
from canopen_proto.nmt import NmtState
from tests.gateway.fleet_world import BUS, SITE, fleet, real_time, seen
from tests.gateway.history_world import BEGIN, SECOND, Clock, asked, needs_history

pytest.importorskip("zenoh", reason="the extra fleet is not installed")
pytestmark = needs_history

PLACE = FleetPlace("hall", "arm", 5)
ONE, OTHER = b"1" * 8, b"2" * 8
FIELD = FleetField("6041:00", "statusword", DataType.UNSIGNED16, "", 0x0237, b"\x37\x02")


class Bench:
    """A recorder on a clock of its own."""

    def __init__(self, folder: Path, pattern: str = "") -> None:
        self.folder = folder
        self.clock = Clock()
        place = FleetPlace(*pattern.split("/"), 0) if pattern else FleetPlace(ANY, ANY)  # type: ignore[arg-type]
        self.recorder = FleetRecorder(place, HistoryWriter(folder, clock=self.clock))

    def pdo(self, run: bytes, number: int, lost: int = 0, *, place: FleetPlace = PLACE, pdo: int = 1) -> None:
        """A PDO of a bridge. number, lost: its counts."""
        self.clock.now += SECOND
        count = PdoCount(run, number, lost)
        self.recorder.take(FleetPdo(place, pdo, b"\x37\x02", [FIELD], self.clock.now - 5, count))

    def gaps(self) -> list[tuple[object, ...]]:
        """What was lost: where, which PDO, how many, and why."""
        writer = self.recorder.writer
        writer.write(writer.take())
        return asked(self.folder, "SELECT place, pdo, lost, why FROM gaps WHERE site <> '@recorder' ORDER BY until")


def test_what_was_lost_on_the_way_is_counted_with_the_times_around_it(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    for number in (7, 8, 12, 11, 13):  # 11 was overtaken: it is there, and had counted as lost
        bench.pdo(ONE, number)
    bench.pdo(ONE, 1, pdo=2)
    ((place, pdo, lost, why),) = bench.gaps()
    assert (place, pdo, lost, "between the bridge" in str(why)) == ("hall/arm/5", 1, 3, True)
    assert bench.recorder.lost == 3
    ((begun, until),) = asked(tmp_path, "SELECT begun, until FROM gaps WHERE lost = 3")
    assert begun < until
    assert asked(tmp_path, "SELECT count(*) FROM samples") == [(6,)]
    assert asked(tmp_path, "SELECT DISTINCT name, integer, raw, type, pdo FROM samples ORDER BY pdo") == [
        ("statusword", 0x0237, "37 02", "UNSIGNED16", 1), ("statusword", 0x0237, "37 02", "UNSIGNED16", 2),
    ]  # fmt: skip


def test_a_bridge_that_began_anew_is_a_gap_of_unknown_length(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    for run, number in ((ONE, 900), (OTHER, 3), (OTHER, 4)):
        bench.pdo(run, number)
    ((place, pdo, lost, why),) = bench.gaps()
    assert (place, pdo, lost, "began anew" in str(why)) == ("hall/arm/5", 1, None, True)


def test_what_the_bridge_did_not_take_is_a_gap_of_the_bus(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.pdo(ONE, 1, 5)  # before this recorder began
    bench.pdo(ONE, 2, 5)
    bench.pdo(ONE, 3, 9)
    bench.pdo(ONE, 1, 9, place=PLACE._replace(node_id=6))
    ((place, pdo, lost, why),) = bench.gaps()
    assert (place, pdo, lost, "faster" in str(why)) == ("hall/arm", None, 4, True)


def test_who_was_away_has_a_gap_until_it_is_back(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    for event in (PlaceAppeared(PLACE), PlaceGone(PLACE), PlaceAppeared(PLACE), PlaceGone(PLACE)):
        bench.clock.now += SECOND
        bench.recorder.take(event)
    assert [(each[0], each[3]) for each in bench.gaps()] == [("hall/arm/5", "it was away")] * 2
    rows = asked(tmp_path, "SELECT begun, until FROM gaps WHERE why = 'it was away' ORDER BY begun")
    assert rows[0][1] > rows[0][0]
    assert rows[1][1] is None


def test_what_a_stranger_sends_is_recorded_as_it_is_and_ends_nothing(tmp_path: Path) -> None:
    """Anybody who may publish may send such things: times that are none, numbers that are none, half characters."""
    bench = Bench(tmp_path)
    evil = FleetField("\ud800", "\ud800" * 10_000, DataType.VISIBLE_STRING, "\x1b[2J", "\ud800", b"\xff" * 1000)
    recorder = bench.recorder
    recorder.take(FleetPdo(PLACE, 512, b"x", [evil], 1 << 64, PdoCount(ONE, (1 << 64) - 1, (1 << 64) - 1)))
    recorder.take(FleetPdo(PLACE, 512, b"x", [], -1, PdoCount(ONE, 0, 0)))
    recorder.take(FleetPdo(PLACE, 512, b"x", [], 0, PdoCount(OTHER, (1 << 64) - 1, (1 << 64) - 1)))
    recorder.take(FleetPdo(PLACE, 512, b"x", [], 0))
    recorder.take(FleetEmcy(PLACE, 0xFFFF, 255, b"\xff" * 5, (1 << 64) - 1))
    recorder.take(FleetState(PLACE, None, (1 << 64) - 1))
    recorder.take(FleetState(PLACE, NmtState.OPERATIONAL, BEGIN))
    recorder.take_value(FleetValue(PLACE, "\ud800", None, problem="\ud800", object="\ud800"))
    recorder.take_value(FleetValue(PLACE, "1018:01", 7, "vendor", "", b"\7", "", "1018:01", "\ud800", 1 << 70))
    bench.gaps()
    assert asked(tmp_path, "SELECT count(*) FROM samples WHERE problem IS NULL") == [(2,)]
    assert asked(tmp_path, "SELECT state, site_time IS NULL FROM states ORDER BY state") == [
        ("OPERATIONAL", False),
        ("unknown", True),
    ]
    assert asked(tmp_path, "SELECT code, raw FROM emergencies") == [(0xFFFF, "ff ff ff ff ff ff")]
    assert asked(tmp_path, "SELECT problem FROM samples WHERE object = '\\ud800' AND problem IS NOT NULL") == [("\\ud800",)]


def test_only_what_was_asked_for_is_recorded(tmp_path: Path) -> None:
    bench = Bench(tmp_path, "hall/arm")
    bench.pdo(ONE, 1)
    bench.pdo(ONE, 1, place=FleetPlace("hall", "other", 5))
    bench.gaps()
    assert asked(tmp_path, "SELECT place FROM nodes") == [("hall/arm/5",)]


@real_time
async def test_a_fleet_is_recorded_as_it_is_read(tmp_path: Path) -> None:
    async with fleet(3, 4) as (viewer, _):
        told, started = Recorded(), trio.Event()

        async def record() -> None:
            await record_fleet(
                viewer,
                tmp_path,
                objects=["statusword", "1018:01"],
                every=0.05,
                flush=1.0,
                started=lambda recorded: started.set(),
                told=told,
            )

        async with trio.open_nursery() as nursery:
            nursery.start_soon(record)
            await started.wait()
            await seen(lambda: told.rows > 30)
            nursery.cancel_scope.cancel()
    assert (told.problem, told.rows > 30) == ("", True)
    place = f"{SITE}/{BUS}"
    with open_history(tmp_path) as history:
        found = list(history.ask("SELECT DISTINCT place, name, integer, type FROM samples ORDER BY ALL").rows)
        assert [each for each in found if each[1] == "statusword"] == [
            (f"{place}/{node}", "statusword", 0x0240, "UNSIGNED16") for node in (3, 4)
        ]
        ((behind,),) = history.ask("SELECT count(*) FROM samples WHERE site_time > recorder_time OR site_time IS NULL").rows
        assert behind == 0  # one computer, one clock
        assert [each[0] for each in history.ask("SELECT ended FROM runs").rows] == [True]


@real_time
async def test_a_bridge_counts_its_pdos_and_tells_what_they_carry() -> None:
    """Every PDO has the number of its kind in this run of the bridge, so a viewer knows what it did not get."""
    device = DeviceModel(load_description("sample_io.eds").dictionary, node_id=5)
    async with fleet(5, makers=[device], without_drives=True) as (viewer, served):
        node = served.service.master.node(5, "sample_io.eds")
        with viewer.news(FleetPdo) as news:
            await node.start()
            found: dict[int, list[FleetPdo]] = {}
            async for pdo in news:
                found.setdefault(pdo.number, []).append(pdo)
                if len(found[pdo.number]) > 3 and pdo.fields:
                    break
                await node.write(0x6200_01, len(found[pdo.number]) & 1)
    kind = found[pdo.number]
    counts = [each.count for each in kind if each.count is not None]
    assert [each.number - counts[0].number for each in counts] == [*range(len(kind))]
    assert {(each.run, each.lost) for each in counts} == {(counts[0].run, 0)}
    assert b"".join(each.data for each in pdo.fields) == pdo.data
    assert {each.object for each in pdo.fields} <= {"6000:01", "6000:02", "6401:01", "6401:02", "6401:03", "6401:04"}
