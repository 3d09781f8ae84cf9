"""Programs of ours on one computer agree who uses the SDO channels of a node: one long transfer at a time on each.

CiA 301 gives each SDO channel one client. The core notices others when their frames meet (sdo/contention.py); this keeps our own
programs from meeting. A program that reads or writes much (a backup, a restore, a program download) claims the node's first
channel, and waits up to LONG for another that has it. One that reads a little waits up to SHORT, and claims nothing. A command
that may stop a drive neither claims nor waits. Who waits longer ends, before anything was sent on that channel, with the name of
the program that has the node.

A program that only reads, and finds the first channel in use, uses a further one that its file gives the device
(further_channels.py), and claims that. One that writes (restore, a program download) wants the node for itself: it claims the
first channel, then the node for writing, and waits until the readers on further channels are done. So no backup holds values of
before and after a restore, and nobody asks a device that is being reset. Each side takes its claim first, and looks for that of
the other side then: both cannot miss each other.

A program that looks after nodes (`canopen net boot`, `net watch`) would reset and start one while it gets another program, and
two of them would reset each other's nodes. So each of these, and a program download, claims the NMT state of its nodes
(`state_claim`): one program at a time. Nothing else is kept from such a node.

A claim is an abstract Unix socket with the name of bus, node and channel. Two programs cannot have the same, and the kernel takes
it back when the process ends, however it ends. It belongs to the network namespace, as a SocketCAN interface does. The kernel
also says which process has it (SO_PEERCRED), and /proc tells its command.

Not claimed: a bus inside one process (`virtual`), a log (`file`), and any bus on a computer without such sockets (all but Linux):
there only the core's hearing remains. The claim is advisory: other makers' programs, and other computers, do not know it.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import AsyncIterator, Iterable
from contextlib import ExitStack, asynccontextmanager, closing
from pathlib import Path
from typing import Final

from canopen_master.claims.further_channels import FurtherChannels
from canopen_master.errors import CHANNEL_TAKEN, NodeError
from canopen_master.plain_text import clean
from canopen_proto.sdo.channels import FURTHER_SERVERS
from canopen_transports import TransportError
from canopen_transports.locator import parse_locator
from canopen_transports.loop import current_loop

LONG: Final = 10.0
"""Seconds that a long transfer waits for another one: as long as a person waits for a command that says nothing."""
SHORT: Final = 2.0
"""Seconds that a short command waits."""
LOOK_AGAIN: Final = 0.05
FIRST: Final = ""
WRITING: Final = "/writing"
NMT_STATE: Final = "/nmt"
_CREDENTIALS: Final = struct.Struct("3i")
"""pid, uid, gid: `struct ucred` of unix(7)."""
_ASKERS: Final = 128
"""Programs that may ask who has a claim: each of them stays in the queue of its socket."""
_LONGEST_BUS: Final = 90
"""Bytes of a bus in the name of a socket, which has 108 with node and part (unix(7))."""
_INSIDE: Final = ("virtual", "file")
_ALIASES: Final = {"localhost": "127.0.0.1", "::1": "127.0.0.1"}


class ChannelTakenError(NodeError):
    """Another program of ours uses the node's SDO channel; nothing was sent over it."""


class _Claims:
    """The claims that this program has on a node. A part is FIRST, WRITING, NMT_STATE, or the index of a further channel."""

    def __init__(self, name: bytes) -> None:
        """name: of bus and node."""
        self._name = name
        self._held: dict[str, socket.socket] = {}

    def take(self, part: str) -> bool:
        """Claim a part. Returns False if another program has it."""
        if part in self._held:
            return True
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            claim.bind(self._name_of(part))
            claim.listen(_ASKERS)
        except OSError:
            claim.close()
            return False
        self._held[part] = claim
        return True

    def release(self, part: str) -> None:
        """Give a claim back."""
        self._held.pop(part).close()

    def has(self, part: str) -> bool:
        """Return whether this program has a part."""
        return part in self._held

    def is_free(self, part: str) -> bool:
        """Return whether no other program has a part."""
        is_free = self.take(part)
        if is_free:
            self.release(part)
        return is_free

    def close(self) -> None:
        """Give all claims back."""
        for part in tuple(self._held):
            self.release(part)

    def holder(self, part: str) -> str:
        """Return who has a part, as in "process 4711 (canopen backup 5 -o before.dcf)"."""
        return _holder(self._name_of(part))

    def _name_of(self, part: str) -> bytes:
        return self._name + part.encode()


