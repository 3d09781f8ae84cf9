"""`WebDoor`: the web door on a TCP port, with its token and, for other computers, TLS.

- It listens on this computer only, unless it has a certificate: without TLS an address that others reach is refused.
- The token is made anew at each start, unless one is given; whoever has it may do what is allowed.
- If the door itself fails, it is closed, and says why (`failure`); the master goes on.
"""

from __future__ import annotations

import ipaddress
import logging
import os
import secrets
import socket
import ssl
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import hypercorn.trio.run
import trio
from hypercorn.config import Config
from hypercorn.trio import serve
from hypercorn.trio.tcp_server import TCPServer

from canopen_gateway.errors import DoorError, first_of
from canopen_gateway.guard import Permission
from canopen_gateway.listening import address_of, open_listeners
from canopen_gateway.service import GatewayService, GatewaySession
from canopen_gateway.web.api import WebApi, web_app
from canopen_gateway.web.guard import AsgiApp, WebGuard
from canopen_gateway.web.live import MAX_MESSAGE, LiveHub
from canopen_gateway.web.machine_subject import MachineSubject
from canopen_gateway.web.subject import WebSubject
from canopen_transports.tcp.address import is_loopback

if TYPE_CHECKING:
    from canopen_gateway.fleet import Fleet

DEFAULT_PORT: Final = 8402
"""After CiA 402; few programs listen there."""
SEND_BUFFER: Final = 1 << 14
"""Bytes that the system keeps for a client that takes nothing: values that are old when it wakes are of no use."""
TOKEN_BYTES: Final = 24
LEAST_TOKEN: Final = 16
"""Characters of a token that somebody chose."""
PING: Final = 5.0
"""Seconds between two pings of a WebSocket."""
LOOPBACK: Final = ("localhost", "127.0.0.1", "[::1]")
NAME: Final = "the web door"
LOGGER: Final = logging.getLogger("canopen_gateway")


class _Connection(TCPServer):
    """A connection that ends alone. In hypercorn an error of one ends the server, and a client without a token can cause some: by
    a body whose chunks are garbled, or words behind the beginning of a WebSocket."""

    async def run(self) -> None:
        try:
            await super().run()
        except* Exception as failed:  # noqa: BLE001 - whatever a client made of it
            LOGGER.info("a connection of the web door has failed: %r", first_of(failed))
            await trio.aclose_forcefully(self.stream)


hypercorn.trio.run.TCPServer = _Connection  # type: ignore[attr-defined]  # it has no other way to be given one


