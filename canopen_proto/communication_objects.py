"""The communication objects of a device that take effect, except those of PDOs, and the machines that they set.

Each index has a rule for its writes (`check_write`) and an effect on the machines (`_effects`). 0x1001 and 0x1003 belong to the
EMCY producer; they are copied into the values when they are read (`refresh`).

    0x1003   error history: writing 0 to subindex 0 clears it, nothing else may be written; an entry
             beyond the number of errors has no data to read (0x08000024)                             7.5.2.4
    0x1005   COB-ID SYNC: bit 30 makes us the producer; the CAN-ID may not change while it is set     7.5.2.5
    0x1006   communication cycle period in us, 0 stops the producer                                   7.5.2.6
    0x100C   guard time in ms, and 0x100D life time factor: their product is the node life time. A
             device that has both answers guarding requests while it has no heartbeat               7.5.2.11, .12
    0x1012   COB-ID TIME: bit 31 lets us receive it, bit 30 send it; the CAN-ID may not change
             while one of them is set                                                               7.5.2.15
    0x1014   COB-ID EMCY: the CAN-ID may not change while it is valid                                 7.5.2.17
    0x1015   EMCY inhibit time in 100 us                                                              7.5.2.18
    0x1016   heartbeat consumers: node-ID << 16 | ms, one entry for each node at most                 7.5.2.19
    0x1017   producer heartbeat time in ms                                                            7.5.2.20
    0x1019   SYNC counter overflow: 0 or 2 to 240, only while 0x1006 is 0                             7.5.2.22
    0x1028   EMCY consumers: the subindex is the node-ID; the CAN-ID may not change while it is
             valid. 0, which no EMCY can have, counts as not valid                                  7.5.2.31
    0x1029   error behaviour: 0, 1 or 2; other values are reserved, or of other manufacturers          7.5.2.32

A write that changes nothing is always allowed. CAN-IDs that the standard restricts are refused (7.3.5, table 40). If the file of
a device has such a CAN-ID as a default, or another type than the standard, the service is off or uses the default of the
standard; `canopen_data.device_notices` reports it.

The synchronous window (0x1007) and the PDO parameters are in pdo/parameters.py.

Source: CiA 301 v4.2.0, the clause at each row.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.cob_id import CAN_ID_AND_FRAME, CONSUMES, PRODUCES, check_can_id, check_cob_id, is_valid
from canopen_proto.datatypes import Value, range_of
from canopen_proto.dictionary import Values
from canopen_proto.emcy import MAX_HISTORY, EmcyConsumer, EmcyProducer
from canopen_proto.frame import COB_ID_INVALID, EMCY, MAX_NODE_ID, SYNC, key_of_cob_id
from canopen_proto.group import Members
from canopen_proto.guarding import GuardingSlave
from canopen_proto.heartbeat import HeartbeatConsumer, HeartbeatProducer
from canopen_proto.machine import MICROSECOND, MILLISECOND, Outbox, Time
from canopen_proto.multiplexer import Mux, index_of, mux, subindex_of
from canopen_proto.nmt import SERVICES, NmtState, Service
from canopen_proto.owner import Owner
from canopen_proto.pdo.mapping import number_at
from canopen_proto.sync import MAX_COUNTER, SyncConsumer, SyncProducer
from canopen_proto.time_stamp import TimeConsumer, TimeProducer

MIN_SYNC_PERIOD_US: Final = 100
"""The shortest communication cycle period that a client may set: two empty frames at 1 Mbit/s. A shorter one floods the bus."""

_TIME_BITS: Final = PRODUCES | CONSUMES

ERROR_REGISTER: Final = mux(indices.ERROR_REGISTER)
_SHOWN: Final = (indices.ERROR_REGISTER, indices.PREDEFINED_ERROR_FIELD)
"""What the EMCY producer holds, and the values show when they are read."""
ERROR_HISTORY: Final = mux(indices.PREDEFINED_ERROR_FIELD)
COB_ID_SYNC: Final = mux(indices.COB_ID_SYNC)
CYCLE_PERIOD: Final = mux(indices.COMMUNICATION_CYCLE_PERIOD)
GUARD_TIME: Final = mux(indices.GUARD_TIME)
LIFE_TIME_FACTOR: Final = mux(indices.LIFE_TIME_FACTOR)
COB_ID_TIME: Final = mux(indices.COB_ID_TIME_STAMP)
COB_ID_EMCY: Final = mux(indices.COB_ID_EMERGENCY)
EMCY_INHIBIT_TIME: Final = mux(indices.INHIBIT_TIME_EMERGENCY)
PRODUCER_HEARTBEAT: Final = mux(indices.PRODUCER_HEARTBEAT_TIME)
SYNC_OVERFLOW: Final = mux(indices.SYNCHRONOUS_COUNTER_OVERFLOW_VALUE)
LAST_ERROR_BEHAVIOUR: Final = 2
"""The values of 0x1029: 0 = pre-operational, 1 = no change, 2 = stopped."""

BYTE: Final = 0xFF
MAX_NUMBER: Final = 0xFFFF_FFFF
"""The greatest number of a communication object, an UNSIGNED32 at most. A faulty file may have more, and such a time would reach
NEVER."""

DEFAULT_HISTORY_LENGTH: Final = 8
"""The entries of the history if the dictionary has no 0x1003."""


class CommunicationObjects(Owner):
    """The machines that a device's communication objects set, and the rules for writes to these objects."""

    def __init__(self, out: Outbox, node_id: int, values: Values, members: Members) -> None:
        """Make the machines and attach them to `members`. `reload` sets them by the values."""
        self._out = out
        self._state = NmtState.INITIALISING
        self._members = members
        self.node_id = node_id
        self.values = values
        history = values.dictionary.objects.get(indices.PREDEFINED_ERROR_FIELD)
        length = DEFAULT_HISTORY_LENGTH if history is None else min(max(1, len(history.variables) - 1), MAX_HISTORY)
        self.emcy = EmcyProducer(out, node_id, history_length=length)
        self.heartbeat = HeartbeatProducer(out, node_id)
        self.guarding = GuardingSlave(out, node_id)
        self.monitors: dict[int, HeartbeatConsumer] = {}
        self.emcy_consumers: dict[int, EmcyConsumer] = {}
        self.sync_producer = SyncProducer(out)
        self.sync_consumer = SyncConsumer(out)
        self.time_producer = TimeProducer(out)
        self.time_consumer = TimeConsumer(out, None)
        self.emcy.set_enabled(False, 0)  # until the boot-up frame is out
        self._effects: dict[int, Callable[[Time], None]] = {
            indices.PREDEFINED_ERROR_FIELD: self._clear_history,
            indices.COB_ID_SYNC: self._set_sync,
            indices.COMMUNICATION_CYCLE_PERIOD: self._set_sync,
            indices.GUARD_TIME: self._set_guarding,
            indices.LIFE_TIME_FACTOR: self._set_guarding,
            indices.COB_ID_TIME_STAMP: self._set_time,
            indices.COB_ID_EMERGENCY: self._set_emcy,
            indices.INHIBIT_TIME_EMERGENCY: self._set_emcy_inhibit,
            indices.CONSUMER_HEARTBEAT_TIME: self._set_monitors,
            indices.PRODUCER_HEARTBEAT_TIME: self._set_heartbeat,
            indices.SYNCHRONOUS_COUNTER_OVERFLOW_VALUE: self._set_sync,
            indices.EMERGENCY_CONSUMER: self._set_emcy_consumers,
        }
        for machine in (self.emcy, self.heartbeat, self.guarding, self.sync_producer, self.sync_consumer, self.time_consumer):
            members.attach(machine)

    def _int(self, key: Mux, default: int = 0) -> int:
        """Return the stored number, at most MAX_NUMBER; `default` if a file describes the object as no number."""
        return min(number_at(self.values.store, key, default), MAX_NUMBER)

    def _cob_id(self, key: Mux, default: int) -> int:
        """Return the stored COB-ID, or `default` if its CAN-ID is restricted (only a faulty file can put one there)."""
        cob_id = self._int(key, default)
        return cob_id if check_can_id(cob_id & CAN_ID_AND_FRAME) is None else default

    def _cob_id_emcy(self) -> int:
        cob_id = self._int(COB_ID_EMCY)
        return cob_id if cob_id & COB_ID_INVALID else self._cob_id(COB_ID_EMCY, EMCY + self.node_id)

    def reload(self, now: Time) -> None:
        """Set all machines by the values: at start-up, and after a reset to the defaults. Monitoring of nodes starts again."""
        self.stop_monitoring()
        self._set_emcy(now)
        self._set_emcy_inhibit(now)
        self._set_heartbeat(now)
        self._set_monitors(now)
        self._set_sync(now)
        self._set_time(now)
        self._set_emcy_consumers(now)

    def set_node_id(self, node_id: int) -> None:
        """Take another node-ID (LSS); call `reload` then."""
        self.node_id = self.emcy.node_id = self.heartbeat.node_id = node_id
        self.guarding.set_node_id(node_id)

    def stop_monitoring(self) -> None:
        """Stop watching the heartbeats of other nodes."""
        for monitor in self.monitors.values():
            self._members.detach(monitor)
        self.monitors.clear()

    def set_state(self, state: NmtState, now: Time) -> None:
        """Set the NMT state. It decides which services run; heartbeats and guarding answers show it."""
        self._state = state
        self.emcy.set_enabled(self._lives(Service.EMCY), now)
        self._set_sync(now)
        self._set_time(now)
        self._set_emcy_consumers(now)
        self.heartbeat.set_state(state, now)
        self.guarding.set_state(state)

    @property
    def may_send_time(self) -> bool:
        """Whether the device is a TIME producer (0x1012), and its NMT state allows TIME."""
        return bool(self._cob_id(COB_ID_TIME, 0) & PRODUCES) and self._lives(Service.TIME)

    def _lives(self, service: Service) -> bool:
        return service in SERVICES[self._state]

    def refresh(self, index: int, subindex: int) -> AbortCode | None:
        """Copy 0x1001 or 0x1003 into the values before a read. Returns NO_DATA for an entry of 0x1003 beyond the last error."""
        if index not in _SHOWN:
            return None
        store = self.values.store
        if index == indices.ERROR_REGISTER and self._has_room(indices.ERROR_REGISTER, 0, BYTE):
            store[ERROR_REGISTER] = self.emcy.error_register
        elif index == indices.PREDEFINED_ERROR_FIELD and self._has_room(indices.PREDEFINED_ERROR_FIELD, 0, BYTE):
            shown = {
                mux(indices.PREDEFINED_ERROR_FIELD, number): entry for number, entry in enumerate(self.emcy.history, start=1)
            }
            shown = {
                key: entry
                for key, entry in shown.items()
                if self._has_room(indices.PREDEFINED_ERROR_FIELD, subindex_of(key), MAX_NUMBER)
            }
            store.update(shown)
            store[ERROR_HISTORY] = len(shown)
            if subindex and (key := ERROR_HISTORY + subindex) in store and key not in shown:
                return AbortCode.NO_DATA
        return None

    def _has_room(self, index: int, subindex: int, highest: int) -> bool:
        """Return whether the dictionary has an object, with a type that can hold numbers up to `highest`."""
        variable = self.values.dictionary.get(index, subindex)
        numbers = None if variable is None else range_of(variable.data_type)
        return numbers is not None and numbers[1] >= highest

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        if index == indices.PREDEFINED_ERROR_FIELD:
            return None if value == 0 and subindex == 0 else AbortCode.INVALID_VALUE
        present = self.values.store.get(mux(index, subindex))
        if not isinstance(value, int) or not isinstance(present, int) or value == present:
            return None
        match index:
            case indices.COB_ID_SYNC:
                return check_cob_id(value, present, in_use=bool(present & value & PRODUCES))
            case indices.COMMUNICATION_CYCLE_PERIOD if value and value < MIN_SYNC_PERIOD_US:
                return AbortCode.INVALID_VALUE
            case indices.COB_ID_TIME_STAMP:
                return check_cob_id(value, present, in_use=bool(present & _TIME_BITS and value & _TIME_BITS))
            case indices.COB_ID_EMERGENCY if not value & COB_ID_INVALID:
                return check_cob_id(value, present, in_use=not present & COB_ID_INVALID)
            case indices.CONSUMER_HEARTBEAT_TIME:
                return self._check_monitor(subindex, value)
            case indices.SYNCHRONOUS_COUNTER_OVERFLOW_VALUE:
                if self._int(CYCLE_PERIOD):
                    return AbortCode.DEVICE_STATE
                return None if _is_overflow(value) else AbortCode.INVALID_VALUE
            case indices.EMERGENCY_CONSUMER if not value & COB_ID_INVALID:
                return check_cob_id(value, present, in_use=is_valid(present))
            case indices.ERROR_BEHAVIOR if value > LAST_ERROR_BEHAVIOUR:
                return AbortCode.INVALID_VALUE
        return None

    def apply(self, index: int, subindex: int, now: Time) -> None:
        effect = self._effects.get(index)
        if effect is not None:
            effect(now)

    def _check_monitor(self, subindex: int, value: int) -> AbortCode | None:
        node_id, period = value >> 16 & 0xFF, value & 0xFFFF
        if not 1 <= node_id <= MAX_NODE_ID or period == 0:
            return None  # an entry that is not used
        for other, present in self._entries(indices.CONSUMER_HEARTBEAT_TIME).items():
            if other != subindex and present & 0xFFFF and present >> 16 & 0xFF == node_id:
                return AbortCode.PARAMETER_INCOMPATIBLE
        return None

    def _entries(self, index: int) -> dict[int, int]:
        """Return the numbers of an array by subindex."""
        described = self.values.dictionary.objects.get(index)
        subindices = [] if described is None else [subindex for subindex in described.variables if subindex]
        return {subindex: self._int(mux(index, subindex)) for subindex in subindices}

    def _clear_history(self, now: Time) -> None:
        self.emcy.clear_history()
        for key in self.values.store:
            if index_of(key) == indices.PREDEFINED_ERROR_FIELD and self._has_room(
                indices.PREDEFINED_ERROR_FIELD, subindex_of(key), BYTE
            ):
                self.values.store[key] = 0

    def _set_emcy(self, now: Time) -> None:
        self.emcy.set_cob_id(self._cob_id_emcy(), now)

    def _set_emcy_inhibit(self, now: Time) -> None:
        self.emcy.set_inhibit_time(self._int(EMCY_INHIBIT_TIME) * 100 * MICROSECOND, now)

    def _set_heartbeat(self, now: Time) -> None:
        self.heartbeat.set_period(self._int(PRODUCER_HEARTBEAT) * MILLISECOND, now)
        self._set_guarding(now)

    def _set_monitors(self, now: Time) -> None:
        wanted: dict[int, Time] = {}
        for entry in self._entries(indices.CONSUMER_HEARTBEAT_TIME).values():
            node_id, period = entry >> 16 & 0xFF, entry & 0xFFFF
            if 1 <= node_id <= MAX_NODE_ID and period:
                wanted.setdefault(node_id, period * MILLISECOND)
        for node_id in [node_id for node_id in self.monitors if node_id not in wanted]:
            self._members.detach(self.monitors.pop(node_id))
        for node_id, timeout in wanted.items():
            monitor = self.monitors.get(node_id)
            if monitor is None:
                monitor = self.monitors[node_id] = HeartbeatConsumer(self._out, node_id)
                self._members.attach(monitor)
            if monitor.timeout != timeout:
                monitor.set_timeout(timeout, now)

    def _set_emcy_consumers(self, now: Time) -> None:
        """Keep one consumer for each valid entry of 0x1028, whose subindex is the node-ID, while the NMT state allows EMCY."""
        entries = self._entries(indices.EMERGENCY_CONSUMER).items() if self._lives(Service.EMCY) else ()
        wanted = {node_id: key_of_cob_id(entry) for node_id, entry in entries if node_id <= MAX_NODE_ID and is_valid(entry)}
        for node_id in [each for each, consumer in self.emcy_consumers.items() if wanted.get(each) != consumer.key]:
            self._members.detach(self.emcy_consumers.pop(node_id))
        for node_id in sorted(wanted.keys() - self.emcy_consumers.keys()):
            consumer = self.emcy_consumers[node_id] = EmcyConsumer(self._out, node_id, wanted[node_id])
            self._members.attach(consumer)

    def _set_guarding(self, now: Time) -> None:
        store = self.values.store
        has_heartbeat = self._int(PRODUCER_HEARTBEAT) != 0  # a device uses only one of the two: 7.2.8.3.2
        self.guarding.set_enabled(GUARD_TIME in store and LIFE_TIME_FACTOR in store and not has_heartbeat)
        life_time = self._int(GUARD_TIME) * self._int(LIFE_TIME_FACTOR) * MILLISECOND
        if life_time != self.guarding.life_time:
            self.guarding.set_life_time(life_time, now)

    def _set_sync(self, now: Time) -> None:
        cob_id, overflow = self._cob_id(COB_ID_SYNC, SYNC), self._int(SYNC_OVERFLOW)
        if not _is_overflow(overflow):
            overflow = 0  # a faulty file may have a value that no client could write
        produces = self._lives(Service.SYNC) and bool(cob_id & PRODUCES)
        period = self._int(CYCLE_PERIOD) if produces else 0
        if period:
            period = max(period, MIN_SYNC_PERIOD_US) * MICROSECOND
        key, producer = key_of_cob_id(cob_id), self.sync_producer
        self.sync_consumer.configure(key, overflow)
        if (producer.key, producer.period, producer.counter_overflow) == (key, period, overflow):
            return
        producer.stop()
        producer.key, producer.counter_overflow = key, overflow
        if period:
            producer.start(period, now)

    def _set_time(self, now: Time) -> None:
        cob_id = self._cob_id(COB_ID_TIME, 0)
        key = key_of_cob_id(cob_id)
        self.time_producer.key = key
        self.time_consumer.set_key(key if cob_id & CONSUMES and self._lives(Service.TIME) else None)


def _is_overflow(value: int) -> bool:
    return value == 0 or 2 <= value <= MAX_COUNTER
