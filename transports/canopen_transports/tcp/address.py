"""The address in `tcp:HOST:PORT`, and the errors when it cannot be reached."""

from __future__ import annotations

import errno
import ipaddress
import re
import socket
from typing import Final

from canopen_transports.errors import BUS_LOST, CANNOT_OPEN, NO_PERMISSION, TransportError, bad_locator

DEFAULT_HOST: Final = "127.0.0.1"
DEFAULT_PORT: Final = 20301
"""Free in IANA's list. 301 is the number of CANopen's application layer."""

_ADDRESS: Final = re.compile(r"(?:(\[[0-9A-Fa-f:.]+\]|[^\[\]:\s/]+)(?::([0-9]{1,5}))?)?")


def parse_address(locator: str, channel: str) -> tuple[str, int]:
    """Return host and port of a locator's channel: "localhost:20301", "[::1]:20301", "localhost", "". Raises TransportError
    (CO100)."""
    match = _ADDRESS.fullmatch(channel)
    port = int(match[2] or DEFAULT_PORT) if match is not None else 0
    if match is None or not 1 <= port <= 65535:
        seen = f"{channel!r} is not of the form HOST:PORT, with a port of 1 to 65535"
        tries = (f"tcp:{DEFAULT_HOST}:{DEFAULT_PORT}", f"tcp:[::1]:{DEFAULT_PORT}   (an IPv6 address stands in brackets)")
        raise bad_locator(locator, seen, tries)
    return (match[1] or DEFAULT_HOST).strip("[]"), port


def address_text(host: str, port: int) -> str:
    """Return HOST:PORT as it stands in a locator."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_loopback(host: str) -> bool:
    """Return whether only this computer can reach this address. A name other than localhost counts as not. host: an address or a
    name."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def joining(locator: str) -> tuple[str, str]:
    """Return the locators by which this computer and other computers join the bus; the second is "" if it is the same or
    impossible."""
    host, port = parse_address(locator, locator.partition(":")[2])
    if host not in ("0.0.0.0", "::"):
        return locator, ""
    here = DEFAULT_HOST if host == "0.0.0.0" else "::1"
    return f"tcp:{address_text(here, port)}", f"tcp:{socket.gethostname()}:{port}"


def serve_command(host: str, port: int) -> str:
    """Return the command that starts a server at this address. host, port: where it shall listen."""
    command = "canopen bus serve" + (f" --port {port}" if port != DEFAULT_PORT else "")
    if is_loopback(host):
        return f"{command}    (in another terminal)"
    return f"{command} --bind 0.0.0.0 --yes    (on {host}; whoever reaches it can move its drives)"


def cannot_connect(locator: str, host: str, port: int, error: OSError | UnicodeError) -> TransportError:
    """Return why there is no connection. UnicodeError: the host is not a valid name. port: of the server."""
    number = _error_number(error)
    tries: tuple[str, ...] = (serve_command(host, port),)
    if isinstance(error, socket.gaierror | UnicodeError):
        seen, cause = _unknown_name(host, error), "the name is mistyped, or no name server that knows it can be reached"
        tries = (f"tcp:{DEFAULT_HOST}:{port}",)
    elif isinstance(error, TimeoutError) or number == errno.ETIMEDOUT:
        seen, cause = f"{host} port {port} did not answer", "the computer is off, or a firewall is between"
    elif number == errno.ECONNREFUSED:
        seen, cause = f"nobody listens at {host} port {port}", "no bus server runs there"
    else:
        seen, cause = str(error.__cause__ or error), "there is no way through the network to that computer"
    return TransportError(CANNOT_OPEN, locator, f"cannot open {locator}", seen=seen, cause=cause, tries=tries)


def no_bus_server(locator: str, host: str, port: int, seen: str) -> TransportError:
    """Return the error if another program listens there, or the bus server refuses us. host, port: of the server. seen: what it
    sent."""
    tries = (serve_command(host, port + 1 if port < 65535 else DEFAULT_PORT),)
    cause = "another program uses this port, or another version of this one; or the bus server is stopped (Ctrl-Z)"
    return TransportError(CANNOT_OPEN, locator, f"cannot open {locator}", seen=seen, cause=cause, tries=tries)


def connection_lost(locator: str, doing: str, seen: str, cause: str) -> TransportError:
    """Return the error for a connection that has ended. We do not reconnect: the caller would miss frames without knowing it.
    doing: what was tried. seen, cause: see Explained."""
    tries = (serve_command(*parse_address(locator, locator.partition(":")[2])), "start this program again once it runs")
    return TransportError(BUS_LOST, locator, f"cannot {doing} on {locator}", seen=seen, cause=cause, tries=tries)


def cannot_listen(host: str, port: int, error: OSError | UnicodeError) -> TransportError:
    """Return why no server can be started there. UnicodeError: the host is not a valid name. host, port: where it should have
    listened."""
    where = f"tcp:{address_text(host, port)}"
    number, code = _error_number(error), CANNOT_OPEN
    seen = _unknown_name(host, error) if isinstance(error, socket.gaierror | UnicodeError) else str(error)
    tries: tuple[str, ...] = (f"canopen bus serve --bind {DEFAULT_HOST}",)
    cause = "this computer has no such address"
    if number == errno.EADDRINUSE:
        other = port + 1 if port < 65535 else DEFAULT_PORT
        cause = "a bus server runs there already (then just use it), or another program does"
        tries = (f"-b {where}    (to join it)", f"canopen bus serve --port {other}")
    elif number in (errno.EACCES, errno.EPERM):
        code, cause = NO_PERMISSION, "ports below 1024 are the administrator's"
        tries = (f"canopen bus serve --port {DEFAULT_PORT}",)
    return TransportError(code, where, f"cannot serve a bus on {where}", seen=seen, cause=cause, tries=tries)


def _unknown_name(host: str, error: socket.gaierror | UnicodeError) -> str:
    return f"the name {host!r} is not known: {error.strerror if isinstance(error, socket.gaierror) else error}"


def _error_number(error: BaseException) -> int | None:
    """Return the errno of an OSError, or of the first OSError behind it (trio tries each address of a name)."""
    if isinstance(error, BaseExceptionGroup):
        return _error_number(error.exceptions[0])
    number = error.errno if isinstance(error, OSError) else None
    if number is None and error.__cause__ is not None:
        return _error_number(error.__cause__)
    return number
