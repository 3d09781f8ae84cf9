"""`NodeEar`: what one client of a gateway hears of the nodes of a bus: boot-ups, NMT states, emergencies, lost heartbeats.

It only listens: it sends nothing, and no other machine of the bus hears of it. So the heartbeat time that one client sets is
nobody else's, and no drive is stopped because a client was impatient. Each client has an ear of its own, with its own number.

    boot-ups      of all nodes, while `hears_boot_ups`
    emergencies   of all nodes then, and always of those that are watched
    states        of the nodes that are watched: the first heartbeat (HEARTBEAT_STARTED), each new state, and HEARTBEAT_LOST when
                  none has come within the time; the next one is HEARTBEAT_STARTED again
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canopen_proto.frame import ALL_NODE_IDS, EMCY, ERROR_CONTROL, Frame, RoutingKey, routing_key
from canopen_proto.gateway.answer import GatewayNews
from canopen_proto.gateway.codes import GatewayCode
from canopen_proto.machine import MILLISECOND, NEVER, Event, LocalProtocolError, Machine, Outbox, Time, check_node_id
from canopen_proto.nmt import STATE_OF_BYTE, NmtState

_EMCY_LENGTH: Final = 8


class NodeReport(Event):
    """An ear has heard something of a node. ear: its number. kind: what it was. numbers: as those of a GatewayEvent."""

    __match_args__ = ("node_id", "ear", "kind", "numbers")

    def __init__(self, node_id: int, ear: int, kind: GatewayNews, numbers: tuple[int, ...]) -> None:
        self.node_id = node_id
        self.ear = ear
        self.kind = kind
        self.numbers = numbers


class _Watched:
    """A node whose heartbeat is watched. timeout: ns. deadline: when it is lost; NEVER before its first heartbeat."""

    __slots__ = ("deadline", "state", "timeout")

    def __init__(self, timeout: Time) -> None:
        self.timeout = timeout
        self.deadline: Time = NEVER
        self.state: NmtState | None = None


class NodeEar(Machine):
    """See this module's text. number: tells it from other ears. hears_boot_ups: may be set."""

    def __init__(self, out: Outbox, number: int) -> None:
        """number: any; it stands in each NodeReport."""
        super().__init__(out)
        self.number = number
        self.hears_boot_ups = False
        self._watched: dict[int, _Watched] = {}

    def can_ids(self) -> Iterable[RoutingKey]:
        return [routing_key(base + node_id) for base in (ERROR_CONTROL, EMCY) for node_id in ALL_NODE_IDS]

    @property
    def watched(self) -> tuple[int, ...]:
        """The node-IDs whose heartbeats are watched."""
        return tuple(self._watched)

    def watch(self, node_id: int, timeout: Time) -> None:
        """Watch the heartbeat of a node, from its next one on. timeout: ns, 1 ms or more; it replaces the one before. Raises
        LocalProtocolError for another time, and for a node-ID outside 1..127."""
        check_node_id(node_id)
        if timeout < MILLISECOND:
            raise LocalProtocolError(f"a heartbeat time of {timeout} ns: it is 1 ms or more")
        self._watched[node_id] = _Watched(timeout)
        self._set_deadline()

    def forget(self, node_id: int) -> None:
        """End `watch`; does nothing for a node that is not watched."""
        self._watched.pop(node_id, None)
        self._set_deadline()

    def receive(self, frame: Frame, now: Time) -> None:
        """Take a boot-up, a heartbeat, or an emergency. Frames that are none of these are somebody else's to report."""
        if frame.can_id < ERROR_CONTROL:
            self._on_emcy(frame.can_id - EMCY, frame.data)
        elif len(frame.data) == 1:
            self._on_error_control(frame.can_id - ERROR_CONTROL, frame.data[0], now)

    def handle_timeout(self, now: Time) -> None:
        """Report the nodes whose heartbeat is lost, each once."""
        if now < self.deadline:
            return
        for node_id, watched in self._watched.items():
            if watched.deadline <= now:
                watched.deadline, watched.state = NEVER, None
                self._report(node_id, GatewayNews.ERROR, GatewayCode.HEARTBEAT_LOST)
        self._set_deadline()

    def _on_emcy(self, node_id: int, data: bytes) -> None:
        if self.hears_boot_ups or node_id in self._watched:
            whole = data.ljust(_EMCY_LENGTH, b"\0")
            code = int.from_bytes(whole[:2], "little")
            self.out.events.append(NodeReport(node_id, self.number, GatewayNews.EMCY, (code, whole[2], *whole[3:8])))

    def _on_error_control(self, node_id: int, byte: int, now: Time) -> None:
        state = STATE_OF_BYTE[byte]
        watched = self._watched.get(node_id)
        if state is NmtState.INITIALISING:
            if self.hears_boot_ups or watched is not None:
                self._report(node_id, GatewayNews.BOOT_UP)
            if watched is not None and watched.deadline < NEVER:
                watched.deadline = now + watched.timeout  # it lives, and its heartbeat may begin only now
                self._set_deadline()
            return
        if state is None or watched is None:
            return
        if watched.deadline == NEVER:
            self._report(node_id, GatewayNews.ERROR, GatewayCode.HEARTBEAT_STARTED)
        if state is not watched.state:
            watched.state = state
            self._report(node_id, GatewayNews.STATE, state)
        watched.deadline = now + watched.timeout
        self._set_deadline()

    def _report(self, node_id: int, kind: GatewayNews, *numbers: int) -> None:
        self.out.events.append(NodeReport(node_id, self.number, kind, tuple(map(int, numbers))))

    def _set_deadline(self) -> None:
        self._arm(min((watched.deadline for watched in self._watched.values()), default=NEVER))
