"""What the commands of a fleet share: how they join it, and how places are given."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

import click

from canopen_cli.shared.options import FILE, TextKind, together, without_object
from canopen_gateway.errors import FleetError
from canopen_gateway.fleet import Fleet, FleetPlace, open_fleet, parse_place
from canopen_gateway.fleet.joining import DEFAULT_ENDPOINT, check_endpoint
from canopen_gateway.fleet.keys import check_name

F = TypeVar("F", bound=Callable[..., Any])
FLEET_VARIABLE: Final = "CANOPEN_FLEET"


class Endpoint(TextKind):
    """Where a program of a fleet is: "tcp/192.168.1.20:7447"."""

    name = "endpoint"

    def read(self, text: str) -> str:
        return check_endpoint(text)


class SiteName(TextKind):
    """The name of a computer, as keys of a fleet and topics of a broker have it."""

    name = "name"

    def read(self, text: str) -> str:
        return check_name("site", text)


class PlaceText(TextKind):
    """SITE/BUS/NODE, or SITE/BUS. node: it has to name a node."""

    name = "place"

    def __init__(self, *, node: bool = False) -> None:
        self.node = node

    def read(self, text: str) -> FleetPlace:
        return parse_place(text, node=self.node)


class PlaceOfObject(PlaceText):
    """A node of a fleet, perhaps with an object of it: "hall/arm/5:6041". `with_named_object` has the object."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return super().convert(without_object(value, ctx) if ctx is not None and isinstance(value, str) else value, param, ctx)


def zenoh_file(command: F) -> F:
    """Add the option for Zenoh's own configuration."""
    added: F = click.option(
        "--zenoh",
        "config",
        type=FILE,
        metavar="FILE.json5",
        help="A file of Zenoh's configuration: users, TLS, rules of access (docs/fleet.md).",
    )(command)
    return added


def or_default(endpoints: tuple[str, ...], config: Path | None) -> tuple[str, ...]:
    """Return the endpoints that were named; if neither one was, nor a configuration, the default one."""
    return endpoints or (() if config is not None else (DEFAULT_ENDPOINT,))


class WayIn:
    """How a viewer joins a fleet. connect: bridges and routers."""

    def __init__(self, connect: tuple[str, ...], config: Path | None) -> None:
        self.connect = or_default(connect, config)
        self._config = config

    def open(self) -> AbstractAsyncContextManager[Fleet]:
        """Join the fleet while the block runs, whoever is there."""
        return open_fleet(connect=self.connect, config=self._config)

    def __str__(self) -> str:
        return ", ".join(self.connect) or str(self._config)


joining: Final = together(
    "way_in",
    WayIn,
    click.option(
        "--connect",
        type=Endpoint(),
        multiple=True,
        envvar=FLEET_VARIABLE,
        metavar="ENDPOINT",
        help=f"A bridge or a router; may be repeated.  [default: {DEFAULT_ENDPOINT}; env: {FLEET_VARIABLE}]",
    ),
    zenoh_file,
)
"""The options by which a viewer joins a fleet. The command takes `way_in`: WayIn."""


@asynccontextmanager
async def joined(way_in: WayIn) -> AsyncIterator[Fleet]:
    """Join a fleet while the block runs. Raises FleetError if no bridge is there."""
    async with way_in.open() as fleet:
        await fleet.settled()
        if not fleet.buses:
            raise FleetError(
                "nobody is there",
                seen=f"no bridge showed itself, by {way_in}",
                cause="no bridge runs, or this program may not see it",
                tries=("canopen serve zenoh --site NAME -b BUS --listen tcp/127.0.0.1:7447", "--connect ENDPOINT"),
            )
        yield fleet
