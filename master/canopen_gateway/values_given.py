"""Values that a client gives in JSON, as the bytes of an object."""

from __future__ import annotations

import math

from canopen_master import Node
from canopen_proto.datatypes import Value


def bytes_of(node: Node, index: int, subindex: int, value: Value | None) -> bytes:
    """Return the bytes of a value. value: a number, a text, a constant by its name; bytes in hexadecimal for an object that holds
    bytes. Raises ValueError, LocalProtocolError: nothing was sent. Also for what JSON has no number for (NaN, Infinity), and for
    what becomes that, as 1e999 does."""
    variable = node.dictionary.at(index, subindex)
    if not isinstance(value, int | float | str) or (isinstance(value, bool) and not isinstance(variable.codec.zero, bool)):
        raise ValueError(f"{variable.label}: the value has to be a number or a text")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{variable.label}: the value has to be a finite number; others can be given as bytes")
    if isinstance(value, str) and isinstance(variable.codec.zero, bytes):
        value = bytes.fromhex(value)
    return node.remote.encode(variable, value)[2]
