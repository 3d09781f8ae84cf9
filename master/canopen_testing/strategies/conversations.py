"""What goes to and fro: NMT sequences, SDO conversations, concise DCFs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.dictionary.concise import pack_concise
from canopen_proto.frame import NMT, Frame
from canopen_proto.machine import NEVER, Outbox, Time
from canopen_proto.nmt import ALL_NODES, NmtCommand
from canopen_proto.sdo.client import SdoClient
from canopen_proto.sdo.server import SdoServer
from canopen_testing.strategies.identifiers import node_ids
from canopen_testing.strategies.objects import values

_INDICES: Final = st.sampled_from((0x2000, 0x1018, 0x6041)) | st.integers(0x1000, 0xFFFF)


class NmtOrder(NamedTuple):
    """One NMT command to a node, or to all (node_id 0)."""

    command: NmtCommand
    node_id: int

    @property
    def frame(self) -> Frame:
        """The frame that carries it."""
        return Frame(NMT, bytes((self.command, self.node_id)))


def nmt_sequences(
    *, nodes: SearchStrategy[int] | None = None, min_size: int = 0, max_size: int = 10
) -> SearchStrategy[list[NmtOrder]]:
    """Return a strategy for NMT commands in sequence, to single nodes and to all.

    nodes: which ones; None = `node_ids()`. Bounds: min_size to max_size commands. Shrinks towards few of them, each a start of
    all nodes.
    """
    one = st.builds(NmtOrder, st.sampled_from(NmtCommand), st.just(ALL_NODES) | (node_ids() if nodes is None else nodes))
    return st.lists(one, min_size=min_size, max_size=max_size)


@dataclass(frozen=True)
class SdoConversation:
    """One SDO transfer, with every frame of it in order.

    is_upload: the client reads. data: what was read or written; b"" if it was refused. refusal: the abort code of the server, or
    None. in_blocks: by block transfer, else expedited or in segments.
    """

    node_id: int
    index: int
    subindex: int
    is_upload: bool
    data: bytes
    in_blocks: bool = False
    refusal: AbortCode | None = None
    frames: tuple[Frame, ...] = field(default=(), repr=False)

    @property
    def requests(self) -> tuple[Frame, ...]:
        """The client's frames."""
        return tuple(each for each in self.frames if each.can_id >= 0x600)

    @property
    def answers(self) -> tuple[Frame, ...]:
        """The server's frames."""
        return tuple(each for each in self.frames if each.can_id < 0x600)


@st.composite
def sdo_conversations(
    draw: st.DrawFn, *, nodes: SearchStrategy[int] | None = None, max_size: int = 30, blocks: bool = True, refusals: bool = True
) -> SdoConversation:
    """Return a strategy for SDO transfers as a client and a server that keep to the standard have them, on the default channel.

    nodes: whose server; None = `node_ids()`. blocks: block transfers too. refusals: some are aborted by the server too.
    Bounds: 1 to max_size bytes; up to 4 go expedited. Shrinks towards the upload of one zero byte from 0x2000:00 of node 1: two
    frames.
    """
    node_id = draw(node_ids() if nodes is None else nodes)
    index, subindex = draw(_INDICES), draw(st.integers(0, 0xFF))
    is_upload = not draw(st.booleans())
    in_blocks = blocks and draw(st.booleans())
    refusal = draw(st.none() | st.sampled_from(AbortCode)) if refusals else None
    data = draw(st.binary(min_size=1, max_size=max_size))
    server_block_size = draw(st.integers(1, 127)) if in_blocks else 127
    server = SdoServer(Outbox(), node_id, _OneObject(data, refusal), block_size=server_block_size)
    client = SdoClient(Outbox(), node_id)
    if is_upload:
        client.upload(index, subindex, 0, block=in_blocks)
    else:
        client.download(index, subindex, data, 0, block=in_blocks)
    frames = _played(client, server)
    return SdoConversation(node_id, index, subindex, is_upload, b"" if refusal else data, in_blocks, refusal, frames)


class _OneObject:
    """A store in which each object has the same value; or is refused."""

    def __init__(self, data: bytes, refusal: AbortCode | None) -> None:
        self.data = data
        self.refusal = refusal

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode:
        return self.refusal or self.data

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        return self.refusal

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | None:
        return self.refusal


def _played(client: SdoClient, server: SdoServer) -> tuple[Frame, ...]:
    """All frames of the transfer that the client has begun."""
    frames: list[Frame] = []
    now: Time = 0
    while client.busy or client.out.frames or server.out.frames:
        for one, other in ((client, server), (server, client)):
            sent = one.out.frames[:]
            one.out.frames.clear()
            frames += sent
            for frame in sent:
                other.receive(frame, now)
        if not client.out.frames and not server.out.frames and client.busy:
            now = min(each.deadline for each in (client, server) if each.deadline != NEVER)  # the rest of a sub-block
            client.handle_timeout(now)
            server.handle_timeout(now)
    return tuple(frames)


_ANYTHING: Final = st.tuples(_INDICES, st.integers(0, 0xFF), st.binary(max_size=12))


def concise_dcfs(dictionary: ObjectDictionary | None = None, *, max_size: int = 5) -> SearchStrategy[bytes]:
    """Return a strategy for concise DCFs (CiA 302-3, 0x1F22): their bytes. `from_concise` gives the entries.

    dictionary: only its objects that can be written, each once at most, with values of their type and within their limits; None =
    any objects with up to 12 bytes. Bounds: 0 to max_size entries. Shrinks towards none: four zero bytes.
    """
    if dictionary is None:
        return st.lists(_ANYTHING, max_size=max_size).map(pack_concise)
    writable = [variable for variable in dictionary if variable.access.writable]
    if not writable:
        return st.just(pack_concise([]))
    chosen = st.lists(st.sampled_from(writable), max_size=max_size, unique_by=lambda each: each.mux)
    return chosen.flatmap(lambda picked: st.tuples(*map(_entries, picked))).map(pack_concise)


def _entries(variable: Variable) -> SearchStrategy[tuple[int, int, bytes]]:
    return values(variable).map(lambda value: (variable.index, variable.subindex, variable.encode(value)))
