"""The receiving side of one PDO: a device's RPDO, or the master's view of a device's TPDO.

A PDO is one unconfirmed frame (CiA 301 v4.2.0, 7.2.2). The consumer puts its values into a store, which in a device is the memory
of its dictionary, and reports `PdoReceived`. The transmission type says when:

    0..240      synchronous: at the next SYNC, which `on_sync` reports. A later PDO before that SYNC replaces an earlier one.
    254, 255    event-driven: at once.

With a synchronous window (0x1007, `set_window`), a synchronous PDO that comes after the end of the window is dropped until the
next SYNC: `PdoTooLate`. Before the first SYNC there is no window. The transport's timestamps of SYNC and PDO decide if both have
one: a PDO that was on the bus in time is not late because this process stalled before it looked.

The frame's length is checked against the mapping (7.5.2.36). A shorter frame is not processed; of a longer one the mapped bytes
are used. Both are reported, with the code of the EMCY that a device then sends.

A consumer with an event time watches its PDO: after each one, the next has to come within that time (7.5.2.35, sub 5; "deadline
monitoring").

PDOs exist in NMT state Operational only, which the owner sets by `set_enabled`; frames before that are ignored. A PDO that is not
valid (bit 31 of its COB-ID), or whose mapping is empty, takes no frames at all.

The master receives every TPDO with type 255, whatever the device's own type is: the device has already waited for the SYNC, and
waiting for the next one would make every actual value one cycle older. `request` asks for a TPDO by a remote frame; not every
device answers it, and some CAN controllers cannot send one.

Left out: the inhibit time of an RPDO, to which the standard gives no meaning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final, TypeVar, overload

from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary import Key, PdoDescription
from canopen_proto.dictionary.typed import Readable
from canopen_proto.frame import REMOTE, Frame, RoutingKey, routing_key
from canopen_proto.machine import NEVER, Event, FrameIgnored, Machine, Outbox, Time, check_node_id
from canopen_proto.multiplexer import Mux
from canopen_proto.pdo.mapping import Mapping

T = TypeVar("T", bound=Value)

LAST_SYNCHRONOUS: Final = 240
"""Transmission types 0..240 go by SYNC."""

EVENT_DRIVEN: Final = 255
"""Transmission type: event-driven, as the device profile says (254: as the manufacturer says)."""

EMCY_PDO_NOT_PROCESSED: Final = 0x8210
EMCY_PDO_LENGTH_EXCEEDED: Final = 0x8220
EMCY_RPDO_TIMEOUT: Final = 0x8250


class PdoReceived(Event):
    """The values of a PDO are in the store. A synchronous PDO is reported at the SYNC after it, not when it is received.

    number: 1..512, or 0 if the PDO has none. key: the routing key of the frame. data: its bytes. components: the values in the
    order of `mapping.components`; `get` and `values` give them by name. timestamp: of the frame, from the transport.
    """

    __slots__ = ("components", "data", "key", "mapping", "number", "timestamp")
    __match_args__ = ("node_id", "number", "key", "mapping", "data", "components", "timestamp")
    is_usual = True

    def __init__(
        self,
        node_id: int,
        number: int,
        key: RoutingKey,
        mapping: Mapping,
        data: bytes,
        components: tuple[Value, ...],
        timestamp: int | None,
    ) -> None:
        self.node_id = node_id
        self.number = number
        self.key = key
        self.mapping = mapping
        self.data = data
        self.components = components
        self.timestamp = timestamp

    @property
    def values(self) -> dict[str, Value]:
        """The values by `mapping.labels`: the names of the objects, or "6401:01" if several have the same name."""
        return dict(zip(self.mapping.labels, self.components, strict=True))

    @overload
    def get(self, key: Readable[T]) -> T | None: ...
    @overload
    def get(self, key: Key) -> Value | None: ...
    def get(self, key: Any) -> Any:
        """Return the value of one object; None if the PDO does not carry it. key, errors: as in `Mapping.find_component`."""
        position = self.mapping.position_of(key)
        return None if position is None else self.components[position]


class PdoLengthUnexpected(Event):
    """A PDO was shorter or longer than its mapping. expected, received: bytes. emcy_code: 0x8210 for a short one, which is not
    processed; 0x8220 for a long one, whose mapped bytes are used. number: of the PDO, 1..512, or 0. key: the routing key of its
    frames. timestamp: the transport's, ns, or None."""

    __match_args__ = ("node_id", "number", "key", "expected", "received", "emcy_code", "timestamp")

    def __init__(
        self, node_id: int, number: int, key: RoutingKey, expected: int, received: int, emcy_code: int, timestamp: int | None
    ) -> None:
        self.node_id = node_id
        self.number = number
        self.key = key
        self.expected = expected
        self.received = received
        self.emcy_code = emcy_code
        self.timestamp = timestamp


