"""`canopen serve zenoh` and `canopen fleet`."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_cli.app import main
from canopen_cli.shared.problem import ExitCode
from canopen_gateway import open_gateway, parse_permissions
from canopen_gateway.fleet import bind_fleet_door, bridge
from canopen_gateway.fleet.joining import open_zenoh
from canopen_master import open_master
from canopen_master.simulation.serving import simulated_drives
from tests.cli.cli_support import Outcome, Run, runner
from tests.cli.command_examples import SCHEMAS, strict
from tests.gateway.fleet_world import free_endpoint

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

LOCATOR = "virtual:in-a-fleet"
BUS = "hall/virtual-in-a-fleet"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Commands in real time: what they talk to is in another thread, or in threads of Zenoh."""
    runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))

    def run(*arguments: str) -> Outcome:
        capsys.readouterr()
        status = main(arguments)
        written = capsys.readouterr()
        return Outcome(status, written.out, written.err)

    return run


@pytest.fixture(scope="module")
def joined() -> Iterator[str]:
    """The endpoint of a bridge in a thread of its own, with drives 3 and 4 behind it."""
    started = threading.Event()
    found: dict[str, Any] = {}
    endpoint = free_endpoint()

    async def serve() -> None:
        found["token"], found["over"] = trio.lowlevel.current_trio_token(), trio.Event()
        door = await bind_fleet_door("hall", listen=[endpoint])
        async with (
            door,
            simulated_drives((LOCATOR, node_id) for node_id in (3, 4)),
            open_master(LOCATOR) as master,
            open_gateway(master, allow=parse_permissions("write")) as service,
            trio.open_nursery() as nursery,
        ):
            nursery.start_soon(door.serve, service)
            while len(door.alive) < 2:
                await trio.sleep(0.01)
            started.set()
            await found["over"].wait()
            nursery.cancel_scope.cancel()

    thread = threading.Thread(target=trio.run, args=(serve,))
    thread.start()
    assert started.wait(60)
    yield endpoint
    found["token"].run_sync_soon(found["over"].set)
    thread.join(60)
    assert not thread.is_alive()


def fits(command: str, text: str) -> Any:
    """What a command has answered as JSON, which fits its schema."""
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed: the extra `test` has it")
    document = json.loads(text)
    jsonschema.validate(document, strict(json.loads(SCHEMAS.read_text(encoding="utf-8"))["commands"][command]))
    return document


def test_ls_lists_buses_and_nodes(run: Run, joined: str) -> None:
    status, out, err = run("fleet", "ls", "--connect", joined)
    assert status == ExitCode.OK
    assert [line.split()[0] for line in out.splitlines()[2:]] == [BUS, f"{BUS}/3", f"{BUS}/4"]
    assert "1 bus, 2 nodes" in err
    status, out, _ = run("fleet", "ls", "--connect", joined, "--json")
    (bus,) = fits("fleet ls", out)
    assert (bus["place"], list(bus["nodes"]), bus["allow"]) == (BUS, ["3", "4"], ["write"])


def test_read_reads_many_nodes_and_one(run: Run, joined: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CANOPEN_FLEET", joined)
    status, out, _ = run("fleet", "read", "*/*/*", "statusword", "1008", "--json")
    assert status == ExitCode.OK
    assert [(each["place"], each["value"]) for each in fits("fleet read", out)] == [
        (f"{BUS}/{node_id}", value) for node_id in (3, 4) for value in (0x0240, "Simulated Schunk Powerball joint")
    ]
    status, out, _ = run("fleet", "read", f"{BUS}/4", "6041:00")
    assert (status, "576" in out) == (ExitCode.OK, True)


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (("read", f"{BUS}/3", "no_such_object"), ExitCode.SDO_ABORT, "not in the dictionary"),
        (("read", f"{BUS}/3", "2FFF"), ExitCode.SDO_ABORT, "0x06020000"),
        (("read", f"{BUS}/9", "1001"), ExitCode.NO_ANSWER, "did not answer"),
        (("read", "other/bus/9", "1001"), ExitCode.CANNOT_OPEN, "nobody answers for other/bus/9"),
        (("read", "other/*/*", "1001"), ExitCode.CANNOT_OPEN, "no node of the fleet is other/*/*"),
        (("read", "hall", "1001"), ExitCode.USAGE, "SITE/BUS/NODE"),
        (("halt", "other/bus"), ExitCode.CANNOT_OPEN, "nobody at other/bus answered the halt"),
        (("ls", "--connect", "here"), ExitCode.USAGE, "PROTOCOL/HOST:PORT"),
        (("ls", "--zenoh", "none.json5"), ExitCode.CANNOT_OPEN, "no such file"),
    ],
)
def test_what_cannot_be_is_told_with_its_status(
    run: Run, joined: str, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], status: ExitCode, told: str
) -> None:
    monkeypatch.setenv("CANOPEN_FLEET", joined)
    found, _, err = run("fleet", *words)
    assert (found, told in err) == (status, True), err


