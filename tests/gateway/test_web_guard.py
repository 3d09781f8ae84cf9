"""Who passes the guard of the web door: every method x path x Host x Origin x token x mode, against the rules told again here."""

from __future__ import annotations

from itertools import product

import httpx
import pytest
import trio

from canopen_gateway.web.guard import MAX_BODY, MOST_AT_ONCE, SEND_SECONDS, WebGuard
from tests.gateway.web_world import BEARER, COOKIE, NAMES, TOKEN, web
from tests.master.world import virtual_time

HOSTS = {
    "127.0.0.1:8402": True,
    "LOCALHOST:8402": True,
    "[::1]:8402": True,
    "localhost": False,  # another port
    "localhost:8403": False,
    "evil.example:8402": False,  # DNS rebinding
    "localhost:8402.evil.example": False,
    "": False,
}
ORIGINS = {
    None: True,
    "http://localhost:8402": True,
    "http://127.0.0.1:8402": True,
    "https://localhost:8402": False,
    "http://localhost:3000": False,  # another program's page on this computer
    "http://evil.example": False,
    "null": False,  # a sandboxed frame, a file
}
NO_TOKEN, WRONG, BY_COOKIE, WITH_HEADER, BY_HEADER = "none", "wrong", "cookie", "cookie and x-canopen", "bearer"
TOKENS = {
    NO_TOKEN: {},
    WRONG: {"authorization": "Bearer another", "cookie": "canopen-8402=another"},
    BY_COOKIE: COOKIE,
    WITH_HEADER: {**COOKIE, "x-canopen": "1"},
    BY_HEADER: BEARER,
}
READS, CHANGES = ("GET", "HEAD"), ("PUT", "POST", "DELETE", "PATCH", "OPTIONS")
OPEN = ("/", "/page.js", "/apix")
GUARDED = ("/api/v1/state", "/api/v1/1/3/objects/1017", "/api/v1/1/network", "/api/v1/trace", "/metrics", "/mcp")


def expected(method: str, path: str, host: str, origin: str | None, token: str) -> int:
    """The status by the rules of docs/web.md; 0: it passes."""
    if not HOSTS[host]:
        return 421
    if not ORIGINS[origin]:
        return 403
    if path in OPEN:
        return 0 if method in READS else 405
    if token in (NO_TOKEN, WRONG):
        return 401
    if token == BY_HEADER:
        return 0
    if method == "WEBSOCKET":
        return 0 if origin else 403
    return 0 if method in READS or token == WITH_HEADER else 403


async def nobody(*given: object) -> None:
    raise AssertionError("the guard let it pass")


def guard() -> WebGuard:
    return WebGuard(nobody, token=TOKEN, names=NAMES, port=8402)


def test_the_whole_table() -> None:
    asked = guard()
    count = 0
    for method, path, host, origin, token in product((*READS, *CHANGES, "WEBSOCKET"), (*OPEN, *GUARDED), HOSTS, ORIGINS, TOKENS):
        headers = {"host": [host], **({} if origin is None else {"origin": [origin]})}
        headers |= {name: [value] for name, value in TOKENS[token].items()}
        refusal = asked.refusal(method, path, headers)
        found = 0 if refusal is None else refusal.status
        assert found == expected(method, path, host, origin, token), (method, path, host, origin, token)
        count += 1
    assert count == 8 * 9 * 8 * 7 * 5


