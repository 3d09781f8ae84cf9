"""`canopen log`: record, convert, replay, count and decode log files of CAN buses. `--trace FILE` of any command records one."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import click
import trio

from canopen_cli.live import log_diff, log_export, log_plot, log_record
from canopen_cli.live.frame_lines import Buses, FrameChoice, FrameLines, WantedFrames, choosing
from canopen_cli.live.log_traffic import traffic_in
from canopen_cli.live.monitor import FrameMonitor
from canopen_cli.live.reading import FileReading, watched
from canopen_cli.live.source import (
    FILE_OR_INPUT,
    frames_of,
    overrun_text,
    rate_of,
    reader_of,
    tell_jumps,
    tell_skipped,
)
from canopen_cli.live.window import Window, clocked, time_of_day, windowed
from canopen_cli.shared.lazy import NamingGroup
from canopen_cli.shared.new_files import check_new_file
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import DEMO, FILE, Settings, command, commanding
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.questions import confirm
from canopen_cli.shared.running import run, same_file
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_master.monitor_words import event_text, finding_text
from canopen_master.plain_text import json_text
from canopen_proto.machine import SECOND
from canopen_proto.observer.finding import BusFinding
from canopen_proto.observer.observer import LOAD_LIMIT, RULES
from canopen_proto.observer.story import KINDS, Story
from canopen_transports import open_transport
from canopen_transports.locator import bitrate_text, parse_locator
from canopen_transports.log_files import LOSSES, LogFileError, LogReader, kind_of, log_writer
from canopen_transports.receive_test import NO_WIRE
from canopen_transports.record import Record, RecordClock

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


@click.group(cls=NamingGroup)
def log() -> None:
    """Log files of CAN buses: .log and .txt (candump's), .asc, .blf, .trc, .pcap, .pcapng.

    `canopen log record` makes one; so does any command, by --trace FILE.
    """


for each in (log_record.record, log_export.export, log_plot.plot, log_diff.diff):
    log.add_command(each)


@command(group=log)
@click.argument("source", type=FILE)
@click.argument("target", type=FILE)
@windowed
def convert(settings: Settings, screen: Screen, source: Path, target: Path, window: Window) -> int:
    """Convert a log file to another kind, which the names tell. Records that this kind cannot hold are counted.

    \b
    canopen log convert trace.blf trace.log
    canopen log convert trace.log short.log --since 12:00:05 --until 12:01:00
    """
    if same_file(source, target):
        raise usage("CO123", "a file cannot be converted into itself", tries=(f"canopen log convert {source} other.log",))
    check_new_file(settings, screen, target)
    reader, kind = LogReader(source), kind_of(target)
    records = watched(screen, reader, records_in(reader, window))
    first = list(islice(records, 1))  # if the source cannot be read, an older target stays
    writer = log_writer(target)
    count = 0
    overruns = 0
    try:
        for part in (first, records):
            for record in part:
                if reader.overruns > overruns:  # who reads the copy has to know, too
                    overruns = reader.overruns
                    writer.lost(record.time, record.channel)
                writer.write(record)
                count += 1
    except LogFileError:
        screen.say(f"what could be read, {counted(count - writer.left_out, 'frame')}, is in {escape(str(target))}")
        raise
    finally:
        writer.close()
    screen.say(f"{counted(count - writer.left_out, 'frame')}: [bold]{escape(str(target))}[/]")
    if LOSSES[kind]:
        screen.say(f"[dim]{kind}: {LOSSES[kind]}[/]")
    tell_skipped(screen, reader)
    if settings.json:
        counts = {"frames": count - writer.left_out, "left_out": writer.left_out, "skipped": reader.skipped}
        screen.json({"file": str(source), "output": str(target), **counts})
    if writer.left_out:
        screen.say(f"[yellow]{counted(writer.left_out, 'frame')} left out[/]; .log holds them")
        return ExitCode.PARTIAL
    return ExitCode.OK


@command(group=log)
@click.argument("source", metavar="FILE", type=FILE)
@click.option("--speed", default="1", show_default=True, metavar="FACTOR", help="10 is ten times as fast; max: without waiting.")
@click.option("--only-sent", is_flag=True, help="Only what the recorder sent, such as a master's side.")
@click.option("--channel", metavar="NAME", help="Of a file with several buses: the one whose frames are sent.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@windowed
@commanding
def replay(
    settings: Settings, screen: Screen, source: Path, speed: str, only_sent: bool, channel: str | None, yes: bool, window: Window
) -> None:
    """Send the frames of a file to a bus again. DRIVES MAY MOVE: what a master said then is a command now.

    Only frames of one bus are sent. A file with several buses needs --channel: else a frame for node 5 of one bus would reach
    node 5 of another.

    \b
    canopen log replay trace.log -b socketcan:vcan0                  a bus with a wire asks first
    canopen log replay trace.log -b can0 --since 12s --dry-run    what would be sent, in words; the bus is not opened
    """
    bus = settings.required_bus("-b tcp                         the bus of `canopen bus serve`")
    try:
        factor = None if speed == "max" else float(speed)
    except ValueError:
        factor = 0.0
    if factor is not None and not 0 < factor < 1e9:
        raise usage("CO001", f"the speed {speed!r} is neither a positive number nor max", tries=("--speed 10",))
    if bus == DEMO and not settings.dry_run:
        raise usage(
            "CO123",
            "log replay sends on a bus that others hear, and -b demo is inside one process",
            tries=("-b tcp    the bus of `canopen bus serve`", f"canopen log replay {source} -b {bus} --dry-run"),
        )
    reader = LogReader(source)

    def chosen(reader: LogReader) -> Iterator[Record]:
        for record in records_in(reader, window):
            if (record.sent or not only_sent) and channel in (None, record.channel):
                yield record

    _check_channel(source, channel, {record.channel: None for record in _readable(chosen(LogReader(source)))})
    if settings.dry_run:
        _show_replay(settings, screen, chosen(reader))
        tell_skipped(screen, reader)
        return
    confirm(screen, f"send the frames of {source} on {bus}: DRIVES MAY MOVE", yes, needed=_may_have_drives(bus))

    async def play() -> int:
        count, clock = 0, RecordClock()
        async with await open_transport(bus) as transport:
            start, first = trio.current_time(), None
            for record in FileReading(screen, reader, chosen(reader), look_each=1):
                now = clock.set(record.time)
                first = now if first is None else first
                if factor is not None:
                    await trio.sleep_until(start + (now - first) / SECOND / factor)
                await transport.send(record.frame)
                count += 1
        return count

    count = run(settings, screen, play, reads=source)
    screen.say(f"{counted(count, 'frame')} sent on {escape(bus)}")
    tell_skipped(screen, reader)
    if settings.json:
        screen.json({"file": str(source), "bus": bus, "frames": count, "skipped": reader.skipped})


@command(group=log)
@click.argument("source", metavar="FILE", type=FILE_OR_INPUT)
@click.option("--bitrate", metavar="RATE", default="500k", show_default=True, help="For the load of the bus: 1M, 250k.")
@windowed
def stats(settings: Settings, screen: Screen, source: Path, bitrate: str, window: Window) -> None:
    """Count the frames of a file: number, rate and bus load of each CAN-ID. Of a file with several buses each is counted apart.

    Rates are those of the part that --since and --until name; else from the first frame to the last, if that is a second.

    \b
    canopen log stats trace.log
    canopen log stats trace.log --bitrate 1M --since 10s --until 20s
    """
    rate = rate_of(bitrate)
    reader = reader_of(source)
    traffic = traffic_in(screen, reader, window)
    ids, seconds = traffic.ids, traffic.elapsed / SECOND
    rows = [
        (each.can_id, each.service, each.node_id, each.frames, traffic.per_second(each.frames),
         traffic.per_second(each.bits / rate * 100))
        for each in ids
    ]  # fmt: skip
    loads = {
        channel: traffic.per_second(sum(each.bits for each in ids if each.channel == channel) / rate * 100)
        for channel in traffic.channels
    }
    total = sum(each.frames for each in ids)
    if settings.json:
        names = ("can_id", "service", "node", "frames", "per_second", "load_percent")
        shown = [{"channel": each.channel, **dict(zip(names, row, strict=True))} for each, row in zip(ids, rows, strict=True)]
        busiest = max((load for load in loads.values() if load is not None), default=None)
        counts = {"frames": total, "seconds": seconds, "bitrate": rate, "load_percent": busiest, "skipped": reader.skipped}
        screen.json({**counts, "ids": shown})
        return
    columns = ("CAN-ID", "service", "node", "frames", "per second", "load %")
    for channel, load in loads.items():
        texts = [
            (name, service, str(node or ""), str(count), _text(each), _text(share))
            for traffic_of_id, (name, service, node, count, each, share) in zip(ids, rows, strict=True)
            if traffic_of_id.channel == channel
        ]
        screen.table(columns, texts, right=columns[2:])
        number = sum(each.frames for each in ids if each.channel == channel)
        rates = f"{_text(traffic.per_second(number))} a second, load {_text(load)} % at {bitrate_text(rate)}"
        what = counted(number, "frame") if len(loads) == 1 else f"{escape(channel)}: {counted(number, 'frame')}"
        screen.data(f"{what} in {seconds:.6g} s, {rates if traffic.span else 'too short for a rate'}")
    tell_jumps(screen, traffic.jumps)
    tell_skipped(screen, reader)


@command(group=log)
@click.argument("source", metavar="FILE", type=FILE_OR_INPUT)
@choosing
@windowed
@clocked
def decode(settings: Settings, screen: Screen, source: Path, wanted: WantedFrames, window: Window, clock: bool) -> None:
    """Say what each frame in a file means; - is standard input. `canopen monitor` shows a bus like this.

    PDOs are decoded by the mapping that the recording shows, else by the devices' own files, else by PDOs.csv. A line that begins
    with ! says what is wrong with the frame before it. A line that begins with = sums up frames before it: a fastscan (-v shows
    its frames), or what a node was told behind its boot-up.

    \b
    canopen log decode trace.log
    canopen log decode trace.log -e 5=drive.eds --node 5 --service sdo
    canopen log decode trace.log --clock --since 12:00:05 --until 12:00:06
    candump can0 | canopen log decode -
    """
    choice = FrameChoice(NodeFiles(settings, screen), wanted)
    watch = FrameMonitor(settings, screen, choice, source, window, clock=clock)
    run(settings, screen, watch.show, reads=source)
    watch.tell_passed_over()
    watch.tell_skipped()


@command(group=log)
@click.argument("source", metavar="FILE", type=FILE_OR_INPUT)
@click.option("--bitrate", metavar="RATE", default="", help="Look at the load of the bus, too: 1M, 250k.")
@click.option(
    "--limit",
    default=LOAD_LIMIT * 100,
    metavar="PERCENT",
    show_default=True,
    type=click.FloatRange(1, 100),
    help="Of the load, in %.",
)
@windowed
@clocked
def check(settings: Settings, screen: Screen, source: Path, bitrate: str, limit: float, window: Window, clock: bool) -> int:
    """Say what happened on the bus that a file was recorded on, and what was wrong there; - is standard input.

    All in the order of time: boot-ups, emergencies, drives in fault, nodes that fell silent and came back, aborted SDO transfers.
    What of these repeats is told once, and counted. And findings: what is against the standard. "certain": nothing else can
    look like this. "likely": frames that are missing from the recording might.

    What stands before --since is looked at, and not told. Exit status 1 if anything was wrong. A boot-up is wrong only in the
    middle of operation. An abort is not wrong if the object does not exist, or if a client has waited for a node that nobody
    has heard: many programs look for what may be missing.

    \b
    canopen log check trace.log
    canopen log check trace.log -e 5=drive.eds --bitrate 500k
    """
    rate = rate_of(bitrate) if bitrate else 0
    files = NodeFiles(settings, screen)
    reader, buses = reader_of(source), Buses(files, bitrate=rate, load_limit=limit / 100)
    stories: dict[str, Story] = {}  # by channel
    counts: Counter[tuple[str, bool]] = Counter()  # by rule, and whether it is certain
    number = shown = overruns = 0
    failure: LogFileError | None = None

    def readable() -> Iterator[Record]:
        nonlocal failure
        try:
            yield from frames_of(reader)
        except LogFileError as error:  # what could be read is told: a recorder that was killed leaves half a line
            failure = error

    def tell(record: Record, seconds: float, text: str, fields: dict[str, object]) -> None:
        """Tell what has happened, or what is wrong, at a frame."""
        at = f"{time_of_day(record.time):>12}" if clock else f"{seconds:12.6f}"
        where = {"time": record.time, "channel": record.channel, "frame": str(record.frame)}
        line = json_text(where | fields) if settings.json else f"{at} {record.frame!s:<25} {text}"
        screen.out.out(line, highlight=False)

    first, is_begun = None, False
    seconds = 0.0
    reading = FileReading(screen, reader, readable())
    for number, record in enumerate(reading, 1):
        first = record.time if first is None else first
        is_in = window.has(record.time, first)
        if is_begun and not is_in:
            overruns = reader.overruns
            continue
        if is_in and not is_begun:
            is_begun = True
            for each in stories.values():
                each.forget_told()
        if number % 256 == 0:
            screen.check_reader()
        if reader.overruns > overruns:  # several recorders may be one file: which one lost frames is not looked at
            overruns = reader.overruns
            buses.lost(overrun_text(reader), is_finding=True)
        seconds, observation = buses.observe(record)
        findings = observation.findings
        story = stories.get(record.channel)
        if story is None:
            story = stories[record.channel] = Story()
        events = story.add(record.frame, observation, buses.time)
        shown += is_in
        if not (is_in and (events or findings)):
            continue
        reading.clear()
        for event in events:
            tell(record, seconds, event_text(event), {"event": event.kind, "node_id": event.node_id, "text": event.text})
        for finding in findings:
            counts[finding.rule, finding.is_certain] += 1
            tell(record, seconds, finding_text(finding), finding._asdict())
    if failure is not None and not number:
        raise failure
    window.require(source)
    if reader.overruns > overruns and window.until is None:  # behind the last frame; or somewhere, as a capture says at its end
        finding = BusFinding("missing", 0, f"frames are missing: {overrun_text(reader)}")
        counts[finding.rule, finding.is_certain] += 1
        tell(record, seconds, finding_text(finding), finding._asdict())
    total = sum(counts.values())
    events_told = _summed(story.told for story in stories.values())
    repeated = _summed(story.repeated for story in stories.values())
    for kind in sorted(events_told.keys() | repeated.keys()):
        again = f", and {counted(repeated[kind], 'time')} more" if repeated[kind] else ""
        screen.say(f"{events_told[kind]:>7} x [bold]{kind}[/]: {KINDS[kind]}{again}")
    for (rule, is_certain), count in sorted(counts.items()):
        screen.say(f"{count:>7} x [bold]{rule}[/]{'' if is_certain else ' (likely)'}: {RULES[rule]}")
    totals = [counted(sum(events_told.values()), "event")] if events_told else []
    if total:
        likely = sum(count for (_, is_certain), count in counts.items() if not is_certain)
        totals.append(f"{counted(total, 'finding')}{f' ({total - likely} certain, {likely} likely)' if likely else ''}")
    screen.say(f"{counted(shown, 'frame')}, {', '.join(totals) or 'no findings'}")
    tell_jumps(screen, buses.jumps)
    tell_skipped(screen, reader)
    if failure is not None:
        raise failure
    return ExitCode.DIFFERENT if counts or any(each.is_wrong for each in stories.values()) else ExitCode.OK


def _readable(records: Iterator[Record]) -> Iterator[Record]:
    """Yield the records before the damage, if there is any: who reads them again meets it at its place."""
    with suppress(LogFileError):
        yield from records


def _check_channel(source: Path, wanted: str | None, channels: Iterable[str]) -> None:
    """Raise a CommandError if frames of several buses would go to one. channels: those that would be sent, of the wanted bus."""
    names = list(channels)
    if wanted is not None and not names:
        raise usage("CO001", f"no frame of {source} that would be sent is of {wanted}", tries=(f"canopen log stats {source}",))
    if len(names) > 1:
        raise usage(
            "CO001",
            f"{source} has frames of several buses, and they would all go to one",
            seen=", ".join(names),
            tries=tuple(f"--channel {each}" for each in names[:4]),
        )


def _may_have_drives(bus: str) -> bool:
    """Return whether a bus has a wire. Those in software are for trying things out."""
    locator = parse_locator(bus)
    return locator.interface not in (*NO_WIRE, "file") and not locator.channel.startswith("vcan")


def _show_replay(settings: Settings, screen: Screen, records: Iterable[Record]) -> None:
    """Show the frames that would be sent, each in words."""
    lines, buses, count = FrameLines(screen), Buses(NodeFiles(settings, screen)), 0
    for count, record in enumerate(records, 1):
        if count % 256 == 0:
            screen.check_reader()
        seconds, observation = buses.observe(record)
        screen.out.out(lines.frame(seconds, record, observation).rstrip("\n"), highlight=False)
    screen.say(f"{counted(count, 'frame')} would be sent; nothing was sent (--dry-run)")


def records_in(reader: LogReader, window: Window) -> Iterator[Record]:
    """Yield the records of a part of a recording."""
    first: int | None = None
    for record in frames_of(reader):
        first = record.time if first is None else first
        if window.has(record.time, first):
            yield record
    window.require(reader.path)


def _summed(counts: Iterable[dict[str, int]]) -> Counter[str]:
    total: Counter[str] = Counter()
    for each in counts:
        total.update(each)
    return total


def _text(number: float | None) -> str:
    return "" if number is None else f"{number:.3g}"
