"""`Peer`: another node of the bus, as a participant reaches it: commands to its machines, and what is told of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from canopen_master.errors import SdoError, sdo_error
from canopen_master.participant.bus import Bus
from canopen_master.participant.dispatch import Watcher
from canopen_master.participant.participant import Participant
from canopen_master.participant.requests import OpenRequest
from canopen_master.participant.subscription import Subscription
from canopen_proto.machine import Event, Outcome, RequestId, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.events import SdoAborted
from canopen_transports.loop import protected

E = TypeVar("E", bound=Event)


class Peer:
    """See this module's text. remote: the core's view of the node. name: what people call it, by default "node 12"."""

    def __init__(self, participant: Participant, bus: Bus, remote: RemoteNode) -> None:
        self._participant = participant
        self._bus = bus
        self.remote = remote
        self.name = f"node {remote.node_id}"

    @property
    def node_id(self) -> int:
        return self.remote.node_id

    @property
    def bus(self) -> str:
        """The name of the node's bus."""
        return self._bus.name

    @property
    def network(self) -> Network:
        """The core's Network on the node's bus."""
        return self._bus.network

    @property
    def where(self) -> str:
        """The node and its bus, for people: "node 3 on can0"."""
        return f"node {self.node_id} on {self.bus}"

    @property
    def bus_has_failed(self) -> bool:
        """Whether nothing can be sent to it any longer."""
        return self._bus.failed

    def now(self) -> Time:
        """Return the time of its machines, ns."""
        return self._participant.now()

    def events(self, *kinds: type[E]) -> Subscription[E]:
        """Return the events of this node only; see `Master.events`."""
        return self._participant.subscribe(kinds, self._bus, self.node_id)

    def watch(self, kinds: tuple[type[Event], ...], callback: Callable[[Any], None]) -> Watcher:
        """Watch this node only; see `Participant.watch`."""
        return self._participant.watch(kinds, callback, self._bus, self.node_id)

    def begin(self, submit: Callable[[Time], RequestId]) -> OpenRequest:
        """Give its machines a command that has an outcome. submit: gives the command at a time, and returns its RequestId."""
        return self._participant.begin(self._bus, self.remote, submit)

    @protected
    async def request(self, submit: Callable[[Time], RequestId]) -> Outcome:
        """Give its machines a command and wait for the outcome. If the task is cancelled, the request is taken back. submit:
        gives the command at a time, and returns its RequestId."""
        return await self._participant.begin(self._bus, self.remote, submit).outcome()

    def send_nmt(self, command: NmtCommand, now: Time) -> None:
        """Queue an NMT command, at a procedure's `now`. It goes out when the procedure next waits."""
        self._participant.nmt_master(self._bus).send(command, self.node_id, now)

    def error_of(self, aborted: SdoAborted, attempt: str, *, size_unknown: bool = False) -> SdoError:
        """Return the exception for a transfer that ended with an abort; see `sdo_error`. attempt:
        "reading", "writing 5 to". size_unknown: the size of a stream was not announced."""
        return sdo_error(self.network, self.remote, self.bus, aborted, attempt, self.now(), size_unknown=size_unknown)
