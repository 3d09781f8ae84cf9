"""Shared by the commands of `canopen lss`: the tool on the bus, addresses as they are typed, progress."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import click
import trio
from rich.progress import BarColumn, Progress, TextColumn

from canopen_cli.shared.chosen_machine import NUMBER
from canopen_cli.shared.options import Duration, Kind, Settings, TextKind, node_id_of, together
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.screen import Screen, escape
from canopen_cli.shared.session import BusSession, open_session
from canopen_proto import indices
from canopen_proto.lss.assign import LssNotSelectedError, found_device
from canopen_proto.lss.master import WINDOW
from canopen_proto.lss.messages import UNCONFIGURED, LssAddress
from canopen_proto.lss.scan import (
    DEVICE_LIMIT,
    NUMBERS,
    Known,
    LssError,
    LssFound,
    LssProgress,
    LssTool,
    Pace,
    duration_of,
)
from canopen_proto.machine import SECOND, Time
from canopen_proto.procedures.steps import Procedure

T = TypeVar("T")

ONLY: Final = "only"
MAX_TEXT: Final = 0xFFFF_FFFF


@dataclass
class Lss:
    """An open session with a tool for LSS."""

    session: BusSession
    tool: LssTool
    pace: Pace

    async def run(self, procedure: Procedure[T]) -> T:
        """Run a procedure; LssError and LssNotSelectedError become a CommandError."""
        try:
            return await self.session.master.run(procedure)
        except (LssError, LssNotSelectedError) as failed:
            text, _, tries = str(failed).partition(" Try: ")
            raise CommandError(
                ExitCode.NO_ANSWER, "CO211", text, tries=tries.split("; ") if tries else ("canopen lss scan", "canopen scan")
            ) from failed


@asynccontextmanager
async def open_lss(settings: Settings, screen: Screen, window: Time, limit: Time = DEVICE_LIMIT) -> AsyncIterator[Lss]:
    """Open the bus of the options, with a tool for LSS on it. window: ns, how long silence has to last. limit: ns for one
    device."""
    async with open_session(settings, screen) as session:
        tool = LssTool(session.network.out)
        session.network.attach(tool)
        try:
            yield Lss(session, tool, Pace(window=window, device_limit=limit))
        finally:
            session.network.detach(tool)


class Unsigned32(TextKind):
    """An UNSIGNED32: decimal, or hexadecimal with 0x."""

    name = "number"

    def read(self, text: str) -> int:
        return number_of(text)


class NumberBounds(TextKind):
    """Two UNSIGNED32, inclusive: "1-100"; or one."""

    name = "a-b"

    def read(self, text: str) -> tuple[int, int]:
        first, dash, last = text.partition("-")
        low = number_of(first)
        return low, number_of(last) if dash else low


def number_of(text: str) -> int:
    """Return the UNSIGNED32 in a text. Raises a CommandError."""
    try:
        number = int(text.strip(), 0)
    except ValueError:
        number = -1
    if not 0 <= number <= MAX_TEXT:
        raise usage("CO120", f"{text!r} is not a number of an LSS address", tries=("0x360, or decimal: 864",))
    return number


@dataclass(frozen=True)
class LssTarget:
    """One device: by its LSS address, by its node-ID, or the only one on the bus (both None)."""

    address: LssAddress | None = None
    node_id: int | None = None


class TargetKind(Kind):
    """A device: "0x360:0x2:0x10000:7" (vendor-ID, product code, revision, serial number), a node-ID, or "only"."""

    name = "device"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> LssTarget:
        if isinstance(value, LssTarget):
            return value
        text = str(value).strip()
        if text == ONLY:
            return LssTarget()
        parts = text.split(":")
        if len(parts) == NUMBERS:
            return LssTarget(LssAddress(*map(number_of, parts)))
        if len(parts) > 1:
            raise usage("CO120", f"{text!r} is not an LSS address, which has {NUMBERS} numbers", tries=("0x360:0x2:0x10000:7",))
        settings = None if ctx is None else ctx.find_object(Settings)
        if not NUMBER.fullmatch(text) and (settings is None or settings.machine_file() is None):
            raise usage(
                "CO120", f"{text!r} is no device: neither an LSS address, nor a node-ID, nor `{ONLY}`",
                tries=("0x360:0x2:0x10000:7", "5", f"{ONLY}    (it is the only device on the bus)"),
            )  # fmt: skip
        return LssTarget(node_id=node_id_of(text) if settings is None else settings.node_id(text))


windowed: Final = click.option(
    "--window",
    type=Duration(2_000_000),
    default=WINDOW,
    help=f"How long silence has to last to count.  [default: {WINDOW // 10**6}ms; slow or busy buses need more]",
)
limited: Final = click.option(
    "--limit",
    type=Duration(SECOND),
    default=DEVICE_LIMIT,
    help=f"The longest time to find one device.  [default: {DEVICE_LIMIT // SECOND}s]",
)
_NUMBERS: Final = {"vendor": "vendor-ID", "product": "product code", "revision": "revision", "serial": "serial number"}


def _known(vendor: int | None, product: int | None, revision: int | None, serial: int | None) -> Known:
    return vendor, product, revision, serial


knowing: Final = together(
    "known",
    _known,
    *(
        click.option(f"--{name}", type=Unsigned32(), help=f"The {text} of the devices, if it is known: quicker.")
        for name, text in _NUMBERS.items()
    ),
)
"""The options for known numbers of an address. The command takes `known`."""


def address_text(address: LssAddress) -> str:
    """Return an address as it is typed."""
    return ":".join(f"0x{number:X}" for number in address)


def node_id_text(node_id: int) -> str:
    """Return a node-ID, or that there is none."""
    return "none" if node_id == UNCONFIGURED else str(node_id)


async def device_of(lss: Lss, target: LssTarget) -> tuple[LssAddress, int]:
    """Return address and node-ID of a device. No device is selected then, however it ends. Raises a CommandError."""
    if target.node_id is not None:
        node = lss.session.node(target.node_id)
        numbers = [int.from_bytes(await node.read_bytes(indices.IDENTITY_OBJECT, each), "little") for each in (1, 2, 3, 4)]
        target = LssTarget(LssAddress(*numbers))
    return await lss.run(found_device(lss.tool, lss.pace, target.address))


def estimate(pace: Pace, known: Known) -> str:
    """Return how long one device takes, in words."""
    least, greatest = (time / SECOND for time in duration_of(known, pace))
    return f"{least:.1f} to {greatest:.1f} s for each device, more if answers are late or lost"


@asynccontextmanager
async def progress(lss: Lss, screen: Screen, known: Known) -> AsyncIterator[None]:
    """Tell each device that is found; on a terminal also show how far the search for the next one is."""
    async with trio.open_nursery() as nursery:
        with lss.session.master.events(LssFound) as found, lss.session.master.events(LssProgress) as steps:
            nursery.start_soon(_tell, screen, found)
            if screen.draws:
                nursery.start_soon(_draw, screen, steps, duration_of(known, lss.pace))
            yield
            await trio.sleep(0)
        nursery.cancel_scope.cancel()


async def _tell(screen: Screen, found: Any) -> None:
    async for event in found:
        screen.say(f"found {escape(address_text(event.address))}")


async def _draw(screen: Screen, steps: Any, times: tuple[Time, Time]) -> None:
    columns = (TextColumn("asking"), BarColumn(30), TextColumn("{task.fields[left]}"))
    with Progress(*columns, console=screen.err, transient=True, auto_refresh=False) as drawn:
        task = drawn.add_task("lss", total=NUMBERS, left="")
        start, done = trio.current_time(), 0
        while True:
            for event in steps.take():
                done = event.done % NUMBERS
                start = trio.current_time() if done == 0 else start
            spent = trio.current_time() - start
            bounds = " to ".join(f"{max(0.0, time / SECOND - spent):.0f}" for time in times)
            drawn.update(task, completed=done, left=f"{bounds} s for this device")
            drawn.refresh()
            await trio.sleep(0.1)
