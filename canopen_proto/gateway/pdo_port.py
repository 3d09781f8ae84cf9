"""`PdoPort`: a PDO of a gateway, which one of its clients has set up: received and reported, or sent when the client says so.

A gateway's PDO has numbers and widths, and no dictionary: its values are the bits of the frame, lowest first, as unsigned numbers
(CiA 309-3, `set rpdo`, `set tpdo`). Only event-driven PDOs are sent. Set-points in each cycle belong into the process that owns
the bus: a network between them would make them jump.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from canopen_proto.cob_id import check_can_id
from canopen_proto.frame import COB_ID_INVALID, TPDO1, Frame, RoutingKey, frame_for_key, key_of_cob_id
from canopen_proto.machine import Event, LocalProtocolError, Machine, Outbox, Time

MAX_PDO_BITS: Final = 64
_LAST_OF_SERVICES: Final = TPDO1
"""Up to here are NMT, SYNC, EMCY and TIME (CiA 301 v4.2.0, 7.3.3)."""


class PdoReport(Event):
    """A PDO came that a port listens to. node_id is 0. ear: the number of its client. number: of the PDO. values: of its
    objects."""

    __match_args__ = ("node_id", "ear", "number", "values")

    def __init__(self, node_id: int, ear: int, number: int, values: tuple[int, ...]) -> None:
        self.node_id = node_id
        self.ear = ear
        self.number = number
        self.values = values


class PdoPort(Machine):
    """See this module's text. ear: the number of its client. number: of the PDO. values: the last ones that came; None before.

    widths: bits of its objects. listens: it receives; else it sends.
    """

    def __init__(self, out: Outbox, ear: int, number: int, cob_id: int, widths: Sequence[int], *, listens: bool) -> None:
        """cob_id: of its frames. Raises LocalProtocolError for one that is restricted (CiA 301 v4.2.0, 7.3.5) or not valid, for
        one of SYNC, EMCY or TIME if it sends, and for more than 64 bits."""
        super().__init__(out)
        if sum(widths) > MAX_PDO_BITS:
            raise LocalProtocolError(f"PDO {number} has {sum(widths)} bits: {MAX_PDO_BITS} are possible")
        key = key_of_cob_id(cob_id)
        is_refused = check_can_id(cob_id) is not None or bool(cob_id & COB_ID_INVALID)
        if is_refused or (not listens and key <= _LAST_OF_SERVICES):
            raise LocalProtocolError(f"PDO {number} cannot have the COB-ID 0x{cob_id:X}")
        self.ear = ear
        self.number = number
        self.widths = tuple(widths)
        self.listens = listens
        self.values: tuple[int, ...] | None = None
        self._key: RoutingKey = key

    @property
    def byte_length(self) -> int:
        """The bytes of its frames."""
        return (sum(self.widths) + 7) // 8

    def can_ids(self) -> Iterable[RoutingKey]:
        return (self._key,) if self.listens else ()

    def receive(self, frame: Frame, now: Time) -> None:
        """Take the PDO; one that is too short is nobody's, and of a longer one the first bits count."""
        if len(frame.data) < self.byte_length:
            return
        whole, values = int.from_bytes(frame.data, "little"), []
        for width in self.widths:
            values.append(whole & (1 << width) - 1)
            whole >>= width
        self.values = tuple(values)
        self.out.events.append(PdoReport(0, self.ear, self.number, self.values))

    def send(self, values: Sequence[int], now: Time) -> None:
        """Send the PDO with these values. Raises LocalProtocolError if they are not one for each object, or do not fit."""
        if len(values) != len(self.widths):
            raise LocalProtocolError(f"PDO {self.number} has {len(self.widths)} values, not {len(values)}")
        whole, offset = 0, 0
        for value, width in zip(values, self.widths, strict=True):
            if not 0 <= value < 1 << width:
                raise LocalProtocolError(f"PDO {self.number}: 0x{value:X} does not fit into {width} bits")
            whole |= value << offset
            offset += width
        self.out.frames.append(frame_for_key(self._key, whole.to_bytes(self.byte_length, "little")))
