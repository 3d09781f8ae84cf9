"""`canopen bus serve`, and two other terminals on it: real processes' worth of sockets, in threads of this one."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from pathlib import Path

import pytest
import trio

from canopen_cli.app import main
from canopen_master.simulation.serving import simulated_drives
from canopen_transports.log_files import LogReader
from canopen_transports.tcp import BusServer, serve_bus
from tests.cli.cli_support import Outcome, Run, runner


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner(capsys, monkeypatch, tmp_path)


@pytest.fixture
def run_in_real_time(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """As `run`, where sockets are waited for: virtual time would not."""
    runner(capsys, monkeypatch, tmp_path)  # for its environment

    def run(*arguments: str) -> Outcome:
        status = main(arguments)
        written = capsys.readouterr()
        return Outcome(status, written.out, written.err)

    return run


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        port: int = sock.getsockname()[1]
    return port


def joined(port: int) -> socket.socket:
    """A member of the bus at this port, as soon as it is there."""
    for _ in range(1000):
        try:
            sock = socket.create_connection(("127.0.0.1", port), timeout=10)
        except ConnectionRefusedError:
            time.sleep(0.01)
        else:
            sock.sendall(b"canopen-bus 1\n")
            assert sock.recv(100) == b"canopen-bus 1\n"
            return sock
    raise AssertionError("no bus server comes")


def test_what_it_says(run: Run) -> None:
    outcome = run("bus", "serve", "--port", "0", "--seconds", "1")
    assert outcome.status == 0
    assert "a bus on tcp:127.0.0.1:" in outcome.err
    assert "canopen scan -b tcp:127.0.0.1:" in outcome.err


def test_its_address_for_programs(run: Run) -> None:
    (address,) = run("bus", "serve", "--port", "0", "--seconds", "0", "--json").json["bus"]
    assert address.startswith("tcp:127.0.0.1:")


def test_it_tells_who_comes_and_goes_records_what_is_said_and_ends_with_ctrl_c(
    run_in_real_time: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    port = free_port()

    def guests() -> None:
        with joined(port) as one, joined(port) as other:
            one.sendall(b"605#4041600000000000\n")
            assert other.recv(100) == b"605#4041600000000000\n"
            os.kill(os.getpid(), signal.SIGINT)
            assert other.recv(100) == b"bye the bus server was ended\n"

    thread = threading.Thread(target=guests)
    thread.start()
    outcome = run_in_real_time("bus", "serve", "--port", str(port), "--trace", "t.log")
    thread.join()
    assert outcome.status == 0
    assert "joined: 2 on the bus" in outcome.err
    assert "left, cut off: the bus server was ended" in outcome.err
    assert outcome.err.endswith("ended\n")
    assert [(record.channel, str(record.frame)) for record in LogReader(Path("t.log"))] == [("tcp0", "605#4041600000000000")]
    monkeypatch.setenv("CANOPEN_BUS", "file:t.log")
    assert run_in_real_time("bus", "serve", "--port", "0", "--seconds", "0", "--trace", "t.log").status == 2


def test_a_program_whose_bus_ends_says_what_to_do(run_in_real_time: Run) -> None:
    port = free_port()
    spoken, ready = trio.Event(), threading.Event()

    async def serve_until_somebody_speaks() -> None:
        async with trio.open_nursery() as nursery:
            await nursery.start(serve_bus, "127.0.0.1", port, BusServer(on_frame=lambda frame: spoken.set()))
            ready.set()
            await spoken.wait()
            nursery.cancel_scope.cancel()

    thread = threading.Thread(target=trio.run, args=(serve_until_somebody_speaks,))
    thread.start()
    assert ready.wait(10)
    outcome = run_in_real_time("sim", "--id", "3", "-b", f"tcp:127.0.0.1:{port}")
    thread.join()
    assert outcome.status == 4
    assert f"error CO111: cannot receive on tcp:127.0.0.1:{port}" in outcome.err
    assert "seen:  the bus server says: the bus server was ended" in outcome.err
    assert f"try:   canopen bus serve --port {port} " in outcome.err
    assert "or:    start this program again once it runs" in outcome.err


def test_where_others_join_a_bus_that_is_open_to_all(run: Run) -> None:
    outcome = run("bus", "serve", "--bind", "0.0.0.0", "--port", "0", "--yes", "--seconds", "0")
    assert "a bus on tcp:0.0.0.0:" in outcome.err
    assert "canopen scan -b tcp:127.0.0.1:" in outcome.err
    assert f"from other computers: -b tcp:{socket.gethostname()}:" in outcome.err


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


def test_nobody_serves(run_in_real_time: Run) -> None:
    port = free_port()
    outcome = run_in_real_time("scan", "-b", f"tcp:127.0.0.1:{port}")
    assert outcome.status == 3
    assert f"canopen bus serve --port {port}    (in another terminal)" in outcome.err


def test_two_terminals(run_in_real_time: Run) -> None:
    ready = threading.Event()
    over: list[trio.lowlevel.TrioToken | trio.CancelScope | str] = []

    async def other_terminals() -> None:
        async with trio.open_nursery() as nursery:
            (locator,) = await nursery.start(serve_bus, "127.0.0.1", 0, BusServer())
            async with simulated_drives([(locator, 3), (locator, 4)]):
                over.extend((locator, trio.lowlevel.current_trio_token(), nursery.cancel_scope))
                ready.set()
                await trio.sleep_forever()

    thread = threading.Thread(target=trio.run, args=(other_terminals,))
    thread.start()
    try:
        assert ready.wait(10)
        locator, token, scope = over
        assert isinstance(locator, str)
        outcome = run_in_real_time("read", "3", "statusword", "-b", locator, "--timeout", "20s")
        assert outcome.status == 0
        assert "statusword" in outcome.out
    finally:
        assert isinstance(token, trio.lowlevel.TrioToken)
        assert isinstance(scope, trio.CancelScope)
        token.run_sync_soon(scope.cancel)
        thread.join()
