"""The sending side of one PDO: a device's TPDO, or the master's RPDO for a device.

Theory of operation
-------------------
A PDO is sampled from its store (for a device: the memory of its dictionary) when it is sent. When it is sent is what its
transmission type says (CiA 301 v4.2.0, 7.5.2.37):

    0           synchronous, acyclic: at the next SYNC after `trigger`
    1..240      synchronous, cyclic: at every n-th SYNC
    252         on request, synchronous: sampled at each SYNC, sent when it is requested
    253         on request: sampled and sent when it is requested
    254, 255    event-driven: at `trigger`, and when the event time has passed since it was last sent

A request is a remote frame with the PDO's CAN-ID. Where the COB-ID allows it (bit 30 is 0, `answers_requests`), it is answered
whatever the type: one of type 0 to 240 with the present values and besides its SYNCs, an event-driven one as if it were
triggered. A PDO of type 252 that is requested before the first SYNC has present values too.

`on_sync` is the SYNC. With a SYNC start value the first PDO goes at the SYNC with that counter, and the n-th ones are counted
from there, so that the PDOs of several devices can be spread over the cycle; where SYNC has no counter the start value is not
used.

The inhibit time is the least time between two event-driven transmissions. A trigger within it is not lost: the PDO goes when
the time is over, once, with the values of that moment. A late event timer sends once and reports the periods that it skipped.

`send` sends at once, whatever the type: it is for a master that sends its RPDOs by its own cycle. `sent_at` tells when it
was last sent, for whatever reason; None: never.

PDOs live in NMT state Operational only. The owner says so by `set_enabled`, which starts the event timer; the first SYNC counted
is the first one after it. A PDO that is not valid, or whose mapping is empty, is never sent.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canopen_proto.compiling import mypyc_attr
from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary import PdoDescription
from canopen_proto.frame import REMOTE, Frame, RoutingKey, can_id_of, flags_of, frame_for_key, routing_key
from canopen_proto.machine import NEVER, Event, Machine, Outbox, Time, check_node_id
from canopen_proto.multiplexer import Mux
from canopen_proto.pdo.consumer import EVENT_DRIVEN, LAST_SYNCHRONOUS
from canopen_proto.pdo.mapping import Mapping

SYNCHRONOUS_ON_REQUEST: Final = 252
ON_REQUEST: Final = 253
FIRST_EVENT_DRIVEN: Final = 254


class PdoPeriodsSkipped(Event):
    """The event timer was served late: the PDO was sent once in place of 1 + skipped times."""

    __slots__ = ("key", "number", "skipped")
    __match_args__ = ("node_id", "number", "key", "skipped")

    def __init__(self, node_id: int, number: int, key: RoutingKey, skipped: int) -> None:
        self.node_id = node_id
        self.number = number
        self.key = key
        self.skipped = skipped


class PdoNotSent(Event):
    """A PDO was due, and its store holds a value that its object cannot have: our own application's fault. reason: for people."""

    __slots__ = ("key", "number", "reason")
    __match_args__ = ("node_id", "number", "key", "reason")

    def __init__(self, node_id: int, number: int, key: RoutingKey, reason: str) -> None:
        self.node_id = node_id
        self.number = number
        self.key = key
        self.reason = reason


