"""`WebGuard`: stands in front of the whole web door, and lets nobody pass whom a page from elsewhere has sent.

A browser on this computer visits pages from anywhere, and sends what they like to any port of this computer. Five checks keep
them out, each for a reason of its own:

    Host          must be a name of this door; else 421. A page may let its own name mean 127.0.0.1 (DNS rebinding); the browser
                  then sends that name
    Origin        if there is one, must be this door; else 403. Also `null`, and another port of this computer
    token         whoever asks for data has it: in a cookie, or as `Authorization: Bearer ...`; else 401
    x-canopen: 1  stands in each request that changes something and shows only the cookie; else 403. A form of a foreign page
                  cannot set a header, and no answer here allows it (CORS)
    size          a body has MAX_BODY bytes at most; else 413, and the rest is not read

Besides, one client cannot hold the door open: a body comes within BODY_SECONDS (408), an answer is taken within SEND_SECONDS (the
connection ends), and MOST_AT_ONCE requests are served at a time (503). What a client that is gone has asked for, and
that changes nothing, is given up after LEFT_SECONDS: the next one would wait behind it.

A WebSocket that shows only the cookie needs an Origin: a browser sends one always.

The page itself, its styles and programs are open: they hold no data. `GET /?token=...` sets the cookie, and leads to `/`.
"""

from __future__ import annotations

import hashlib
import logging
import secrets
from collections.abc import Awaitable, Callable, Iterable, Mapping, MutableMapping
from typing import Any, Final, NamedTuple, TypeAlias
from urllib.parse import parse_qs

import trio

from canopen_master.plain_text import json_text
from canopen_transports.loop.beside import beside

Scope: TypeAlias = MutableMapping[str, Any]
AsgiMessage: TypeAlias = MutableMapping[str, Any]
Receive: TypeAlias = Callable[[], Awaitable[AsgiMessage]]
Send: TypeAlias = Callable[[AsgiMessage], Awaitable[None]]
AsgiApp: TypeAlias = Callable[[Scope, Receive, Send], Awaitable[None]]

