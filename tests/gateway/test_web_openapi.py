"""The description of the HTTP interface against what is really sent: each path, each status, each answer by its schema."""

from __future__ import annotations

from typing import Any

import jsonschema
import pytest
import trio

from canopen_gateway.web.api import ROUTES
from canopen_gateway.web.guard import MAX_BODY, MOST_AT_ONCE
from tests.gateway.web_world import Described, body_of, real, web
from tests.master.world import arm_of, virtual_time

OPERATIONS = [(method, path) for method, path, _ in ROUTES]
OF_EACH = {"401", "403", "405", "408", "413", "421"}
"""Statuses that each path answers with."""


@virtual_time
async def test_each_path_and_each_status_of_the_description_is_what_is_sent() -> None:
    async with web(3, 4, allow="write,nmt") as world, trio.open_nursery() as nursery:
        arm_of(world.service.master, 3, 4)
        described = Described(await world.get("/openapi.json"))
        for method, path in OPERATIONS:
            assert described.statuses(method, path) >= OF_EACH | {"200"}

            async def ask(method: str = method, path: str = path, **given: Any) -> int:
                return await described.ask(world, method, path, **given)

            if not path.endswith("/events"):  # it never ends
                assert await ask(json=body_of(method, path)) == 200
            assert await ask(headers={"authorization": ""}) == 401
            assert await ask(headers={"origin": "http://evil.example"}) == 403
            assert await ask(headers={"host": "evil.example:8402"}) == 421
            assert await ask(sent="DELETE") == 405
            assert await ask(content=b"x" * (MAX_BODY + 1)) == 413
            if "{net}" in path:
                assert await ask(at=real(path).replace("/1/", "/77/"), json=body_of(method, path)) == 404
            if method == "PUT":
                assert await ask(content="nonsense") == 400

        object_path = "/api/v1/{net}/{node}/objects/{object}"
        assert await described.ask(world, "GET", object_path, headers={"accept": "application/octet-stream"}) == 200
        assert await described.ask(world, "GET", object_path, at="/api/v1/1/3/objects/2FFF") == 409
        assert await described.ask(world, "GET", object_path, at="/api/v1/1/99/objects/1000") == 504
        assert await described.ask(world, "GET", "/api/v1/trace", at="/api/v1/trace?seconds=x") == 400

        # as many as are served at a time, all of which say nothing; then one more of each
        taken: list[tuple[str, str, list[dict[str, Any]]]] = []

        async def silent() -> dict[str, object]:
            await trio.sleep_forever()
            return {}

        for number in range(MOST_AT_ONCE):
            method, path = OPERATIONS[number % len(OPERATIONS)]
            messages: list[dict[str, Any]] = []
            taken.append((method, path, messages))
            nursery.start_soon(world.raw, method, real(path), silent, messages.append)
        await trio.sleep(0.01)
        for method, path in OPERATIONS:
            is_halt = path.endswith("/halt")
            assert await described.ask(world, method, path, json=body_of(method, path)) == (200 if is_halt else 503)
        await trio.sleep(11)
        for method, path, messages in taken:
            headers = dict(messages[0]["headers"])
            text = messages[1]["body"].decode()
            described.check(method, path, messages[0]["status"], headers[b"content-type"].decode(), text)

        def broken() -> None:
            raise ZeroDivisionError("secret")

        world.hub.subject.state = broken  # type: ignore[assignment,method-assign]
        assert await described.ask(world, "GET", "/api/v1/state") == 500

        for operation in OPERATIONS:
            assert described.seen[operation] >= OF_EACH, operation
        everywhere = {status for each in described.seen.values() for status in each}
        declared = {status for operation in OPERATIONS for status in described.statuses(*operation)}
        assert declared - everywhere == {"501"}  # of a page over a fleet: test_fleet_web.py
        with pytest.raises(jsonschema.ValidationError):  # the check itself finds what is wrong
            described.check("GET", "/api/v1/buses", 200, "application/json", '[{"net": 1}]')


@virtual_time
async def test_a_path_that_has_no_such_method_says_which_it_has() -> None:
    async with web(3) as world:
        answer = await world.http.delete("/api/v1/1/3/objects/1017")
        assert "GET" in answer.headers["allow"]


@virtual_time
async def test_a_page_for_a_browser_is_refused_in_plain_text() -> None:
    async with web(3) as world:
        for answer in (await world.http.get("/?token=wrong"), await world.http.get("/", headers={"host": "evil.example"})):
            assert answer.headers["content-type"].startswith("text/plain")
