"""The sending side of one PDO: a device's TPDO, or the master's RPDO for a device.

A PDO takes its values from a store (in a device, the memory of its dictionary) when it is sent. The transmission type says when
that is (CiA 301 v4.2.0, 7.5.2.37):

    0           synchronous, acyclic: at the next SYNC after `trigger`
    1..240      synchronous, cyclic: at every n-th SYNC
    252         on request, synchronous: takes its values at each SYNC, is sent when it is requested
    253         on request
    254, 255    event-driven: at `trigger`, and when the event time has passed since it was last sent

A request is a remote frame with the PDO's CAN-ID. If the COB-ID allows requests (bit 30 is 0, `answers_requests`), a PDO of every
type answers them: types 0 to 240 with the present values, in addition to the PDOs at a SYNC; an event-driven one as at a trigger.
A PDO of type 252 has the present values too before the first SYNC.

`on_sync` reports a SYNC. With a SYNC start value, the first PDO is sent at the SYNC with that counter, and every n-th one after
it. So the PDOs of several devices can be spread over the cycle. The start value is not used if SYNC has no counter.

The inhibit time is the least time between two event-driven transmissions. After a trigger within it, the PDO is sent once when
the time is over, with the values of that moment. A late event timer sends once and reports the periods that it skipped.

`send` sends at once, whatever the type: a master sends its RPDOs by its own cycle. `sent_at` is the time of the last transmission
of any kind; None = never. `HeldRpdos` tells which of them a device may still hold for its next SYNC.

PDOs exist in NMT state Operational only. The owner sets it by `set_enabled`, which starts the event timer and the count of SYNCs.
A PDO that is not valid, or whose mapping is empty, is never sent.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canopen_proto.compiling import mypyc_attr
from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary import PdoDescription
from canopen_proto.frame import KEY_EXTENDED, REMOTE, Frame, RoutingKey, can_id_of, flags_of, frame_for_key, routing_key
from canopen_proto.machine import MILLISECOND, NEVER, Event, Machine, Outbox, Time, check_node_id
from canopen_proto.multiplexer import Mux
from canopen_proto.pdo.consumer import EVENT_DRIVEN, LAST_SYNCHRONOUS
from canopen_proto.pdo.mapping import Mapping

SYNCHRONOUS_ON_REQUEST: Final = 252
ON_REQUEST: Final = 253
FIRST_EVENT_DRIVEN: Final = 254

SYNC_TRANSIT: Final = 100 * MILLISECOND
"""Adapters delay frames both ways by 16 ms and more, and so does a busy process."""


class PdoPeriodsSkipped(Event):
    """The event timer ran late: the PDO was sent once instead of 1 + skipped times. number: of the PDO, 1..512, or 0. key: the
    routing key of its frames."""

    __match_args__ = ("node_id", "number", "key", "skipped")

    def __init__(self, node_id: int, number: int, key: RoutingKey, skipped: int) -> None:
        self.node_id = node_id
        self.number = number
        self.key = key
        self.skipped = skipped


class PdoNotSent(Event):
    """A PDO was due, but its store holds a value that the object's type cannot hold: an error of our own application. reason:
    text for people. number: of the PDO, 1..512, or 0. key: the routing key of its frames."""

    __match_args__ = ("node_id", "number", "key", "reason")

    def __init__(self, node_id: int, number: int, key: RoutingKey, reason: str) -> None:
        self.node_id = node_id
        self.number = number
        self.key = key
        self.reason = reason


@mypyc_attr(allow_interpreted_subclasses=True)
class PdoProducer(Machine):
    """Sends one PDO from a store; see this module's text. Disabled until `set_enabled`.

    node_id: 1..127, the device itself, or the node that the master sends to. number: 1..512, or 0. key: the routing key of the
    frames; None while the PDO is not valid. store: mux -> value; a missing value is sent as zero. inhibit_time, event_time: ns;
    0 = none. sync_start: 1..240; 0 = none. Source: CiA 301 v4.2.0, 7.2.2, 7.5.2.37, 7.5.2.38. mapping: its objects; without
    entries, nothing is sent. transmission_type: 0..255, see this module's text.
    """

    __slots__ = (
        "_awaits_start", "_event_due", "_inhibited_until", "_sample", "_syncs", "_triggered", "answers_requests", "enabled",
        "event_time", "inhibit_time", "key", "mapping", "node_id", "number", "sent_at", "store", "sync_start",
        "transmission_type",
    )  # fmt: skip

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
        self.mapping = mapping
        self.transmission_type = transmission_type
        self.inhibit_time = inhibit_time
        self.event_time = event_time
        self.sync_start = sync_start
        self.answers_requests = False
        self.sent_at: Time | None = None
        self._sample: bytes | None = None  # type 252: the data of the last SYNC
        self._triggered = False  # waits: for the next SYNC (type 0), for the end of the inhibit time
        self._syncs = 0  # since the last transmission
        self._awaits_start = False  # waits for the SYNC with the start value
        self._inhibited_until: Time = 0
        self._event_due: Time = NEVER
        self.configure(key, mapping, 0, transmission_type, inhibit_time, event_time, sync_start)

    @classmethod
    def from_description(cls, out: Outbox, node_id: int, description: PdoDescription, store: dict[Mux, Value]) -> PdoProducer:
        """Return a master's producer of a node's RPDO, as PDOs.csv describes it. Raises MappingError. store: mux -> value, where
        the values are taken from."""
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
        """Change the parameters. A waiting trigger is dropped; the SYNC count and the event timer start again. answers_requests:
        a remote frame is answered. For the others see the class.

        If only `event_time` changes, the event timer alone starts again; if nothing changes, nothing does. A trigger that waits
        for the inhibit time is sent then: nothing else would tell of what has changed.
        """
        key = key if mapping.entries else None
        before = (self.key, self.mapping, self.transmission_type, self.inhibit_time, self.sync_start) if self.is_live else None
        stays = before == (key, mapping, transmission_type, inhibit_time, sync_start)
        is_other_timer = event_time != self.event_time
        if (key, answers_requests) != (self.key, self.answers_requests):
            self.key, self.answers_requests = key, answers_requests
            self._reroute()
        self.mapping = mapping
        self.transmission_type = transmission_type
        self.inhibit_time = inhibit_time
        self.event_time = event_time
        self.sync_start = sync_start
        if not stays:
            self._restart(now)
        elif is_other_timer:
            self._start_timer(now)

    def set_enabled(self, enabled: bool, now: Time) -> None:
        """Set whether the node is in NMT state Operational. Entering it sends nothing and starts the event timer.

        If the device profile wants an event-driven TPDO to be sent on entering Operational, call `trigger` after this.
        """
        if enabled != self.enabled:
            self.enabled = enabled
            self._restart(now)

    @property
    def is_live(self) -> bool:
        """Whether the PDO can be sent now: it is valid and mapped, and the node Operational."""
        return self.enabled and self.key is not None

    @property
    def is_synchronous(self) -> bool:
        """Whether the transmission type uses SYNC."""
        return self.transmission_type <= LAST_SYNCHRONOUS or self.transmission_type == SYNCHRONOUS_ON_REQUEST

    @property
    def is_event_driven(self) -> bool:
        """Whether the transmission type uses `trigger` and the event timer."""
        return self.transmission_type >= FIRST_EVENT_DRIVEN

    def send(self, now: Time) -> bool:
        """Send the PDO now, whatever its type and inhibit time. Sends nothing and returns False if it is not live.

        Raises ValueRangeError if the store holds a value that the object's type cannot hold, such as a float for an integer.
        """
        if not self.enabled or self.key is None:
            return False
        self._emit(self.key, now)
        return True

    def send_again(self, now: Time) -> None:
        """Send the PDO with the present values, even while it is disabled: its receiver may hold an older one for a SYNC.

        Event: PdoNotSent, as in `trigger`.
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
        """Answer a remote request; see this module's text. Event: PdoNotSent, as in `trigger`. CiA 301 v4.2.0, 7.2.2.5.2"""
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
            self._sample = None  # the next request gets the values of its own moment

    def trigger(self, now: Time) -> None:
        """Send an event-driven PDO now, or when the inhibit time is over, and a PDO of type 0 at the next SYNC.

        Does nothing for cyclic PDOs. Event: PdoNotSent if the store holds a value that cannot be sent. It is not an exception,
        because a peer's write often triggers.
        """
        if not self.enabled or self.key is None:
            return
        if self.is_event_driven:
            if now >= self._inhibited_until:
                self._send_due(now)
            else:
                self._triggered = True
                self._arm(min(self._inhibited_until, self._event_due))
        elif self.transmission_type == 0:
            self._triggered = True

    def on_sync(self, counter: int | None, now: Time) -> None:
        """Handle a SYNC. counter: None = it has none. Event: PdoNotSent, as in `trigger`."""
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
            self._syncs = self.transmission_type - 1  # this SYNC counts as the n-th
        self._awaits_start = False
        self._syncs += 1
        if self._syncs >= self.transmission_type:
            self._syncs = 0
            self._try_to_emit(self.key, now)

    def handle_timeout(self, now: Time) -> None:
        """Send the PDO if a trigger waits and the inhibit time is over, or if the event time has passed. Event: PdoNotSent."""
        if now < self.deadline:
            return
        due = self._event_due
        if now < due:
            self._send_due(now)  # a trigger waited for the end of the inhibit time
        elif now < self._inhibited_until:
            self._event_due = self._inhibited_until  # the timer waits for the end of the inhibit time
            self._arm(self._event_due)
        else:
            skipped = (now - due) // self.event_time
            self._send_due(now)
            self._event_due = due + (skipped + 1) * self.event_time  # the phase is kept
            self._arm(self._event_due)
            if skipped and self.key is not None:
                self.out.events.append(PdoPeriodsSkipped(self.node_id, self.number, self.key, skipped))

    def _emit(self, key: RoutingKey, now: Time) -> None:
        data = self.mapping.pack_from(self.store)
        self.out.frames.append(frame_for_key(key, data) if key & KEY_EXTENDED else Frame(key, data))
        self.sent_at = now
        self._triggered = False
        if self.transmission_type >= FIRST_EVENT_DRIVEN:
            self._inhibited_until = now + self.inhibit_time
            self._event_due = now + self.event_time if self.event_time else NEVER
            self._arm(self._event_due)

    def _send_due(self, now: Time) -> None:
        if self.enabled and self.key is not None:
            self._try_to_emit(self.key, now)

    def _try_to_emit(self, key: RoutingKey, now: Time) -> None:
        """Send the PDO; an error becomes an event, because no caller could handle an exception."""
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
        assert self.key is not None  # only a PDO with a key is due
        self.out.events.append(PdoNotSent(self.node_id, self.number, self.key, str(error)))

    def _restart(self, now: Time) -> None:
        self._sample = None
        self._triggered = False
        self._syncs = 0
        self._awaits_start = self.sync_start != 0
        self._inhibited_until = now
        self._start_timer(now)

    def _start_timer(self, now: Time) -> None:
        timed = self.is_live and self.is_event_driven and self.event_time
        self._event_due = now + self.event_time if timed else NEVER
        waits = self._triggered and self.is_event_driven
        self._arm(min(self._inhibited_until, self._event_due) if waits else self._event_due)


