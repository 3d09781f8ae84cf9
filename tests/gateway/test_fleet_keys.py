"""The keys of a fleet: what is written is read again, and whatever anybody sends is a place or nothing."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_gateway.fleet import FleetPlace, parse_place
from canopen_gateway.fleet.keys import NAME, check_name, key_of, name_of_bus, parse_key
from tests.examples import examples

names = st.from_regex(r"[a-z0-9_-]{1,64}", fullmatch=True)
places = st.builds(FleetPlace, names, names, st.integers(0, 127))
patterns = st.builds(FleetPlace, names | st.just("*"), names | st.just("*"), st.integers(-1, 127))
words = st.lists(st.from_regex(r"[A-Za-z_.:][A-Za-z0-9_.:]{0,20}", fullmatch=True), min_size=1, max_size=3)


@examples(100)
@given(patterns, words)
def test_a_key_is_read_as_it_was_written(place: FleetPlace, rest: list[str]) -> None:
    found = parse_key(key_of(place, *rest))
    assert found is not None
    assert (found[0], list(found[1])) == (place, rest)


@examples(100)
@given(patterns)
def test_a_place_is_read_as_it_was_written(place: FleetPlace) -> None:
    assert parse_place(str(place)) == place


@examples(200)
@given(
    st.text(st.sampled_from("canope/v1*?#$-_.:0123456789 ä\x00"), max_size=60).map(lambda text: f"canopen/v1/{text}") | st.text()
)
def test_no_key_of_anybody_names_a_place_that_cannot_be(key: str) -> None:
    found = parse_key(key)
    if found is not None:
        place, rest = found
        assert -1 <= place.node_id <= 127
        assert all(name == "*" or NAME.match(name) for name in place[:2])
        assert rest


@examples(100)
@given(places, patterns)
def test_a_pattern_names_what_each_of_its_parts_names(place: FleetPlace, pattern: FleetPlace) -> None:
    parts = zip(str(place).split("/"), str(pattern).split("/"), strict=False)
    alike = all(wanted in (part, "*") for part, wanted in parts) and bool(place.node_id) is bool(pattern.node_id)
    assert place.matches(pattern) is alike


@examples(100)
@given(st.text(min_size=1, max_size=80))
def test_every_bus_has_a_name_that_may_stand_in_a_key(locator: str) -> None:
    assert NAME.match(name_of_bus(locator))


@pytest.mark.parametrize(
    "text", ["hall", "hall/arm/128", "hall/arm/0", "hall/arm/5/6", "Hall/arm/5", "h?ll/arm/5", "**/arm/5", "//5", "hall/arm/-1"]
)
def test_what_is_no_place_is_told(text: str) -> None:
    with pytest.raises(ValueError, match="place|name|node-ID"):
        parse_place(text)


def test_a_bus_is_no_node() -> None:
    with pytest.raises(ValueError, match="SITE/BUS/NODE"):
        parse_place("hall/arm", node=True)


@pytest.mark.parametrize("name", ["", "Hall", "a b", "a/b", "*", "ä", "a" * 65, "a\n"])
def test_a_site_has_a_plain_name(name: str) -> None:
    with pytest.raises(ValueError, match="1 to 64 small letters"):
        check_name("site", name)