def test_halt_halts(run: Run, joined: str) -> None:
    status, out, _ = run("fleet", "halt", "--connect", joined)
    assert (status, out) == (ExitCode.OK, f"{BUS}: nothing moves\n")
    status, out, _ = run("fleet", "halt", "--connect", joined, "--json")
    assert fits("fleet halt", out) == [{"place": BUS, "problems": []}]


def test_watch_tells_what_happens(run: Run, joined: str) -> None:
    status, out, err = run("fleet", "watch", "--connect", joined, "--seconds", "0.2", "--json")
    assert (status, out) == (ExitCode.OK, "")
    assert "1 bus, 2 nodes" in err


def test_a_fleet_is_recorded_and_asked(run: Run, joined: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("duckdb", reason="the extra history is not installed")
    folder = str(tmp_path / "history")
    words = ("--read", "statusword", "--read", "1008", "--every", "50ms", "--for", "0.5s")
    status, out, err = run("fleet", "record", folder, "hall/*/3", "--connect", joined, *words, "--json")
    assert (status, "a kill loses 60 s at most" in err) == (ExitCode.OK, True)
    assert fits("fleet record", out)["rows"] > 4
    status, out, _ = run("fleet", "query", folder, "--json")
    (node,) = fits("fleet query", out)["rows"]
    assert node[:3] == [f"{BUS}/3", node[1], 2]
    (tmp_path / "history" / "notes").write_text("x")
    status, out, err = run("fleet", "query", folder, "hall/3:statusword", "--since", "1h ago", "--limit", "1")
    assert (status, "576" in out, "there are more" in err, "left alone" in err) == (ExitCode.OK, True, True, True)
    status, out, _ = run(
        "fleet", "query", folder, f"{BUS}/3:1008:00", "hall/9:statusword", "--since", "1h", "--csv", "--limit", "1"
    )
    assert out.splitlines()[0] == "time,place,object,name,value,unit,raw,problem"
    assert f"{BUS}/3,1008:00,manufacturer_device_name,Simulated Schunk Powerball joint,," in out
    for view in ("gaps", "runs", "states", "emergencies"):
        assert run("fleet", "query", folder, "--sql", view, "--json").status == ExitCode.OK
    for sql in (f"SELECT * FROM read_text('{tmp_path}/history/notes')", "SELECT", "COPY samples TO 'x'"):
        status, _, err = run("fleet", "query", folder, "--sql", sql)
        assert (status, "CO164" in err) == (ExitCode.USAGE, True)
    for wrong in (("--since", "soon"), ("hall",), ("hall/3:",), ("--sql", "SELECT 1", "hall/3:x"), ("--csv", "--json")):
        assert run("fleet", "query", folder, *wrong).status == ExitCode.USAGE
    part = next((tmp_path / "history" / "hall").rglob("*.parquet"))
    part.write_bytes(part.read_bytes()[:-10])
    status, _, err = run("fleet", "query", folder)
    assert (status, "CO163" in err, part.name in err.replace("\n", "")) == (ExitCode.BAD_FILE, True, True)
    for module, extra in (("duckdb", "history"), ("pyarrow", "parquet")):
        with monkeypatch.context() as without:
            without.setitem(sys.modules, module, None)
            status, _, err = run("fleet", "query", folder)
            assert (status, f"canopen-proto[{extra}]" in err) == (ExitCode.USAGE, True)


def test_a_folder_that_cannot_be_written_is_told_at_once(run: Run, joined: str, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("x")
    status, _, err = run("fleet", "record", str(tmp_path / "taken" / "history"), "--connect", joined, "--for", "5s")
    assert (status, "taken" in err) == (ExitCode.BAD_FILE, True), err


@pytest.mark.thorough
def test_nobody_there_is_told_with_the_next_step(run: Run) -> None:
    endpoint = free_endpoint()
    status, _, err = run("fleet", "ls", "--connect", endpoint)
    assert status == ExitCode.CANNOT_OPEN
    assert "canopen serve zenoh" in err


def test_serve_says_where_it_is_and_ends(run: Run) -> None:
    endpoint = free_endpoint()
    status, out, _ = run("serve", "zenoh", "--site", "hall", "-b", "demo", "--listen", endpoint, "--seconds", "0.1", "--json")
    assert status == ExitCode.OK
    assert json.loads(out) == {"site": "hall", "buses": ["virtual-demo"], "listen": [endpoint], "connect": [], "allow": []}


def test_a_site_that_another_bridge_has_is_refused_in_words_unless_it_is_said_to_be_a_twin(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bridge, "TWIN_WAIT", 0.3)
    endpoint = free_endpoint()
    other = trio.run(partial(open_zenoh, listen=[endpoint], mode="router"))
    token = other.liveliness().declare_token("canopen/v1/hall/virtual-demo/alive")
    words = ("serve", "zenoh", "--site", "hall", "-b", "demo", "--connect", endpoint, "--seconds")
    status, _, err = run(*words, "20")
    assert status == ExitCode.CANNOT_OPEN
    for told in ("canopen/v1/hall/virtual-demo/alive", "--site", "--twin"):
        assert told in err
    assert "is in the fleet" not in err
    status, _, err = run(*words, "0.5", "--twin")
    assert (status, "hall is in the fleet" in err) == (ExitCode.OK, True)
    token.undeclare()  # type: ignore[no-untyped-call]
    assert run(*words, "0.5").status == ExitCode.OK
    other.close()  # type: ignore[no-untyped-call]


def test_a_router_says_where_it_is_and_ends(run: Run) -> None:
    endpoint = free_endpoint()
    status, out, _ = run("fleet", "router", "--listen", endpoint, "--seconds", "0", "--json")
    assert (status, json.loads(out)) == (ExitCode.OK, {"listen": [endpoint]})


@pytest.mark.parametrize("words", [("serve", "zenoh", "--site", "hall", "-b", "demo"), ("fleet", "router")])
def test_other_computers_stay_out_and_a_port_in_use_is_told(run: Run, joined: str, words: tuple[str, ...]) -> None:
    status, _, err = run(*words, "--listen", "tcp/0.0.0.0:7447")
    assert (status, "reachable from other computers" in err) == (ExitCode.CANNOT_OPEN, True)
    status, _, err = run(*words, "--listen", joined)
    assert (status, "cannot listen" in err) == (ExitCode.CANNOT_OPEN, True)


def test_without_its_extra_a_fleet_says_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    status, _, err = run("fleet", "ls")
    assert (status, "canopen-proto[fleet]" in err) == (ExitCode.USAGE, True)


def test_a_page_over_a_fleet_says_where_it_is_and_begins_where_nobody_is(run: Run, tmp_path: Path, joined: str) -> None:
    outcome = run("fleet", "web", "--connect", joined, "--port", "0", "--seconds", "0.1")
    assert outcome.status == 0
    assert "open http://127.0.0.1:" in outcome.err
    assert "read-only, as far as each bridge allows it" in outcome.err
    token = tmp_path / "token"
    token.write_text("chosen-by-somebody\n")
    nobody = ("fleet", "web", "--connect", "tcp/127.0.0.1:9", "--port", "0", "--seconds", "0.1", "--json")
    told = fits("fleet web", run(*nobody, "--allow", "nmt,write", "--token-file", str(token)).out)
    assert told["url"].endswith("/?token=chosen-by-somebody")
    assert (told["connect"], told["allow"]) == (["tcp/127.0.0.1:9"], ["nmt", "write"])
    for never in ("motion", "write,lss"):
        refused = run(*nobody, "--allow", never)
        assert refused.status == ExitCode.USAGE
        assert "not over a fleet" in refused.out + refused.err
    assert run("fleet", "web", "--bind", "0.0.0.0", "--port", "0", "--seconds", "0").status == ExitCode.CANNOT_OPEN
