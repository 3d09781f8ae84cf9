"""Turn python-can's exceptions into `TransportError`: what failed, what was seen, the likely cause, the next step.

python-can reports in many ways that a bus cannot be opened. A missing Kvaser library is a NameError, a missing PEAK library an
OSError without errno, a missing module an ImportError or CanInterfaceNotImplementedError, an unknown PEAK channel a KeyError, and
an option that the backend does not know a TypeError.
"""

from __future__ import annotations

import errno
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from canopen_proto.explained import counted
from canopen_transports.errors import (
    BAD_LOCATOR,
    BUS_LOST,
    CANNOT_OPEN,
    NO_PERMISSION,
    NOT_ACKNOWLEDGED,
    TransportError,
    bad_locator,
)
from canopen_transports.locator import Locator, bitrate_text, nearest
from canopen_transports.peak import attached

DRIVER_ERRORS: Final = (Exception,)
"""A call into python-can may raise anything. Adapters' packages have exceptions of all kinds: a function missing in the driver's
library is a NameError, a descriptor too high for `select` a ValueError, half a frame on a serial line a TypeError. Where this is
caught, only python-can's code runs, and the code that reads its answers."""

ROOM_TIME: Final = 1.0
"""Seconds that a sender waits for room. The ten frames of a usual network queue take 0.13 s even at 10 kbit/s."""
ROOM_POLL: Final = 0.001
"""Seconds between two tries: four frames at 500k. (No file descriptor shows when a network queue has room again.)"""
QUIET_TIME: Final = 1.0
"""Seconds before the same fault on the wire is reported again: some come with each frame."""

SAMPLE_BITRATE: Final = 500_000
"""Bit/s, for suggested commands where we do not know the bus's bit rate."""

# The extra of python-can that installs a backend's Python modules.
_EXTRAS: Final = {
    "slcan": "serial",
    "serial": "serial",
    "robotell": "serial",
    "seeedstudio": "seeedstudio",
    "gs_usb": "gs-usb",
    "neovi": "neovi",
    "canalystii": "canalystii",
    "cantact": "cantact",
    "nixnet": "nixnet",
    "udp_multicast": "multicast",
}
# The driver that the maker of the adapter provides.
_DRIVERS: Final = {
    "pcan": "PEAK's driver and its PCAN-Basic library (peak-system.com)",
    "kvaser": "Kvaser's driver and its CANlib (kvaser.com)",
    "ixxat": "the VCI driver of Ixxat (Windows)",
    "vector": "the XL driver library of Vector (Windows)",
    "nican": "NI-CAN (Windows)",
    "usb2can": "the driver and usb2can.dll of 8devices, and 'python-can[pywin32]' (Windows)",
    "nixnet": "NI-XNET (Windows)",
    "systec": "the USB-CANmodul driver of SYS TEC (Windows)",
    "etas": "the BOA library of ETAS (Windows)",
    "iscan": "the driver of isCAN",
    "neousys": "the WDT_DIO library of Neousys",
}
KERNEL_DRIVERS: Final = {
    "pcan": "peak_usb",
    "kvaser": "kvaser_usb",
    "gs_usb": "gs_usb",
    "usb2can": "usb_8dev",
    "etas": "etas_es58x",
}
"""Linux's own drivers for USB adapters, by python-can's name for the adapter's interface. Each makes SocketCAN interfaces."""
# Whole locators, for interfaces that need more than a channel number.
_EXAMPLES: Final = {
    "slcan": "slcan:/dev/ttyACM0@250k",
    "robotell": "robotell:/dev/ttyUSB0@250k",
    "seeedstudio": "seeedstudio:/dev/ttyUSB0@250k",
    "serial": "serial:/dev/ttyUSB0",
    "socketcand": "socketcand:can0?host=192.168.0.2&port=29536",
    "canalystii": "canalystii:0@500k",
    "neovi": "neovi:1@500k",
    "etas": "etas:ETAS://ETH/ES910:abcd/CAN:1@500k",
}
_NO_ADAPTER: Final = "the adapter is not plugged in, its driver is not loaded, or it has another name"
_ROUTE_MULTICAST: Final = "sudo ip route add 224.0.0.0/4 dev lo   (two terminals of this computer)"
_ARPHRD_CAN: Final = 280
# PCAN-Basic: "The transmit queue is full"; Vector: XL_ERR_QUEUE_IS_FULL; Kvaser: "Transmit buffer overflow"
_FULL: Final = re.compile(r"(buffer|queue).*full|transmit.*overflow", re.IGNORECASE)
# gs_usb: "Cannot find device 0. Devices found: 0"; neovi: "No device found."; canalystii: "No Canalyst-II USB device found"
_NOT_FOUND: Final = re.compile(r"cannot find device|\bno\b.*\bdevice found|DeviceNotFound", re.IGNORECASE)