class PdoTooLate(Event):
    """A synchronous PDO came after the synchronous window and was dropped. late: ns after its end, as it was on the bus; if SYNC
    or PDO had no timestamp of the transport, as this process handled them, so that the lateness may be our own. timestamp: of
    the frame. number: of the PDO, 1..512, or 0. key: the routing key of its frames."""

    __match_args__ = ("node_id", "number", "key", "late", "timestamp")

    def __init__(self, node_id: int, number: int, key: RoutingKey, late: Time, timestamp: int | None) -> None:
        self.node_id = node_id
        self.number = number
        self.key = key
        self.late = late
        self.timestamp = timestamp


class PdoOverdue(Event):
    """A PDO did not come within the event time after the last one. Reported once; the watch starts again with the next PDO.
    number: of the PDO, 1..512, or 0. key: the routing key of its frames. emcy_code: 0x8250."""

    __match_args__ = ("node_id", "number", "key", "emcy_code")

    def __init__(self, node_id: int, number: int, key: RoutingKey, emcy_code: int) -> None:
        self.node_id = node_id
        self.number = number
        self.key = key
        self.emcy_code = emcy_code


class PdoConsumer(Machine):
    """Receives one PDO into a store; see this module's text. Disabled until `set_enabled`.

    node_id: 1..127, the device itself, or the node whose TPDO the master receives. number: 1..512, or 0. key: the routing key of
    the frames; None while the PDO is not valid. store: mux -> value, written without a check of limits. event_time: ns; 0 = not
    watched. Source: CiA 301 v4.2.0, 7.2.2, 7.5.2.35, 7.5.2.36. mapping: its objects; without entries, nothing is received.
    transmission_type: 0..240 = the data take effect at the next SYNC; above, at once. at_once: what decodes a frame of the right
    length that takes effect at once and is not watched; None if no frame does.
    """

    __slots__ = (
        "_held", "_held_timestamp", "_stamp_end", "_window", "_window_end", "at_once", "enabled", "event_time", "key", "mapping",
        "node_id", "number", "store", "synchronous",
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
        event_time: Time = 0,
    ) -> None:
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.number = number
        self.store = store
        self.enabled = False
        self.at_once: Callable[[bytes], tuple[Any, ...]] | None = None
        self.key: RoutingKey | None = None
        self.mapping = mapping
        self.synchronous = transmission_type <= LAST_SYNCHRONOUS
        self.event_time = event_time
        self._held: bytes | None = None  # the data that wait for a SYNC
        self._held_timestamp: int | None = None
        self._window: Time = 0
        self._window_end: Time = NEVER
        self._stamp_end: Time | None = None  # the end of the window by the transport's clock
        self.configure(key, mapping, transmission_type, event_time)

    @classmethod
    def from_description(cls, out: Outbox, node_id: int, description: PdoDescription, store: dict[Mux, Value]) -> PdoConsumer:
        """Return a master's consumer of a node's TPDO, as PDOs.csv describes it. Raises MappingError. store: mux -> value, where
        the values go."""
        mapping = Mapping.from_description(description)
        return cls(out, node_id, description.number or 0, routing_key(description.can_id(node_id)), mapping, store)

    def configure(
        self, key: RoutingKey | None, mapping: Mapping, transmission_type: int = EVENT_DRIVEN, event_time: Time = 0
    ) -> None:
        """Change the parameters. For what they mean see the class.

        Data held for a SYNC are dropped if CAN-ID, mapping or the way of acting change. Another event time is watched from the
        next PDO on; the same one goes on. CiA 301 v4.2.0, 7.5.2.35, sub 5
        """
        if not mapping.entries:
            key = None  # "mapping disabled"
        synchronous = transmission_type <= LAST_SYNCHRONOUS
        if key is None or key != self.key or mapping != self.mapping or synchronous != self.synchronous:
            self._forget()
        elif event_time != self.event_time:
            self._arm(NEVER)
        self.mapping = mapping
        self.synchronous = synchronous
        self.event_time = event_time
        if key != self.key:
            self.key = key
            self._reroute()
        self._renew()

    def set_enabled(self, enabled: bool, now: Time) -> None:
        """Set whether the node is in NMT state Operational. Leaving it drops data held for a SYNC and ends the watch."""
        if enabled != self.enabled:
            self.enabled = enabled
            self._forget()
            self._renew()

    def _renew(self) -> None:
        is_usual = self.is_live and not self.synchronous and not self.event_time
        layout = self.mapping.layout
        self.at_once = layout.unpack if is_usual and layout is not None else None

    def set_window(self, window: Time) -> None:
        """Set how long after a SYNC synchronous PDOs are accepted. window: ns; 0 = until the next SYNC. Holds from the next SYNC
        on.

        CiA 301 v4.2.0, 7.5.2.7
        """
        self._window = window
        self._window_end, self._stamp_end = NEVER, None

    def request(self, now: Time) -> bool:
        """Ask for the PDO by a remote frame. Sends nothing and returns False if it is not live. CiA 301 v4.2.0, 7.2.2.5.2"""
        if not self.enabled or self.key is None:
            return False
        self.out.frames.append(Frame(self.key & 0x1FFFFFFF, b"", self.key >> 29 | REMOTE, self.mapping.byte_length))
        return True

    @property
    def is_live(self) -> bool:
        """Whether a frame is processed now: the PDO is valid and mapped, and the node Operational."""
        return self.enabled and self.key is not None

    def can_ids(self) -> Iterable[RoutingKey]:
        return () if self.key is None else (self.key,)

    def receive(self, frame: Frame, now: Time) -> None:
        """Hold the data for the next SYNC, or put their values into the store and report `PdoReceived`.

        Events: `PdoLengthUnexpected` for a wrong length; `FrameIgnored` if the bytes are no valid value (a time of 25 hours).
        """
        if not self.enabled or self.key is None:
            return
        data = frame.data
        expected = self.mapping.byte_length
        if len(data) != expected:
            if len(data) < expected:
                self._report_length(len(data), EMCY_PDO_NOT_PROCESSED)
                return
            self._report_length(len(data), EMCY_PDO_LENGTH_EXCEEDED)
        if self.event_time:
            self._arm(now + self.event_time)
        if self.synchronous:
            stamp, end = self.out.timestamp, self._stamp_end
            late = now - self._window_end if stamp is None or end is None else stamp - end
            if late > 0:
                self.out.events.append(PdoTooLate(self.node_id, self.number, self.key, late, self.out.timestamp))
                return
            self._held = data
            self._held_timestamp = self.out.timestamp
        else:
            self._take(data, self.out.root.timestamp)

    def on_sync(self, counter: int | None, now: Time) -> None:
        """Handle a SYNC: put the held data into the store and report `PdoReceived`. counter: not used by consumers."""
        if self._window:
            stamp = self.out.timestamp
            self._window_end = now + self._window
            self._stamp_end = None if stamp is None else stamp + self._window
        data = self._held
        if data is not None:
            self._held = None
            self._take(data, self._held_timestamp)

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        self._arm(NEVER)
        assert self.key is not None  # only a PDO with a key is watched
        self.out.events.append(PdoOverdue(self.node_id, self.number, self.key, EMCY_RPDO_TIMEOUT))

    def _take(self, data: bytes, timestamp: int | None) -> None:
        key = self.key
        assert key is not None  # only a PDO with a key receives and holds data
        try:
            components = self.mapping.unpack_into(self.store, data)
        except ValueRangeError as error:
            self.out.events.append(FrameIgnored(self.node_id, Frame(key & 0x1FFFFFFF, data, key >> 29), str(error)))
            return
        self.out.events.append(PdoReceived(self.node_id, self.number, key, self.mapping, data, components, timestamp))

    def _report_length(self, received: int, emcy_code: int) -> None:
        assert self.key is not None
        self.out.events.append(
            PdoLengthUnexpected(
                self.node_id, self.number, self.key, self.mapping.byte_length, received, emcy_code, self.out.timestamp
            )
        )

    def _forget(self) -> None:
        self._held = None
        self._window_end, self._stamp_end = NEVER, None
        self._arm(NEVER)
