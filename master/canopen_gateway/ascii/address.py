"""Where a text gateway is: `gw:HOST:PORT`, `gw:HOST`, or `gw:/path` for a Unix socket.

`?net=2` means another net of the gateway than its first one, and `?dialect=lely` one that ends its lines by LF alone.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from canopen_gateway.errors import NoGatewayError
from canopen_proto.gateway import CANOPENNODE, DIALECTS, Dialect

SCHEME: Final = "gw:"
DEFAULT_HOST: Final = "127.0.0.1"
DEFAULT_PORT: Final = 60000
"""What CANopenNode's client asks for by itself."""
_ADDRESS: Final = re.compile(r"(?:(\[[0-9A-Fa-f:.]+\]|[^\[\]:\s/?]+)(?::([0-9]{1,5}))?)?")


@dataclass(frozen=True)
class GatewayAddress:
    """Where a text gateway is. path: of its Unix socket; "" for TCP. net: its number there."""

    text: str
    host: str = DEFAULT_HOST
    port: int = DEFAULT_PORT
    path: str = ""
    net: int = 1
    dialect: Dialect = CANOPENNODE


def parse_gateway_address(text: str) -> GatewayAddress:
    """Return the parts of a locator such as "gw:localhost:60000?net=2". Raises NoGatewayError, which says what is wrong."""
    place, _, query = text.removeprefix(SCHEME).partition("?")
    net, dialect = 1, CANOPENNODE
    for option in query.split("&") if query else ():
        name, _, value = option.partition("=")
        if name == "net" and value.isdecimal() and 1 <= int(value) <= 0xFFFF:
            net = int(value)
        elif name == "dialect" and value in DIALECTS:
            dialect = DIALECTS[value]
        else:
            raise _bad_address(text, f"{option!r} is neither net=1 nor dialect={' or dialect='.join(DIALECTS)}")
    if place.startswith(("/", ".")):
        return GatewayAddress(text, path=place, net=net, dialect=dialect)
    match = _ADDRESS.fullmatch(place)
    port = int(match[2] or DEFAULT_PORT) if match is not None else 0
    if match is None or not 1 <= port <= 65535:
        raise _bad_address(text, f"{place!r} is neither HOST:PORT nor a path")
    return GatewayAddress(text, (match[1] or DEFAULT_HOST).strip("[]"), port, net=net, dialect=dialect)


def _bad_address(text: str, seen: str) -> NoGatewayError:
    tries = ("gw:localhost:60000", "gw:/tmp/CO_command_socket", "gw:localhost:60000?net=2")
    return NoGatewayError(f"{text!r} is no address of a text gateway", seen=seen, tries=tries)
