"""`canopen serve web`, and its door on real sockets: TLS, ports in use, and a door that fails."""

from __future__ import annotations

import contextlib
import gc
import json
import socket
import ssl
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import trio
import trio.testing
import trio_websocket

from canopen_cli.demo.web import open_simulated_arm
from canopen_cli.serve.served import open_service
from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import ExitCode
from canopen_gateway import DoorError, GatewayService, open_gateway
from canopen_gateway.web import WebDoor, bind_web_door
from canopen_master import open_master
from canopen_master.simulation.serving import simulated_drives
from tests.cli.cli_support import Run, runner

LOCATOR = "virtual:behind a web door"
CERTIFICATE = """-----BEGIN CERTIFICATE-----
MIIBmjCCAUGgAwIBAgIUPcP1JUR1ggL3WtWr86nktgUQq7owCgYIKoZIzj0EAwIw
FDESMBAGA1UEAwwJbG9jYWxob3N0MCAXDTI2MTEyODE5MjUxOFoYDzIxMjYxMTA0
MTkyNTE4WjAUMRIwEAYDVQQDDAlsb2NhbGhvc3QwWTATBgcqhkjOPQIBBggqhkjO
PQMBBwNCAARJgSjcixK68Fw1jIKnSF/UQ82Q7WtUHFt5eUFlgqTkJda1yy64oaTx
TlI8R8wqRknhc3jCJhzaAo+DtfBaSnhdo28wbTAdBgNVHQ4EFgQUh1SDys7Hm3bS
ti6QGSE9bv35tLMwHwYDVR0jBBgwFoAUh1SDys7Hm3bSti6QGSE9bv35tLMwDwYD
VR0TAQH/BAUwAwEB/zAaBgNVHREEEzARgglsb2NhbGhvc3SHBH8AAAEwCgYIKoZI
zj0EAwIDRwAwRAIgDUME+RjCO35PjTutwLnMTs0Rq9B/1CJY5JwxvBDqcxECIEWc
1Sv71TVBXPgqgDcTO/kJk51aI7V844HhrQR8MHJK
-----END CERTIFICATE-----
"""
KEY = """-----BEGIN PRIVATE KEY-----
MIGHAgEAMBMGByqGSM49AgEGCCqGSM49AwEHBG0wawIBAQQg+cWK6FQNFhyUTWHu
544iw4FGsu2QzcB67hEPq2a3etOhRANCAARJgSjcixK68Fw1jIKnSF/UQ82Q7WtU
HFt5eUFlgqTkJda1yy64oaTxTlI8R8wqRknhc3jCJhzaAo+DtfBaSnhd
-----END PRIVATE KEY-----
"""
"""Of nobody: made for these tests, for localhost."""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[Path, Path]:
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    cert.write_text(CERTIFICATE)
    key.write_text(KEY)
    return cert, key


def test_it_says_where_the_page_is_and_what_it_allows(run: Run, tmp_path: Path) -> None:
    outcome = run("serve", "web", "-b", "demo", "--port", "0", "--seconds", "0")
    assert outcome.status == 0
    assert "open http://127.0.0.1:" in outcome.err
    assert "/?token=" in outcome.err
    assert "read-only" in outcome.err
    token = tmp_path / "token"
    token.write_text("chosen-by-somebody\n")
    command = ("serve", "web", "-b", "demo", "--port", "0", "--seconds", "0", "--json", "--allow", "nmt,write")
    told = run(*command, "--token-file", str(token)).json
    assert told["url"].endswith("/?token=chosen-by-somebody")
    assert (told["nets"], told["allow"]) == (["virtual:demo"], ["nmt", "write"])
    assert run(*command).json["url"] != run(*command).json["url"]  # a new token at each start
    token.write_text("short")
    refused = run(*command, "--token-file", str(token))
    assert (refused.status, "16 characters" in refused.err) == (ExitCode.CANNOT_OPEN, True)


def test_a_port_in_use_is_told_before_anything_is_opened(run: Run) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        outcome = run("serve", "web", "-b", "socketcan:nowhere", "--port", str(taken.getsockname()[1]))
    assert outcome.status == ExitCode.CANNOT_OPEN
    assert "error CO155: cannot listen at 127.0.0.1 port" in outcome.err


def test_other_computers_need_tls(run: Run, certificate: tuple[Path, Path], tmp_path: Path) -> None:
    refused = run("serve", "web", "-b", "demo", "--bind", "0.0.0.0", "--port", "0", "--seconds", "0")
    assert refused.status == ExitCode.CANNOT_OPEN
    assert "--cert FILE --key FILE" in refused.err
    cert, key = map(str, certificate)
    command = (
        "serve",
        "web",
        "-b",
        "demo",
        "--bind",
        "0.0.0.0",
        "--port",
        "0",
        "--name",
        "cell7.lan",
        "--seconds",
        "0",
        "--json",
    )
    assert run(*command, "--cert", cert, "--key", key).json["url"].startswith("https://cell7.lan:")
    assert run(*command, "--cert", cert).status == ExitCode.USAGE
    wrong = run(*command, "--cert", cert, "--key", cert)
    assert (wrong.status, "belong together" in wrong.err) == (ExitCode.CANNOT_OPEN, True)