def error_number(error: BaseException) -> int | None:
    """Return the errno of an OSError, or of the OSError that caused this exception. Drivers' own codes are other numbers."""
    link: BaseException | None = error
    while link is not None:
        if isinstance(link, OSError) and link.errno is not None:
            return link.errno
        link = link.__cause__
    return None


def queue_is_full(error: BaseException) -> bool:
    """Return whether a send failed only because the queue has no room.

    SocketCAN and UDP tell it by errno. The others tell it by text: each driver has its own number, but all texts say "full"
    (PCAN-Basic: "The transmit queue is full", python-can: "Transmit buffer full").
    """
    return error_number(error) in (errno.ENOBUFS, errno.EAGAIN) or _FULL.search(str(error)) is not None


def is_can_device(name: str, root: Path = Path("/")) -> bool | None:
    """Return whether a network interface is a CAN bus; None if the system does not tell. name: of the interface, such as "can0".
    root: of the files to read; a test passes a folder of its own."""
    try:
        return int((root / "sys/class/net" / name / "type").read_text()) == _ARPHRD_CAN
    except (OSError, ValueError):
        return None


def found_here(root: Path = Path("/")) -> list[str]:
    """Return locators of what looks like a CAN adapter on this computer. root: of the files to read; a test passes a folder of
    its own."""
    names = sorted(path.name for path in (root / "sys/class/net").glob("*"))
    found = [f"socketcan:{name}" for name in names if is_can_device(name, root)]
    for prefix, pattern in (("", "pcan[0-9]*"), ("slcan:", "ttyACM*"), ("slcan:", "ttyUSB*")):
        found += [f"{prefix}/dev/{path.name}" for path in sorted((root / "dev").glob(pattern))]
    return found


def bring_up(locator: Locator) -> str:
    """Return the command that brings a SocketCAN interface up."""
    if locator.channel.startswith("vcan"):
        return f"sudo ip link set {locator.channel} up"
    return f"sudo ip link set {locator.channel} up type can bitrate {locator.bitrate or SAMPLE_BITRATE}"


def cannot_open(locator: Locator, error: BaseException) -> TransportError:
    """Return why a bus could not be opened, for an exception of python-can."""
    number = error_number(error)
    seen = _text(error)
    code, cause, tries = CANNOT_OPEN, "", list(_further_steps(locator))
    device = locator.channel if locator.channel.startswith("/dev/") else ""
    if number in (errno.EACCES, errno.EPERM):
        code, cause = NO_PERMISSION, "this user may not use the interface"
        tries = [
            "sudo usermod -aG dialout $USER   (then log in again)" if device else "ask for access to it, or run this as root"
        ]
    elif number == errno.EBUSY:
        cause = "another program uses the adapter"
        tries = [f"fuser -v {device}   (tells which)"] if device else ["close the other program"]
    elif isinstance(error, AttributeError) and locator.interface == "socketcan":  # of Python's `socket`
        seen, cause = f"this system ({sys.platform}) has no SocketCAN", "SocketCAN is a part of Linux"
        tries = [
            "the interface of your adapter, such as pcan:, kvaser: or slcan:",
            "udp_multicast, or virtual: (no hardware needed)",
        ]
    elif number in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT) and locator.interface == "socketcan":
        seen, cause = (
            f"this {sys.platform} kernel has no SocketCAN",
            "the kernel was built without it, or the module is not loaded",
        )
        tries = ["sudo modprobe can_raw", "udp_multicast, or virtual: (no hardware needed)"]
    elif locator.interface == "udp_multicast" and number is not None:
        cause = "no network interface of this computer carries multicast"
        tries = [_ROUTE_MULTICAST, "virtual: (one process)"]
    elif locator.interface == "socketcand" and isinstance(error, OSError):
        cause = "no server of socketcand runs there, or a firewall is between"
        tries = [f"socketcand -v -i {locator.channel or 'can0'}   (on the computer that has the adapter)", *tries]
    elif number in (errno.ENODEV, errno.ENOENT, errno.ENXIO) or _NOT_FOUND.search(seen):
        cause = _NO_ADAPTER
        if device and number == errno.ENOENT:  # pyserial's text has the number and the name twice
            seen = f"there is no {device}"
        tries.insert(-1, "plug it in, then canopen doctor   (which adapters this computer has)")
        tries = [*_kernel_driver(locator), *tries]
    elif _driver_is_missing(error):
        cause = "the software for this adapter is not installed"
        if type(error) is NameError:  # the name of the missing function helps nobody
            seen = f"python-can found no library of {locator.interface}"
        elif type(error.__context__) in (ImportError, AttributeError):  # while python-can imported its backend
            seen = f"python-can's {locator.interface} does not run on this system ({sys.platform})"
        tries = [*_driver_steps(locator), *tries]
    elif locator.interface == "pcan" and _not_initialised(error):
        cause, steps = _why_no_peak_channel(locator, attached())
        tries = [*steps, *tries]
    elif isinstance(error, LookupError | ValueError | TypeError):
        seen = f"{locator.interface} of python-can does not accept channel {locator.channel!r} with these options: {seen}"
        cause = "a part of the locator is wrong or missing, or the interface does not know it"
        tries = [*_channel_steps(locator), f"https://python-can.readthedocs.io/ says what {locator.interface} takes"]
    else:
        cause = "the adapter is not plugged in, or its driver refuses to open it"
    return _not_opened(locator, seen, cause, tries, code)


