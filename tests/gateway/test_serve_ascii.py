"""`canopen serve ascii`, and the commands that go over a text gateway: `-b gw:HOST:PORT`."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_cli.shared.problem import ExitCode
from canopen_gateway import open_gateway, parse_permissions
from canopen_gateway.ascii import bind_ascii_door
from canopen_master import open_master
from canopen_master.simulation.serving import simulated_drives
from tests.cli.cli_support import Run, runner

LOCATOR = "virtual:behind a gateway"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))


@pytest.fixture
def bus() -> Iterator[str]:
    """The locator of a text gateway in a thread of its own, with drives 3 and 4 behind it."""
    started = threading.Event()
    found: dict[str, Any] = {}

    async def serve() -> None:
        found["token"], found["over"] = trio.lowlevel.current_trio_token(), trio.Event()
        door = await bind_ascii_door(tcp=("127.0.0.1", 0))
        async with (
            door,
            simulated_drives((LOCATOR, node_id) for node_id in (3, 4)),
            open_master(LOCATOR) as master,
            open_gateway(master, allow=parse_permissions("write,nmt")) as service,
            trio.open_nursery() as nursery,
        ):
            nursery.start_soon(door.serve, service)
            found["address"] = door.addresses[0]
            started.set()
            await found["over"].wait()
            nursery.cancel_scope.cancel()

    thread = threading.Thread(target=trio.run, args=(serve,))
    thread.start()
    assert started.wait(30)
    yield f"gw:{found['address']}"
    found["token"].run_sync_soon(found["over"].set)
    thread.join(30)
    assert not thread.is_alive()


@pytest.fixture
def run_for_real(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> Run:
    """Commands in real time: the gateway is in another thread."""
    from canopen_cli.app import main
    from tests.cli.cli_support import Outcome

    runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))

    def run(*arguments: str) -> Outcome:
        capsys.readouterr()
        status = main(arguments)
        written = capsys.readouterr()
        return Outcome(status, written.out, written.err)

    return run


def test_it_says_where_it_listens_and_what_it_allows(run: Run, tmp_path: Path) -> None:
    outcome = run("serve", "ascii", "-b", "demo", "--port", "0", "--seconds", "1")
    assert outcome.status == 0
    assert "a text gateway (CiA 309-3) at 127.0.0.1:" in outcome.err
    assert "read-only" in outcome.err
    assert "net 1 is virtual:demo" in outcome.err
    path = tmp_path / "gw"
    told = run("serve", "ascii", "-b", "demo", "--unix", str(path), "--allow", "nmt,write", "--seconds", "0", "--json").json
    assert told == {"doors": [str(path)], "nets": ["virtual:demo"], "allow": ["nmt", "write"]}
    assert not path.exists()


def test_all_buses_of_a_machine_are_its_nets(run: Run, tmp_path: Path) -> None:
    machine = tmp_path / "cell.toml"
    machine.write_text(
        '[buses.front]\nlocator = "can0"\n[buses.rear]\nlocator = "can1"\n'
        '[nodes.one]\nbus = "front"\nid = 3\n[nodes.two]\nbus = "rear"\nid = 4\n'
        '[joints.a]\nnode = "one"\n[joints.b]\nnode = "two"\n[chains.arm]\njoints = ["a", "b"]\n'
    )
    told = run("serve", "ascii", "-m", str(machine), "-b", "demo", "--port", "0", "--seconds", "0", "--json").json
    assert told["nets"] == ["front", "rear"]
    refused = run("serve", "ascii", "-m", str(machine), "-b", "can5", "--port", "0", "--seconds", "0")
    assert refused.status == ExitCode.USAGE
    assert "has the buses front, rear" in refused.err


def test_a_port_in_use_is_told_before_anything_is_opened(run: Run) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        outcome = run("serve", "ascii", "-b", "socketcan:nowhere", "--port", str(taken.getsockname()[1]))
    assert outcome.status == ExitCode.CANNOT_OPEN
    assert "error CO155: cannot listen at 127.0.0.1 port" in outcome.err


def test_other_computers_are_kept_out_without_a_word(run: Run) -> None:
    outcome = run("serve", "ascii", "-b", "demo", "--bind", "0.0.0.0", "--seconds", "0")
    assert outcome.status == ExitCode.CANNOT_OPEN
    assert "--reachable" in outcome.err
    assert run("serve", "ascii", "-b", "demo", "--bind", "0.0.0.0", "--port", "0", "--reachable", "--seconds", "0").status == 0
    assert run("serve", "ascii", "-b", "demo", "--allow", "all", "--seconds", "0").status == ExitCode.USAGE


def test_reading_writing_commanding_and_scanning_over_it(bus: str, run_for_real: Run) -> None:
    run = run_for_real
    read = run("read", "3", "1008", "statusword", "--json", "-b", bus).json
    assert [each["value"] for each in read] == ["Simulated Schunk Powerball joint", 576]
    assert read[1]["constants"] == ["switch_on_disabled", "remote"]
    written = run("write", "3", "1017", "300", "--verify", "-b", bus)
    assert written.status == 0
    assert "500 (0x01F4) → 300 (0x012C)" in written.out
    assert run("nmt", "start", "3", "-b", bus).status == 0
    assert run("nmt", "start", "--all", "--yes", "-b", bus).status == 0
    rows = run("scan", "--ids", "2-5", "--json", "--timeout", "50ms", "-b", bus).json
    assert [(row["node"], row["vendor_id"], row["serial_number"], row["state"]) for row in rows] == [
        (3, 0x332, 1, None),
        (4, 0x332, 2, None),
    ]
    assert run("scan", "--ids", "9", "--timeout", "20ms", "-b", bus).status == ExitCode.NO_ANSWER


def test_what_is_refused_and_what_is_silent_over_it(bus: str, run_for_real: Run) -> None:
    run = run_for_real
    refused = run("read", "3", "2FFF", "--type", "u8", "--json", "-b", bus)
    assert (refused.status, refused.error["code"], refused.error["abort"]) == (ExitCode.SDO_ABORT, "CO154", 0x06020000)
    assert (refused.error["node"], refused.error["index"], refused.error["sub"]) == (3, 0x2FFF, 0)
    silent = run("read", "9", "1000", "--timeout", "50ms", "-b", bus)
    assert silent.status == ExitCode.NO_ANSWER
    forbidden = run("write", "3", "controlword", "6", "-b", bus)
    assert forbidden.status == ExitCode.SDO_ABORT
    assert "without --allow motion" in forbidden.err
    too_much = run("write", "3", "1017", "70000", "-b", bus)  # refused here, before anything is sent
    assert (too_much.status, "CO304" in too_much.err) == (ExitCode.USAGE, True)


@pytest.mark.parametrize(
    "command",
    [
        ("info", "3"),
        ("monitor",),
        ("watch", "3", "statusword"),
        ("backup", "3", "-o", "x.dcf"),
        ("lss", "scan"),
        ("drive", "3", "state"),
        ("sim", "--id", "5"),
        ("serve", "ascii", "--port", "0"),
    ],
)
def test_every_other_command_says_that_it_needs_a_bus(
    command: tuple[str, ...], run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = run(*command, "-b", "gw:localhost:1")
    assert outcome.status == ExitCode.USAGE, outcome
    assert "error CO156: gw:localhost:1 is a text gateway, which carries no frames" in outcome.err
    assert "read, write, nmt, scan" in outcome.err


@pytest.mark.parametrize(
    "command",
    [
        ("read", "3", "1008", "-o", "x.bin"),
        ("read", "3", "1008", "--block"),
        ("write", "3", "1008", "--file", "x.bin"),
        ("nmt", "start", "3", "--wait"),
        ("scan", "--passive"),
    ],
)
def test_options_that_need_a_bus(command: tuple[str, ...], run: Run) -> None:
    outcome = run(*command, "-b", "gw:localhost:1")
    assert outcome.status == ExitCode.USAGE, outcome
    assert "does not work over gw:localhost:1" in outcome.err


def test_nobody_there_and_no_address(run: Run) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    outcome = run("read", "3", "1000", "-b", f"gw:127.0.0.1:{port}")
    assert outcome.status == ExitCode.CANNOT_OPEN
    assert "error CO153: there is no text gateway at 127.0.0.1 port" in outcome.err
    assert "no address of a text gateway" in run("read", "3", "1000", "-b", "gw:a:b").err


def test_a_master_cannot_stand_on_it() -> None:
    from canopen_master import BusError

    async def opened() -> None:
        async with open_master("gw:localhost:60000"):
            pass

    with pytest.raises(BusError, match="a text gateway carries no frames"):
        trio.run(opened)
