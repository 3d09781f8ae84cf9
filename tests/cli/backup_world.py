"""One device on the bus of `-b demo` that keeps its values from one command to the next, for the tests of backup and restore."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import trio

from canopen_cli.shared import session
from canopen_data.configured import configure
from canopen_data.describing import describe
from canopen_data.eds.writer import write_eds
from canopen_master.simulation.host import simulate
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Outbox
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_transports import open_transport
from tests.cli.cli_support import Run
from tests.core.devices import TEXT
from tests.manager.restore_bench import GAIN, Strict, device

NODE = ("5", "-b", "demo")
EDS = ("-e", "device.eds")
"""The file of the device, in the current folder."""


class Lasting:
    """See this module's text.

    prepare: what is done to the device before the next commands; task: what goes on beside one. values: what it held at the end
    of the last one; state: its NMT state then.
    """

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self.dictionary = dictionary
        self.values: dict[int, Value] = {}
        self.state: NmtState | None = None
        self.writes: list[tuple[int, int]] = []
        self.prepare: Callable[[Strict], object] = lambda node: None
        self.is_there = True

    def make(self, out: Outbox) -> LocalNode:
        held = {key: value for key, value in self.values.items() if self._is_kept(key)}
        self.node = Strict(out, 5, configure(self.dictionary, held, 5))
        return self.node

    def _is_kept(self, key: int) -> bool:
        return key >> 8 not in (0x1001, 0x1003, 0x1010, 0x1011)

    @asynccontextmanager
    async def simulation(self, *arguments: object) -> AsyncIterator[None]:
        error: Exception | None = None
        async with trio.open_nursery() as nursery:
            if self.is_there:
                await nursery.start(simulate, await open_transport("virtual:demo"), [self.make])
                self.prepare(self.node)
                self.node.execute(NmtCommand.START, 0)
            await trio.sleep(0.05)
            try:
                yield
            except Exception as raised:  # noqa: BLE001 - raised below: out of the nursery it would come in a group
                error = raised
            finally:
                if self.is_there:
                    self.values = dict(self.node.values.store)
                    self.state = self.node.state
                    self.writes = [(index, subindex) for index, subindex, _ in self.node.writes]
                nursery.cancel_scope.cancel()
        if error is not None:
            raise error


def lasting(monkeypatch: pytest.MonkeyPatch, dictionary: ObjectDictionary) -> Lasting:
    """A device that the next commands find on `-b demo`, Operational."""
    world = Lasting(dictionary)
    monkeypatch.setattr(session, "simulated_drives", world.simulation)
    return world


def lasting_device(monkeypatch: pytest.MonkeyPatch) -> Lasting:
    """The device of restore_bench.py, and its file: device.eds in the current folder."""
    dictionary = device()
    Path("device.eds").write_text(write_eds(describe(dictionary)))
    return lasting(monkeypatch, dictionary)


_FILES: dict[int, dict[str, str]] = {}
"""before.dcf and changed.dcf of each dictionary, by its id, as the first test that wants them has made them."""


def change(run: Run, world: Lasting) -> None:
    """The backup of the device, a changed one beside it, and the device as the changed one says."""
    files = _FILES.setdefault(id(world.dictionary), {})
    if not files:
        assert run("backup", *NODE, *EDS, "-o", "before.dcf").status == 0
        before = Path("before.dcf").read_text()
        changed = before.replace("ParameterValue=0x00000285", "ParameterValue=0x00000295")
        changed = changed.replace("ParameterValue=an I/O device with a long name", "ParameterValue=changed")
        files.update({"before.dcf": before, "changed.dcf": changed.replace("ParameterValue=1.5", "ParameterValue=2.5")})
    for name, text in files.items():
        Path(name).write_text(text)
    world.values.update({0x1801_01: 0x295, TEXT << 8: "changed", GAIN << 8: 2.5})


def answering(node: Strict, answers: dict[int, bytes | AbortCode]) -> None:
    """Have a device answer reads of some indices otherwise."""
    reads = node.read
    node.read = lambda index, sub, now: answers.get(index) or reads(index, sub, now)  # type: ignore[method-assign]