MAX_BODY: Final = 1 << 16
"""Bytes of the body of a request."""
BODY_SECONDS: Final = 10.0
"""Seconds that a body may take to come."""
SEND_SECONDS: Final = 30.0
"""Seconds that a client may take for a piece of an answer."""
LEFT_SECONDS: Final = 1.0
"""Seconds for which an answer is still made for a client that has closed its end: some do so, and take it all the same."""
MOST_AT_ONCE: Final = 64
"""Requests that are served at a time, event streams too. A browser has six of them at most."""
SAFE_METHODS: Final = frozenset({"GET", "HEAD"})
CLOSE_POLICY: Final = 1008
"""The close code of a WebSocket that is refused (RFC 6455, 7.4.1)."""
GUARDED: Final = ("/api/", "/metrics", "/mcp")
"""What needs the token: all that begins so."""
HEADERS: Final = (
    (b"content-security-policy", b"default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
"""Of every answer. no-store: a page of yesterday's version must not speak to today's door, and values are nobody else's."""


LOGGER: Final = logging.getLogger("canopen_gateway")


class WebRefusal(NamedTuple):
    """Why a request does not pass. status: of HTTP."""

    status: int
    text: str


FULL: Final = WebRefusal(503, f"this door serves {MOST_AT_ONCE} requests at a time")
TOO_LONG: Final = WebRefusal(413, f"a body has {MAX_BODY} bytes at most")
TOO_SLOW: Final = WebRefusal(408, "the body did not come in time")
CLOSE: Final = (b"connection", b"close")
DUE: Final = {
    401: (b"www-authenticate", b'Bearer realm="canopen"'),
    405: (b"allow", b", ".join(map(str.encode, sorted(SAFE_METHODS)))),
}
"""The header that a status has to have: how to prove who one is (RFC 9110, 11.6.1; RFC 6750, 3), and what the page takes (RFC
9110, 15.5.6)."""


class WebGuard:
    """See this module's text. hosts: the names of this door, each with its port, in lower case. cookie: the name of the cookie;
    cookies are shared by all ports of a host, so the port is part of it."""

    def __init__(self, app: AsgiApp, *, token: str, names: Iterable[str], port: int, tls: bool = False) -> None:
        """app: what is guarded. names: those under which it may be reached; `[::1]` for an IPv6 address. tls: whether it is
        reached by https."""
        self.hosts = frozenset(f"{name.lower()}:{port}" for name in names)
        default = 443 if tls else 80
        if port == default:
            self.hosts |= {name.lower() for name in names}
        self.cookie = f"canopen-{port}"
        self._app = app
        self._at_once = 0
        self._token = _digest(token)
        self._cookie_line = f"{self.cookie}={token}; Path=/; HttpOnly; SameSite=Strict{'; Secure' if tls else ''}"
        self._origins = frozenset(f"{'https' if tls else 'http'}://{host}" for host in self.hosts)

    def refusal(self, method: str, path: str, headers: Mapping[str, list[str]]) -> WebRefusal | None:
        """Return why a request does not pass, or None. method: "WEBSOCKET" for the beginning of one. headers: all values, by
        names in lower case."""
        host = headers.get("host", [])
        if len(host) != 1 or host[0].lower() not in self.hosts:
            return WebRefusal(
                421, "this is not the host that was asked for: start the door with --name, if it is to have this name"
            )
        origins = headers.get("origin", [])
        if any(origin.lower() not in self._origins for origin in origins):
            return WebRefusal(403, "a page of another origin has sent this")
        if not path.startswith(GUARDED):
            return None if method in SAFE_METHODS else WebRefusal(405, "the page is only read")
        if self._bears_token(headers):
            return None
        if not self._has_cookie(headers):
            return WebRefusal(401, "the token is missing or wrong: open the address that was shown at the start")
        if method == "WEBSOCKET":
            return None if origins else WebRefusal(403, "a WebSocket with a cookie needs an Origin")
        if method not in SAFE_METHODS and headers.get("x-canopen") != ["1"]:
            return WebRefusal(403, "a change needs the header x-canopen: 1")
        return None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request, as ASGI has it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers: dict[str, list[str]] = {}
        for name, value in scope["headers"]:
            headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
        method = "WEBSOCKET" if scope["type"] == "websocket" else scope["method"]
        refusal = self.refusal(method, scope["path"], headers)
        if scope["type"] == "websocket":
            if refusal is None:
                await self._app(scope, receive, send)
            else:
                await receive()
                await send({"type": "websocket.close", "code": CLOSE_POLICY, "reason": refusal.text})
            return
        if refusal is None and _announced(headers) > MAX_BODY:
            refusal = TOO_LONG
        is_halt = method == "POST" and scope["path"].startswith(GUARDED) and scope["path"].endswith("/halt")
        if refusal is None and self._at_once >= MOST_AT_ONCE and not is_halt:  # a halt passes whatever else is asked
            refusal = FULL
        if refusal is not None:
            await _refuse(send, scope["path"], refusal)
        elif scope["path"] == "/" and b"token=" in scope["query_string"]:
            await self._enter(scope, send)
        else:
            self._at_once += 1
            try:
                await self._pass(scope, receive, send)
            except trio.TooSlowError:
                LOGGER.info("%s is cut off: it took nothing for %g s", scope.get("client"), SEND_SECONDS)
                raise
            finally:
                self._at_once -= 1

    async def _enter(self, scope: Scope, send: Send) -> None:
        """Take the token out of the address, and put it into a cookie: an address stays in histories and screenshots."""
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if not secrets.compare_digest(_digest(given), self._token):
            await _answer(send, 401, "this token is wrong, or of an earlier start: open the address that was shown last")
            return
        await _answer(send, 303, "", [(b"location", b"/"), (b"set-cookie", self._cookie_line.encode("latin-1"))])

    async def _pass(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request pass once its body is here, bounded; set our headers on its answer."""
        body = b""
        more = scope["path"].startswith(GUARDED)  # who shows no token sends no body: nothing is kept for him
        with trio.move_on_after(BODY_SECONDS) as limit:
            while more:
                message = await receive()
                if message["type"] == "http.disconnect":
                    return
                body += message.get("body", b"")
                more = message.get("more_body", False)
                if len(body) > MAX_BODY:
                    await _refuse(send, scope["path"], TOO_LONG, [CLOSE])
                    return
        if limit.cancelled_caught:
            await _refuse(send, scope["path"], TOO_SLOW, [CLOSE])
            return
        whole: list[AsgiMessage] = [{"type": "http.request", "body": body, "more_body": False}]
        left = trio.Event()

        async def replayed() -> AsgiMessage:
            if whole:
                return whole.pop()
            await left.wait()
            return {"type": "http.disconnect"}

        async def with_headers(message: AsgiMessage) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *HEADERS]
            with trio.fail_after(SEND_SECONDS):
                await send(message)

        async with beside(trio.open_nursery()) as nursery:

            async def watch() -> None:
                if (await receive())["type"] == "http.disconnect":  # nothing else can come behind the body
                    left.set()
                    if scope["method"] in SAFE_METHODS:  # what changes something, or halts, is done all the same
                        await trio.sleep(LEFT_SECONDS)
                        nursery.cancel_scope.cancel()

            if scope["path"].startswith(GUARDED):
                nursery.start_soon(watch)
            await self._app(scope, replayed, with_headers)

    def _bears_token(self, headers: Mapping[str, list[str]]) -> bool:
        given = headers.get("authorization", [])
        kind, _, token = (given[0] if len(given) == 1 else "").partition(" ")
        return kind.lower() == "bearer" and secrets.compare_digest(_digest(token.strip()), self._token)

    def _has_cookie(self, headers: Mapping[str, list[str]]) -> bool:
        pairs = (each.strip().partition("=") for line in headers.get("cookie", []) for each in line.split(";"))
        given = [value for name, _, value in pairs if name == self.cookie]
        return len(given) == 1 and secrets.compare_digest(_digest(given[0]), self._token)


def _digest(token: str) -> bytes:
    """Return what is compared: of one length, and of bytes that any text has."""
    return hashlib.sha256(token.encode("utf-8", "surrogateescape")).digest()


def _announced(headers: Mapping[str, list[str]]) -> int:
    text = headers.get("content-length", ["0"])[0]
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 20 else MAX_BODY + 1


async def _refuse(send: Send, path: str, refusal: WebRefusal, more: Iterable[tuple[bytes, bytes]] = ()) -> None:
    """Refuse a request: a program gets JSON, as each error of the interface is; who asks for the page gets text."""
    if not path.startswith(GUARDED):
        await _answer(send, *refusal, more)
        return
    error = {"error": {"code": "", "text": refusal.text, "details": []}}
    await _answer(send, refusal.status, json_text(error), more, kind=b"application/json")


async def _answer(
    send: Send, status: int, text: str, more: Iterable[tuple[bytes, bytes]] = (), kind: bytes = b"text/plain; charset=utf-8"
) -> None:
    body = f"{text}\n".encode() if text else b""
    lengths = [(b"content-type", kind), (b"content-length", str(len(body)).encode())]
    due = [DUE[status]] if status in DUE else []
    await send({"type": "http.response.start", "status": status, "headers": [*lengths, *due, *more, *HEADERS]})
    await send({"type": "http.response.body", "body": body})
