"""`canopen doctor`: find out which buses this computer can reach, what is missing, and what is heard on a bus.

Without -b nothing is opened. With -b the bus is opened, listen-only if the adapter can, and nothing is sent.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any, Final

import click
import trio

from canopen_cli.shared.chosen_machine import BUS_VARIABLE, MACHINE_VARIABLE
from canopen_cli.shared.configuration import configuration_path
from canopen_cli.shared.options import DEMO, Settings, command, lasting, option_group
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.time_left import time_left
from canopen_master.simulation.serving import DEMO_LOCATOR, DEMO_NODES, simulated_drives
from canopen_transports.doctor import DoctorFinding, Health, examine
from canopen_transports.locator import bitrate_text, parse_locator
from canopen_transports.realtime_checks import check_realtime
from canopen_transports.receive_test import BITRATES, NO_WIRE, Each, Heard, find_bitrate, listen

LISTEN: Final = 2.0
"""Seconds: longer than the usual heartbeat time of 1 s."""
SHOWN_IDS: Final = 12
"""CAN-IDs shown in one line."""

_STYLES: Final = {Health.OK: "green", Health.NOTE: "dim", Health.WARNING: "bold yellow"}


LISTENING: Final = "How long to listen on the bus; with --bitrates, at each of them.  [default: 2s]"
bitrates_too: Final = option_group(
    click.option("--bitrates", is_flag=True, help="Find the bit rate: listen at each in turn. For adapters that listen only.")
)
"""The option of both commands that listen at each bit rate. The command takes `bitrates`."""


@command()
@bitrates_too
@lasting(LISTENING, low=0.1, high=3600, default=LISTEN)
def doctor(settings: Settings, screen: Screen, seconds: float, bitrates: bool) -> int:
    """Check adapters, drivers and permissions; with -b also what is heard on a bus. Nothing is sent.

    The lines about real time say what keeps this computer from an exact cycle: docs/realtime.md.

    Exit status: 0 all is well, 1 something needs doing, 3 or 9 the bus cannot be opened, 4 bus
    fault, 5 nothing was heard.

    \b
    canopen doctor
    canopen doctor -b socketcan:can0
    """
    bus = settings.named_bus()
    if bus is None:
        if bitrates:
            raise usage("CO121", "no bus was named", tries=("canopen doctor --bitrates -b pcan:PCAN_USBBUS1",))
        return _examine_computer(settings, screen)
    if bitrates:
        found = run(settings, screen, lambda: try_bitrates(screen, bus, seconds))
        if screen.json_output:
            screen.json(heard_as_json(found) if found is not None else None)
        elif found is not None:
            screen.fact("bus", found.locator)
            screen.fact("heard", f"{counted(found.frames, 'frame')}, no errors")
        return ExitCode.OK if found is not None else ExitCode.DIFFERENT
    heard = run(settings, screen, lambda: hear(screen, bus, seconds))
    if screen.json_output:
        screen.json(heard_as_json(heard))
    else:
        for each in _named(settings):
            screen.detail(f"{each.subject}: {each.seen}")
        show_heard(screen, heard, seconds)
    return status_of(heard)


def _named(settings: Settings) -> list[DoctorFinding]:
    """Return which bus and which machine commands take, and who says so: the first of three counts."""
    written = settings.chosen.configuration
    path = written.path or configuration_path()
    said = {
        "bus": (settings.bus, os.environ.get(BUS_VARIABLE), written.bus),
        "machine": (settings.machine, os.environ.get(MACHINE_VARIABLE), written.machine),
    }
    found = []
    for what, option, variable in (("bus", "-b", BUS_VARIABLE), ("machine", "-m", MACHINE_VARIABLE)):
        places = list(zip((option, f"${variable}", str(path)), said[what], strict=True))
        chosen = next((f"{value}, by {place}" for place, value in places if value), "none")
        rest = "; ".join(f"{place}: {value or 'nothing'}" for place, value in places)
        found.append(DoctorFinding(f"{what} of commands", Health.NOTE, f"{chosen}. The first of these counts: {rest}"))
    return found


def _examine_computer(settings: Settings, screen: Screen) -> int:
    findings, named = [*examine(), *check_realtime()], _named(settings)
    if screen.json_output:
        screen.json([_finding_as_json(each) for each in (*findings, *named)])
    else:
        for each in findings:
            _show_finding(screen, each)
        for each in named:
            screen.detail(f"{each.subject}: {each.seen}")
        buses = [each.locator for each in findings if each.locator and each.health is Health.OK]
        if buses:
            screen.say(f"what is heard there: canopen doctor -b {escape(buses[0])}")
    return ExitCode.DIFFERENT if any(each.health is Health.WARNING for each in findings) else ExitCode.OK


def _show_finding(screen: Screen, finding: DoctorFinding) -> None:
    style = _STYLES[finding.health]
    line = f"[{style}]{finding.health.value:<8}[/]{escape(finding.subject)}: {escape(finding.seen)}"
    screen.out.print(line, soft_wrap=True)
    for number, step in enumerate(finding.tries):
        screen.out.print(f"        {'or:' if number else 'try:':<5}{escape(step)}", soft_wrap=True)


def _finding_as_json(finding: DoctorFinding) -> dict[str, Any]:
    return {
        "subject": finding.subject,
        "health": finding.health.value,
        "seen": finding.seen,
        "try": list(finding.tries),
        "bus": finding.locator,
    }


def status_of(heard: Heard) -> ExitCode:
    """Return the exit status for what was heard."""
    if heard.is_bad:
        return ExitCode.BUS_FAULT
    return ExitCode.OK if heard.frames else ExitCode.NO_ANSWER


async def hear(screen: Screen, bus: str, seconds: float, each: Each = lambda frame, stamp: None) -> Heard:
    """Listen on a bus, or on that of the simulated drives. See `listen` of canopen_transports.receive_test. seconds: how long."""
    async with time_left(screen, f"listening on {bus}", seconds):
        if bus != DEMO:
            return await listen(bus, seconds, each)
        async with simulated_drives((DEMO_LOCATOR, node_id) for node_id in DEMO_NODES):
            return replace(await listen(DEMO_LOCATOR, seconds, each), locator=DEMO)


def show_heard(screen: Screen, heard: Heard, seconds: float) -> None:
    """Show the counts of what was heard, and what to do next. seconds: how long it was listened for."""
    how = "opened to listen only" if heard.listen_only else "opened"
    screen.fact("bus", f"{heard.locator}, {how}")
    screen.fact(
        "heard", f"{counted(heard.frames, 'frame')} in {seconds:g} s" + (f", {heard.lost} more lost" if heard.lost else "")
    )
    if heard.nodes:
        screen.fact("nodes", ", ".join(f"{node} (0x{node:02X})" for node in heard.nodes))
    if heard.ids:
        often = [f"{can_id:03X} {count}x" for can_id, count in heard.ids.most_common(SHOWN_IDS)]
        more = len(heard.ids) - len(often)
        screen.fact("CAN-IDs", ", ".join(often) + (f", and {more} more" if more else ""))
    if heard.first is not None:
        screen.fact("first frame", str(heard.first))
    for state, seen in heard.states:
        screen.fact("reported", f"{state.value}: {seen}")
    if heard.faults:
        screen.fact("error frames", str(heard.faults))
    for number, step in enumerate(_advice(heard)):
        screen.fact("or" if number else "try", step)


def _advice(heard: Heard) -> list[str]:
    locator = parse_locator(DEMO_LOCATOR if heard.locator == DEMO else heard.locator)
    rate = locator.bitrate
    ours = f"the bit rate (ours {bitrate_text(rate)})" if rate else "the bit rate"
    if heard.is_bad:
        steps = [f"check {ours}, CAN-H and CAN-L, termination (60 ohm between them)"]
        return [*steps, f"canopen doctor --bitrates -b {heard.locator}"] if heard.listen_only else steps
    if heard.frames:
        return [f"canopen scan -b {heard.locator}"]
    if locator.interface in NO_WIRE:
        return [
            f"canopen scan -b {heard.locator}   (asks the nodes: devices without a heartbeat are silent)",
            f"somebody else on this bus, in another terminal: canopen sim --id 5 -b {heard.locator}",
        ]
    return [
        f"switch a drive off and on: its boot-up should be heard; if not, check {ours} and the wiring",
        f"canopen scan -b {heard.locator}   (asks the nodes: devices without a heartbeat are silent)",
    ]


def heard_as_json(heard: Heard) -> dict[str, Any]:
    """Return what was heard for --json."""
    return {
        "bus": heard.locator,
        "listen_only": heard.listen_only,
        "frames": heard.frames,
        "lost": heard.lost,
        "nodes": heard.nodes,
        "can_ids": {f"{can_id:03X}": count for can_id, count in sorted(heard.ids.items())},
        "first": str(heard.first) if heard.first is not None else None,
        "error_frames": heard.faults,
        "states": [{"state": state.value, "seen": seen} for state, seen in heard.states],
        "try": _advice(heard),
    }


async def try_bitrates(screen: Screen, bus: str, seconds: float) -> Heard | None:
    """Listen at one bit rate after the other, and tell it; return the first result with frames and without errors, or None.
    seconds: for each."""

    def tell(heard: Heard) -> None:
        screen.say(escape(f"{heard.locator}: {counted(heard.frames, 'frame')}, {counted(heard.faults, 'error')}"))

    async with time_left(screen, "listening at each bit rate, at most", seconds * len(BITRATES)):
        found = await find_bitrate(DEMO_LOCATOR if bus == DEMO else bus, seconds, tell)
    await trio.lowlevel.checkpoint()
    if found is None:
        screen.say("at no bit rate were frames heard without errors: does anything send at all? Try a longer time")
    return found