class WebDoor:
    """See this module's text; made by `bind_web_door`. url: the address of the page, with the token. addresses: where it listens.
    token: what clients show. site: the name of the place, for files. failure: why it was closed, or None."""

    def __init__(
        self,
        listeners: Iterable[trio.SocketListener],
        names: Iterable[str],
        token: str,
        certificate: tuple[Path, Path] | None,
        site: str,
    ) -> None:
        self.token = token
        self.site = site
        self.failure: Exception | None = None
        self._listeners = list(listeners)
        self._names = tuple(names)
        self._certificate = certificate
        self.addresses = tuple(address_of(listener) for listener in self._listeners)
        self.port: int = self._listeners[0].socket.getsockname()[1]
        scheme = "http" if certificate is None else "https"
        self.url = f"{scheme}://{self._names[0]}:{self.port}/?token={token}"

    async def serve(self, service: GatewayService, begun: Callable[[], object] | None = None) -> None:
        """Serve the page and its interface until cancelled. begun: called once the door serves. Returns early only if the door
        itself fails; see `failure`."""
        if begun is not None:
            begun()  # clients that come from now on wait in the listeners
        with self._failing_alone(), service.open_session(NAME) as session:
            await self._serve_page(MachineSubject(service, session))

    async def serve_fleet(self, fleet: Fleet, allow: Collection[Permission] = ()) -> None:
        """Serve the page and its interface over a fleet, as `serve` does over a machine. allow: what its clients may change, as
        far as each bridge allows it, too; by default nothing. Raises ValueError for motion and lss, which no page has over a
        fleet."""
        from canopen_gateway.web.fleet_subject import FleetSubject  # here: it needs the extra `fleet`

        subject = FleetSubject(fleet, allow)
        with self._failing_alone():
            await self._serve_page(subject)

    async def serve_app(self, service: GatewayService, make: Callable[[GatewaySession], AsgiApp]) -> None:
        """Serve any application behind the guard, as `serve` does. make: returns it; is given a client of the service."""
        with self._failing_alone(), service.open_session(NAME) as session:
            await self._serve_guarded(make(session))

    async def _serve_page(self, subject: WebSubject) -> None:
        hub = LiveHub(subject)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(hub.run)
            await self._serve_guarded(web_app(WebApi(hub, self.site)))

    async def _serve_guarded(self, app: AsgiApp) -> None:
        tls = self._certificate is not None
        guarded = WebGuard(app, token=self.token, names=self._names, port=self.port, tls=tls)
        await serve(guarded, self._config(), mode="asgi")  # type: ignore[arg-type] # it is an ASGI application

    @contextmanager
    def _failing_alone(self) -> Iterator[None]:
        try:
            yield
        except* Exception as failed:  # noqa: BLE001 - whatever it is, it ends this door alone
            self.failure = first_of(failed)
            LOGGER.warning("the web door is closed: %s", self.failure)

    def _config(self) -> Config:
        config = Config()
        config.bind = [f"fd://{os.dup(listener.socket.fileno())}" for listener in self._listeners]
        config.accesslog = config.errorlog = None  # ours are told; and an access log would have the token
        config.alpn_protocols = ["http/1.1"]
        config.include_server_header = False
        config.websocket_max_message_size = MAX_MESSAGE
        config.websocket_ping_interval = PING
        config.graceful_timeout = 0.5
        if self._certificate is not None:
            config.certfile, config.keyfile = map(str, self._certificate)
        return config

    async def __aenter__(self) -> WebDoor:
        return self

    async def __aexit__(self, *exc: object) -> None:
        with trio.CancelScope(shield=True):
            for listener in self._listeners:
                await listener.aclose()


async def bind_web_door(
    *,
    host: str = "127.0.0.1",
    port: int = DEFAULT_PORT,
    names: Iterable[str] = (),
    certificate: tuple[Path, Path] | None = None,
    token: str = "",
) -> WebDoor:
    """Bind the socket of a web door; `WebDoor.serve` then serves clients.

    host, port: an address of this computer; port 0: any free one. names: further names by which browsers reach it. certificate:
    the files of a certificate and its key (PEM), for TLS; an address that other computers reach needs one. token: what clients
    show, 16 characters or more; "": a new one. Raises DoorError, with nothing bound.
    """
    if not is_loopback(host) and certificate is None:
        raise DoorError(
            f"{host} can be reached from other computers, and this door has no certificate",
            cause="without TLS everybody on the way reads the token, and may then do what is allowed",
            tries=("--cert FILE --key FILE", "--bind 127.0.0.1, and ssh -L 8402:localhost:8402 from elsewhere"),
        )
    if token and (len(token) < LEAST_TOKEN or not all(each.isascii() and (each.isalnum() or each in "-_") for each in token)):
        seen = "letters, digits, - and _ of ASCII make one"
        raise DoorError(f"a token has {LEAST_TOKEN} characters or more", seen=seen, tries=("no token: one is made",))
    _check_certificate(certificate)
    listeners = await open_listeners(host, port)
    for listener in listeners:
        listener.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
    names = tuple(names)
    site = names[0] if names else socket.gethostname()
    return WebDoor(listeners, _names_of(host, names), token or secrets.token_urlsafe(TOKEN_BYTES), certificate, site)


def _check_certificate(certificate: tuple[Path, Path] | None) -> None:
    if certificate is None:
        return
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(*certificate)
    except (OSError, ssl.SSLError) as error:
        what = "the certificate cannot be used: " + ", ".join(map(str, certificate))
        raise DoorError(what, seen=str(error), tries=("--cert and --key with PEM files that belong together",)) from error


def _names_of(host: str, names: Iterable[str]) -> list[str]:
    """Return the names under which browsers may reach it; the first one is shown."""
    found = [*names]
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        found.append(host)
    else:
        if not address.is_unspecified:
            found.append(f"[{host}]" if address.version == 6 else host)
        elif not found:
            found.append(socket.gethostname())
    return list(dict.fromkeys([*found, *LOOPBACK]))