def _not_opened(locator: Locator, seen: str, cause: str, tries: Iterable[str], code: str = CANNOT_OPEN) -> TransportError:
    return TransportError(code, locator.text, f"cannot open {locator.text}", seen=seen, cause=cause, tries=tries)


def interface_missing(locator: Locator) -> TransportError:
    """Return the error for a SocketCAN interface that does not exist."""
    tries = list(_further_steps(locator))
    if locator.channel.startswith("vcan"):
        tries.insert(0, f"sudo modprobe vcan && sudo ip link add dev {locator.channel} type vcan && {bring_up(locator)}")
    return _not_opened(locator, f"there is no network interface {locator.channel!r}", _NO_ADAPTER, (*tries, "ip link show"))


def not_a_can_interface(locator: Locator) -> TransportError:
    """Return the error for a network interface that is not a CAN bus, but an Ethernet card or the like."""
    seen = f"{locator.channel} is a network interface, but not a CAN bus"
    return _not_opened(locator, seen, "another interface is meant", (*_further_steps(locator), "ip link show"))


def interface_down(locator: Locator) -> TransportError:
    """Return the error for a SocketCAN interface that is DOWN. (The kernel still lets a socket be bound to it.)"""
    cause = "it was not brought up yet, or somebody took it down; the kernel keeps the bit rate, a program cannot set it"
    return _not_opened(locator, f"{locator.channel} is there, but it is DOWN", cause, (bring_up(locator),))


def unknown_bitrate(locator: Locator, known: list[int]) -> TransportError:
    """Return the error for a bit rate that the adapter does not support. known: those that it does."""
    seen = f"{locator.interface} has no bit rate {locator.bitrate}"
    tries = (f"one of {', '.join(bitrate_text(rate) for rate in known)}",)
    return _not_opened(locator, seen, "python-can knows only these by name", tries)


def bitrate_is_set_elsewhere(locator: Locator) -> TransportError:
    """Return the error for a bit rate that python-can would accept, but not use."""
    seen = f"{locator.interface} sets no bit rate: the other end of the connection does"
    return _not_opened(locator, seen, "", ("leave the bit rate out",), BAD_LOCATOR)


def unknown_option(locator: Locator, option: str, known: list[str]) -> TransportError:
    """Return the error for an option that our own transport of this interface does not have. known: those that it has."""
    seen = f"{locator.interface} has no option {option!r}; it has {', '.join(known)}"
    tries = (f"{locator.interface}:{locator.channel}", f"pythoncan:{locator.text}   (python-can's own, with its options)")
    return bad_locator(locator.text, seen, tries)


def bus_lost(locator: Locator, doing: str, error: BaseException) -> TransportError:
    """Return the error for a bus that worked and has now failed. doing: what was tried, such as "send 601#40"."""
    number = error_number(error)
    seen, cause = _text(error), "the adapter was unplugged, or its driver failed"
    tries: tuple[str, ...] = ("plug it in again, then open the bus again",)
    if locator.interface == "socketcan" and number == errno.ENETDOWN:
        seen, cause = f"{locator.channel} is DOWN", "somebody set it down, or the adapter was unplugged"
        tries = (bring_up(locator),)
    elif locator.interface == "udp_multicast":
        cause, tries = "the network went away, or no route leads to the group", (_ROUTE_MULTICAST,)
    return TransportError(BUS_LOST, locator.text, f"cannot {doing} on {locator.text}", seen=seen, cause=cause, tries=tries)


