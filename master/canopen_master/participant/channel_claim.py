"""Programs of ours on one computer agree who uses the SDO channel of a node: one long transfer at a time.

CiA 301 gives each SDO channel one client. The core notices others when their frames meet (sdo/contention.py); this keeps our own
programs from meeting. A program that reads or writes much (a backup, a restore, a program download) claims the node first, and
waits up to LONG for another that has it. One that reads a little waits up to SHORT, and claims nothing. A command that may stop a
drive neither claims nor waits. Who waits longer ends, before anything was sent, with the name of the program that has the node.

The claim is an abstract Unix socket with the name of bus and node. Two programs cannot have the same, and the kernel takes it
back when the process ends, however it ends. It belongs to the network namespace, as a SocketCAN interface does. The kernel also
says which process has it (SO_PEERCRED), and /proc tells its command.

Not claimed: a bus inside one process (`virtual`), a log (`file`), and any bus on a computer without such sockets (all but Linux):
there only the core's hearing remains. The claim is advisory: other makers' programs, and other computers, do not know it.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final

import trio

from canopen_master.errors import CHANNEL_TAKEN, NodeError
from canopen_master.plain_text import clean
from canopen_transports import TransportError
from canopen_transports.locator import parse_locator

LONG: Final = 10.0
"""Seconds that a long transfer waits for another one: as long as a person waits for a command that says nothing."""
SHORT: Final = 2.0
"""Seconds that a short command waits."""
LOOK_AGAIN: Final = 0.05
_CREDENTIALS: Final = struct.Struct("3i")
"""pid, uid, gid: `struct ucred` of unix(7)."""
_INSIDE: Final = ("virtual", "file")
_ALIASES: Final = {"localhost": "127.0.0.1", "::1": "127.0.0.1"}


class ChannelTaken(NodeError):
    """Another program of ours uses the node's SDO channel; nothing was sent."""


@asynccontextmanager
async def channel_claim(locator: str, node_id: int, patience: float = LONG) -> AsyncIterator[None]:
    """Have the SDO channel of a node for as long as the block runs. locator: of the bus. patience: seconds.

    Raises ChannelTaken if another program has it for longer than that. Does nothing where there is nothing to claim.
    """
    name = _name_of(locator, node_id)
    claim = None if name is None else await _claimed(name, locator, node_id, patience)
    try:
        yield
    finally:
        if claim is not None:
            claim.close()


async def channel_free(locator: str, node_id: int, patience: float = SHORT) -> None:
    """Wait until no program of ours has the SDO channel of a node. Raises ChannelTaken as `channel_claim` does."""
    async with channel_claim(locator, node_id, patience):
        pass


def _name_of(locator: str, node_id: int) -> bytes | None:
    """Return the name of the socket; None where there is nothing to claim."""
    if not hasattr(socket, "SO_PEERCRED"):
        return None
    try:
        parts = parse_locator(locator)
    except TransportError:
        return None
    if parts.interface in _INSIDE:
        return None
    host, colon, rest = parts.channel.partition(":")
    return f"\0canopen/{parts.interface}:{_ALIASES.get(host, host)}{colon}{rest}/{node_id}".encode()[:107]


async def _claimed(name: bytes, locator: str, node_id: int, patience: float) -> socket.socket:
    until = trio.current_time() + patience
    while True:
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            claim.bind(name)
            claim.listen(8)
        except OSError:
            claim.close()
        else:
            return claim
        if trio.current_time() >= until:
            raise ChannelTaken(
                CHANNEL_TAKEN,
                node_id,
                locator,
                f"another program uses the SDO channel of node {node_id} on {locator}; nothing was sent",
                seen=f"{_holder(name)}, for {patience:g} s at least",
                cause="two transfers at once on one channel disturb each other",
                tries=("wait until it is done, and give the same command again", "end it"),
            )
        await trio.sleep(LOOK_AGAIN)


def _holder(name: bytes) -> str:
    """Return who has a claim, as in "process 4711 (canopen backup 5 -o before.dcf)"."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        try:
            asking.setblocking(False)
            asking.connect(name)
            pid, _, _ = _CREDENTIALS.unpack(asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))
        except OSError:
            return "a program that has ended meanwhile, or does not say who it is"
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return f"process {pid}"
    shown = [Path(words[0]).name, *words[1:]]
    if len(shown) > 1 and shown[0].startswith("python"):
        shown = [Path(shown[1]).name, *shown[2:]]
    return f"process {pid} ({clean(' '.join(shown).strip())[:80]})"
