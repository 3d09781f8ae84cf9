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
from collections.abc import Iterator
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


def rows() -> list[Row]:
    """The rows of the page in order, the imports first."""
    found = []
    for line in (DOCS / "from-canopen.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if line.startswith("| `import"):
            found.append(Row("imports", code_of(cells[0]), code_of(cells[1])))
        elif line.startswith("| ") and not line.startswith(("| task ", "| `canopen`")):
            task, theirs, ours = cells
            found.append(Row(task, code_of(theirs), code_of(ours)))
    return found


ROWS = rows()


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


def run_theirs(channel: str) -> list[Any]:
    """Run the left cells; return the `value` of each row."""
    scope: dict[str, Any] = {}
    values = []
    for row in ROWS:
        code = row.theirs.replace('interface="socketcan", channel="can0"', f'interface="virtual", channel="{channel}"')
        code = re.sub(r'"(sample_\w+\.eds)"', lambda found: repr(str(SAMPLES / found[1])), code)
        scope["value"] = NOTHING
        try:
            exec(compile(code, row.task, "exec"), scope)
        except Exception as error:
            error.add_note(f"{row.task}: {code}")
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


@pytest.fixture(scope="module")
def values() -> tuple[list[Any], list[Any]]:
    """What each row found, with `canopen` and here."""
    channel = new_channel()
    served = Served(channel)
    with pytest.MonkeyPatch.context() as patch, served.running():
        patch.setattr(canopen, "BaseNode402", PatientNode402, raising=False)
        patch.setattr(canopen.lss.LssMaster, "RESPONSE_TIMEOUT", 0.05)
        theirs = run_theirs(channel)
        ours = trio.run(functools.partial(run_ours, served.locator))
    return theirs, ours


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


def test_the_table_has_each_part_of_their_interface() -> None:
    theirs = "\n".join(row.theirs for row in ROWS)
    parts = "Network() scanner add_node sdo[ nmt. tpdo rpdo emcy sync time.transmit lss 402 LocalNode import_od disconnect"
    assert [part for part in parts.split() if part not in theirs] == []
    assert len(ROWS) > 35


def test_the_page_imports_public_names_only() -> None:
    for statement in ast.parse(ROWS[0].ours).body:
        if isinstance(statement, ast.ImportFrom) and str(statement.module).startswith("canopen_"):
            public = importlib.import_module(str(statement.module)).__all__
            assert [each.name for each in statement.names if each.name not in public] == []
