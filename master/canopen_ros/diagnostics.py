"""`Diagnostic`: what /diagnostics tells of the joints, chains and buses. It is made of what is known; nothing is asked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Final, NamedTuple

from canopen_master.motion.chain import Chain, ChainState
from canopen_master.motion.device import Device
from canopen_master.participant.bus import Bus
from canopen_proto.drives.cia402.states import State, StatusBit
from canopen_proto.error_codes import error_text
from canopen_proto.machine import SECOND, Time
from canopen_transports import BusState

LOAD_TIME: Final = SECOND
"""A load over less says little: a cycle is one burst."""
_BITS: Final = {
    "voltage enabled": StatusBit.VOLTAGE_ENABLED,
    "warning": StatusBit.WARNING,
    "remote": StatusBit.REMOTE,
    "target reached": StatusBit.TARGET_REACHED,
    "internal limit": StatusBit.INTERNAL_LIMIT,
}


class Level(IntEnum):
    """`level` of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Diagnostic(NamedTuple):
    """One DiagnosticStatus. name: such as "arm: joint1". hardware_id: such as "node 3 on can0". values: by key, as text."""

    name: str
    hardware_id: str
    level: Level
    message: str
    values: Mapping[str, str]


def named(found: Iterable[Diagnostic], node: str) -> list[Diagnostic]:
    """Put the name of the node, with its namespace, before each name: "left/ros_canopen: arm: joint1". found: of the bridge.

    diagnostic_updater does so in ROS 1, and in ROS 2 with `use_fqn`: aggregators sort by it. node: its name from the root.
    """
    return [each._replace(name=f"{node.removeprefix('/')}: {each.name}") for each in found]


class Loads:
    """The load of each bus: its share of bits since the last look, which is at least LOAD_TIME ago."""

    def __init__(self) -> None:
        self._looks: dict[str, tuple[Time, int]] = {}  # by the name of a bus: when, and the bits until then
        self._texts: dict[str, str] = {}

    def of(self, bus: Bus, now: Time) -> str:
        """Return the load of a bus in words."""
        if bus.bitrate is None:
            return "unknown: nobody tells the bit rate"
        begin, bits = self._looks.setdefault(bus.name, (now, bus.bits))
        if now - begin >= LOAD_TIME:
            share = (bus.bits - bits) * SECOND / ((now - begin) * bus.bitrate)
            least = "" if bus.network.hears_all else "at least "  # its transport filters
            self._texts[bus.name] = f"{least}{share * 100:.0f} %"
            self._looks[bus.name] = (now, bus.bits)
        return self._texts.get(bus.name, "not known yet")


def of_bus(bus: Bus, load: str, failure: Exception | None) -> Diagnostic:
    """Return what is known of a bus. load: see Loads. failure: that of the master, None while it works."""
    values = {
        "state": bus.state.value,
        "load": load,
        "frames waiting": str(bus.pending),
        "SYNC period [ms]": f"{bus.sync_period / 1e6:g}",
    }
    if failure is not None:
        return Diagnostic(f"bus: {bus.name}", bus.name, Level.ERROR, _first_line(failure), {**values, "error": str(failure)})
    if bus.network.outage:
        return Diagnostic(f"bus: {bus.name}", bus.name, Level.ERROR, bus.network.outage, values)
    fine = bus.state in (BusState.ACTIVE, BusState.UP)
    return Diagnostic(f"bus: {bus.name}", bus.name, Level.OK if fine else Level.WARN, bus.state.value, values)


def of_chain(chain: Chain, state: str, failure: Exception | None) -> Diagnostic:
    """Return what is known of a chain. state: as `ChainBridge.state`. failure: why it cannot work; None while it does."""
    values = {
        "state": state,
        "homed": "yes" if chain.is_homed else "no",
        "SYNC cycles": str(chain.sync_cycles),
        "missed cycles": str(chain.missed_cycles),
        "skipped cycles": str(chain.skipped_cycles),
    }
    level, message = Level.OK, state
    if failure is not None:
        level, message = Level.ERROR, _first_line(failure)
    elif chain.state is ChainState.FAULT:
        level, message = Level.ERROR, _first_line(chain.stop_reason())
    elif chain.state in (ChainState.HALTED, ChainState.STOPPING):
        level, message = Level.WARN, _first_line(chain.stop_reason())
    return Diagnostic(f"chain: {chain.name}", chain.name, level, message, values)


def of_joint(device: Device, chain: str, failure: Exception | None) -> Diagnostic:
    """Return what is known of a joint. chain: the name of its chain. failure: why it cannot work; None while it does."""
    statusword = device.statusword
    values = {
        "state": str(device.state),
        "statusword": f"0x{statusword:04X}",
        "bits": _bits(statusword),
        "error code (603F)": f"0x{device.error_code:04X} {error_text(device.error_code)}" if device.error_code else "none",
        "emergency": _emergency(device),
        "NMT state": "unknown" if device.nmt_state is None else device.nmt_state.name,
        "homed": "yes" if device.is_homed else "no",
        "following error": f"{device.following_error:.6g}",
        "largest following error": f"{device.largest_following_error:.6g}",
    }
    level, message = Level.OK, str(device.state)
    if failure is not None or device.state is State.UNKNOWN:
        level = Level.STALE
    elif device.has_fault:
        level, message = Level.ERROR, device.describe()
    return Diagnostic(f"{chain}: {device.name}", device.node.where, level, message, values)


def _emergency(device: Device) -> str:
    if device.emcy is None or device.emcy_time is None:
        return "none"
    age = (device.node.now() - device.emcy_time) / SECOND
    return f"0x{device.emcy.code:04X} {device.emcy.text}, register 0x{device.emcy.error_register:02X}, {age:.3g} s ago"


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]


def _bits(statusword: int) -> str:
    """Return the names of the bits that are set, without those of the state machine."""
    return ", ".join(name for name, bit in _BITS.items() if statusword & bit)
