"""docs/from-canopen.md: each row runs with canopen 2.4.1 and with our master, on the same devices, on one bus of python-can.

In real time, because `canopen` has threads; nothing depends on when something comes.
"""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import canopen
import pytest
import trio
from canopen.profiles.p402 import BaseNode402

import canopen_data
from canopen_data.configured import configure
from canopen_data.descriptions import load_description
from canopen_master import DeviceModel, open_master, simulate
from canopen_master.simulation.serving import drive_maker
from canopen_proto.multiplexer import mux
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_transports import open_transport
from tests.docs_build import DOCS
from tests.interop.driver import LIMIT
from tests.interop.peer import new_channel

SAMPLES = Path(str(canopen_data.__file__)).parent / "samples"
NOTHING = "nothing was set"
INPUT = 0xA5
"""What the I/O device reads at its inputs."""


class Row(NamedTuple):
    """A row of the page. Code that is "" is a sentence in the page."""

    task: str
    theirs: str
    ours: str


def code_of(cell: str) -> str:
    """The lines of a cell that is nothing but code, else ""."""
    rest = re.sub(r"`[^`]+`|<br>", "", cell)
    return "" if rest.strip() else "\n".join(re.findall(r"`([^`]+)`", cell))


def rows(text: str) -> list[Row]:
    """The rows of a part of the page in order, the imports first."""
    found = []
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if line.startswith("| `import"):
            found.append(Row("imports", code_of(cells[0]), code_of(cells[1])))
        elif line.startswith("| ") and not line.startswith(("| task ", "| `canopen`")):
            task, theirs, ours = cells
            found.append(Row(task, code_of(theirs), code_of(ours)))
    return found


ASYNC_PART, _, BLOCKING_PART = (DOCS / "from-canopen.md").read_text(encoding="utf-8").partition("\n## Without async\n")
ROWS, BLOCKING = rows(ASYNC_PART), rows(BLOCKING_PART)


class Served:
    """The devices of the page on a channel, in a thread of their own: an I/O device 5, a drive 6, two without a node-ID."""

    def __init__(self, channel: str) -> None:
        self.locator = f"pythoncan:virtual:{channel}"
        self._stop: tuple[trio.lowlevel.TrioToken, trio.CancelScope] | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=trio.run, args=(self._serve,), name="devices")

    @contextmanager
    def running(self) -> Iterator[None]:
        self._thread.start()
        assert self._ready.wait(LIMIT)
        try:
            yield
        finally:
            assert self._stop is not None
            token, scope = self._stop
            token.run_sync_soon(scope.cancel)
            self._thread.join(LIMIT)
            assert not self._thread.is_alive()

    async def _serve(self) -> None:
        devices = [
            DeviceModel(configure(load_description("sample_io.eds").dictionary, {mux(0x6000, 1): INPUT}, 5), 5),
            DeviceModel(load_description("sample_drive.eds").dictionary, 6, DriveSettings(position=0)),
            *(drive_maker(number, 255) for number in range(2)),
        ]
        async with trio.open_nursery() as nursery:
            host = await nursery.start(simulate, await open_transport(self.locator), devices)
            self._stop = trio.lowlevel.current_trio_token(), nursery.cancel_scope
            self._ready.set()
            station = host.nodes[0]
            while True:  # its input changes and it has errors, all the time
                station.set_value(0x6000, 1, INPUT, host.now())
                station.raise_error(0x8110, 0, b"", host.now())
                station.clear_error(0x8110, host.now())
                host.pump()
                await trio.sleep(0.05)


def run_theirs(channel: str, rows: Sequence[Row] = ROWS) -> list[Any]:
    """Run the left cells; return the `value` of each row."""
    return run_cells([(row.task, row.theirs) for row in rows], channel)


def run_blocking(channel: str) -> list[Any]:
    """Run the right cells of the part without async; return the `value` of each row."""
    return run_cells([(row.task, row.ours) for row in BLOCKING], channel)


def run_cells(cells: Sequence[tuple[str, str]], channel: str) -> list[Any]:
    scope: dict[str, Any] = {}
    values = []
    for task, cell in cells:
        code = cell.replace('"socketcan:can0"', repr(f"pythoncan:virtual:{channel}"))
        code = code.replace('interface="socketcan", channel="can0"', f'interface="virtual", channel="{channel}"')
        code = re.sub(r'"(sample_\w+\.eds)"', lambda found: repr(str(SAMPLES / found[1])), code)
        scope["value"] = NOTHING
        try:
            exec(compile(code, task, "exec"), scope)
        except Exception as error:
            error.add_note(f"{task}: {code}")
            raise
        values.append(scope["value"])
    return values