class HeldRpdos:
    """The RPDOs that one device may hold for its next SYNC, as far as their sender can tell.

    The data of a synchronous RPDO wait in the device for a SYNC (CiA 301 v4.2.0, 7.5.2.35). They then overwrite what SDO wrote in
    the meantime. No frame tells whether they still wait. The sender knows when it sent them, and when a SYNC passed. A SYNC of
    its own comes after all frames that it sent before. A SYNC that it receives may have been on its way for SYNC_TRANSIT.
    """

    __slots__ = ("_by_hand", "_since")

    def __init__(self) -> None:
        self._by_hand: set[PdoProducer] = set()
        self._since: Time = -NEVER  # the device no longer holds an RPDO that was sent before this time

    def sent_by_hand(self, producer: PdoProducer) -> None:
        """Note an RPDO that was sent once by hand. The `rpdos` of `carrying` do not have it."""
        self._by_hand.add(producer)

    def on_sync(self, now: Time, heard: bool) -> None:
        """Note a SYNC. heard: it was received, not sent."""
        since = now - SYNC_TRANSIT if heard else now
        if since > self._since:
            self._since = since
        if self._by_hand:
            self._by_hand = {each for each in self._by_hand if self._may_be_held(each)}

    def on_boot(self, now: Time) -> None:
        """Note that the device has booted: it holds nothing."""
        self._since = now
        self._by_hand.clear()

    def forget(self, number: int) -> None:
        """Forget RPDO `number`: it is no longer exchanged, or gets other settings."""
        self._by_hand = {each for each in self._by_hand if each.number != number}

    def carrying(self, mux: Mux, rpdos: Iterable[PdoProducer]) -> list[PdoProducer]:
        """Return the RPDOs with an object that the device may hold. rpdos: those that are exchanged."""
        return [each for each in (*rpdos, *self._by_hand) if self._may_be_held(each) and mux in each.mapping.muxes]

    def _may_be_held(self, producer: PdoProducer) -> bool:
        sent_at = producer.sent_at
        return producer.is_synchronous and sent_at is not None and sent_at >= self._since
