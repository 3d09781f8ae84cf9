"""Locators: the text that names a bus, `INTERFACE:CHANNEL@BITRATE?OPTION=VALUE&...`.

    virtual:demo                        a bus inside this process (the name may be left out)
    virtual:demo?bitrate=1M&loss=0.001  the same with bit times, arbitration and faults (see virtual_wire.py)
    socketcan:can0                      Linux; `ip link` sets the bit rate, not we; also just `can0`, `vcan0`
    socketcan:can0?filter=ids           the kernel lets through only the frames that the master's machines want
    socketcan:can0?sync=bcm             the kernel's broadcast manager sends the cyclic SYNC
    pcan:PCAN_USBBUS1@500k              PEAK adapters by PCAN-Basic; 500k unless given
    /dev/pcan32  /dev/pcanusb32         the same by PEAK's Linux device file, as in the manual's chain files
    slcan:/dev/ttyACM0@250k             serial-line adapters; `?tty_baudrate=1000000` and the like go to python-can
    pcan:PCAN_USBBUS1@500k?listen_only=true     only listens; does not even acknowledge (see `listen_only`)
    tcp  tcp:localhost:20301            the bus of `canopen bus serve`, for several terminals, on one computer or several
    file:trace.log?speed=max            a log file, replayed: .log, .asc, .blf, .trc, .pcap, .pcapng (see `replay`)
    udp_multicast                       two terminals of one computer, without a server
    udp_multicast:239.1.2.3?hop_limit=1&port=4000      two computers of one local network
    kvaser:0@500k  gs_usb:0@1M ...      every other interface of python-can, by python-can's name for it
    pythoncan:virtual:demo              python-can's interface of a name that is ours otherwise, such as `virtual`, `socketcan`

Bit rates: `500k`, `1M`, `83.333k`, `125000`. Channels and options are read as in python-can's configuration files: `0` is a
number, `true` is true.

PEAK's driver numbers its device files (in character-device mode, "NET=NO") by hardware: 0 to 7 PCI, 8 to 15 ISA, 32 to 39 USB, 40
to 47 PC card. So `/dev/pcan32` is the first USB channel, PCAN-Basic's PCAN_USBBUS1. Numbers 16 to 31, the parallel-port dongles,
are refused: PCAN-Basic has one name for all of them.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Iterable, Iterator
from typing import Final, NamedTuple, TypeAlias

from canopen_transports.errors import TransportError, bad_locator

Option: TypeAlias = str | int | float | bool

DEFAULT_BUS_NAME: Final = "default"
MANUAL_BITRATE: Final = 500_000
"""For /dev/pcan32, which the manual opens without a bit rate."""

OUR_INTERFACES: Final = ("virtual", "tcp", "file", "pythoncan")
_EXAMPLES: Final = ("virtual:demo", "socketcan:can0", "pcan:PCAN_USBBUS1@500k", "slcan:/dev/ttyACM0@250k", "udp_multicast")

_BITRATE: Final = re.compile(r"([0-9]+(?:\.[0-9]+)?)([kM]?)")
_PEAK_DEVICE: Final = re.compile(r"/dev/pcan(usb|pci|isa|pcc)?([0-9]{1,2})")
_PEAK_KINDS: Final = {0: "PCI", 8: "ISA", 32: "USB", 40: "PCC"}
_NET_DEVICE: Final = re.compile(r"(?:v|vx|sl)?can[0-9]+")

# Options that would break the promises of a transport, with the reason.
_REFUSED_OPTIONS: Final = {
    "fd": "CANopen runs on classical CAN; CAN FD is not supported",
    "receive_own_messages": "a transport never hands out our own frames",
}


class Locator(NamedTuple):
    """The parts of a locator. own: whether the transport is ours, not python-can's. bitrate: bit/s. options: as python-can takes
    them."""

    text: str
    own: bool
    interface: str
    channel: str
    bitrate: int | None
    options: dict[str, Option]

    @property
    def python_can_channel(self) -> Option:
        """The channel with the type that python-can's configuration would give it: a number if it looks like one."""
        return _typed(self.channel)