def not_acknowledged(locator: Locator, doing: str, seen: str, received: int) -> TransportError:
    """Return the error for frames that do not get out: the queue stays full, or the controller is bus-off.

    doing: what was tried. received: the number of frames heard so far.

    seen: what was observed.
    """
    rate = f" (ours {bitrate_text(locator.bitrate)})" if locator.bitrate else ""
    causes = [f"wrong bit rate{rate}", "CAN-H and CAN-L swapped or a wire broken", "termination (60 ohm between them)"]
    if received:  # another node is there, and we understand it
        causes = ["a device or a cable that disturbs the bus", "the bus is overloaded"]
    else:
        causes.insert(0, "nobody else on the bus, or its power is off")
    tries = ["check the causes in that order"]
    if locator.interface == "socketcan":
        tries.append(f"ip -details -statistics link show {locator.channel}")
        tries.append(f"sudo ip link set {locator.channel} down && {bring_up(locator)} restart-ms 100")
    return TransportError(
        NOT_ACKNOWLEDGED,
        locator.text,
        f"cannot {doing} on {locator.text}: nothing acknowledges our frames",
        seen=seen,
        cause="; ".join(causes),
        tries=tries,
    )


def no_room(locator: Locator, doing: str, seconds: float, received: int, last_error: str) -> TransportError:
    """Return the error for a transmit queue that stayed full for so many seconds. received, last_error: see the transports.
    doing: what was tried."""
    heard = f"{counted(received, 'frame')} received so far" if received else "no frame ever received"
    seen = f"no room in the transmit queue for {seconds:g} s; {heard}" + (f"; {last_error}" if last_error else "")
    return not_acknowledged(locator, doing, seen, received)


def _text(error: BaseException) -> str:
    """Return an exception's text in one line, followed by its cause's text if that is not in it already."""
    text, _, _ = str(error).partition("Traceback (most recent call last)")  # socketcand's messages contain one
    text = " ".join(text.split()) or type(error).__name__
    cause = " ".join(str(error.__cause__ or "").split())
    return text if cause in text else f"{text}: {cause}"


def _driver_is_missing(error: BaseException) -> bool:
    if isinstance(error, ImportError | NameError | AttributeError | NotImplementedError):
        return True
    # PCAN-Basic: OSError("pcanbasic library not found."); ctypes: OSError("libx.so: cannot open shared object file: ...")
    return type(error) is OSError and error.errno is None


def _not_initialised(error: BaseException) -> bool:
    from can import CanInitializationError  # where python-can has failed, it was imported

    return isinstance(error, CanInitializationError)


def _driver_steps(locator: Locator) -> Iterator[str]:
    if locator.interface in _EXTRAS:
        yield f"pip install 'python-can[{_EXTRAS[locator.interface]}]'"
    if locator.interface in _DRIVERS:
        yield f"install {_DRIVERS[locator.interface]}"
    yield from _kernel_driver(locator)


def _kernel_driver(locator: Locator) -> Iterator[str]:
    if locator.interface in KERNEL_DRIVERS and sys.platform == "linux":
        by_kernel = locator._replace(interface="socketcan", channel="can0")
        yield f"socketcan:can0, after {bring_up(by_kernel)}   (with the kernel's own driver, {KERNEL_DRIVERS[locator.interface]})"


def _why_no_peak_channel(locator: Locator, channels: dict[str, str]) -> tuple[str, list[str]]:
    """Return the cause and the next steps if PCAN-Basic is installed but does not open the channel."""
    condition = channels.get(locator.channel)
    others = [name for name, state in channels.items() if state == "free" and name != locator.channel]
    steps = [f"pcan:{name}@{bitrate_text(locator.bitrate or SAMPLE_BITRATE)}" for name in others[:2]]
    if condition == "in use":
        return "another program uses the adapter", ["close the other program", *steps]
    if condition == "free":
        return "the driver refuses the adapter, which is there and free", ["plug it in again", *steps]
    if steps:
        return f"there is no {locator.channel}, but {', '.join(others)}", steps
    return "no PEAK adapter is plugged in, or its driver is not loaded", [
        "sudo modprobe pcan && cat /proc/pcan",
        "canopen doctor",
    ]


def _channel_steps(locator: Locator) -> Iterator[str]:
    if locator.interface == "pcan":
        from can.interfaces.pcan.basic import PCAN_CHANNEL_NAMES

        meant = nearest(locator.channel, PCAN_CHANNEL_NAMES) or "PCAN_USBBUS1"
        yield f"pcan:{meant}@{bitrate_text(locator.bitrate or SAMPLE_BITRATE)}"
    elif locator.interface in _EXAMPLES:
        yield _EXAMPLES[locator.interface]
    elif not locator.channel:
        yield f"{locator.interface}:0@{bitrate_text(locator.bitrate or SAMPLE_BITRATE)}"


def _further_steps(locator: Locator) -> Iterator[str]:
    found = [other for other in found_here() if other != locator.text]
    if found:
        yield f"what was found here: {', '.join(found)}"
    yield "virtual: or udp_multicast (no hardware needed)"