def test_headers_that_come_twice_or_are_odd() -> None:
    asked = guard()

    def status(**headers: list[str]) -> int:
        refusal = asked.refusal("GET", "/api/v1/state", {"host": ["localhost:8402"], **headers})
        return 0 if refusal is None else refusal.status

    assert status(host=[]) == 421
    assert status(host=["localhost:8402", "localhost:8402"]) == 421
    assert status(authorization=[f"Bearer {TOKEN}", f"Bearer {TOKEN}"]) == 401
    assert status(authorization=[f"bearer  {TOKEN} "]) == 0
    assert status(authorization=[f"Basic {TOKEN}"]) == 401
    assert status(authorization=["Bearer \udcff\u20ac"]) == 401
    assert status(cookie=[f"a=b; canopen-8402={TOKEN}; c"]) == 0
    assert status(cookie=[f"canopen-8402={TOKEN}; canopen-8402=another"]) == 401
    assert status(cookie=[f"canopen-8403={TOKEN}"]) == 401
    assert status(authorization=[f"Bearer {TOKEN}"], origin=["http://localhost:8402", "http://evil.example"]) == 403


def test_the_usual_port_needs_no_number_and_tls_changes_the_origin() -> None:
    asked = WebGuard(nobody, token=TOKEN, names=["cell7.lan"], port=443, tls=True)
    headers = {"host": ["cell7.lan"], "authorization": [f"Bearer {TOKEN}"]}
    assert asked.refusal("GET", "/api/v1/state", headers) is None
    assert asked.refusal("GET", "/api/v1/state", {**headers, "origin": ["https://cell7.lan"]}) is None
    refused = asked.refusal("GET", "/api/v1/state", {**headers, "origin": ["http://cell7.lan"]})
    assert refused is not None
    assert refused.status == 403


MODES = {"": set(), "write": {"write"}, "motion": {"motion"}, "nmt": {"nmt"}, "write,motion,nmt": {"write", "motion", "nmt"}}
REQUESTS = (
    ("GET", "/api/v1/1/3/objects/1008", None, ""),
    ("GET", "/api/v1/1/network", None, ""),
    ("GET", "/api/v1/1/trace", None, ""),
    ("GET", "/api/v1/trace", None, ""),
    ("GET", "/api/v1/1/3/pdos", None, ""),
    ("PUT", "/api/v1/1/3/objects/1017", {"value": 300}, "write"),
    ("PUT", "/api/v1/1/3/objects/controlword", {"value": 0}, "motion"),
    ("PUT", "/api/v1/1/3/objects/6060", {"value": 0}, "motion"),
    ("PUT", "/api/v1/1/3/objects/1010:01", {"value": 0}, "store"),
    ("PUT", "/api/v1/1/3/objects/1F50:01", {"value": 0}, "program"),
    ("PUT", "/api/v1/1/3/nmt", {"command": "start"}, "nmt"),
    ("PUT", "/api/v1/1/nmt", {"command": "preoperational"}, "nmt"),
    ("POST", "/api/v1/1/halt", None, ""),
    ("POST", "/api/v1/halt", None, ""),
)


@virtual_time
async def test_each_mode_opens_what_it_names_and_nothing_else() -> None:
    """And the checks of the guard come first, in every mode."""
    for mode, allowed in MODES.items():
        async with web(3, allow=mode) as world:
            for method, path, body, needs in REQUESTS:
                answer = await world.http.request(method, path, json=body)
                wanted = 200 if not needs or needs in allowed else 403
                assert answer.status_code == wanted, (mode, path, answer.text)
                if wanted == 403:
                    assert answer.json()["error"]["code"] == "CO150"
                foreign = await world.http.request(method, path, json=body, headers={"origin": "http://evil.example"})
                assert foreign.status_code == 403
                assert "error" not in foreign.headers.get("content-type", "")
                rebound = await world.http.request(method, path, json=body, headers={"host": "evil.example:8402"})
                assert rebound.status_code == 421


