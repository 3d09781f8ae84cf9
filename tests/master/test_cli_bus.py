"""`canopen bus serve`, and two other terminals on it: real processes' worth of sockets, in threads of this one."""

from __future__ import annotations

import os
import signal
import socket
import threading
from pathlib import Path

import pytest
import trio

from canopen_master.cli import main
from tests.master.cli_support import Run, runner


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner(capsys, monkeypatch, tmp_path)


def test_what_it_says(run: Run) -> None:
    outcome = run("bus", "serve", "--port", "0", "--seconds", "1")
    assert outcome.status == 0
    assert "a bus on tcp:127.0.0.1:" in outcome.err
    assert "canopen scan -b tcp:127.0.0.1:" in outcome.err


def test_ctrl_c_is_how_it_ends(run: Run) -> None:
    timer = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    outcome = run("bus", "serve", "--port", "0")
    timer.join()
    assert outcome.status == 0
    assert outcome.err.endswith("ended\n")


def test_the_network_needs_a_word(run: Run) -> None:
    outcome = run("bus", "serve", "--bind", "0.0.0.0", "--port", "0")
    assert outcome.status == 2
    assert "can move its drives" in outcome.err
    assert "the same with --yes" in outcome.err
    outcome = run("bus", "serve", "--bind", "0.0.0.0", "--port", "0", "--yes", "--seconds", "0")
    assert outcome.status == 0
    assert "no password guards this bus" in outcome.err


def test_a_port_that_is_taken(run: Run) -> None:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        sock.listen()
        outcome = run("bus", "serve", "--port", str(sock.getsockname()[1]))
    assert outcome.status == 3
    assert "error CO101: cannot serve a bus on tcp:127.0.0.1:" in outcome.err
    assert "try:   -b tcp:" in outcome.err


def test_nobody_serves(run: Run) -> None:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        port = sock.getsockname()[1]
    outcome = run("scan", "-b", f"tcp:127.0.0.1:{port}")
    assert outcome.status == 3
    assert f"canopen bus serve --port {port}    (in another terminal)" in outcome.err


def test_two_terminals(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from canopen_master.cli.fleet import simulated_fleet
    from canopen_transports.tcp import BusServer, serve_bus

    monkeypatch.setenv("CANOPEN_DATA", str(tmp_path))
    ready = threading.Event()
    over: list[trio.lowlevel.TrioToken | trio.CancelScope | str] = []

    async def other_terminals() -> None:
        async with trio.open_nursery() as nursery:
            (locator,) = await nursery.start(serve_bus, "127.0.0.1", 0, BusServer())
            async with simulated_fleet([(locator, 3), (locator, 4)]):
                over.extend((locator, trio.lowlevel.current_trio_token(), nursery.cancel_scope))
                ready.set()
                await trio.sleep_forever()

    thread = threading.Thread(target=trio.run, args=(other_terminals,))
    thread.start()
    try:
        assert ready.wait(10)
        locator, token, scope = over
        assert isinstance(locator, str)
        status = main(("read", "3", "statusword", "-b", locator))
        assert status == 0
        assert "statusword" in capsys.readouterr().out
    finally:
        assert isinstance(token, trio.lowlevel.TrioToken)
        assert isinstance(scope, trio.CancelScope)
        token.run_sync_soon(scope.cancel)
        thread.join()
