"""`canopen lss set-id`, `store` and `assign`: they write to devices, and ask before they do."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import click
import trio

from canopen_cli.lss.support import (
    Lss,
    LssTarget,
    TargetKind,
    address_text,
    device_of,
    estimate,
    knowing,
    limited,
    node_id_text,
    number_of,
    open_lss,
    progress,
    windowed,
)
from canopen_cli.shared.dry_run import run_or_show
from canopen_cli.shared.options import FILE, NodeId, NodeIds, Settings, command, commanding, node_id_of
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.questions import Questions, confirm, require_somebody
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.values import identity_json
from canopen_cli.shared.withholding import show_unsent
from canopen_data.named_files import read_text
from canopen_proto.frame import UNCONFIGURED
from canopen_proto.lss.assign import (
    NOBODY_AGREED,
    Given,
    LssAssignment,
    by_table,
    give,
    in_order,
    nodes_there,
)
from canopen_proto.lss.bit_rate import store_all
from canopen_proto.lss.messages import LssAddress
from canopen_proto.lss.scan import Known
from canopen_proto.machine import Time

GO_ON: Final = "the same command again: it goes on with those that are left"
TABLE_COLUMNS: Final = ("node_id", "vendor", "product", "revision", "serial")


@command("set-id")
@click.argument("device", metavar="DEVICE", type=TargetKind())
@click.argument("node_id", metavar="NODE", type=NodeId())
@click.option("--no-store", is_flag=True, help="Only until the power goes off.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@windowed
@commanding
def set_id(settings: Settings, screen: Screen, device: LssTarget, node_id: int, no_store: bool, yes: bool, window: Time) -> None:
    """Give one device a node-ID, or another one.

    DEVICE: its LSS address, its node-ID, or `only` if it is the only one on the bus. A device that has a node-ID resets its
    communication: PDOs and heartbeat settings that were not stored are lost, and a drive that moves stops.

    \b
    canopen lss set-id 0x360:0x2:0x10000:7 12 -b can0
    canopen lss set-id 5 12 -b can0
    """
    confirm(
        screen,
        f"give a device the node-ID {node_id}; one that has a node-ID now is reset, and a drive stops",
        yes,
        needed=not settings.dry_run,
    )

    begun: list[LssAddress] = []

    def story(confirmed: bool) -> list[str]:
        if not begun:
            return ["nothing was written"]
        return [f"the device may have the new node-ID, now or after its next reset: canopen lss inquire {address_text(begun[0])}"]

    async def change() -> Given:
        async with open_lss(settings, screen, window) as lss:
            address, present = await device_of(lss, device)
            if present != node_id and node_id in await lss.run(nodes_there(lss.tool, [node_id])):
                raise usage(
                    "CO123", f"another node has the node-ID {node_id}", seen="nothing was written",
                    tries=("canopen scan    (which are free?)",),
                )  # fmt: skip
            screen.say(f"{escape(address_text(address))}: node-ID {node_id_text(present)}")
            begun.append(address)
            return await lss.run(give(lss.tool, lss.pace, address, node_id, present=present, store=not no_store))

    _show(settings, screen, [run_or_show(settings, screen, change, story=story)])


@command()
@click.argument("device", metavar="DEVICE", type=TargetKind())
@click.option("--yes", is_flag=True, help="Do not ask.")
@windowed
@commanding
def store(settings: Settings, screen: Screen, device: LssTarget, yes: bool, window: Time) -> None:
    """Let one device store its node-ID and bit rate. DEVICE: see set-id.

    \b
    canopen lss store 5 -b can0
    """
    question = "let the device store its node-ID and bit rate: it has them from its next power-on, too"
    confirm(screen, question, yes, needed=not settings.dry_run)

    async def keep() -> None:
        async with open_lss(settings, screen, window) as lss:
            address, node_id = await device_of(lss, device)
            failed = await lss.run(store_all(lss.tool, lss.pace, [address]))
            if failed:
                raise CommandError(
                    ExitCode.PARTIAL, "CO212", f"{address_text(address)} has not confirmed that it stored", seen=failed[0].remark
                )
            screen.say(f"{escape(address_text(address))}: stored, node-ID {node_id_text(node_id)}")
            if settings.json and not settings.dry_run:
                screen.json({"node": None if node_id == UNCONFIGURED else node_id, **identity_json(address), "stored": True})

    run_or_show(settings, screen, keep)


@command()
@click.option("--ids", "node_ids", type=NodeIds(), help="The node-IDs to give, in this order: 10-20,30.")
@click.option(
    "--table", type=FILE, metavar="FILE.csv",
    help=f"Which device gets which: columns {', '.join(TABLE_COLUMNS)}; an empty number fits any.",
)  # fmt: skip
@click.option("--no-store", is_flag=True, help="Only until the power goes off.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@knowing
@windowed
@limited
@commanding
def assign(
    settings: Settings,
    screen: Screen,
    node_ids: tuple[int, ...] | None,
    table: Path | None,
    no_store: bool,
    yes: bool,
    known: Known,
    window: Time,
    limit: Time,
) -> None:
    """Give all devices without a node-ID theirs, in order or by a table.

    One after the other: it finds a device, shows what it is to get, and asks; the device stores its node-ID and boots before the
    next one is searched. Node-IDs that somebody has are not given. Interrupted, or with devices switched on later: the same
    command again goes on.

    \b
    canopen lss assign --ids 10-20 -b can0
    canopen lss assign --ids 10-20 -b can0 --dry-run     which device would get which, and every frame
    canopen lss assign --table nodes.csv --vendor 0x360 -b can0
    """
    if (node_ids is None) == (table is None):
        raise usage("CO123", "node-IDs in order, or by a table: one of the two", tries=("--ids 10-20", "--table nodes.csv"))
    rows = read_table(table) if table is not None else ()
    choose = by_table(rows) if node_ids is None else in_order(node_ids)
    require_somebody(screen, "write node-IDs into devices", yes or settings.dry_run)
    questions = Questions(screen, agrees=yes or settings.dry_run)

    async def give_all() -> LssAssignment:
        async with open_lss(settings, screen, window, limit) as lss:
            screen.say(f"[dim]{estimate(lss.pace, known)}[/]")
            assignment = LssAssignment(lss.tool, choose, lss.pace, known, not no_store, done)
            await _assign(lss, screen, questions, assignment, is_rehearsal=settings.dry_run)
            given = {each.node_id for each in assignment.done}
            wanted = [node_id for _, node_id in rows if node_id not in given]
            there = await lss.run(nodes_there(lss.tool, wanted)) if wanted else set()
            absent.extend(node_id for node_id in wanted if node_id not in there)
            return assignment

    absent: list[int] = []
    done: list[Given] = []
    if settings.dry_run:
        result = show_unsent(settings, screen, give_all)
        given = ", ".join(f"{each.node_id} to {address_text(each.address)}" for each in result.done)
        screen.say(f"would give {counted(len(result.done), 'node-ID')}{f': {escape(given)}' if given else ''}")
        screen.say("two devices with one address would show only once the first has its node-ID")
    else:
        result = run(settings, screen, give_all, story=lambda confirmed: [*map(_line, done), GO_ON])
    for address, why in result.left.items():
        screen.say(f"[yellow]{escape(address_text(address))} is left alone: {escape(why)}[/]")
    if result.remark:
        screen.say(f"[yellow]{escape(result.remark)}[/]")
    if not settings.dry_run:
        _show(settings, screen, result.done)
    if NOBODY_AGREED in result.left.values():
        raise CommandError(ExitCode.INTERRUPTED, "CO132", f"by you: {counted(len(result.done), 'node-ID')} written")
    if result.unfinished:
        text, _, tries = result.unfinished.partition(" Try: ")
        failed = f"there may be more devices without a node-ID: {text}"
        raise CommandError(ExitCode.PARTIAL, "CO212", failed, tries=(*filter(None, tries.split("; ")), GO_ON))
    if absent:
        failed = f"no device has node-ID {', '.join(map(str, absent))} of {table}"
        step = "look whether these devices are on, and whether their rows have the right numbers"
        raise CommandError(ExitCode.PARTIAL, "CO212", failed, tries=(step, "canopen lss scan"))
    if result.left:
        raise CommandError(
            ExitCode.PARTIAL,
            "CO212",
            f"{counted(len(result.left), 'device')} left without a node-ID",
            tries=("more --ids, or rows",),
        )


async def _assign(lss: Lss, screen: Screen, questions: Questions, assignment: LssAssignment, *, is_rehearsal: bool) -> None:
    """Give node-IDs until nobody is left. is_rehearsal: what is written stays here, so each device has to be put aside."""
    begun = trio.current_time()
    while True:
        async with progress(lss, screen, assignment.known):
            plan = await lss.run(assignment.next_plan())
        if not plan:
            return
        for planned in plan:
            screen.say(f"{escape(address_text(planned.address))} is to get the node-ID [bold]{planned.node_id}[/]")
        if not await questions.may(f"Write {counted(len(plan), 'node-ID')}?"):
            assignment.leave(plan)
            continue
        for planned in plan:
            (given,) = await lss.run(assignment.write([planned]))
            screen.say(escape(_line(given)) if given.is_complete else f"[yellow]{escape(_line(given))}[/]")
            screen.say(f"[dim]{counted(len(assignment.done), 'device')} so far, in {trio.current_time() - begun:.1f} s[/]")
        if is_rehearsal:
            assignment.put_aside(plan)


def read_table(path: Path | None) -> Sequence[tuple[Known, int]]:
    """Read a table of addresses and node-IDs. Raises a CommandError."""
    assert path is not None
    rows: list[tuple[Known, int]] = []
    reader = csv.DictReader(read_text(path).splitlines(), skipinitialspace=True)
    if reader.fieldnames is None or set(reader.fieldnames) - set(TABLE_COLUMNS) or "node_id" not in reader.fieldnames:
        seen = f"line 1: {', '.join(reader.fieldnames)}" if reader.fieldnames else "the file is empty"
        raise _bad_table(f"{path}: its columns are not node_id and some of {', '.join(TABLE_COLUMNS[1:])}", seen)
    lines: dict[int, int] = {}
    for row in reader:
        try:
            numbers = [number_of(text) if (text := (row.get(name) or "").strip()) else None for name in TABLE_COLUMNS[1:]]
            node_id = node_id_of(row["node_id"] or "")
        except CommandError as wrong:
            raise _bad_table(f"{path}:{reader.line_num}: {wrong.failed}") from None
        if node_id in lines:
            raise _bad_table(f"{path}:{reader.line_num}: node-ID {node_id} is in line {lines[node_id]}, too")
        lines[node_id] = reader.line_num
        rows.append(((numbers[0], numbers[1], numbers[2], numbers[3]), node_id))
    return rows


def _bad_table(failed: str, seen: str = "") -> CommandError:
    return CommandError(ExitCode.BAD_FILE, "CO301", failed, seen=seen, tries=("correct the file",))


def _line(given: Given) -> str:
    state = "ready" if given.is_complete else "not ready"
    why = f": {given.remark}" if given.remark else ""
    return f"{address_text(given.address)}: node-ID {given.node_id}, {state}{why}"


def _show(settings: Settings, screen: Screen, done: Sequence[Given]) -> None:
    """Show what became of the devices. Raises a CommandError if it is not all."""
    if settings.json:
        screen.json([_as_json(given) for given in done])
    elif done:
        yes_no = {True: "yes", False: "NO", None: "not wanted"}
        rows = [(str(g.node_id), address_text(g.address), yes_no[g.written], yes_no[g.stored], yes_no[g.booted]) for g in done]
        screen.table(("node", "address", "written", "stored", "booted"), rows, right=("node",))
    unfinished = [given for given in done if not given.is_complete]
    screen.say(f"{counted(len(done) - len(unfinished), 'device')} ready")
    if unfinished:
        first = unfinished[0]
        failed = f"{counted(len(unfinished), 'device')} did not get everything; the first: {address_text(first.address)}"
        raise CommandError(ExitCode.PARTIAL, "CO212", failed, seen=first.remark, tries=_next_steps(first))


def _next_steps(given: Given) -> tuple[str, ...]:
    """Return what may help a device that did not get everything. The same again does not help one that has refused."""
    if given.is_refused and given.stored is False:
        return (
            f"canopen store {given.node_id}    (0x1010: some devices keep their node-ID with their parameters)",
            "the maker's manual: many such devices take their node-ID from switches",
            "--no-store, and this command after each power-up",
        )
    if given.is_refused:
        return ("another node-ID: --ids", "the maker's manual: the device has refused this one")
    if given.written and not given.booted:
        return ("canopen nmt reset-comm --all", "power off and on")
    return ("the same command again: devices that have their node-ID are left alone",)


def _as_json(given: Given) -> dict[str, Any]:
    return {
        "node": given.node_id,
        **identity_json(given.address),
        "written": given.written,
        "stored": given.stored,
        "booted": given.booted,
        "remark": given.remark or None,
        "refused": given.is_refused,
    }
