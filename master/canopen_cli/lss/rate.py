"""`canopen lss set-bitrate`: another bit rate for all devices of a bus, and for our interface.

The order is that of canopen_proto/lss/bit_rate.py; here are the search for all devices, the question, and our own
interface: a bus whose locator has a bit rate is opened again with the new one, others need a command (`--interface-command`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import click
import trio

from canopen_cli.lss.support import Lss, address_text, open_lss, progress, windowed
from canopen_cli.shared.options import DEMO, Duration, Settings, command, commanding
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.questions import confirm, require_somebody
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.time_left import time_left
from canopen_cli.shared.values import identity_json
from canopen_master.errors import BusError
from canopen_master.simulation.serving import DEMO_LOCATOR
from canopen_proto.frame import ALL_NODE_IDS
from canopen_proto.lss.assign import found_device
from canopen_proto.lss.bit_rate import DELAY, Refusal, activate, missing, prepare, store_all, take_back
from canopen_proto.lss.messages import BIT_RATES, LssAddress
from canopen_proto.lss.scan import survey
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.manager.scan import LISTEN, duration_of, scan
from canopen_transports import TransportError
from canopen_transports.locator import bitrate_text, parse_bitrate, parse_locator

WITHOUT_RATE: Final = ("virtual", "tcp", "udp_multicast")
"""Buses in software: nothing is to be switched."""
COMMAND_TIME: Final = 10
"""Seconds that the interface command may take."""


class Rate(click.ParamType):  # type: ignore[type-arg, unused-ignore]
    """Takes a bit rate of CiA's table, such as "250k"; gives it in kbit/s."""

    name = "rate"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if isinstance(value, int):
            return value
        try:
            rate, rest = divmod(parse_bitrate(str(value)), 1000)
        except ValueError as error:
            self.fail(str(error), param, ctx)
        if rest or rate not in BIT_RATES.values():
            self.fail(f"{value} is not in CiA's table: {', '.join(bitrate_text(each * 1000) for each in BIT_RATES.values())}")
        return rate


@dataclass
class RateChange:
    """The order. old, new: kbit/s. locators: of our bus before and after. command: switches our interface, "" for none. delay:
    before the switch, ns (`LssMaster.activate_bit_timing`). store: let the devices store the new one.

    story: what has become of the devices so far, for an interruption."""

    old: int
    new: int
    locators: tuple[str, str]
    command: str
    delay: Time
    store: bool
    story: str = "nothing was switched"

    @property
    def way_back(self) -> str:
        """What brings the old bit rate back, whatever was switched."""
        return f"nothing was stored: power off and on brings {self.old} kbit/s back"

    @property
    def back(self) -> RateChange:
        """The way back."""
        return RateChange(self.new, self.old, self.locators[::-1], self.command, self.delay, False)


