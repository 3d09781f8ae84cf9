"""The boot-up of a network (CiA 302-2) in a machine file: `[network]`, and `boot` of a node. docs/network.md explains it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Time

MAX_NUMBER: Final = 0xFFFF_FFFF
MAX_MILLISECONDS: Final = 0xFFFF
MAX_FACTOR: Final = 0xFF
MAX_RESTORE: Final = 0x7F


class StartOrder(StrEnum):
    """The nodes that the master starts, and when (0x1F80, bits 1 and 3)."""

    EACH = "each"
    """Each node as soon as it has booted well."""
    ALL = "all"
    """All at once, when every mandatory node has booted well."""
    NONE = "none"
    """None: they stay pre-operational until somebody starts them."""


class LossReaction(StrEnum):
    """The reaction of the master to the loss of a mandatory node (0x1F80, bits 4 and 6)."""

    NODE = "node"
    """Only that node is reset, and booted again."""
    RESET_ALL = "reset all"
    STOP_ALL = "stop all"


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """`[network]`, for each bus by itself.

    boot_time: ns within which all mandatory nodes have to boot (0x1F89); 0 = without end. nmt_pause: ns between two NMT commands
    (0x102A).
    """

    start: StartOrder = StartOrder.EACH
    mandatory_lost: LossReaction = LossReaction.NODE
    boot_time: Time = 10 * SECOND
    nmt_pause: Time = 0


@dataclass(frozen=True, slots=True)
class BootSettings:
    """`boot` of a node: the node is in the network list of the master. Raises LocalProtocolError for values that contradict each
    other.

    device_type .. serial: the value that is expected; 0 = any. None: device type, vendor-ID and product code are those of the
    node's file, the others any. heartbeat: ns, written to 0x1017; None: the node's own. heartbeat_timeout: ns after which the
    node is lost; None: three times its heartbeat. guard_time: ns, 0 = no guarding. configuration: the DCF or concise DCF that is
    written. store: the node keeps it, and is not configured again while it has it. restore: subindex of 0x1011, 0 = none.
    software: the number in 0x1F56; None: not checked. program: the image that brings it. confirm_program: it has to be confirmed.
    """

    mandatory: bool = False
    start: bool = True
    keep_alive: bool = False
    device_type: int | None = None
    vendor: int | None = None
    product: int | None = None
    revision: int | None = None
    serial: int | None = None
    heartbeat: Time | None = None
    heartbeat_timeout: Time | None = None
    guard_time: Time = 0
    life_time_factor: int = 3
    configuration: str = ""
    store: bool = False
    restore: int = 0
    software: int | None = None
    program: str = ""
    confirm_program: bool = False

    def __post_init__(self) -> None:
        for name in ("device_type", "vendor", "product", "revision", "serial", "software"):
            _check_number(name, getattr(self, name), MAX_NUMBER)
        for name in ("heartbeat", "heartbeat_timeout", "guard_time"):
            _check_time(name, getattr(self, name))
        _check_number("life_time_factor", self.life_time_factor, MAX_FACTOR)
        _check_number("restore", self.restore, MAX_RESTORE)
        if self.heartbeat and self.heartbeat_timeout and self.heartbeat_timeout <= self.heartbeat:
            raise LocalProtocolError("heartbeat_timeout must be longer than heartbeat: three times as long is usual")
        if self.guard_time and (self.heartbeat or self.heartbeat_timeout):
            raise LocalProtocolError("a node has a heartbeat or is guarded, not both: leave out guard_time")
        if self.guard_time and not self.life_time_factor:
            raise LocalProtocolError("guarding needs a life_time_factor above 0")
        if self.program and not self.software:
            raise LocalProtocolError("program needs software: the number in 0x1F56 that the program has")


def _check_number(name: str, value: int | None, most: int) -> None:
    if value is not None and not 0 <= value <= most:
        raise LocalProtocolError(f"{name} is {value}; it has to be in 0..{most}")


def _check_time(name: str, value: Time | None) -> None:
    if value is not None and (value % MILLISECOND or not 0 <= value <= MAX_MILLISECONDS * MILLISECOND):
        raise LocalProtocolError(f"{name} has to be whole milliseconds, {MAX_MILLISECONDS} at most")