@asynccontextmanager
async def channel_claim(
    locator: str,
    node_id: int,
    patience: float = LONG,
    *,
    brief: bool = False,
    writes: bool = False,
    further: FurtherChannels | None = None,
) -> AsyncIterator[None]:
    """Have an SDO channel of a node for as long as the block runs: the first one, or while that is in use a further one.

    locator: of the bus. patience: seconds. brief: claim the first channel only until it is free, for the few reads of a short
    command. writes: have the node for itself. further: the channels to use instead of the first, for a program that only reads;
    the client of its node is on one of them then, and back on the first one afterwards.

    Raises ChannelTakenError if other programs have them for longer than that. Does nothing where there is nothing to claim. With
    `further` also BusError, MasterClosedError.
    """
    name = _name_of(locator, node_id)
    if name is None:
        yield
        return
    with closing(_Claims(name)) as claims:
        until = current_loop().current_time() + patience
        while (blocked := await _blocked(claims, writes, None if writes else further)) is not None:
            if current_loop().current_time() >= until:
                raise _taken(locator, node_id, patience, claims.holder(blocked), further)
            await current_loop().sleep(LOOK_AGAIN)
        is_first = claims.has(FIRST)
        if is_first and brief:
            claims.release(FIRST)
        try:
            yield
        finally:
            if further is not None and not is_first:
                further.leave()


@asynccontextmanager
async def state_claim(locator: str, node_ids: Iterable[int], patience: float = SHORT) -> AsyncIterator[None]:
    """Have the NMT states of nodes for as long as the block runs. locator: of their bus. patience: seconds.

    Raises ChannelTakenError if another program has that of one of them for longer than that. Does nothing where there is nothing
    to claim.
    """
    until = current_loop().current_time() + patience
    with ExitStack() as stack:
        for node_id in node_ids:
            name = _name_of(locator, node_id)
            if name is None:
                continue
            claims = stack.enter_context(closing(_Claims(name)))
            while not claims.take(NMT_STATE):
                if current_loop().current_time() >= until:
                    raise _state_taken(locator, node_id, claims.holder(NMT_STATE))
                await current_loop().sleep(LOOK_AGAIN)
        yield


async def _blocked(claims: _Claims, writes: bool, further: FurtherChannels | None) -> str | None:
    """Try to have a channel. Returns the part that another program has; None if we have what we want."""
    if claims.take(FIRST):
        if not writes:
            return None
        if not claims.take(WRITING):  # a reader looks, for an instant
            return WRITING
        return next((part for part in map(_part, FURTHER_SERVERS) if not claims.is_free(part)), None)
    if further is not None:
        for index in further.candidates:
            part = _part(index)
            if claims.take(part):
                if claims.is_free(WRITING) and await further.enter(index, lambda: claims.holder(FIRST)):
                    return None
                claims.release(part)
    return FIRST


def _part(index: int) -> str:
    return f"/{index:04X}"


def _taken(locator: str, node_id: int, patience: float, holder: str, further: FurtherChannels | None) -> ChannelTakenError:
    seen = f"{holder}, for {patience:g} s at least"
    if further is not None:
        seen += "".join(f"; its further channel 0x{index:04X} {why}" for index, why in further.unusable.items())
    return ChannelTakenError(
        CHANNEL_TAKEN,
        node_id,
        locator,
        f"another program uses the SDO channel of node {node_id} on {locator}; nothing was sent over it",
        seen=seen,
        cause="two transfers at once on one channel disturb each other",
        tries=("wait until it is done, and give the same command again", "end it"),
    )


def _state_taken(locator: str, node_id: int, holder: str) -> ChannelTakenError:
    return ChannelTakenError(
        CHANNEL_TAKEN,
        node_id,
        locator,
        f"another program resets and starts node {node_id} on {locator}, or writes a program into it; nothing was sent to it",
        seen=holder,
        cause="a reset in the middle leaves a device without a program; two masters undo what each other does",
        tries=("wait until it is done, and give the same command again", "end it"),
    )


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
    bus = f"\0canopen/{parts.interface}:{_ALIASES.get(host, host)}{colon}{rest}".encode()
    return bus[:_LONGEST_BUS] + f"/{node_id}".encode()


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