@command("set-bitrate")
@click.argument("rate", metavar="RATE", type=Rate())
@click.option("--present", type=Rate(), help="The present bit rate, if the name of the bus does not say it.")
@click.option(
    "--delay", type=Duration(0, 65_535 * MILLISECOND), default=DELAY, help="Before and after the switch.  [default: 1s]"
)
@click.option(
    "--interface-command", "command", default="", metavar="COMMAND",
    help="Switches our interface; {bitrate} stands for the new one in bit/s.",
)  # fmt: skip
@click.option("--no-store", is_flag=True, help="Only until the power goes off.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@windowed
@commanding
def set_bitrate(
    settings: Settings, screen: Screen, rate: int, present: int | None, delay: Time, command: str, no_store: bool, yes: bool,
    window: Time,
) -> None:  # fmt: skip
    """Change the bit rate of all devices of a bus.

    Each device is found and selected first: if one does not know LSS, or refuses the new bit rate, nothing is switched. Then all
    switch at once, and our interface with them. Devices that are missing afterwards bring the others back to the old bit rate.
    It is stored at the end only: until then, power off and on is the way back.

    \b
    canopen lss set-bitrate 250k --dry-run -b pcan:PCAN_USBBUS1@500k
    canopen lss set-bitrate 250k --present 500k -b can0 --interface-command "ip link set can0 down && ..."
    """
    change = _change(settings, rate, present, delay, command, not no_store)
    require_somebody(screen, "change the bit rate of all devices", yes or settings.dry_run)

    async def prepare_all() -> list[LssAddress]:
        async with open_lss(settings, screen, window) as lss:
            return await _devices(lss, screen)

    addresses = run(settings, screen, prepare_all, story=lambda confirmed: [change.story])
    _show(screen, change, addresses)
    if settings.dry_run:
        screen.say("dry run: nothing was written")
        _tell_json(settings, screen, change, addresses)
        return
    confirm(screen, f"change the bit rate of {counted(len(addresses), 'device')}; no drive may move meanwhile", yes, needed=True)

    async def carry_out() -> list[Refusal]:
        await _switch(settings, screen, change, addresses, window)
        return await _check(settings, screen, change, addresses, window)

    try:
        failed = run(settings, screen, carry_out, story=lambda confirmed: [change.story])
    except (BusError, TransportError) as lost:
        lost.add_note(change.story)
        raise
    _tell_json(settings, screen, change, addresses, failed)
    if failed:
        seen = "; ".join(f"{address_text(each.address)}: {each.remark}" for each in failed)
        raise CommandError(
            ExitCode.PARTIAL, "CO212", f"{counted(len(failed), 'device')} did not confirm that they stored the new bit rate",
            seen=seen, tries=("canopen lss store NODE", "after power off and on look at each: it may have the old one again"),
        )  # fmt: skip
    screen.say(f"{counted(len(addresses), 'device')} at {rate} kbit/s. Open the bus as {escape(change.locators[1])} from now on")


def _change(settings: Settings, rate: int, present: int | None, delay: Time, command: str, store: bool) -> RateChange:
    bus = settings.required_bus()
    locator = parse_locator(DEMO_LOCATOR if bus == DEMO else bus)
    old = present or (locator.bitrate or 0) // 1000
    if old not in BIT_RATES.values():
        raise usage("CO123", "which bit rate does the bus have now? It is needed for the way back", tries=("--present 500k",))
    has_rate = locator.interface not in (*WITHOUT_RATE, "socketcan")
    if locator.interface == "socketcan" and not command:
        link = f"ip link set {locator.channel}"
        example = f'--interface-command "{link} down && {link} type can bitrate {{bitrate}} && {link} up"    (as root)'
        failed = "the bit rate of a SocketCAN interface is set by the system, and has to change together with the devices'"
        raise usage("CO123", failed, tries=(example,))
    after = bus
    if has_rate:
        address, mark, options = bus.partition("?")
        after = re.sub("@.*", "", address) + f"@{bitrate_text(rate * 1000)}" + mark + options
    return RateChange(old, rate, (bus, after), command, delay, store)


async def _devices(lss: Lss, screen: Screen) -> list[LssAddress]:
    """Return the addresses of all devices on the bus. Raises a CommandError if one cannot be reached by LSS."""
    screen.say("[dim]looking for all devices: nodes, and devices without a node-ID[/]")
    async with time_left(screen, "asking all node-IDs", duration_of(len(ALL_NODE_IDS), listen=LISTEN) / SECOND):
        found = await lss.run(scan(lss.tool.scanner, ALL_NODE_IDS, listen=LISTEN))
    async with progress(lss, screen, (None, None, None, None)):
        surveyed = await lss.run(survey(lss.tool, lss.pace))
    by_node = {node.node_id: LssAddress(*(number or 0 for number in node.identity)) for node in found}
    nodes = list(by_node.values())
    for each in set(nodes).intersection(surveyed.found):  # Lely's take part in a fastscan with a node-ID, too: is it one device?
        await lss.run(found_device(lss.tool, lss.pace, each))
    addresses = [*nodes, *(each for each in surveyed.found if each not in nodes)]
    absent = await lss.run(missing(lss.tool, lss.pace, addresses))
    if absent or not addresses or len(set(addresses)) < len(addresses) or surveyed.again is not None:
        names = [f"node {node_id} ({address_text(each)})" for node_id, each in by_node.items() if each in absent]
        if names:
            seen = f"not selected: {', '.join(names)}"
        elif surveyed.again is not None:
            seen = f"{address_text(surveyed.again)} takes part in the fastscan though it is selected, and may hide others"
        else:
            seen = "two have the same address" if addresses else "no device was found"
        raise CommandError(
            ExitCode.NO_ANSWER, "CO211", "not every device of the bus can be reached by LSS; nothing was written", seen=seen,
            tries=("switch off what does not know LSS, and set its bit rate by hand",),
        )  # fmt: skip
    return addresses


def _tell_json(
    settings: Settings, screen: Screen, change: RateChange, addresses: Sequence[LssAddress], failed: Sequence[Refusal] = ()
) -> None:
    """With --json print what was done. failed: devices that did not confirm that they stored the new bit rate; of one that said
    nothing nobody knows."""
    if not settings.json:
        return
    refusals = {each.address: each for each in failed}
    is_wanted = change.store and not settings.dry_run
    devices = [
        {
            **identity_json(address),
            "stored": _has_stored(refusals.get(address)) if is_wanted else None,
            "remark": refusals[address].remark if address in refusals else None,
        }
        for address in addresses
    ]
    rates = {"before": change.old * 1000, "bitrate": change.new * 1000}
    screen.json({"bus": change.locators[1], **rates, "dry_run": settings.dry_run, "devices": devices})


def _has_stored(refusal: Refusal | None) -> bool | None:
    """Return whether a device has stored; None where only its answer is missing. refusal: None if it has confirmed it."""
    if refusal is None:
        return True
    return None if refusal.is_silent else False


def _show(screen: Screen, change: RateChange, addresses: Sequence[LssAddress]) -> None:
    for address in addresses:
        screen.say(f"  {escape(address_text(address))}: {change.new} kbit/s in place of {change.old}")
    delay = change.delay / SECOND
    screen.say(f"  then all at once: silent for {delay:g} s, switch, silent for {delay:g} s; then look for each of them")
    screen.say(f"  {'then all store it' if change.store else 'nothing is stored'}; our bus: {escape(change.locators[1])}")


async def _switch(settings: Settings, screen: Screen, change: RateChange, addresses: Sequence[LssAddress], window: Time) -> None:
    """Prepare the devices, let them switch, and switch our interface. Raises a CommandError if one refuses: nothing is
    switched."""
    settings.bus = change.locators[0]
    async with open_lss(settings, screen, window) as lss:
        refused = await lss.run(prepare(lss.tool, lss.pace, addresses, change.new, change.old))
        if refused:
            seen = "; ".join(f"{address_text(each.address)}: {each.remark}" for each in refused)
            raise CommandError(
                ExitCode.PARTIAL, "CO212", f"not every device takes {change.new} kbit/s; nothing was switched", seen=seen
            )
        change.story = f"the devices may be at {change.new} kbit/s already, and our interface perhaps is not; {change.way_back}"
        async with time_left(screen, "silent before the switch", change.delay / SECOND):
            try:
                await lss.run(activate(lss.tool, change.delay))
            except CommandError:  # another LSS master is at work: nothing was switched
                await lss.run(take_back(lss.tool, lss.pace, change.old))
                raise
    started = trio.current_time()
    if change.command:
        await _run_command(change)
    change.story = f"the devices were switched to {change.new} kbit/s, and our interface too; {change.way_back}"
    settings.bus = change.locators[1]
    rest = max(0.0, change.delay / SECOND - (trio.current_time() - started))
    async with time_left(screen, "silent behind the switch", rest):
        await trio.sleep(rest)


async def _run_command(change: RateChange) -> None:
    text = change.command.replace("{bitrate}", str(change.new * 1000))
    with trio.move_on_after(COMMAND_TIME):
        ended = await trio.run_process(["/bin/sh", "-c", text], check=False, capture_stderr=True)
        if ended.returncode == 0:
            return
        seen = ended.stderr.decode(errors="replace").strip()
        raise CommandError(
            ExitCode.CANNOT_OPEN, "CO213", f"our interface was not switched to {change.new} kbit/s; the devices were",
            seen=seen, tries=(f"by hand: {text}", "power off and on is the way back: nothing was stored"),
        )  # fmt: skip
    raise CommandError(
        ExitCode.CANNOT_OPEN, "CO213", f"the interface command did not end within {COMMAND_TIME} s; the devices have switched",
        tries=("by hand; nothing was stored: power off and on is the way back",),
    )  # fmt: skip


async def _check(
    settings: Settings, screen: Screen, change: RateChange, addresses: Sequence[LssAddress], window: Time
) -> list[Refusal]:
    """Look for all devices at the new bit rate, and let them store it; return those that did not. If one is missing, bring the
    others back, and raise a CommandError."""
    async with open_lss(settings, screen, window) as lss:
        absent = await lss.run(missing(lss.tool, lss.pace, addresses))
        if not absent:
            if not change.store:
                return []
            change.story = f"the devices are at {change.new} kbit/s; perhaps not all have stored it: canopen lss store, for each"
            return await lss.run(store_all(lss.tool, lss.pace, addresses))
    screen.say(f"[yellow]{counted(len(absent), 'device')} missing at {change.new} kbit/s: back to {change.old}[/]")
    back = [each for each in addresses if each not in absent]
    change.story = f"some devices are at {change.new} kbit/s, others at {change.old}; {change.way_back}"
    if back:
        try:
            await _switch(settings, screen, change.back, back, window)
        except CommandError as refused:
            refused.also = [*refused.also, change.story]
            raise
    elif change.command:
        await _run_command(change.back)
    settings.bus = change.locators[0]
    async with open_lss(settings, screen, window) as lss:
        lost = await lss.run(missing(lss.tool, lss.pace, addresses))
        await lss.run(take_back(lss.tool, lss.pace, change.old))  # those that missed the switch have the new one pending
    seen = f"at {change.new} kbit/s nothing from {', '.join(map(address_text, absent))}; "
    seen += f"back at {change.old} kbit/s, {'all are there' if not lost else 'missing: ' + ', '.join(map(address_text, lost))}"
    raise CommandError(
        ExitCode.PARTIAL, "CO212", f"not every device came to {change.new} kbit/s; nothing was stored", seen=seen,
        tries=("a longer --delay", "power off and on: each device has its old bit rate again"),
    )  # fmt: skip
