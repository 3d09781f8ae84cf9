"""`open_transport`: open the bus that a locator names, or raise an error that says what to do."""

from __future__ import annotations

import errno
import functools
import ipaddress
import logging
import os
import socket
from typing import TYPE_CHECKING, Final, TypeAlias

from canopen_transports import diagnosis, leftovers, listen_only
from canopen_transports.driver_calls import open_bus
from canopen_transports.errors import TransportError, bad_locator
from canopen_transports.locator import Locator, parse_locator
from canopen_transports.loop import current_loop
from canopen_transports.tcp import TcpTransport, open_tcp
from canopen_transports.tracing import TracingTransport, traced
from canopen_transports.virtual import VirtualTransport, has_stand_in, open_virtual
from canopen_transports.virtual_wire import WireTransport

if TYPE_CHECKING:
    import can

    from canopen_transports.python_can import PythonCanTransport
    from canopen_transports.replay import ReplayTransport
    from canopen_transports.socketcan import SocketCanTransport

OpenTransport: TypeAlias = (
    "VirtualTransport | WireTransport | SocketCanTransport | TcpTransport | ReplayTransport | PythonCanTransport"
)

MULTICAST_GROUP: Final = "239.74.163.2"
"""python-can's IPv4 group. (Its default is an IPv6 group, to which many computers have no route.)"""
MULTICAST_HOP_LIMIT: Final = 0
"""0 keeps frames on this computer unless the locator says otherwise: a colleague's demonstration must not move drives."""

CONNECT_TIME: Final = 3.0
"""Seconds in which a socketcand server must accept a connection."""

# python-can accepts a bit rate for these, and does not use it.
_BITRATE_ELSEWHERE: Final = ("serial", "socketcand")

# Backends log a complaint before they raise, and Python prints it if logging is not set up. Our errors say what matters; an
# application that sets up logging still gets everything.
logging.getLogger("can").addHandler(logging.NullHandler())


async def open_transport(locator: str) -> OpenTransport | TracingTransport:
    """Open the bus that a locator names, such as "virtual:demo" or "socketcan:can0"; the module `locator` lists them all.

    Runs in trio or asyncio. `async with await open_transport("virtual:demo") as bus: ...` closes the bus. If cancelled, nothing
    stays open. Raises TransportError: CO100 for a locator that is not valid, CO101 and CO102 for a bus that cannot be opened.
    """
    return traced(await _open(parse_locator(locator)))


async def _open(parsed: Locator) -> OpenTransport:
    if has_stand_in() and parsed.interface != "file":
        await current_loop().checkpoint()
        return VirtualTransport(parsed.channel)
    if parsed.own:
        await current_loop().checkpoint()
        if parsed.interface == "virtual":
            return await open_virtual(parsed.text, parsed.channel, parsed.bitrate, parsed.options)
        if parsed.interface == "file":
            from canopen_transports.replay import open_replay  # only here, as python-can below

            return open_replay(parsed.text, parsed.channel, parsed.options)
        if parsed.interface == "tcp":
            return await open_tcp(parsed.text, parsed.channel)
        return _open_socketcan(parsed)
    from canopen_transports.python_can import PythonCanTransport  # only here: python-can is slow to import

    await current_loop().checkpoint_if_cancelled()
    reopen = functools.partial(open_bus, functools.partial(_open_bus, parsed))
    return PythonCanTransport(await reopen(), locator=parsed, reopen=reopen)


def _open_socketcan(locator: Locator) -> SocketCanTransport:
    if listen_only.LISTEN_ONLY in locator.options:
        raise listen_only.refused(locator)
    try:
        _check_net_device(locator)
    except (OSError, AttributeError) as error:  # no SocketCAN here
        raise diagnosis.cannot_open(locator, error) from error
    from canopen_transports.socketcan import open_socketcan  # only here: Linux alone has it

    return open_socketcan(locator)


def _open_bus(locator: Locator) -> can.BusABC:
    channel, options = locator.python_can_channel, listen_only.backend_options(locator)
    if locator.bitrate is not None:
        if locator.interface in _BITRATE_ELSEWHERE:
            raise diagnosis.bitrate_is_set_elsewhere(locator)
        options["bitrate"] = locator.bitrate
    try:
        if locator.interface == "socketcan":
            channel = locator.channel
            _check_net_device(locator)
        elif locator.interface == "udp_multicast":
            channel = _multicast_group(locator)
            options.setdefault("hop_limit", MULTICAST_HOP_LIMIT)
        elif locator.interface == "socketcand":
            _check_server(locator)
        elif locator.interface == "pcan":
            _check_peak_bitrate(locator)
        from can import Bus

        # ignore_config: else python-can adds options from ~/.canrc and the environment that the locator does not name.
        bus = Bus(
            channel=channel if channel != "" else None,  # type: ignore[arg-type]
            interface=locator.interface,
            ignore_config=True,
            **options,
        )
    except TransportError:
        raise
    except diagnosis.DRIVER_ERRORS as error:
        leftovers.clear_away(error)
        raise diagnosis.cannot_open(locator, error) from error
    if locator.interface == "socketcan" and _pending_error(bus) == errno.ENETDOWN:
        bus.shutdown()
        raise diagnosis.interface_down(locator)
    return bus


def _check_net_device(locator: Locator) -> None:
    # Checked before python-can binds its socket, which it leaks if the bind fails.
    socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()  # OSError: no SocketCAN; AttributeError: not Linux
    if locator.channel not in (name for _, name in socket.if_nameindex()):
        raise diagnosis.interface_missing(locator)
    if diagnosis.is_can_device(locator.channel) is False:
        raise diagnosis.not_a_can_interface(locator)


def _pending_error(bus: can.BusABC) -> int:
    """Return the socket's pending error. The kernel binds to an interface that is DOWN, and reports it here."""
    with socket.socket(fileno=os.dup(bus.fileno())) as own:
        return own.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)


def _multicast_group(locator: Locator) -> str:
    group = locator.channel or MULTICAST_GROUP
    try:
        is_multicast = ipaddress.ip_address(group).is_multicast
    except ValueError:
        is_multicast = False
    if not is_multicast:
        seen = f"{group!r} is not a multicast address (224.0.0.0 to 239.255.255.255, or ff00::/8)"
        raise bad_locator(locator.text, seen, ("udp_multicast", f"udp_multicast:{MULTICAST_GROUP}"))
    return group


def _check_server(locator: Locator) -> None:
    # Checked before python-can connects: it would try for 10 s, without a pause.
    host, port = locator.options.get("host"), locator.options.get("port")
    if isinstance(host, str) and isinstance(port, int):
        socket.create_connection((host, port), timeout=CONNECT_TIME).close()


def _check_peak_bitrate(locator: Locator) -> None:
    from can.interfaces.pcan.basic import PCAN_BITRATES

    # python-can silently uses 500k in place of an unknown bit rate, which would disturb a live bus.
    if locator.bitrate is not None and locator.bitrate not in PCAN_BITRATES:
        raise diagnosis.unknown_bitrate(locator, sorted(PCAN_BITRATES, reverse=True))