def test_the_collector_leaves_what_was_made_before_alone_while_a_door_is_served(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full collection takes 35 ms: three cycles of an arm."""
    counts: list[int] = []

    async def serve(door: WebDoor, service: GatewayService, begun: object) -> None:
        counts.append(gc.get_freeze_count())
        await trio.lowlevel.checkpoint()

    monkeypatch.setattr(WebDoor, "serve", serve)
    assert run("serve", "web", "-b", "demo", "--port", "0")[0] == ExitCode.OK
    assert counts[0] > 10_000
    assert gc.get_freeze_count() == 0


def test_the_demonstration_on_a_page(run: Run) -> None:
    told = run("demo", "--web", "--port", "0", "--seconds", "0.5", "--json").json
    assert (told["nets"], told["allow"]) == (["virtual:demo"], ["motion", "nmt", "write"])
    for options in (("--plot", "x.png"), ("--bus", "can0"), ("--fault", "5@1"), ("--swing", "5"), ("--eds", "x.eds")):
        refused = run("demo", "--web", *options)
        assert (refused.status, "--web" in refused.err) == (ExitCode.USAGE, True), refused.err


async def arm_of_the_demonstration() -> list[str]:
    async with open_simulated_arm() as service:
        (arm,) = service.master.chains.values()
        await arm.initialise()
        await arm.follow()
        return [f"{device.position:g} {device.axis.settings.unit}" for device in arm.devices]


def test_its_joints_are_in_degrees() -> None:
    clock = trio.testing.MockClock(autojump_threshold=0)
    assert trio.run(arm_of_the_demonstration, clock=clock)[:2] == ["-14 degree", "9 degree"]


def test_it_is_no_text_gateway_and_needs_a_bus(run: Run) -> None:
    assert run("serve", "web", "-b", "gw:localhost:1", "--port", "0").status == ExitCode.USAGE


@asynccontextmanager
async def served(door: WebDoor) -> AsyncIterator[GatewayService]:
    async with (
        door,
        simulated_drives((LOCATOR, node_id) for node_id in (3, 4)),
        open_master(LOCATOR) as master,
        open_gateway(master) as service,
        trio.open_nursery() as nursery,
    ):
        nursery.start_soon(door.serve, service)
        yield service
        nursery.cancel_scope.cancel()


async def asked(door: WebDoor, request: bytes, context: ssl.SSLContext | None = None) -> bytes:
    """What the door answers to bytes, until it closes."""
    stream: trio.abc.Stream = await trio.open_tcp_stream("127.0.0.1", door.port)
    if context is not None:
        stream = trio.SSLStream(stream, context, server_hostname="localhost", https_compatible=True)
    with trio.fail_after(30):
        async with stream:
            await stream.send_all(request)
            answer = b""
            while data := await stream.receive_some(65536):
                answer += bytes(data)
    return answer


def get(path: str, door: WebDoor, *lines: str) -> bytes:
    head = [f"GET {path} HTTP/1.1", f"Host: localhost:{door.port}", f"Authorization: Bearer {door.token}", "Connection: close"]
    return "\r\n".join([*head, *lines, "", ""]).encode()


def test_on_a_real_socket() -> None:
    """HTTP, the WebSocket, and clients that send anything; all on one door, which serves on."""

    async def main() -> None:
        door = await bind_web_door(port=0)
        async with served(door):
            head, _, body = (await asked(door, get("/api/v1/1/3/objects/1008", door))).partition(b"\r\n\r\n")
            assert head.startswith(b"HTTP/1.1 200")
            assert b"server:" not in head.lower()
            assert json.loads(body)["value"] == "Simulated Schunk Powerball joint"
            assert (await asked(door, get("/", door))).startswith(b"HTTP/1.1 200")
            for request in (
                b"\x00\xff" * 500 + b"\r\n\r\n",
                b"GET / HTTP/9.9\r\nConnection: close\r\n\r\n",
                b"[1] 3 r 0x1008 0 vs\r\n\r\n",
            ):
                assert (await asked(door, request))[9:12] in (b"400", b"421")
            # No path leads out of the page's files
            for path in ("/../api.py", "/%2e%2e/api.py", "/static/", "//etc/passwd", "/index.html"):
                assert (await asked(door, get(path, door))).startswith(b"HTTP/1.1 404")
            headers = [(b"authorization", f"Bearer {door.token}".encode())]
            async with await trio.open_tcp_stream("127.0.0.1", door.port) as stream, trio.open_nursery() as nursery:
                host = f"localhost:{door.port}"
                page = await trio_websocket.wrap_client_stream(nursery, stream, host, "/api/v1/live", extra_headers=headers)
                with trio.fail_after(30):
                    assert json.loads(await page.get_message())["k"] == "hello"
                    await page.send_message("x" * 5000)  # more than a message may have
                    with pytest.raises(trio_websocket.ConnectionClosed):
                        while True:
                            await page.get_message()
            lines = "Upgrade: websocket", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="
            request = get("/api/v1/live", door, *lines).replace(b"Connection: close", b"Connection: Upgrade")
            refused = await asked(door, request.replace(door.token.encode(), b"another"))
            assert refused.startswith(b"HTTP/1.1 403")
            assert door.failure is None
            assert (await asked(door, get("/api/v1/state", door))).startswith(b"HTTP/1.1 200")

    trio.run(main)


def test_a_connection_that_fails_ends_alone() -> None:
    """Of what ends hypercorn's own server: the first needs no token."""

    async def main() -> None:
        door = await bind_web_door(port=0)
        lines = "Upgrade: websocket", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="
        upgrade = get("/api/v1/live", door, *lines).replace(b"Connection: close", b"Connection: Upgrade")
        garbled = b"PUT /api/v1/1/3/objects/1017 HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nyyyyy\r\nZZ\r\n"
        async with served(door):
            for number in range(30):
                for request in (garbled, upgrade + b"\x81\xff" + bytes((number * place) % 256 for place in range(500))):
                    async with await trio.open_tcp_stream("127.0.0.1", door.port) as stream:
                        await stream.send_all(request)
                        with trio.move_on_after(0.01):
                            await stream.receive_some()
                assert (await asked(door, get("/api/v1/state", door))).startswith(b"HTTP/1.1 200")
            assert door.failure is None

    trio.run(main)


def test_others_are_served_while_hundreds_of_connections_say_nothing() -> None:
    async def main() -> None:
        door = await bind_web_door(port=0)
        async with served(door), contextlib.AsyncExitStack() as stack:
            for number in range(300):
                stream = await stack.enter_async_context(await trio.open_tcp_stream("127.0.0.1", door.port))
                await stream.send_all(b"GET /api/v1/state HT" if number % 2 else b"")
            assert (await asked(door, get("/api/v1/state", door))).startswith(b"HTTP/1.1 200")
            assert door.failure is None

    trio.run(main)


def test_by_tls(certificate: tuple[Path, Path]) -> None:
    async def main() -> None:
        door = await bind_web_door(port=0, certificate=certificate)
        context = ssl.create_default_context(cadata=CERTIFICATE)
        async with served(door):
            assert door.url.startswith("https://127.0.0.1:")
            assert (await asked(door, get("/api/v1/state", door), context)).startswith(b"HTTP/1.1 200")
            entered = await asked(door, get(f"/?token={door.token}", door), context)
            assert b"; Secure" in entered
            assert b"HTTP/1.1 2" not in await asked(door, get("/api/v1/state", door))  # without TLS

    trio.run(main)


def test_a_door_that_fails_never_takes_the_master_with_it() -> None:
    async def main() -> None:
        door = await bind_web_door(port=0)
        async with served(door) as service:
            await trio.sleep(0.1)

            def broken() -> object:
                raise ZeroDivisionError("a bug of the door")

            service.nets = property(broken)  # type: ignore[assignment] # what the door's own task looks at
            with trio.fail_after(30):
                while door.failure is None:
                    await trio.sleep(0.05)
            assert isinstance(door.failure, TypeError)
            assert await service.master.node(3).read("device_type") == 0x20192

    trio.run(main)


def test_doors_that_cannot_be_opened() -> None:
    async def main() -> None:
        for options in ({"host": "192.0.2.1"}, {"host": "0.0.0.0"}, {"token": "a token with blanks"}, {"host": "no such host"}):
            with pytest.raises(DoorError):
                await bind_web_door(port=0, **options)

    trio.run(main)


@pytest.mark.parametrize(("library", "extra", "command"), [("starlette", "web", "web"), ("mcp", "mcp", "mcp")])
def test_without_its_extra_it_says_which(library: str, extra: str, command: str) -> None:
    start = f"import sys; sys.path[:0] = {[each for each in sys.path if each]!r}; sys.modules[{library!r}] = None"
    start += "; from canopen_cli.entry import main; sys.exit(main())"
    ended = subprocess.run([sys.executable, "-c", start, "serve", command, "-b", "demo"], capture_output=True, text=True)
    assert ended.returncode == ExitCode.CANNOT_OPEN
    assert f"pip install 'canopen-proto[{extra}]'" in ended.stderr


@pytest.mark.parametrize("for_whom", ["5=", ""], ids=["of one node", "of all nodes"])
def test_a_door_knows_the_nodes_by_their_own_files(for_whom: str) -> None:
    async def known() -> list[bool]:
        settings = Settings(bus=LOCATOR, eds=(f"{for_whom}sample_io.eds",))
        screen = settings.screen()
        async with open_service(settings, screen, allow=()) as service:
            (net,) = service.nets
            return [service.node(net, each).dictionary.get(0x6401, 1) is not None for each in (5, 6)]

    assert trio.run(known) == [True, not for_whom]
