"""The PDOs in the class of a device, as they are after power-on: `Rpdo` and `Tpdo`.

A master may set up each of them in another way, as long as it is switched off meanwhile (CiA 301 v4.2.0, 7.5.2.36).
"""

from __future__ import annotations

from typing import ClassVar, Final, TypeAlias

from canopen_proto.datatypes import Value
from canopen_proto.declared.objects import Declared
from canopen_proto.dictionary import Direction
from canopen_proto.dictionary.objects import Access, Object, ObjectType, Variable
from canopen_proto.dictionary.pdo_records import pdo_records
from canopen_proto.frame import COB_ID_INVALID, COB_ID_NO_RTR
from canopen_proto.machine import MILLISECOND, LocalProtocolError, Time
from canopen_proto.pdo.settings import (
    EVENT_TIMER,
    INHIBIT_TIME,
    INHIBIT_UNIT,
    PREDEFINED,
    SYNC_START,
    TRANSMISSION_TYPE,
    communication_index,
)

ON_EVENT: Final = 255
MAX_BITS: Final = 64

Carried: TypeAlias = Declared | Variable
"""What a PDO may carry: an object with all of its entries, one entry of an array, or a standard object."""


class DefaultPdo:
    """A PDO after power-on. entries: what it carries, lowest bits first."""

    direction: ClassVar[Direction]

    def __init__(self, number: int, *carried: Carried, transmission_type: int = ON_EVENT, cob_id: int | None = None) -> None:
        """number: 1..512. carried: 8 bytes at most. transmission_type: 255 = on events; n = 1..240 = at each n-th SYNC, for an
        RPDO at the next one; 0 = at the SYNC behind an event. cob_id: the node-ID is added to it; None = that of the predefined
        connection set, which PDO 1 to 4 have; others are switched off then.

        Raises LocalProtocolError for another number, and for objects that such a PDO cannot carry.
        """
        self.index = communication_index(self.direction, number)
        self.label = f"{self.direction} {number}"
        self.entries = [variable for each in carried for variable in _variables(each)]
        self.fields: dict[int, Value | None] = {TRANSMISSION_TYPE: transmission_type}
        predefined = PREDEFINED[self.direction]
        if cob_id is None and number <= len(predefined):
            cob_id = predefined[number - 1]
        self.cob_id = COB_ID_INVALID if cob_id is None else cob_id
        self._check()

    def _check(self) -> None:
        forbidden = Access.RWR if self.direction is Direction.RPDO else Access.RWW
        for each in self.entries:
            fits = each.access.writable if self.direction is Direction.RPDO else each.access.readable
            if not each.pdo_mappable or not fits or each.access is forbidden or each.bit_length is None:
                raise LocalProtocolError(f"{self.label} cannot carry {each.label}: it is {each.access}, pdo={each.pdo_mappable}")
        bits = sum(each.bit_length or 0 for each in self.entries)
        if bits > MAX_BITS:
            raise LocalProtocolError(f"{self.label} carries {bits} bits; a PDO has {MAX_BITS}")

    def records(self) -> list[Object]:
        """Return its two objects."""
        return pdo_records(self.index, self.cob_id, self.fields, self.entries)


class Rpdo(DefaultPdo):
    """A PDO that the device receives: `Rpdo(1, outputs)`."""

    direction = Direction.RPDO

    def __init__(
        self,
        number: int,
        *carried: Carried,
        transmission_type: int = ON_EVENT,
        event_time: Time = 0,
        cob_id: int | None = None,
    ) -> None:
        """event_time: ns, in whole ms; if the next PDO does not come within it, the device sends EMCY 0x8250, and its `stop` is
        called; 0 = no limit. The others: as of `DefaultPdo`."""
        super().__init__(number, *carried, transmission_type=transmission_type, cob_id=cob_id)
        self.fields |= {INHIBIT_TIME: 0, EVENT_TIMER: event_time // MILLISECOND}


class Tpdo(DefaultPdo):
    """A PDO that the device sends: `Tpdo(1, inputs, event_time=SECOND)`."""

    direction = Direction.TPDO

    def __init__(
        self,
        number: int,
        *carried: Carried,
        transmission_type: int = ON_EVENT,
        inhibit_time: Time = 0,
        event_time: Time = 0,
        cob_id: int | None = None,
    ) -> None:
        """inhibit_time: ns in multiples of 100 us, between two of them at least. event_time: ns in whole ms, after which it is
        sent without an event; 0 = never. The others: as of `DefaultPdo`. It is not sent on remote requests (bit 30)."""
        super().__init__(number, *carried, transmission_type=transmission_type, cob_id=cob_id)
        self.cob_id |= COB_ID_NO_RTR
        self.fields |= {INHIBIT_TIME: inhibit_time // INHIBIT_UNIT, EVENT_TIMER: event_time // MILLISECOND, SYNC_START: 0}


def _variables(carried: Carried) -> tuple[Variable, ...]:
    if isinstance(carried, Variable):
        return (carried,)
    return carried.variables[1:] if carried.object_type is ObjectType.ARRAY else carried.variables
