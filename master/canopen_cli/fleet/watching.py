"""`canopen fleet watch`: what happens in a fleet, a line each."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import click
import trio

from canopen_cli.fleet.joining import PlaceText, WayIn, joined, joining
from canopen_cli.shared.options import Settings, command, lasting
from canopen_cli.shared.running import run_until_interrupted
from canopen_cli.shared.screen import Screen, counted
from canopen_gateway.fleet import FleetEmcy, FleetNews, FleetPdo, FleetPlace, FleetState, PlaceAppeared, PlaceGone
from canopen_master.plain_text import json_text
from canopen_proto.error_codes import error_text


@command()
@click.argument("place", type=PlaceText(), default="*/*")
@click.option("--pdos", is_flag=True, help="The PDOs, too: many lines.")
@lasting()
@joining
def watch(settings: Settings, screen: Screen, place: FleetPlace, pdos: bool, seconds: float, way_in: WayIn) -> None:
    """Tell what happens in a fleet, until Ctrl-C: who comes and goes, states, emergencies.

    PLACE is SITE/BUS, for all of a bus, or SITE/BUS/NODE; * stands for each. All by default.

    \b
    canopen fleet watch 'hall-2/*' --pdos
    """
    kinds: tuple[type[FleetNews], ...] = (PlaceAppeared, PlaceGone, FleetState, FleetEmcy, *((FleetPdo,) if pdos else ()))

    async def look() -> None:
        async with joined(way_in) as fleet:
            with fleet.news(*kinds) as news, trio.move_on_after(seconds):
                screen.say(f"{counted(len(fleet.buses), 'bus')}, {counted(len(fleet.nodes), 'node')}; what happens from now on:")
                async for event in news:
                    if _is_about(event.place, place):
                        told = _told(event)
                        if settings.json:
                            screen.text(json_text({"place": str(event.place), **told}))
                        else:
                            screen.text(f"{event.place}  {_words(event, told)}")
                    if news.dropped:
                        screen.warn(f"{counted(news.dropped, 'event')} lost: they came faster than they were shown")
                        news.dropped = 0

    run_until_interrupted(settings, screen, look)


def _is_about(place: FleetPlace, pattern: FleetPlace) -> bool:
    return place.matches(pattern) if pattern.node_id else place.bus_place.matches(pattern)


def _told(event: FleetNews) -> dict[str, Any]:
    match event:
        case PlaceAppeared():
            return {"event": "appeared"}
        case PlaceGone():
            return {"event": "gone"}
        case FleetState(state=state):
            return {"event": "state", "state": None if state is None else state.name}
        case FleetEmcy():
            return {
                "event": "emergency",
                "time": event.time,
                "code": event.code,
                "text": error_text(event.code),
                "register": event.error_register,
                "data": event.vendor_data.hex(),
            }
        case FleetPdo():
            values = {name: value.hex() if isinstance(value, bytes) else value for name, value in event.values.items()}
            return {"event": "pdo", "time": event.time, "number": event.number, "bytes": event.data.hex(), "values": values}
    return {"event": type(event).__name__}


def _words(event: FleetNews, told: dict[str, Any]) -> str:
    match event:
        case FleetState(state=state):
            return "a state that this program does not know" if state is None else state.name.lower().replace("_", "-")
        case FleetEmcy(code=code):
            return f"emergency 0x{code:04X} {told['text']}, register 0x{event.error_register:02X}, at {_clock(event.time)}"
        case FleetPdo(number=number):
            values = ", ".join(f"{name} {value}" for name, value in told["values"].items())
            return f"PDO {number}: {values or event.data.hex(' ')}"
    return str(told["event"])


def _clock(nanoseconds: int) -> str:
    try:
        return datetime.fromtimestamp(nanoseconds / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (OverflowError, ValueError, OSError):
        return "an impossible time"
