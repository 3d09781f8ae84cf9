"""What a bridge tells of its PDOs is taken with care: one that tells nonsense ends no program that looks at the fleet."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from canopen_gateway.fleet.fleet import Fleet, FleetAnswer
from canopen_gateway.fleet.keys import PDO, FleetPlace, key_of
from canopen_gateway.fleet.news import FleetPdo
from tests.loops import loop
from tests.master.world import virtual_time

PLACE = FleetPlace("hall", "arm", 5)


def entry(bits: str) -> str:
    return f'{{"object": "6041:00", "name": "statusword", "type": "UNSIGNED16", "bits": {bits}}}'


@pytest.mark.parametrize("told", [[entry("-8"), entry("24")], [entry("1e999")], [entry("NaN")], [entry("0"), entry("16")]])
@virtual_time
async def test_a_pdo_whose_bridge_tells_impossible_lengths_comes_without_values(told: list[str]) -> None:
    fleet = Fleet(None, loop, 1.0)  # type: ignore[arg-type]

    async def ask(place: FleetPlace, *rest: str, **more: Any) -> list[FleetAnswer]:
        return [FleetAnswer(place, f'{{"1": [{", ".join(told)}]}}'.encode(), {})]

    fleet.ask = ask  # type: ignore[method-assign]
    heard: list[Any] = []
    fleet._tell = heard.append  # type: ignore[method-assign]
    for time in range(3):
        payload = time.to_bytes(8, "little") + b"\x40\x02"
        fleet._on_sample(SimpleNamespace(key_expr=key_of(PLACE, PDO, "1"), payload=payload, attachment=None))  # type: ignore[arg-type]
        await loop.sleep(1)
    assert [(type(each), each.values, each.data) for each in heard] == [(FleetPdo, {}, b"\x40\x02")] * 3
