"""Node-IDs, CAN-IDs and COB-IDs."""

from __future__ import annotations

from typing import Final

from hypothesis import strategies as st
from hypothesis.errors import InvalidArgument
from hypothesis.strategies import SearchStrategy

from canopen_proto.cob_id import RESTRICTED_CAN_IDS
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID, COB_ID_NO_RTR, MAX_NODE_ID, TPDO1

_ALLOWED: Final = [can_id for can_id in range(0x800) if not any(can_id in each for each in RESTRICTED_CAN_IDS)]
_FREE: Final = sorted(_ALLOWED, key=lambda can_id: can_id <= TPDO1)
"""The CAN-IDs that a communication object may take, those of PDOs first: SYNC, TIME and EMCY stand below them."""


def node_ids(min_value: int = 1, max_value: int = MAX_NODE_ID) -> SearchStrategy[int]:
    """Return a strategy for the node-IDs from min_value to max_value.

    Bounds: 1 and 127 (CiA 301 v4.2.0, 7.2.8); others raise InvalidArgument. Shrinks towards min_value.
    """
    if not 1 <= min_value <= max_value <= MAX_NODE_ID:
        raise InvalidArgument(
            f"there are no node-IDs from {min_value} to {max_value}: min_value and max_value are in 1..{MAX_NODE_ID}"
        )
    return st.integers(min_value, max_value)


def cob_ids(*, extended: bool = False, flags: bool = False) -> SearchStrategy[int]:
    """Return a strategy for COB-IDs that a device accepts for a communication object: a CAN-ID that is not restricted.

    extended: CAN-IDs of 29 bits too, with bit 29 set. flags: bit 31 (not valid) and bit 30 (no remote frames) too.
    Bounds: those of CiA 301 v4.2.0, 7.3.5, table 40. Shrinks towards 0x181, without flags.
    """
    plain: SearchStrategy[int] = st.sampled_from(_FREE)
    if extended:
        plain |= st.integers(0, 0x1FFF_FFFF).map(lambda can_id: can_id | COB_ID_EXTENDED)
    if flags:
        bits = st.sampled_from((0, COB_ID_INVALID, COB_ID_NO_RTR, COB_ID_INVALID | COB_ID_NO_RTR))
        return st.builds(lambda cob_id, more: cob_id | more, plain, bits)
    return plain
