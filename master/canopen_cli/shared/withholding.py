"""`--dry-run` of commands that need no likeness of a drive: what only reads goes out, all else is kept back, answered and shown.

`open_session` puts a `WithholdingTransport` between the master and the bus wherever --dry-run was given. So no command can forget
it: a frame that is not known to read never leaves. For the command to go on to its last frame, what is kept back is answered in
the devices' place, as by devices that take everything:

- an SDO download, by an SDO server in the node's place. What was "written" is read from there afterwards, as --verify does;
- an NMT command: the node's heartbeats come with the state that it would have, and a boot-up follows a reset. A node that "is
  told" to send heartbeats (0x1017) sends one then, and one with each command;
- LSS: the confirmation. A device that "has got" a node-ID boots with it.

A real device may refuse what is accepted here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Final, TypeVar

import trio

from canopen_cli.shared.frames_shown import show_frames
from canopen_cli.shared.options import Settings
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import (
    ERROR_CONTROL,
    MAX_NODE_ID,
    NMT,
    REMOTE,
    SDO_CLIENT_TO_SERVER,
    UNCONFIGURED,
    Frame,
)
from canopen_proto.indices import PRODUCER_HEARTBEAT_TIME
from canopen_proto.lss.messages import FROM_MASTER, FROM_SLAVE, LENGTH, LssService, LssState
from canopen_proto.machine import NEVER, SECOND, Outbox, Time
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.nmt import ALL_NODES, COMMAND_OF_BYTE, NmtCommand, NmtState, target_of
from canopen_proto.parameter_storage import RESTORE, STORE
from canopen_proto.sdo.codec import INITIATES, REQUESTS, SdoFrame, mux_in
from canopen_proto.sdo.server import SdoServer
from canopen_transports.errors import Report
from canopen_transports.loop import AsyncResource
from canopen_transports.record import Record
from canopen_transports.tracing import Named
from canopen_transports.transport import Received

T = TypeVar("T")

RESETS: Final = (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)
_DOWNLOADS: Final = (SdoFrame.DOWNLOAD, SdoFrame.BLOCK_DOWNLOAD)
_CONFIGURING: Final = (
    LssService.CONFIGURE_NODE_ID, LssService.CONFIGURE_BIT_TIMING, LssService.ACTIVATE_BIT_TIMING, LssService.STORE,
)  # fmt: skip
_READING: Final = (2, 3, 4, 5)
"""The command specifiers of what reads: initiate upload, upload segment, abort, block upload. CiA 301 v4.2.0, 7.2.4.3"""
_COMMANDS: Final = frozenset({STORE, RESTORE})
"""Objects that read as something else than what was written: the device's own answer counts."""


@dataclass
class Unsent:
    """The frames of a dry run. records: all that passed, and those that were kept back; the channel of each is its bus. gone_out:
    the places there of those that were really sent. dictionaries: by bus, what gives the dictionary of a node."""

    records: list[Record] = field(default_factory=list)
    gone_out: set[int] = field(default_factory=set)
    dictionaries: dict[str, Callable[[int], ObjectDictionary | None]] = field(default_factory=dict)

    def add(self, bus: str, frame: Frame, *, sent: bool, gone_out: bool = False) -> None:
        """Add a frame, now. sent: by us."""
        if gone_out:
            self.gone_out.add(len(self.records))
        self.records.append(Record(round(trio.current_time() * SECOND), bus, frame, sent))

    def dictionary_of(self, bus: str, node_id: int) -> ObjectDictionary | None:
        """Return the dictionary of a node."""
        return self.dictionaries[bus](node_id)


_unsent: Final[ContextVar[Unsent | None]] = ContextVar("dry run under way", default=None)