async def run_ours(locator: str) -> list[Any]:
    """Run the right cells; return the `value` of each row."""
    values = []
    async with trio.open_nursery() as nursery, open_master(locator) as master:
        scope: dict[str, Any] = {"master": master, "nursery": nursery}
        for row in ROWS:
            code = row.ours.replace('"socketcan:can0"', repr(locator))
            scope["value"] = NOTHING
            if "async with" in code:  # opens a master of its own
                scope["master"] = None
            try:
                waits = eval(compile(code, row.task, "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT), scope)
                if inspect.iscoroutine(waits):
                    await waits
            except Exception as error:
                error.add_note(f"{row.task}: {code}")
                raise
            scope["master"] = master
            values.append(scope["value"])
        nursery.cancel_scope.cancel()
    return values


def until_all_answered(lss: Any) -> float:
    """How long the peer waits for an LSS answer: none comes any more once the I/O device has answered a later request.

    All devices are of one host, which answers in order, and so does the peer's thread hear. A time would be too short under load.
    """
    answered = threading.Event()

    def hear(*_: object) -> None:
        answered.set()

    lss.network.subscribe(0x585, hear)
    try:
        lss.network.send_message(0x605, bytes.fromhex("4000100000000000"))
        assert answered.wait(LIMIT)
    finally:
        lss.network.unsubscribe(0x585, hear)
    return 0.0


@pytest.fixture(scope="module")
def values(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Any], list[Any]]:
    """What each row found, with `canopen` and here."""
    channel = new_channel()
    served = Served(channel)
    with pytest.MonkeyPatch.context() as patch, served.running():
        patch.chdir(tmp_path_factory.mktemp("files"))
        patch.setattr(canopen, "BaseNode402", PatientNode402, raising=False)
        patch.setattr(canopen.lss.LssMaster, "RESPONSE_TIMEOUT", property(until_all_answered))
        theirs = run_theirs(channel)
        ours = trio.run(functools.partial(run_ours, served.locator))
    return theirs, ours


@pytest.fixture(scope="module")
def values_without_async() -> tuple[list[Any], list[Any]]:
    """The same of the part without async, each with devices of its own."""
    found = []
    runs: tuple[Callable[[str], list[Any]], ...] = (lambda channel: run_theirs(channel, BLOCKING), run_blocking)
    for run in runs:
        channel = new_channel()
        with pytest.MonkeyPatch.context() as patch, Served(channel).running():
            patch.setattr(canopen, "BaseNode402", PatientNode402, raising=False)
            found.append(run(channel))
    return found[0], found[1]


class PatientNode402(BaseNode402):
    """With time enough for a machine under load."""

    TIMEOUT_SWITCH_OP_MODE = TIMEOUT_SWITCH_STATE_FINAL = TIMEOUT_SWITCH_STATE_SINGLE = 20


@pytest.mark.parametrize("number", range(len(ROWS)), ids=[row.task for row in ROWS])
def test_a_row_does_the_same_here_as_with_canopen(values: tuple[list[Any], list[Any]], number: int) -> None:
    theirs, ours = (each[number] for each in values)
    row = ROWS[number]
    assert row.theirs or row.ours
    if row.theirs and row.ours:
        assert theirs == ours
    assert ("value =" in row.theirs) == (theirs is not NOTHING)


@pytest.mark.parametrize("number", range(len(BLOCKING)), ids=[row.task for row in BLOCKING])
def test_a_row_without_async_does_the_same(values_without_async: tuple[list[Any], list[Any]], number: int) -> None:
    theirs, ours = (each[number] for each in values_without_async)
    row = BLOCKING[number]
    assert row.theirs
    assert row.ours
    assert theirs == ours
    assert ("value =" in row.theirs) == (theirs is not NOTHING)


def test_the_table_has_each_part_of_their_interface() -> None:
    theirs = "\n".join(row.theirs for row in ROWS)
    parts = "Network() scanner add_node sdo[ nmt. tpdo rpdo emcy sync time.transmit lss 402 LocalNode import_od disconnect"
    parts += " .phys .bits guarding .log export_od subscribe"
    assert [part for part in parts.split() if part not in theirs] == []
    assert len(ROWS) > 35
    assert len(BLOCKING) > 12


def test_the_page_imports_public_names_only() -> None:
    for statement in (*ast.parse(ROWS[0].ours).body, *ast.parse(BLOCKING[0].ours).body):
        if isinstance(statement, ast.ImportFrom) and str(statement.module).startswith("canopen_"):
            public = importlib.import_module(str(statement.module)).__all__
            assert [each.name for each in statement.names if each.name not in public] == []