def parse_locator(text: str) -> Locator:
    """Return the parts of a locator. Raises TransportError (CO100), which names the wrong part and proposes a correction. text:
    such as "socketcan:can0" or "pcan:PCAN_USBBUS1@500k"."""
    address, _, query = text.strip().partition("?")
    options = dict(_options(text, query))
    if address.startswith("file:"):  # a path may contain any character
        return Locator(text, True, "file", address.removeprefix("file:"), None, options)
    address, bitrate = _split_bitrate(text, address)
    interface, colon, channel = address.partition(":")
    if interface.startswith("/dev/pcan") and not colon:
        return Locator(text, False, "pcan", _peak_channel(text, interface), bitrate or MANUAL_BITRATE, options)
    if _NET_DEVICE.fullmatch(interface) and not colon:
        return Locator(text, True, "socketcan", interface, bitrate, options)
    if interface == "virtual":
        return Locator(text, True, interface, channel or DEFAULT_BUS_NAME, bitrate, options)
    if interface == "socketcan":
        return Locator(text, True, interface, channel, bitrate, options)
    if interface == "tcp":
        if bitrate is not None or options:
            raise bad_locator(text, "a tcp: bus has neither bit rate nor options", (f"tcp:{channel}" if channel else "tcp",))
        return Locator(text, True, interface, channel, None, {})
    if interface == "pythoncan":
        interface, _, channel = channel.partition(":")
    if interface not in _python_can_interfaces():
        raise _unknown_interface(text, interface)
    return Locator(text, False, interface, channel, bitrate, options)


def parse_bitrate(text: str) -> int:
    """Return the bit/s of "500k", "1M", "83.333k" or "125000". Raises ValueError with the reason."""
    match = _BITRATE.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a bit rate such as 500k, 1M or 125000")
    bitrate = round(float(match[1]) * {"": 1, "k": 1_000, "M": 1_000_000}[match[2]])
    if bitrate > 1_000_000:
        raise ValueError(f"bit rate {text}: classical CAN has at most 1M")
    if bitrate < 5_000:  # slower, a dominant bit trips the transceivers' time-out; "500" is a mistake
        hint = f"; did you mean {text}k?" if 5 <= bitrate <= 1_000 else ""
        raise ValueError(f"bit rate {text}: CAN has at least 5k{hint}")
    return bitrate


def bitrate_text(bitrate: int) -> str:
    """Return the short form of a bit rate: "500k" for 500000. bitrate: bit/s."""
    if bitrate % 1_000_000 == 0:
        return f"{bitrate // 1_000_000}M"
    return f"{bitrate // 1000}k" if bitrate % 1000 == 0 else str(bitrate)


def _options(text: str, query: str) -> Iterator[tuple[str, Option]]:
    for option in query.split("&") if query else ():
        name, equals, value = option.partition("=")
        if not (name and equals):
            raise bad_locator(text, f"the option {option!r} is not of the form NAME=VALUE", ("join several options by &",))
        typed = _typed(value)
        if name in _REFUSED_OPTIONS and typed not in (False, 0):
            raise bad_locator(text, f"the option {option!r} is refused: {_REFUSED_OPTIONS[name]}", ("leave it out",))
        yield name, typed


def _typed(value: str) -> Option:
    """Return an option with the type that python-can's configuration would give it."""
    from can.util import cast_from_string  # here: python-can is a quarter of a command's start, and few buses need it

    return cast_from_string(value)


def _python_can_interfaces() -> Collection[str]:
    from can.interfaces import VALID_INTERFACES  # here, as above

    return VALID_INTERFACES


def _split_bitrate(text: str, address: str) -> tuple[str, int | None]:
    rest, at, tail = address.rpartition("@")
    if not at:
        return address, None
    try:
        return rest, parse_bitrate(tail)
    except ValueError as error:
        raise bad_locator(text, str(error), (f"{rest}@500k",)) from None


def _peak_channel(text: str, path: str) -> str:
    match = _PEAK_DEVICE.fullmatch(path)
    if match is not None:
        minor = int(match[2])
        kind = _PEAK_KINDS.get(minor & ~7)
        if kind is not None and match[1] in (None, kind.lower()):
            return f"PCAN_{kind}BUS{(minor & 7) + 1}"
    seen = f"{path} is not a device file of a PEAK adapter with a name in PCAN-Basic"
    raise bad_locator(text, seen, ("/dev/pcan32", "pcan:PCAN_USBBUS1@500k"))


def _unknown_interface(text: str, interface: str) -> TransportError:
    known = (*OUR_INTERFACES, *sorted(_python_can_interfaces()))
    meant = nearest(interface, known)
    tries = [text.replace(interface, meant, 1)] if meant else []
    if interface == "gw":
        seen = "a text gateway carries no frames, so it is no bus"
        raise bad_locator(text, seen, (f"canopen read 5 1000 -b {text}", "canopen_gateway.ascii.open_remote_gateway"))
    seen = f"there is no interface {interface!r}" if interface else "the locator names no interface"
    seen += f"; known are {', '.join(dict.fromkeys(known))}"
    return bad_locator(text, seen, (*tries, f"a locator such as {', '.join(_EXAMPLES)}"))


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word that was probably meant, or None."""
    spelled = {name.lower(): name for name in known}
    found = difflib.get_close_matches(word.lower(), spelled, n=1)
    return spelled[found[0]] if found else None