class _Written:
    """An `ObjectStore` in a node's place: it takes all, and gives back what it took."""

    def __init__(self) -> None:
        self.values: dict[Mux, bytes] = {}

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode:
        return self.values.get(mux(index, subindex), AbortCode.NO_SUCH_OBJECT)

    def check_write(self, index: int, subindex: int, size: int | None) -> None:
        """Take any size."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> None:
        if index not in _COMMANDS:
            self.values[mux(index, subindex)] = data


class _InPlace:
    """What answers SDO in the place of one node."""

    def __init__(self, node_id: int) -> None:
        self.out = Outbox()
        self.store = _Written()
        self.server = SdoServer(self.out, node_id, self.store)
        self._is_ours = False  # the transfer under way is with us, and not with the node

    def takes(self, frame: Frame) -> bool:
        """Return whether a request is for us: a download, or an upload of what was downloaded."""
        if not frame.data:
            return True  # no client of ours sends it
        kind = REQUESTS[frame.data[0]]
        if not self.server.busy and kind in INITIATES:
            self._is_ours = kind in _DOWNLOADS or mux_in(frame.data.ljust(4, b"\0")) in self.store.values
        return self._is_ours


class Withholding:
    """Which frames go out, and what answers the others. Frames and time in, frames out: no bus, no clock."""

    def __init__(self) -> None:
        self._nodes: dict[int, _InPlace] = {}
        self._states: dict[int, NmtState] = {}
        self._beating: set[int] = set()  # nodes that were "told" to send heartbeats
        self._new_id = UNCONFIGURED  # of the selected LSS slave
        self._present_id = UNCONFIGURED

    def goes_out(self, frame: Frame) -> bool:
        """Return whether a frame only reads: then it is to be sent. Else `answers` has to be asked."""
        if frame.flags & REMOTE:  # node guarding, or a question for a PDO
            return True
        if frame.flags:
            return False
        node_id = frame.can_id - SDO_CLIENT_TO_SERVER
        if 1 <= node_id <= MAX_NODE_ID:
            return not self._node(node_id).takes(frame) and bool(frame.data) and frame.data[0] >> 5 in _READING
        return frame.can_id == FROM_MASTER and bool(frame.data) and frame.data[0] not in _CONFIGURING

    def answers(self, frame: Frame, now: Time) -> list[Frame]:
        """Return what devices would answer to a frame that was kept back, or that went out."""
        node_id = frame.can_id - SDO_CLIENT_TO_SERVER
        if frame.can_id == NMT and len(frame.data) == 2 and frame.data[0] in COMMAND_OF_BYTE:
            return self._on_nmt(COMMAND_OF_BYTE[frame.data[0]], frame.data[1])
        if frame.can_id == FROM_MASTER and frame.data:
            return self._on_lss(frame.data)
        if 1 <= node_id <= MAX_NODE_ID and not frame.flags and self._nodes[node_id].takes(frame):
            place = self._nodes[node_id]
            place.server.receive(frame, now)
            while place.server.deadline <= now and place.server.deadline != NEVER:
                place.server.handle_timeout(now)  # the rest of a burst
            answered, place.out.frames[:] = list(place.out.frames), []
            place.out.events.clear()
            return [*answered, *self._new_heartbeat(node_id)]
        return []

    def heard(self, frame: Frame) -> Frame:
        """Return a frame of the bus as it would be after what was kept back."""
        if frame.can_id == FROM_SLAVE and frame.data[:1] == bytes((LssService.INQUIRE_NODE_ID,)) and len(frame.data) > 1:
            self._present_id = frame.data[1]
        state = self._states.get(frame.can_id - ERROR_CONTROL)
        if state is None or frame.flags or len(frame.data) != 1 or frame.data[0] == NmtState.INITIALISING:
            return frame
        return Frame(frame.can_id, bytes((frame.data[0] & 0x80 | state,)))  # the toggle bit of guarding stays

    def _new_heartbeat(self, node_id: int) -> list[Frame]:
        """Return the first heartbeat of a node that has just been "told" to send them (0x1017)."""
        time = self._node(node_id).store.values.get(mux(PRODUCER_HEARTBEAT_TIME, 0))
        if node_id in self._beating or not time or not any(time):
            return []
        self._beating.add(node_id)
        return [self._heartbeat(node_id)]

    def _heartbeat(self, node_id: int) -> Frame:
        return Frame(ERROR_CONTROL + node_id, bytes((self._states.get(node_id, NmtState.PRE_OPERATIONAL),)))

    def _node(self, node_id: int) -> _InPlace:
        if node_id not in self._nodes:
            self._nodes[node_id] = _InPlace(node_id)
        return self._nodes[node_id]

    def _on_nmt(self, command: NmtCommand, node_id: int) -> list[Frame]:
        is_reset = command in RESETS
        if is_reset:
            self._beating.clear()
        state = NmtState.PRE_OPERATIONAL if is_reset else target_of(command)
        self._states.update(dict.fromkeys(range(1, MAX_NODE_ID + 1) if node_id == ALL_NODES else (node_id,), state))
        if not is_reset:
            return [self._heartbeat(each) for each in sorted(self._beating) if node_id in (ALL_NODES, each)]
        if node_id == ALL_NODES:
            return []
        return [self._boot_up(self._take_new_id() if node_id == self._present_id else node_id)]

    def _on_lss(self, data: bytes) -> list[Frame]:
        service = data[0]
        if service == LssService.CONFIGURE_NODE_ID:
            self._new_id = data[1]
        if service in _CONFIGURING and service != LssService.ACTIVATE_BIT_TIMING:  # which nobody confirms
            return [Frame(FROM_SLAVE, bytes((service,)).ljust(LENGTH, b"\0"))]
        leaves = service == LssService.SWITCH_GLOBAL and data[1] == LssState.WAITING
        if leaves and self._present_id == UNCONFIGURED and self._new_id != UNCONFIGURED:
            return [self._boot_up(self._take_new_id())]
        return []

    def _take_new_id(self) -> int:
        taken, self._new_id = (self._present_id if self._new_id == UNCONFIGURED else self._new_id), UNCONFIGURED
        return taken

    @staticmethod
    def _boot_up(node_id: int) -> Frame:
        return Frame(ERROR_CONTROL + node_id, b"\0")


class WithholdingTransport(AsyncResource):
    """A transport that sends only what reads."""

    def __init__(self, transport: Named, unsent: Unsent, bus: str = "") -> None:
        self.locator = transport.locator
        self._bus = bus
        self._transport = transport
        self._unsent = unsent
        self._rules = Withholding()
        self._answers: deque[Frame] = deque()
        self._waiting: trio.CancelScope | None = None

    async def send(self, frame: Frame) -> None:
        goes_out = self._rules.goes_out(frame)
        self._unsent.add(self._bus, frame, sent=True, gone_out=goes_out)
        if goes_out:
            await self._transport.send(frame)
        else:
            await trio.lowlevel.checkpoint()
        self._answers += self._rules.answers(frame, round(trio.current_time() * SECOND))
        if self._answers and self._waiting is not None:
            self._waiting.cancel()

    async def receive(self) -> Received | Report:
        while not self._answers:
            with trio.CancelScope() as self._waiting:
                try:
                    received = await self._transport.receive()
                finally:
                    self._waiting = None
                return self._heard(received)
        await trio.lowlevel.checkpoint()
        return self._heard((self._answers.popleft(), None))

    async def aclose(self) -> None:
        await self._transport.aclose()

    def _heard(self, received: Received | Report) -> Received | Report:
        if not isinstance(received, tuple):
            return received
        frame = self._rules.heard(received[0])
        self._unsent.add(self._bus, frame, sent=False)
        return frame, received[1]


def withheld(transport: Named, dictionary_of: Callable[[int], ObjectDictionary | None], bus: str = "") -> WithholdingTransport:
    """Return the transport, which from now on sends only what reads. bus: its name, for a command that may have several."""
    unsent = _unsent.get() or Unsent()
    unsent.dictionaries[bus] = dictionary_of
    return WithholdingTransport(transport, unsent, bus)


@contextmanager
def kept_back() -> Iterator[Unsent]:
    """Collects what the commands inside do not send."""
    unsent = Unsent()
    token = _unsent.set(unsent)
    try:
        yield unsent
    finally:
        _unsent.reset(token)


def show_unsent(settings: Settings, screen: Screen, command: Callable[[], Awaitable[T]]) -> T:
    """Run a command without sending what it would send (--dry-run), and show that. Nothing of its result, which is returned, has
    happened.

    Raises what the command raises, once the frames up to there are shown.
    """
    with kept_back() as unsent:
        try:
            result = run(settings, screen, command)
        finally:
            show_frames(settings, screen, unsent.records, unsent.dictionary_of, gone_out=unsent.gone_out)
    screen.say("nothing of this was sent (--dry-run). A device may refuse what is accepted here")
    return result
