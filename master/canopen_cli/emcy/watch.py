"""`canopen emcy watch`: the emergencies of a bus or of a recording, each as a line of words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click
import trio

from canopen_cli.live.frame_lines import Buses
from canopen_cli.live.line_writer import open_line_writer
from canopen_cli.live.source import open_live_source, recorded, tell_skipped
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import NodeId, NodeIds, Settings, command, lasting, until_text
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.running import first_error, run_until_interrupted
from canopen_cli.shared.screen import Screen, counted, escape, node_text
from canopen_master.plain_text import json_text
from canopen_proto.emcy import NO_ERROR
from canopen_proto.error_codes import error_text, register_names
from canopen_transports.record import Record

_LEAST: Final = 2
"""Bytes of an emergency that say what it is. Missing ones count as 0, as in EmcyConsumer."""


@command()
@click.argument("node_id", metavar="[NODE]", type=NodeId(), required=False)
@click.option("--node", "nodes", type=NodeIds(), help="Only from these nodes: 5, or 3-8.")
@recorded
@lasting()
def watch(
    settings: Settings, screen: Screen, node_id: int | None, nodes: tuple[int, ...] | None, source: Path | None, seconds: float
) -> int:
    """Show emergencies in words as they come, of all nodes or of one, until Ctrl-C. Nothing is sent.

    Each line has the error code, what it means, the error register and the maker's bytes. An emergency with the code 0 says that
    errors are gone. Exit status 5: no frame at all was heard.

    \b
    canopen emcy watch -b demo
    canopen emcy watch 5 --for 10s -b can0
    canopen emcy watch --log trace.log --json
    """
    if node_id is not None:
        nodes = (node_id, *(nodes or ()))
    files = NodeFiles(settings, screen)
    counts = _Counts()

    async def show() -> None:
        try:
            with trio.move_on_after(seconds):
                await _show(settings, screen, files, frozenset(nodes or ()), source, counts, seconds)
        finally:
            if source is None or counts.frames:
                screen.say(counted(counts.told, "emergency"))

    run_until_interrupted(settings, screen, show, reads=source)
    if source is None and not counts.frames:
        screen.say("[yellow]no frame at all was heard: that nobody tells of an error says nothing[/]")
        return ExitCode.NO_ANSWER
    return ExitCode.OK


@dataclass
class _Counts:
    """What has come. told: emergencies that were shown."""

    frames: int = 0
    told: int = 0


async def _show(
    settings: Settings,
    screen: Screen,
    files: NodeFiles,
    nodes: frozenset[int],
    source: Path | None,
    counts: _Counts,
    seconds: float,
) -> None:
    async with (
        first_error(),
        open_live_source(settings, source, screen) as live,
        open_line_writer(screen, _gap, waits=not live.is_live, clear=live.clear) as writer,
    ):
        if live.is_live:
            screen.say(f"[bold]{escape(live.name)}[/], {until_text(seconds)}; nothing is sent")
        buses = Buses(files)
        async for heard in live:
            if not isinstance(heard, Record):  # what was lost may have been an emergency
                live.clear()
                screen.say(f"[yellow]{escape(heard.failed)}: {escape(heard.seen)}[/]")
                continue
            counts.frames += 1
            seconds, observation = buses.observe(heard)
            meaning = observation.meaning
            wanted = meaning.service == "EMCY" and len(heard.frame.data) >= _LEAST
            if wanted and (not nodes or meaning.node_id in nodes):
                counts.told += 1
                await writer.put(_line(screen, seconds, heard, meaning.node_id))
        tell_skipped(screen, live)


def _gap(number: int) -> str:
    return f"! {counted(number, 'emergency')} left out here\n"


def _line(screen: Screen, seconds: float, record: Record, node_id: int) -> str:
    data = record.frame.data[:8].ljust(8, b"\0")
    code, register, own = int.from_bytes(data[:2], "little"), data[2], data[3:]
    names = register_names(register)
    if screen.json_output:
        return (
            json_text(
                {
                    "time": record.time,
                    "channel": record.channel,
                    "node": node_id,
                    "code": code,
                    "text": error_text(code),
                    "register": register,
                    "register_names": list(names),
                    "vendor": own.hex(),
                }
            )
            + "\n"
        )
    bits = f"register 0x{register:02X} ({', '.join(names)})" if register else "register 0x00"
    vendor = f", maker's bytes {own.hex(' ')}" if any(own) else ""
    mark = " " if code >> 8 == NO_ERROR else "!"
    return f"{mark} {seconds:10.3f} {node_text(node_id)}: 0x{code:04X} {error_text(code)}; {bits}{vendor}\n"
