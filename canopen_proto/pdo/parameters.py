"""The PDOs of a device: made from its dictionary, and changed by writes to their parameters.

A device has an RPDO for each record at 0x1400..0x15FF, and a TPDO for each at 0x1800..0x19FF; the mapping is 0x200 above.
`DevicePdos` makes a consumer or a producer for each record, and one machine for the multiplexed PDOs of each direction. A later
write changes a machine and never replaces it: the owner attaches `machines` once.

`check_write` is called before a value is stored (rules.py has the rules), `apply` after it. Both also handle the synchronous
window length (0x1007) and the lists of multiplexed PDOs (0x1FA0..0x1FFF).

Bit 30 of a TPDO's COB-ID forbids remote requests; if it is 0, the device answers them.

Invalid defaults, which some EDS files have, do not keep the device from starting. A record without a COB-ID makes no PDO. An
invalid mapping, or a CAN-ID that no PDO may have, disables its PDO. `faults` lists them.

Source: CiA 301 v4.2.0, 7.5.2.7 and 7.5.2.35 to 7.5.2.40.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.cob_id import check_can_id
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Direction, Values
from canopen_proto.frame import COB_ID_INVALID, COB_ID_NO_RTR, RoutingKey, key_of_cob_id
from canopen_proto.machine import MICROSECOND, MILLISECOND, Machine, Outbox, Time
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.owner import Owner
from canopen_proto.pdo.consumer import EVENT_DRIVEN, PdoConsumer
from canopen_proto.pdo.mapping import Mapping, MappingError, number_at
from canopen_proto.pdo.multiplexed import DISPATCHER_LISTS, SCANNER_LISTS, MpdoConsumer, MpdoMode, MpdoProducer
from canopen_proto.pdo.producer import FIRST_EVENT_DRIVEN, PdoProducer
from canopen_proto.pdo.rules import PdoWriteRules
from canopen_proto.pdo.settings import (
    COB_ID,
    EVENT_TIMER,
    INHIBIT_TIME,
    INHIBIT_UNIT,
    SYNC_START,
    TRANSMISSION_TYPE,
    communication_index,
    mapping_index,
    place_of,
    places_of,
)

MAX_TIME: Final = 0xFFFF_FFFF
"""The greatest value of a time, in its own unit: only a faulty file has more than UNSIGNED32, and it must not reach NEVER."""

_NOTHING: Final = Mapping()
_MODES: Final = {int(mode): mode for mode in MpdoMode}


class DevicePdos(Owner):
    """All PDOs of one device; see this module's text.

    values: the device's memory, which the PDOs read and write. consumers, producers: by PDO number, 1..512. No machine is added
    or removed later. faults: the error in a parameter, by its index. sends_on_start: send each event-driven TPDO once on entering
    Operational, so that a master that has just begun to listen gets the present values. CANopenNode's devices (seen in a
    recorded session) and I/O modules such as Bürkert's 8645 do so, Lely's do not; CiA 301 leaves it open.
    """

    def __init__(self, out: Outbox, node_id: int, values: Values) -> None:
        self._values = values
        self.sends_on_start = False
        self.consumers: dict[int, PdoConsumer] = {}
        self.producers: dict[int, PdoProducer] = {}
        self.mpdo_consumer = MpdoConsumer(out, node_id, values)
        self.mpdo_producer = MpdoProducer(out, node_id, values)
        self.faults: dict[int, str] = {}
        self._rules = PdoWriteRules(values, self.faults)
        self._triggers: dict[int, list[PdoProducer]] = {}  # by the muxes that they carry
        self._synchronous: tuple[PdoConsumer | PdoProducer, ...] = ()  # producers first
        for direction, number in places_of(values.dictionary.objects):
            index = communication_index(direction, number)
            if values.dictionary.get(index, COB_ID) is None:
                self.faults[index] = f"it has no COB-ID (subindex {COB_ID})"
            elif direction == Direction.RPDO:
                self.consumers[number] = PdoConsumer(out, node_id, number, None, _NOTHING, values.store)
            else:
                self.producers[number] = PdoProducer(out, node_id, number, None, _NOTHING, values.store)
        self.reload(0)

    @property
    def machines(self) -> Iterator[Machine]:
        """All machines, for the owner to attach."""
        yield from self.consumers.values()
        yield from self.producers.values()
        yield self.mpdo_consumer
        yield self.mpdo_producer

    @staticmethod
    def owns(index: int) -> bool:
        """Return whether an object is a PDO parameter: its writes go through `check_write` and `apply`."""
        return (
            index == indices.SYNCHRONOUS_WINDOW_LENGTH
            or place_of(index) is not None
            or index in SCANNER_LISTS
            or index in DISPATCHER_LISTS
        )

    def set_node_id(self, node_id: int) -> None:
        """Be another node from now on (LSS), before `reload`."""
        for consumer in self.consumers.values():
            consumer.node_id = node_id
        for producer in self.producers.values():
            producer.node_id = node_id
        self.mpdo_consumer.node_id = self.mpdo_producer.node_id = node_id

    def set_enabled(self, enabled: bool, now: Time) -> None:
        """Set whether the device is in NMT state Operational: PDOs exist in no other state.

        Entering it starts the event timers; with `sends_on_start`, each event-driven TPDO is sent once.
        """
        for consumer in self.consumers.values():
            consumer.set_enabled(enabled, now)
        for producer in self.producers.values():
            begins = self.sends_on_start and enabled and not producer.enabled
            producer.set_enabled(enabled, now)
            if begins and producer.transmission_type >= FIRST_EVENT_DRIVEN:
                producer.trigger(now)
        self.mpdo_consumer.set_enabled(enabled)
        self.mpdo_producer.set_enabled(enabled, now)

    def on_sync(self, counter: int | None, now: Time) -> None:
        """Handle a SYNC: send the TPDOs, then let the held RPDOs take effect. counter: of the SYNC, None if it has none.

        In this order the TPDOs report the state at the SYNC, before the RPDOs change it.
        """
        for machine in self._synchronous:
            machine.on_sync(counter, now)

    def trigger(self, mux: Mux, now: Time) -> None:
        """Trigger the TPDOs that carry a mux, whose value has changed."""
        for producer in self._triggers.get(mux, ()):
            producer.trigger(now)
        if self.mpdo_producer.has_source:
            self.mpdo_producer.trigger(mux, now)

    def reload(self, now: Time) -> None:
        """Apply all parameters again: at start-up, and after a reset to the defaults."""
        for number in self.consumers:
            self._configure(Direction.RPDO, number, now)
        for number in self.producers:
            self._configure(Direction.TPDO, number, now)
        self.mpdo_consumer.reload_lists()
        self.mpdo_producer.reload_lists()
        self._set_window()
        self._sort()

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """Return the abort code that refuses a write, or None. value: checked for type and limits. See `PdoWriteRules`."""
        return self._rules.check_write(index, subindex, value)

    def apply(self, index: int, subindex: int, now: Time) -> None:
        """Let a stored value take effect. The PDO's machine announces a changed CAN-ID itself."""
        place = place_of(index)
        if place is not None and place.number in (self.consumers if place.direction == Direction.RPDO else self.producers):
            self._configure(place.direction, place.number, now)
            self._sort()
        elif index == indices.SYNCHRONOUS_WINDOW_LENGTH:
            self._set_window()
        elif index in SCANNER_LISTS:
            self.mpdo_producer.reload_lists()
        elif index in DISPATCHER_LISTS:
            self.mpdo_consumer.reload_lists()

    def _configure(self, direction: Direction, number: int, now: Time) -> None:
        """Give one machine the parameters that are in the dictionary."""
        mapping, mode = self._standing_mapping(direction, number)
        store = self._values.store
        index = communication_index(direction, number)
        cob_id = number_at(store, mux(index, COB_ID), COB_ID_INVALID)
        key = self._key(index, cob_id)
        transmission_type = number_at(store, mux(index, TRANSMISSION_TYPE), EVENT_DRIVEN)
        event_time = min(number_at(store, mux(index, EVENT_TIMER)), MAX_TIME) * MILLISECOND
        if direction == Direction.RPDO:
            self.mpdo_consumer.set_pdo(number, key, mode)
            self.consumers[number].configure(key, mapping, transmission_type, event_time)
            return
        inhibit_time = min(number_at(store, mux(index, INHIBIT_TIME)), MAX_TIME) * INHIBIT_UNIT
        sync_start = number_at(store, mux(index, SYNC_START))
        self.mpdo_producer.set_pdo(number, key, mode, now, inhibit_time, event_time)
        self.producers[number].configure(
            key,
            mapping,
            now,
            transmission_type,
            inhibit_time,
            event_time,
            sync_start,
            answers_requests=not cob_id & COB_ID_NO_RTR,
        )

    def _key(self, index: int, cob_id: int) -> RoutingKey | None:
        """Return the routing key for a COB-ID at `index`; None if its PDO is not valid, or its CAN-ID not allowed."""
        self.faults.pop(index, None)
        if cob_id & COB_ID_INVALID:
            return None
        if check_can_id(cob_id) is not None:
            self.faults[index] = f"COB-ID 0x{cob_id:X} has a CAN-ID that no PDO may have"
            return None
        return key_of_cob_id(cob_id)

    def _sort(self) -> None:
        """Sort the PDOs by what they wait for: a SYNC, or the change of a value."""
        producers = [each for each in self.producers.values() if each.key is not None]
        consumers = [each for each in self.consumers.values() if each.key is not None and each.synchronous]
        self._synchronous = (*(each for each in producers if each.is_synchronous), *consumers)
        self._triggers.clear()
        for producer in producers:
            for each in {entry.mux for entry in producer.mapping.components}:
                self._triggers.setdefault(each, []).append(producer)

    def _set_window(self) -> None:
        window = min(number_at(self._values.store, mux(indices.SYNCHRONOUS_WINDOW_LENGTH)), MAX_TIME) * MICROSECOND  # 0: none
        for consumer in self.consumers.values():
            consumer.set_window(window)

    def _standing_mapping(self, direction: Direction, number: int) -> tuple[Mapping, MpdoMode | None]:
        """Return the mapping in the dictionary and the mode of an MPDO. An MPDO and an invalid mapping (`faults`) give an empty
        one."""
        index = mapping_index(direction, number)
        self.faults.pop(index, None)
        mode = _MODES.get(number_at(self._values.store, mux(index)))
        if mode is not None:
            return _NOTHING, mode
        try:
            return Mapping.from_values(self._values, index), None
        except MappingError as error:
            self.faults[index] = str(error)
            return _NOTHING, None
