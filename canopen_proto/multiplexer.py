"""The multiplexer: index and subindex of an object in one number, the key of `Values.store` and of all fast look-ups.

CiA 301 v4.2.0, 7.2.4.3.3, calls the index and subindex in an SDO frame by that name. `Mux` is a type of its own, so that mypy
tells it from an index, from a routing key and from a plain number: `values.store[0x6040] = 15` is an error there, and
`values.store[mux(0x6040)] = 15` is right.
"""

from __future__ import annotations

from typing import Final, NewType

Mux = NewType("Mux", int)
"""Index << 8 | subindex: 0x604100 is object 0x6041, subindex 0."""

FIRST_MUX: Final = 0x100000

AXIS_STEP: Final = 0x800
"""From the index of an object of a logical device (an axis, if the node is a drive) to that of the next one."""


def mux(index: int, subindex: int = 0) -> Mux:
    """Return the multiplexer of an object: index 0..0xFFFF, subindex 0..0xFF, not checked."""
    return index << 8 | subindex  # type: ignore[return-value]  # `Mux(...)` would cost a call, twice as much as the rest


def index_of(multiplexer: Mux) -> int:
    """Return the index, 0..0xFFFF."""
    return multiplexer >> 8


def subindex_of(multiplexer: Mux) -> int:
    """Return the subindex, 0..0xFF."""
    return multiplexer & 0xFF


def split_mux(multiplexer: Mux) -> tuple[int, int]:
    """Return index and subindex."""
    return multiplexer >> 8, multiplexer & 0xFF


def place_of(number: int) -> tuple[int, int]:
    """Return the index and subindex that a number means: a multiplexer, or an index alone, which stands for its subindex 0.

    A number of six hexadecimal digits is a multiplexer. No device has an object to read or write below index 0x1000.
    """
    return (number, 0) if number < FIRST_MUX else (number >> 8, number & 0xFF)


def mux_text(multiplexer: Mux) -> str:
    """Return the place as people write it: "0x6041:00"."""
    return f"0x{multiplexer >> 8:04X}:{multiplexer & 0xFF:02X}"


def mapping_entry(multiplexer: Mux, bits: int) -> int:
    """Return the entry of a PDO mapping parameter for an object of so many bits, 0..0xFF. CiA 301 v4.2.0, 7.5.2.36 multiplexer:
    of the object."""
    return multiplexer << 8 | bits


def mapped(entry: int) -> tuple[int, int, int]:
    """Return index, subindex and number of bits of the object that an entry of a PDO mapping parameter names."""
    return entry >> 16 & 0xFFFF, entry >> 8 & 0xFF, entry & 0xFF