@mypyc_attr(allow_interpreted_subclasses=True)
class PdoProducer(Machine):
    """Sends one PDO out of a store; see this module's text.

    node_id: the node that it is about: the device's own, or the one that the master sends to. number: 1..512, or 0. key: the
    routing key of its frames, None while the PDO is not valid. store: mux -> value; what it lacks is sent as zero.
    inhibit_time, event_time: ns, 0 = none. sync_start: 1..240, 0 = none. Disabled until `set_enabled`; requests
    are answered when `configure` says so.
    Source: CiA 301 v4.2.0, 7.2.2, 7.5.2.37, 7.5.2.38.
    """

    __slots__ = (
        "_awaits_start",
        "_event_due",
        "_inhibited_until",
        "_sample",
        "_syncs",
        "_triggered",
        "answers_requests",
        "enabled",
        "event_time",
        "inhibit_time",
        "key",
        "mapping",
        "node_id",
        "number",
        "sent_at",
        "store",
        "sync_start",
        "transmission_type",
    )

    def __init__(
        self,
        out: Outbox,
        node_id: int,
        number: int,
        key: RoutingKey | None,
        mapping: Mapping,
        store: dict[Mux, Value],
        transmission_type: int = EVENT_DRIVEN,
        inhibit_time: Time = 0,
        event_time: Time = 0,
        sync_start: int = 0,
    ) -> None:
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.number = number
        self.store = store
        self.enabled = False
        self.key: RoutingKey | None = None
        self.answers_requests = False
        self.sent_at: Time | None = None
        self._sample: bytes | None = None  # of type 252: the data of the last SYNC
        self._triggered = False  # of type 0: waits for the next SYNC
        self._syncs = 0  # since it was sent last
        self._awaits_start = False  # for the SYNC with the start value
        self._inhibited_until: Time = 0
        self._event_due: Time = NEVER
        self.configure(key, mapping, 0, transmission_type, inhibit_time, event_time, sync_start)

    @classmethod
    def from_description(cls, out: Outbox, node_id: int, description: PdoDescription, store: dict[Mux, Value]) -> PdoProducer:
        """A producer of what PDOs.csv describes: the master's end of a node's RPDO. store: the caller's. Raises MappingError."""
        mapping = Mapping.from_description(description)
        return cls(out, node_id, description.number or 0, routing_key(description.can_id(node_id)), mapping, store)

    def configure(
        self,
        key: RoutingKey | None,
        mapping: Mapping,
        now: Time,
        transmission_type: int = EVENT_DRIVEN,
        inhibit_time: Time = 0,
        event_time: Time = 0,
        sync_start: int = 0,
        *,
        answers_requests: bool = False,
    ) -> None:
        """Apply other parameters. Triggers are forgotten; the SYNC count and the event timer start again."""
        key = key if mapping.entries else None
        if (key, answers_requests) != (self.key, self.answers_requests):
            self.key, self.answers_requests = key, answers_requests
            self._reroute()
        self.mapping = mapping
        self.transmission_type = transmission_type
        self.inhibit_time = inhibit_time
        self.event_time = event_time
        self.sync_start = sync_start
        self._restart(now)

    def set_enabled(self, enabled: bool, now: Time) -> None:
        """Whether the node is in NMT state Operational. Nothing is sent by entering it; the event timer starts.

        A device whose profile wants an event-driven TPDO to be sent on entering Operational says `trigger` after this.
        """
        if enabled != self.enabled:
            self.enabled = enabled
            self._restart(now)

    @property
    def is_live(self) -> bool:
        """Whether it would send now: valid, mapped, and the node Operational."""
        return self.enabled and self.key is not None

    @property
    def is_synchronous(self) -> bool:
        """Whether SYNC concerns it."""
        return self.transmission_type <= LAST_SYNCHRONOUS or self.transmission_type == SYNCHRONOUS_ON_REQUEST

    @property
    def is_event_driven(self) -> bool:
        """Whether it goes by `trigger` and by the event timer."""
        return self.transmission_type >= FIRST_EVENT_DRIVEN

    def send(self, now: Time) -> bool:
        """Send it now, whatever its type and inhibit time. Returns False, and sends nothing, where it is not live.

        Raises ValueRangeError where the store holds a value that its object cannot have (such as a float for an integer).
        """
        if not self.enabled or self.key is None:
            return False
        self._emit(self.key, now)
        return True

    def send_again(self, now: Time) -> None:
        """Send it once more, with the values of now, also while it is disabled: its receiver may hold an older one for a SYNC.

        `PdoNotSent` as in `trigger`.
        """
        if self.key is not None:
            self._try_to_emit(self.key, now)

    def can_ids(self) -> Iterable[RoutingKey]:
        return (
            (routing_key(can_id_of(self.key), flags_of(self.key) | REMOTE),)
            if self.answers_requests and self.key is not None
            else ()
        )

    def receive(self, frame: Frame, now: Time) -> None:
        """Answer a remote request; see this module's text. `PdoNotSent` as in `trigger`. CiA 301 v4.2.0, 7.2.2.5.2"""
        if not self.enabled or self.key is None:
            return
        if self.is_event_driven:
            self.trigger(now)
            return
        if self._sample is None:
            self._take_sample()
        if self._sample is not None:
            self.out.frames.append(frame_for_key(self.key, self._sample))
        if self.transmission_type != SYNCHRONOUS_ON_REQUEST:
            self._sample = None  # the next request has the values of its own moment

    def trigger(self, now: Time) -> None:
        """Its event happened: an event-driven PDO goes now or when the inhibit time is over, a PDO of type 0 at the next SYNC.

        Cyclic PDOs go anyway; to them it means nothing. `PdoNotSent` follows where the store holds what cannot be sent: often it
        is a peer's write that triggers, and it must not be the one to suffer.
        """
        if not self.enabled or self.key is None:
            return
        if self.is_event_driven:
            if now >= self._inhibited_until:
                self._send_due(now)
            else:
                self._arm(min(self._inhibited_until, self._event_due))
        elif self.transmission_type == 0:
            self._triggered = True

    def on_sync(self, counter: int | None, now: Time) -> None:
        """A SYNC came, with this counter (None: without one). `PdoNotSent` as in `trigger`."""
        if not self.enabled or self.key is None:
            return
        if self.transmission_type > LAST_SYNCHRONOUS:
            if self.transmission_type == SYNCHRONOUS_ON_REQUEST:
                self._take_sample()
            return
        if self.transmission_type == 0:
            if self._triggered:
                self._send_due(now)
            return
        if self._awaits_start and counter is not None:
            if counter != self.sync_start:
                return
            self._syncs = self.transmission_type - 1  # that SYNC counts as the n-th
        self._awaits_start = False
        self._syncs += 1
        if self._syncs >= self.transmission_type:
            self._syncs = 0
            self._send_due(now)

    def handle_timeout(self, now: Time) -> None:
        """The inhibit time is over and a trigger waits, or the event time has passed. `PdoNotSent` as in `trigger`."""
        if now < self.deadline:
            return
        due = self._event_due
        if now < due:
            self._send_due(now)  # a trigger waited for the end of the inhibit time
        elif now < self._inhibited_until:
            self._event_due = NEVER  # an event time shorter than the inhibit time: due, and waiting
            self._arm(self._inhibited_until)
        else:
            skipped = (now - due) // self.event_time
            self._send_due(now)
            self._event_due = due + (skipped + 1) * self.event_time  # the phase is kept
            self._arm(self._event_due)
            if skipped and self.key is not None:
                self.out.events.append(PdoPeriodsSkipped(self.node_id, self.number, self.key, skipped))

    def _emit(self, key: RoutingKey, now: Time) -> None:
        self.out.frames.append(frame_for_key(key, self.mapping.pack_from(self.store)))
        self.sent_at = now
        self._triggered = False
        if self.is_event_driven:
            self._inhibited_until = now + self.inhibit_time
            self._event_due = now + self.event_time if self.event_time else NEVER
            self._arm(self._event_due)

    def _send_due(self, now: Time) -> None:
        if self.enabled and self.key is not None:
            self._try_to_emit(self.key, now)

    def _try_to_emit(self, key: RoutingKey, now: Time) -> None:
        """Send where there is nobody to raise to: the fault becomes an event, and the turn has passed."""
        try:
            self._emit(key, now)
        except ValueRangeError as error:
            self._triggered = False
            self._arm(self._event_due)
            self._report(error)

    def _take_sample(self) -> None:
        try:
            self._sample = self.mapping.pack_from(self.store)
        except ValueRangeError as error:
            self._sample = None
            self._report(error)

    def _report(self, error: ValueRangeError) -> None:
        assert self.key is not None  # nothing is due without one
        self.out.events.append(PdoNotSent(self.node_id, self.number, self.key, str(error)))

    def _restart(self, now: Time) -> None:
        self._sample = None
        self._triggered = False
        self._syncs = 0
        self._awaits_start = self.sync_start != 0
        self._inhibited_until = now
        timed = self.is_live and self.is_event_driven and self.event_time
        self._event_due = now + self.event_time if timed else NEVER
        self._arm(self._event_due)
