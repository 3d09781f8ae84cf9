"""`canopen emcy history` and `clear`: what a node remembers of its errors, and how it forgets it."""

from __future__ import annotations

from typing import Any, NamedTuple

import click

from canopen_cli.shared.dry_run import run_or_show
from canopen_cli.shared.options import NodeId, Settings, command, commanding
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, node_text
from canopen_cli.shared.session import open_session
from canopen_master.node import Node, number_if_present
from canopen_proto import indices
from canopen_proto.emcy import MAX_HISTORY
from canopen_proto.error_codes import error_text, register_names

COLUMNS = ("", "code", "meaning", "maker's")


class ErrorHistory(NamedTuple):
    """What a node remembers. register: 0x1001. entries: 0x1003 from subindex 1 on, the newest first; None if it has no such
    object."""

    register: int
    entries: tuple[int, ...] | None


@command()
@click.argument("node_id", metavar="NODE", type=NodeId())
def history(settings: Settings, screen: Screen, node_id: int) -> None:
    """Show a node's error register (0x1001) and its last errors (0x1003), the newest first.

    \b
    canopen emcy history 3 -b demo
    """
    found = run(settings, screen, lambda: _read(settings, screen, node_id))
    if settings.json:
        entries = None if found.entries is None else [_as_json(each) for each in found.entries]
        names = list(register_names(found.register))
        screen.json({"node": node_id, "register": found.register, "register_names": names, "history": entries})
        return
    names_text = ", ".join(register_names(found.register)) or "no error"
    screen.fact("error register", f"{names_text}  (0x{found.register:02X})")
    if found.entries is None:
        screen.fact("last errors", "this device has no history (0x1003)")
    elif not found.entries:
        screen.fact("last errors", "none")
    else:
        rows = [(str(number), *_row(each)) for number, each in enumerate(found.entries, start=1)]
        screen.table(COLUMNS, rows, right=("",))


@command()
@click.argument("node_id", metavar="NODE", type=NodeId())
@commanding
def clear(settings: Settings, screen: Screen, node_id: int) -> None:
    """Have a node forget its last errors: 0 is written to 0x1003:00.

    An error that is present stays present: a drive's fault is reset by `canopen drive fault-reset`.

    \b
    canopen emcy clear 3 -b demo
    """
    forgotten = run_or_show(settings, screen, lambda: _clear(settings, screen, node_id))
    if settings.json:
        screen.json({"node": node_id, "forgotten": forgotten})
    else:
        screen.say(f"{node_text(node_id)}: {counted(forgotten, 'error')} forgotten (0x1003:00 = 0)")


async def _read(settings: Settings, screen: Screen, node_id: int) -> ErrorHistory:
    async with open_session(settings, screen) as session, session.turn(node_id):
        node = session.node(node_id)
        register = await _number(node, indices.ERROR_REGISTER, 0)
        count = await _count(node)
        if count is None:
            return ErrorHistory(register, None)
        entries = [await _number(node, indices.PREDEFINED_ERROR_FIELD, number) for number in range(1, count + 1)]
        return ErrorHistory(register, tuple(entries))


async def _clear(settings: Settings, screen: Screen, node_id: int) -> int:
    async with open_session(settings, screen) as session, session.claim_to_write(node_id):
        node = session.node(node_id)
        count = await _count(node)
        await node.write_bytes(indices.PREDEFINED_ERROR_FIELD, 0, b"\0")
        return count or 0


async def _count(node: Node) -> int | None:
    """Return how many errors a node remembers; None if it has no such object."""
    count = await number_if_present(node, indices.PREDEFINED_ERROR_FIELD)
    return None if count is None else min(count, MAX_HISTORY)


async def _number(node: Node, index: int, subindex: int) -> int:
    return int.from_bytes(await node.read_bytes(index, subindex), "little")


def _row(entry: int) -> tuple[str, str, str]:
    code, own = entry & 0xFFFF, entry >> 16
    return f"0x{code:04X}", error_text(code), f"0x{own:04X}" if own else ""


def _as_json(entry: int) -> dict[str, Any]:
    return {"code": entry & 0xFFFF, "text": error_text(entry & 0xFFFF), "vendor": entry >> 16}
