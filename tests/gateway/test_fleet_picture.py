"""What a page knows of a fleet, and what it takes from a bridge that tells nonsense. Pure, in given time."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_gateway import BridgeRefusedError, NotAllowedError, Permission, parse_permissions
from canopen_gateway.fleet import FleetEmcy, FleetNews, FleetPlace, FleetState, FleetStatus, PlaceAppeared, PlaceGone
from canopen_gateway.fleet.fleet import Fleet, FleetAnswer
from canopen_gateway.web.fleet_picture import MOST_BUSES, MOST_NAME, FleetPicture
from canopen_gateway.web.fleet_subject import FleetSubject
from canopen_master.plain_text import json_text
from canopen_proto.nmt import NmtState
from tests.examples import examples
from tests.loops import loop
from tests.master.world import virtual_time

BUS, NODE = FleetPlace("hall", "arm"), FleetPlace("hall", "arm", 5)
SECOND = 10**9


def picture(*news: FleetNews, now: float = 100.0) -> FleetPicture:
    found = FleetPicture()
    found.take([PlaceAppeared(BUS), PlaceAppeared(NODE), *news], now)
    return found


def bus(found: FleetPicture, now: float = 100.0) -> dict[str, Any]:
    return found.net_data("hall/arm", Permission, now)


def test_a_bridge_is_late_without_a_status_and_lost_with_the_time_since() -> None:
    found = picture(FleetStatus(BUS, {"nodes": {"5": "OPERATIONAL"}, "allow": ["write"], "names": {"5": "elbow"}}))
    assert [bus(found, 103.0)[each] for each in ("state", "age", "allow")] == ["there", None, ["write"]]
    assert [bus(found)["nodes"][0][each] for each in ("name", "state")] == ["elbow", "operational"]
    assert [bus(found, 103.5)[each] for each in ("state", "age")] == ["late", 3.5]
    found.take([PlaceGone(BUS)], 104.0)
    assert [bus(found, 110.0)[each] for each in ("state", "age")] == ["lost", 6.0]
    assert [bus(found, 110.0)["nodes"][0][each] for each in ("state", "age")] == ["lost", 6.0]
    found.take([PlaceAppeared(NODE), PlaceAppeared(BUS)], 111.0)
    assert [bus(found, 111.0)[each] for each in ("net", "state", "age")] == [1, "there", None]
    assert bus(found, 111.0)["nodes"][0]["state"] == "operational"


def test_a_bridge_and_its_nodes_that_are_lost_together_are_one_event() -> None:
    found = picture()
    (told,) = found.take([PlaceGone(NODE), PlaceGone(BUS)], 101.0)
    assert (told[0], told[1]["kind"], told[1]["node"]) == ("hall/arm", "lost", 0)
    found.take([PlaceAppeared(BUS), PlaceAppeared(NODE)], 102.0)
    (told,) = found.take([PlaceGone(NODE)], 103.0)
    assert (told[1]["place"], told[1]["kind"]) == ("hall/arm/5", "lost")


def test_two_bridges_of_one_name_are_told_from_one_that_was_started_anew() -> None:
    found = picture(*(FleetStatus(BUS, {"run": run}) for run in ("a", "b", "c", "c")))
    assert (found.twins(100.0), bus(found)["outage"]) == ([], "")
    for number, run in enumerate(("b", "c", "b")):
        found.take([FleetStatus(BUS, {"run": run})], 101.0 + number)
        assert found.twins(101.0 + number) == ["hall/arm"]
    assert "several bridges" in bus(found, 103.0)["outage"]
    for number in range(5):
        found.take([FleetStatus(BUS, {"run": "b"})], 104.0 + number)  # "c" has ended
    assert (found.twins(108.0), bus(found, 108.0)["outage"]) == ([], "")


def test_an_emergency_stays_until_the_errors_are_gone() -> None:
    found = picture()
    (told,) = found.take([FleetEmcy(NODE, 0x2310, 3, b"\1\2\3\4\5", 0)], 101.0)
    assert (told[1]["code"], told[1]["vendor"], told[1]["register"]) == ("0x2310", "01 02 03 04 05", 3)
    assert bus(found)["nodes"][0]["emergency"]["code"] == "0x2310"
    (told,) = found.take([FleetEmcy(NODE, 0x0000, 0, bytes(5), 0)], 102.0)
    assert told[1]["text"] == "no error any more"
    assert bus(found)["nodes"][0]["emergency"] is None


def test_what_is_told_late_is_found_out_whatever_the_clocks_say() -> None:
    found = picture()
    ahead = 3600  # the bridge's clock
    stamps = [(ahead + at) * SECOND for at in range(5)]
    assert [found.late_by(NODE, stamp, at + 0.01) for at, stamp in enumerate(stamps)] == [0.0] * 5
    assert found.late_by(NODE, stamps[4], 7.01) == 3.0
    assert found.late_by(NODE, stamps[4] + 3 * SECOND, 7.01) == 0.0
    # Its clock is set back: what comes counts as late, until the time before is forgotten
    assert found.late_by(NODE, 0, 10.0) > 3000
    assert [found.late_by(NODE, at * SECOND, at + 10.0) for at in (31, 62, 63)][1:] == [0.0, 0.0]
    for nonsense in (None, -1, 1 << 64, 10**4000):
        assert found.late_by(NODE, nonsense, 10.0) == 0.0


def test_news_that_were_dropped_leave_no_wrong_picture() -> None:
    found = picture()
    other = FleetPlace("yard", "press", 7)
    found.agree([other, other.bus_place], 101.0)
    assert bus(found)["state"] == "lost"
    assert found.lost() == ["hall/arm"]
    assert found.net_data("yard/press", (), 101.0)["nodes"][0]["state"] == "not heard"


def test_the_number_of_a_bus_means_that_bus_whoever_comes_and_goes() -> None:
    found = FleetPicture()
    found.take([PlaceAppeared(FleetPlace("yard", "press"))], 1.0)
    found.take([PlaceAppeared(BUS), PlaceGone(FleetPlace("yard", "press"))], 2.0)
    assert found.names == ["hall/arm", "yard/press"]
    assert [found.name_of(number) for number in (1, 2, 3)] == ["yard/press", "hall/arm", None]


def test_there_is_room_for_so_many_buses_and_the_first_that_is_left_out_is_told() -> None:
    found = FleetPicture()
    places = [FleetPlace(f"s{number}", "b", 1) for number in range(MOST_BUSES + 3)]
    told = found.take(list(map(PlaceAppeared, places)), 1.0)
    assert len(found.names) == MOST_BUSES
    assert [event["text"] for _, event in told if event["kind"] == "other"] == [
        f"more than {MOST_BUSES} buses: this one, and all further ones, are not shown"
    ]
    assert found.take([FleetState(places[-1], NmtState.STOPPED), PlaceGone(places[-1])], 2.0) == []


NONSENSE = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(("5", "name", "path", "x")), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from(("outage", "allow", "nodes", "names", "chains")), NONSENSE))
@examples(200, least=60)
def test_a_status_of_anything_is_taken(told: dict[str, Any]) -> None:
    found = picture(FleetStatus(BUS, told))
    shown = bus(found)
    assert set(shown["allow"]) <= {each.value for each in Permission}
    assert isinstance(shown["outage"], str)
    assert isinstance(shown["nodes"][0]["name"], str)
    json.loads(json_text(shown))


def test_a_text_of_a_bridge_is_cut_and_what_a_terminal_obeys_is_shown_as_code() -> None:
    evil = "\x1b[2J\u202e<b>" + "x" * 10_000
    shown = bus(picture(FleetStatus(BUS, {"outage": evil, "names": {"5": evil}})))
    for text in (shown["outage"], shown["nodes"][0]["name"]):
        assert "\x1b" not in text
        assert "\u202e" not in text
        assert len(text) < MOST_NAME + 50


def subject(answer: bytes, beside: dict[str, Any] | None = None, allow: str = "") -> tuple[FleetSubject, list[tuple[str, ...]]]:
    """A page over a bridge that gives one answer to everything; and what it was asked for."""
    fleet = Fleet(None, loop, 1.0)  # type: ignore[arg-type]
    asked: list[tuple[str, ...]] = []

    async def ask(place: FleetPlace, *rest: str, **more: Any) -> list[FleetAnswer]:
        asked.append(rest)
        return [FleetAnswer(place, answer, beside or {})]

    fleet.ask = ask  # type: ignore[method-assign]
    shown = FleetSubject(fleet, parse_permissions(allow), clock=lambda: 1000.0)
    shown.picture.take([PlaceAppeared(BUS), PlaceAppeared(NODE)], 100.0)
    return shown, asked


@given(
    st.binary(max_size=40), st.dictionaries(st.sampled_from(("object", "name", "type", "unit", "constants", "time")), NONSENSE)
)
@examples(100, least=40)
def test_a_value_of_anything_is_read(data: bytes, beside: dict[str, Any]) -> None:
    async def read() -> None:
        shown, _ = subject(data, beside)
        raw, plain = await shown.read("hall/arm", 5, "6041:00")
        assert raw == data
        json.loads(json_text(plain))
        json.loads(json_text(await shown.about("hall/arm", 5)))

    virtual_time(read)()


@given(NONSENSE)
@examples(100, least=40)
def test_objects_of_anything_are_listed(told: Any) -> None:
    async def look() -> None:
        for answer in (told, {"objects": told}, {"objects": [told, {"path": "6041:00", "name": told}]}):
            shown, _ = subject(json.dumps(answer).encode())
            for row in await shown.objects("hall/arm", 5):
                assert row["path"] == "6041:00"
                assert all(isinstance(row[each], str) for each in ("name", "type", "access", "unit"))

    virtual_time(look)()


@virtual_time
async def test_a_value_that_is_longer_than_a_page_takes_is_refused() -> None:
    shown, _ = subject(bytes((1 << 20) + 1))
    with pytest.raises(BridgeRefusedError, match="a page takes 1048576"):
        await shown.read("hall/arm", 5, "1F50:01")


@pytest.mark.parametrize("answer", [b"", b"\xff", b"{}", b'"all stand"', b"[" * 100_000, b"7"])
@virtual_time
async def test_a_bridge_that_answers_a_halt_with_nonsense_has_confirmed_nothing(answer: bytes) -> None:
    shown, _ = subject(answer)
    assert await shown.halt("hall/arm") == ["hall/arm: its bridge does not say whether all stands"]


@virtual_time
async def test_of_two_answers_to_a_halt_for_one_place_the_bad_one_counts() -> None:
    shown, _ = subject(b"[]")

    async def ask(place: FleetPlace, *rest: str, **more: Any) -> list[FleetAnswer]:
        return [FleetAnswer(BUS, each, {}) for each in (b'["it still moves"]', b"[]")]

    shown.fleet.ask = ask  # type: ignore[method-assign]
    assert await shown.halt(None) == ["hall/arm: it still moves"]


@virtual_time
async def test_a_name_that_a_bridge_gives_to_what_moves_is_no_way_around_the_guard() -> None:
    told = {
        "objects": [
            {"path": "6040:00", "name": "harmless"},
            {"path": "2000:00", "name": "twice"},
            {"path": "2001:00", "name": "twice"},
        ]
    }
    shown, asked = subject(json.dumps(told).encode(), allow="write")
    with pytest.raises(NotAllowedError, match="writing 0x6040:00"):
        await shown.may_write("hall/arm", 5, "harmless")
    for name in ("twice", "unknown"):
        with pytest.raises(LookupError, match="no object"):
            await shown.may_write("hall/arm", 5, name)
    with pytest.raises(NotAllowedError):
        await shown.write("hall/arm", 5, (0x6040, 0), 6)
    assert not [each for each in asked if each[0] == "set"]
    # What is written is the number that the guard has seen, never the name
    shown, asked = subject(json.dumps({"objects": [{"path": "1017:00", "name": "period"}]}).encode(), allow="write")
    await shown.write("hall/arm", 5, await shown.may_write("hall/arm", 5, "period"), 5)
    assert asked[-1] == ("set", "1017:00")