@virtual_time
async def test_the_token_becomes_a_cookie_and_leaves_the_address() -> None:
    async with web(3) as world:
        transport = httpx.ASGITransport(world.app)  # type: ignore[arg-type]
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost:8402") as browser:
            assert (await browser.get("/api/v1/state")).status_code == 401
            assert (await browser.get("/?token=wrong")).status_code == 401
            for refused in (await browser.get("/metrics"), await browser.get("/?token=wrong"), await browser.put("/api/v1/x")):
                assert refused.headers["www-authenticate"] == 'Bearer realm="canopen"'  # RFC 9110, 11.6.1
            only_read = await browser.post("/")
            assert (only_read.status_code, only_read.headers["allow"]) == (405, "GET, HEAD")
            entered = await browser.get(f"/?token={TOKEN}")
            assert (entered.status_code, entered.headers["location"]) == (303, "/")
            cookie = entered.headers["set-cookie"]
            assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(cookie.split("; "))
            assert (await browser.get("/api/v1/state")).status_code == 200
            assert (await browser.post("/api/v1/halt")).status_code == 403  # as a form of a foreign page would
            assert (await browser.post("/api/v1/halt", headers={"x-canopen": "1"})).status_code == 200


@virtual_time
async def test_a_client_that_takes_no_answer_is_cut_off() -> None:
    async with web(3) as world:

        async def ask() -> dict[str, object]:
            await trio.lowlevel.checkpoint()
            return {"type": "http.request", "body": b"", "more_body": False}

        began = trio.current_time()
        with pytest.raises(trio.TooSlowError):
            await world.raw("GET", "/api/v1/1/3/objects", ask, lambda message: None, hangs=True)
        assert trio.current_time() - began == pytest.approx(SEND_SECONDS, abs=0.1)


@virtual_time
async def test_so_many_requests_at_a_time_and_no_more() -> None:
    async with web(3) as world, trio.open_nursery() as nursery:
        asked = 0

        async def ask() -> dict[str, object]:
            nonlocal asked
            asked += 1
            await trio.sleep(0 if asked <= MOST_AT_ONCE else 3600)
            return {"type": "http.request", "body": b"", "more_body": False}

        for _ in range(MOST_AT_ONCE):
            nursery.start_soon(world.raw, "GET", "/api/v1/events", ask, lambda message: None)
        await trio.sleep(0.1)
        assert (await world.http.get("/api/v1/state")).status_code == 503
        assert (await world.http.post("/api/v1/halt")).status_code == 200  # whatever else is asked
        assert (await world.http.post("/api/v1/1/halt")).status_code == 200
        nursery.cancel_scope.cancel()
        await trio.sleep(0)


@virtual_time
async def test_every_answer_says_what_browsers_must_not_do() -> None:
    async with web(3) as world:
        for path, headers in (("/", {}), ("/api/v1/state", {}), ("/none", {}), ("/", {"host": "evil"}), ("/?token=x", {})):
            answer = await world.http.get(path, headers=headers)
            assert "default-src 'self'" in answer.headers["content-security-policy"]
            assert "unsafe" not in answer.headers["content-security-policy"]
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert not [name for name in answer.headers if name.startswith("access-control")]


@virtual_time
async def test_a_body_that_is_too_long_or_too_slow_is_not_read_on() -> None:
    async with web(3, allow="write") as world:
        path = "/api/v1/1/3/objects/1017"
        announced = await world.http.put(path, content=b"x" * (MAX_BODY + 1))
        assert announced.status_code == 413

        taken: list[dict[str, object]] = []
        given = 0

        async def endless() -> dict[str, object]:
            nonlocal given
            given += 1
            await trio.lowlevel.checkpoint()
            return {"type": "http.request", "body": b"x" * 4096, "more_body": True}

        await world.raw("PUT", path, endless, taken.append)
        assert taken[0]["status"] == 413
        assert given == MAX_BODY // 4096 + 1

        async def slow() -> dict[str, object]:
            await trio.sleep_forever()
            return {}

        taken.clear()
        began = trio.current_time()
        await world.raw("PUT", path, slow, taken.append)
        assert taken[0]["status"] == 408
        assert trio.current_time() - began == pytest.approx(10, abs=0.1)
        assert (await world.http.put(path, json={"value": 300})).status_code == 200
