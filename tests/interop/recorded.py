"""Recorded bus sessions of other stacks, and how they are replayed to ours.

The recordings (candump logs) are not part of the repository. They are looked for in `$CANOPEN_RECORDED_SESSIONS`, else in
`../shared/logs` beside it; without them the tests are skipped.

`DeviceReplay` hands what the recorded device heard to our LocalNode, at the recorded moments. `MasterReplay` hands what it said
to our RemoteNode, and gives that the commands which the recorded master must have had.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import pytest

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import EMCY, ERROR_CONTROL, NMT, SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, SYNC, TPDO1, TPDO2, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Event, Outcome, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster, NmtState
from canopen_proto.pdo.producer import PdoProducer
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sync import SyncProducer
from tests.interop.recorded_transfers import Transfer, is_initiate, transfers_of

VARIABLE = "CANOPEN_RECORDED_SESSIONS"
FOLDER = Path(os.environ.get(VARIABLE) or Path(__file__).parents[2] / ".." / "shared" / "logs")

needs_recordings = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"no recorded bus sessions: there is no folder {FOLDER} (${VARIABLE} names another)"
)

FROM_DEVICE = (SDO_SERVER_TO_CLIENT, ERROR_CONTROL, EMCY, TPDO1, TPDO2)

PREPARED = 500 * MILLISECOND
"""How long a device is up when a recording begins."""
AFTERWARDS = 2 * MILLISECOND
"""How long one is listened to behind the last recorded frame."""


class Line(NamedTuple):
    """One recorded frame. time: ns."""

    time: Time
    frame: Frame

    @property
    def text(self) -> str:
        return str(self.frame)


def load(name: str) -> list[Line]:
    """A recording by its name; the test is skipped where there is none."""
    path = FOLDER / f"{name}.log"
    if not path.exists():
        pytest.skip(f"no recorded session {name}: {FOLDER} has none (${VARIABLE} names another folder)")
    lines = []
    for text in path.read_text().splitlines():
        moment, _, frame = text.split()
        seconds, microseconds = moment.strip("()").split(".")
        lines.append(Line((int(seconds) * 1_000_000 + int(microseconds)) * 1000, Frame.parse(frame)))
    return lines


def sdo_of(lines: list[Line], node_id: int) -> list[Transfer]:
    """The SDO transfers of a node in a recording."""
    request, response = SDO_CLIENT_TO_SERVER + node_id, SDO_SERVER_TO_CLIENT + node_id
    return transfers_of((frame.can_id == request, frame.data) for _, frame in lines if frame.can_id in (request, response))


class Difference(NamedTuple):
    """Where our device answers otherwise than the recorded one, and why both may.

    theirs: the recorded frame. ours: what stands in its place, several frames with blanks between, "" for none.
    """

    theirs: str
    ours: str
    why: str


def with_differences(recorded: Iterable[str], differences: Iterable[Difference]) -> list[str]:
    """What our device is to send where the other one sent `recorded`. Each difference has to occur."""
    instead = {difference.theirs: difference for difference in differences}
    expected: list[str] = []
    for text in recorded:
        difference = instead.get(text)
        expected += [text] if difference is None else difference.ours.split()
    missing = [difference for text, difference in instead.items() if text not in set(recorded)]
    assert not missing, f"no such frame was recorded: {missing}"
    return expected


# ---- the device's side ----


class DeviceReplay:
    """Our device in the place of the recorded one.

    sent: what it sent, with the moment. states: its NMT state at each recorded heartbeat, and what that heartbeat says.
    host: what the device does of itself; it is told of each event.
    """

    def __init__(self, node_id: int, dictionary: ObjectDictionary, host: Callable[[DeviceReplay, Event], None]) -> None:
        self.network = Network()
        self.node = LocalNode(self.network.out, node_id, dictionary)
        self.network.attach(self.node)
        self.now: Time = 0
        self.sent: list[Line] = []
        self.events: list[Event] = []
        self.states: list[tuple[NmtState, NmtState]] = []
        self._host = host
        self.can_ids = {base + node_id for base in FROM_DEVICE}

    def prepare(self, start: Time, state: NmtState) -> None:
        """Bring it into the state that the recorded one was in at the start. What it sends on the way is forgotten.

        INITIALISING: it boots at the start, and the recording begins with that.
        """
        if state is NmtState.INITIALISING:
            self.now = start
            self.node.boot(self.now)
            self.pump()
            return
        self.now = start - PREPARED
        self.node.boot(self.now)
        self.pump()
        if state is NmtState.OPERATIONAL and self.node.state is not state:
            self.node.execute(NmtCommand.START, self.now)
            self.pump()
        self.advance(start)
        self.sent.clear()
        self.events.clear()

    def play(self, lines: list[Line]) -> None:
        """Let it hear what the other one heard."""
        heartbeat = ERROR_CONTROL + self.node.node_id
        for line in lines:
            self.advance(line.time)
            if line.frame.can_id not in self.can_ids:
                self.network.receive(line.frame, self.now)
                self.pump()
            elif line.frame.can_id == heartbeat and line.frame.data != b"\x00":
                self.states.append((self.node.state, NmtState(line.frame.data[0])))
        self.advance(lines[-1].time + AFTERWARDS)

    def advance(self, to: Time) -> None:
        """Let time pass."""
        while (deadline := self.network.next_deadline()) <= to:
            self.now = max(self.now, deadline)
            self.network.handle_timeout(self.now)
            self.pump()
        self.now = to

    def pump(self) -> None:
        busy = True
        while busy:
            frames, events = self.network.drain(self.now)
            self.sent += [Line(self.now, frame) for frame in frames]
            self.events += events
            for event in events:
                self._host(self, event)
            busy = bool(events)


# ---- the master's side ----


class MasterReplay:
    """Our master in the place of the recorded one: an SDO client, NMT commands, SYNC, and what hears the device.

    It gets its commands when the recorded one sent them, and is told by the recorded device's frames how these went.
    sent: what it sent. outcomes: of the SDO transfers, in their order. events: all others. rpdo: live while the device is
    Operational, with the values that the recorded master sent; one that does not go by SYNC is sent when that sent it.
    """

    def __init__(self, node_id: int, dictionary: ObjectDictionary, *, sdo_timeout: Time) -> None:
        self.network = Network()
        self.remote = RemoteNode(self.network.out, node_id, dictionary, sdo_timeout=sdo_timeout)
        self.nmt = NmtMaster(self.network.out)
        self.sync = SyncProducer(self.network.out)
        for machine in (self.remote, self.nmt, self.sync):
            self.network.attach(machine)
        self.now: Time = 0
        self.sent: list[Line] = []
        self.outcomes: list[Outcome] = []
        self.events: list[Event] = []
        self.rpdo: PdoProducer | None = None

    def play(self, lines: list[Line]) -> None:
        """Let it do what the other one did."""
        transfers = iter(sdo_of(lines, self.remote.node_id))
        heard = {base + self.remote.node_id for base in FROM_DEVICE}
        for line in lines:
            self.advance(line.time)
            can_id, data = line.frame.can_id, line.frame.data
            if can_id == NMT:
                self.nmt.send(NmtCommand(data[0]), data[1], self.now)
            elif can_id == SYNC:
                self.sync.send(self.now)
            elif can_id == SDO_CLIENT_TO_SERVER + self.remote.node_id:
                if not self.remote.sdo.busy and is_initiate(data):
                    self._begin(next(transfers))
            elif self.rpdo is not None and can_id == self.rpdo.key:
                self.rpdo.mapping.unpack_into(self.rpdo.store, data)
                if not self.rpdo.is_synchronous:
                    self.rpdo.send(self.now)
            elif can_id in heard:
                self.network.receive(line.frame, self.now, line.time)
            self.pump()
        assert next(transfers, None) is None
        self.advance(lines[-1].time + AFTERWARDS)

    def _begin(self, transfer: Transfer) -> None:
        sdo, now = self.remote.sdo, self.now
        block = {"block": True} if transfer.is_block else {}
        if transfer.is_upload:
            sdo.upload(transfer.index, transfer.subindex, now, **block)
        else:
            sdo.download(transfer.index, transfer.subindex, transfer.data, now, **block)

    def advance(self, to: Time) -> None:
        """Let time pass."""
        while (deadline := self.network.next_deadline()) <= to:
            self.now = max(self.now, deadline)
            self.network.handle_timeout(self.now)
            self.pump()
        self.now = to

    def pump(self) -> None:
        frames, events = self.network.drain(self.now)
        self.sent += [Line(self.now, frame) for frame in frames]
        self.outcomes += [event for event in events if isinstance(event, Outcome)]
        self.events += [event for event in events if not isinstance(event, Outcome)]
        if self.rpdo is not None and self.remote.is_operational and not self.rpdo.is_live:
            self.remote.enable_rpdo(self.rpdo.number, self.now)
