"""How an NMT master treats its network and each node: the bits of 0x1F80 and 0x1F81.

Source: CiA 302-2, objects 0x1F80 (NMT startup) and 0x1F81 (slave assignment), as Lely core and dcfgen have them. Turck's manual
of its BL20 gateway has bits 0 to 4 of 0x1F81 alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from canopen_proto.machine import MILLISECOND, LocalProtocolError, Time

FLYING_MASTER: Final = 1 << 5
_STARTUP_BITS: Final = ("is_master", "start_all", "waits", "application_starts", "reset_all_on_loss", "", "stop_all_on_loss")
_ASSIGNMENT_BITS: Final = (
    "is_listed", "", "boots", "is_mandatory", "keep_alive", "check_software", "update_software", "restore",
)  # fmt: skip
_MAX_U32: Final = 0xFFFF_FFFF
_MAX_GUARD_MS: Final = 0xFFFF
_MAX_RETRY_FACTOR: Final = 0xFF


@dataclass(frozen=True, slots=True)
class Startup:
    """How the master starts the network: 0x1F80.

    is_master: this device is the NMT master (bit 0). start_all: it starts all nodes by one command, once all mandatory ones are
    ready; else each node as soon as it is ready (bit 1). waits: it does not enter Operational by itself (bit 2).
    application_starts: it starts no nodes: the application does (bit 3).

    If a mandatory node is lost: reset_all_on_loss: it resets all nodes (bit 4); stop_all_on_loss: it stops all nodes (bit 6), and
    bit 4 does not count; neither: only that node is reset.
    """

    is_master: bool = True
    start_all: bool = False
    waits: bool = False
    application_starts: bool = False
    reset_all_on_loss: bool = False
    stop_all_on_loss: bool = False

    @classmethod
    def from_value(cls, value: int) -> Startup:
        """Return what a value of 0x1F80 means. Raises LocalProtocolError for the flying master (bit 5) and reserved bits."""
        if value & FLYING_MASTER:
            raise LocalProtocolError(f"0x1F80 is 0x{value:08X}: bit 5 asks for a flying master, which is not supported")
        return cls(**_flags("0x1F80", value, _STARTUP_BITS))

    @property
    def value(self) -> int:
        """The value of 0x1F80."""
        return _packed(self, _STARTUP_BITS)


@dataclass(frozen=True, slots=True)
class Assignment:
    """How the master treats one node: its subindex of 0x1F81.

    is_listed: the node belongs to the network (bit 0). boots: the master boots and starts it, also when it comes back; else it
    only reports it to the application (bit 2). is_mandatory: the network does not start without it (bit 3). keep_alive: if it is
    Operational, it is not reset (bit 4). check_software: 0x1F56:01 has to be the expected one (bit 5). update_software: another
    one may be replaced (bit 6). restore: the node restores its defaults before it is configured (bit 7).

    guard_time: ns between two guarding requests, whole milliseconds (bits 16 to 31). retry_factor: the life time factor of
    guarding (bits 8 to 15). There is guarding only if both are not 0.
    """

    is_listed: bool = True
    boots: bool = True
    is_mandatory: bool = False
    keep_alive: bool = False
    check_software: bool = False
    update_software: bool = False
    restore: bool = False
    retry_factor: int = 0
    guard_time: Time = 0

    def __post_init__(self) -> None:
        """Raises LocalProtocolError for a guard time or a retry factor that 0x1F81 cannot hold."""
        if not 0 <= self.retry_factor <= _MAX_RETRY_FACTOR:
            raise LocalProtocolError(f"a retry factor is 0 to {_MAX_RETRY_FACTOR}, not {self.retry_factor}")
        if self.guard_time % MILLISECOND or not 0 <= self.guard_time <= _MAX_GUARD_MS * MILLISECOND:
            raise LocalProtocolError(f"a guard time is 0 to {_MAX_GUARD_MS} whole ms, not {self.guard_time / MILLISECOND:g} ms")

    @classmethod
    def from_value(cls, value: int) -> Assignment:
        """Return what a value of 0x1F81 means. Raises LocalProtocolError for bit 1, which is reserved, and if it has more than 32
        bits. (In an early edition bit 1 asked to start a node again after an error: bit 2 does so today.)"""
        if not 0 <= value <= _MAX_U32:
            raise LocalProtocolError(f"0x1F81: {value} has more than 32 bits")
        return cls(
            **_flags("0x1F81", value & 0xFF, _ASSIGNMENT_BITS),
            retry_factor=value >> 8 & _MAX_RETRY_FACTOR,
            guard_time=(value >> 16) * MILLISECOND,
        )

    @property
    def value(self) -> int:
        """The value of the node's subindex of 0x1F81."""
        return _packed(self, _ASSIGNMENT_BITS) | self.retry_factor << 8 | self.guard_time // MILLISECOND << 16

    @property
    def guards(self) -> bool:
        """Whether the node is to be guarded, unless it has a heartbeat."""
        return bool(self.guard_time and self.retry_factor)


def _flags(name: str, value: int, bits: tuple[str, ...]) -> dict[str, bool]:
    reserved = value & ~sum(1 << bit for bit, field in enumerate(bits) if field)
    if reserved:
        raise LocalProtocolError(f"{name}: 0x{reserved:X} of 0x{value:X} are reserved bits; they have to be 0")
    return {field: bool(value >> bit & 1) for bit, field in enumerate(bits) if field}


def _packed(flags: Startup | Assignment, bits: tuple[str, ...]) -> int:
    return sum(1 << bit for bit, field in enumerate(bits) if field and getattr(flags, field))
