"""`canopen read -o FILE`, `canopen write --file FILE` and `--block`, in virtual time."""

from __future__ import annotations

import os
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from canopen_cli.node import object_files
from canopen_cli.shared import session
from canopen_cli.shared.problem import ExitCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access
from canopen_proto.dictionary.model import Object, Variable
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Outbox, Time
from tests.cli.cli_support import Run, runner
from tests.core.block_pair import pattern
from tests.core.devices import io_device
from tests.master.test_streams import IMAGE, OldNode
from tests.master.world import simulated

DEMO = ("-b", "demo")
LOG, COMMAND = 0x2300, 0x2301


class Device(LocalNode):
    """Notes which command specifiers came."""

    heard: list[str]

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.can_id == 0x605 and int.from_bytes(frame.data[1:3], "little") in (IMAGE, 0x1000, 0x1017):
            self.heard.append(f"{frame.data[0] & 0xE0:02X}")
        super().receive(frame, now)


class OldDevice(Device, OldNode):
    """Knows no block transfer."""


class Devices:
    """The device that `-b demo` finds as node 5."""

    def __init__(self) -> None:
        self.kind: type[Device] = Device
        self.node: LocalNode | None = None
        self.heard: list[str] = []
        self.content = b""

    def make(self, out: Outbox) -> LocalNode:
        objects = [
            Object.of("image", [Variable(IMAGE, 1, "image:1", DataType.DOMAIN)]),
            Object.of("log", [Variable(LOG, 0, "log", DataType.DOMAIN, Access.RO)]),
            Object.of("command", [Variable(COMMAND, 0, "command", DataType.DOMAIN, Access.WO)]),
        ]
        self.node = self.kind(out, 5, io_device().with_objects(objects))
        self.node.heard = self.heard
        self.node.values.store[IMAGE << 8 | 1] = self.content
        return self.node

    @property
    def image(self) -> Any:
        assert self.node is not None
        return self.node.values.store[IMAGE << 8 | 1]

    @property
    def kinds(self) -> set[str]:
        """Of the initiate requests that it got."""
        kinds = set(self.heard) & {"20", "40", "A0", "C0"}
        self.heard.clear()
        return kinds


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))


@pytest.fixture
def devices(monkeypatch: pytest.MonkeyPatch) -> Devices:
    found = Devices()

    @asynccontextmanager
    async def simulation(*arguments: object) -> AsyncIterator[None]:
        async with simulated(bus="virtual:demo", makers=[found.make]):
            yield

    monkeypatch.setattr(session, "simulated_drives", simulation)
    return found


@pytest.mark.thorough(2)
@pytest.mark.parametrize(
    ("kind", "option", "kinds"),
    [
        (Device, (), {"A0"}),
        (Device, ("--block",), {"A0"}),
        (Device, ("--no-block",), {"40"}),
        (OldDevice, (), {"A0", "40"}),
    ],
)
def test_an_object_goes_into_a_file(
    run: Run, devices: Devices, tmp_path: Path, kind: Any, option: tuple[str, ...], kinds: set[str]
) -> None:
    devices.kind, devices.content = kind, pattern(5000)
    file = tmp_path / "image.bin"
    file.write_bytes(b"the one before")
    outcome = run("read", "5", "1F50:01", "-o", str(file), "--force", *DEMO, *option)
    assert outcome.status == 0
    assert file.read_bytes() == pattern(5000)
    assert f"→ {file}: 5000 bytes in 0." in outcome.out
    assert devices.kinds == kinds
    assert list(tmp_path.iterdir()) == [file]
    document = run("read", "5", "1F50:01", "-o", str(file), "--force", *DEMO, "--json").json
    assert (document["node"], document["index"], document["sub"], document["bytes"]) == (5, IMAGE, 1, 5000)


@pytest.mark.parametrize(
    ("kind", "option", "kinds"),
    [
        (Device, (), {"C0"}),
        (Device, ("--block",), {"C0"}),
        (Device, ("--no-block",), {"20"}),
        (OldDevice, (), {"C0", "20"}),
    ],
)
def test_a_file_goes_into_an_object(
    run: Run, devices: Devices, tmp_path: Path, kind: Any, option: tuple[str, ...], kinds: set[str]
) -> None:
    devices.kind = kind
    file = tmp_path / "image.bin"
    file.write_bytes(pattern(10_000))
    outcome = run("write", "5", "1F50:01", "--file", str(file), *DEMO, *option)
    assert outcome.status == 0
    assert f"← {file}: 10000 bytes in" in outcome.out
    assert devices.image == pattern(10_000)
    assert devices.kinds & {"20", "C0"} == kinds
    document = run("write", "5", "1F50:01", "--file", str(file), "--verify", *DEMO, "--json").json
    assert (document["bytes"], document["verified"]) == (10_000, True)


def test_a_short_object_needs_no_blocks(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "statusword.bin"
    assert run("read", "3", "6041", "-o", str(file), "--force", *DEMO).status == 0
    assert file.read_bytes() == b"\x40\x02"
    file.write_bytes(b"\x06\x00")
    assert run("write", "3", "6040", "--file", str(file), *DEMO).status == 0


def test_block_transfer_of_what_is_shown(run: Run, devices: Devices) -> None:
    assert run("read", "5", "1F50:01", "--type", "bytes", *DEMO).status == 0
    assert devices.kinds == {"A0"}
    assert run("read", "5", "1000", *DEMO).status == 0
    assert devices.kinds == {"40"}
    assert run("read", "5", "1000", "--block", *DEMO).status == 0
    assert devices.kinds == {"A0"}
    assert run("write", "5", "1017", "0", "--block", "--verify", *DEMO).status == 0
    assert devices.kinds == {"A0", "C0"}
    assert run("write", "5", "1017", "0", *DEMO).status == 0
    assert devices.kinds == {"20", "40"}
    devices.kind = OldDevice
    assert run("read", "5", "1000", "--block", *DEMO).status == ExitCode.SDO_ABORT


def test_what_is_read_back_differs(run: Run, devices: Devices, tmp_path: Path) -> None:
    file = tmp_path / "image.bin"
    file.write_bytes(pattern(100))

    class Forgetful(Device):
        def read(self, index: int, subindex: int, now: Time) -> Any:
            return self.lies if index == IMAGE else super().read(index, subindex, now)

    for lies in (pattern(99), pattern(101), pattern(100, 2)):
        Forgetful.lies = lies  # type: ignore[attr-defined]
        devices.kind = Forgetful
        outcome = run("write", "5", "1F50:01", "--file", str(file), "--verify", *DEMO)
        assert outcome.status == ExitCode.VERIFY_MISMATCH
        assert f"shows something else: {len(lies)} bytes" in outcome.err


def test_a_transfer_that_fails_leaves_the_file_as_it_was(run: Run, devices: Devices, tmp_path: Path) -> None:
    file = tmp_path / "image.bin"
    file.write_bytes(b"the one before")
    outcome = run("read", "5", "5000:01", "-o", str(file), "--force", *DEMO)
    assert outcome.status == ExitCode.SDO_ABORT
    assert file.read_bytes() == b"the one before"
    assert list(tmp_path.iterdir()) == [file]


def test_files_that_cannot_be_used(run: Run, devices: Devices, tmp_path: Path) -> None:
    nowhere = str(tmp_path / "missing" / "image.bin")
    outcome = run("read", "5", "1F50:01", "-o", nowhere, *DEMO)
    assert outcome.status == ExitCode.BAD_FILE
    assert f"cannot write {nowhere}" in outcome.err
    outcome = run("write", "5", "1F50:01", "--file", nowhere, *DEMO)
    assert outcome.status == ExitCode.BAD_FILE
    assert f"cannot read {nowhere}" in outcome.err
    assert devices.heard == []


def test_what_was_typed_makes_no_sense(run: Run, devices: Devices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "image.bin"
    file.write_bytes(b"1")
    for arguments in (
        ("read", "5", "1000", "1001", "-o", str(file)),
        ("write", "5", "1017"),
        ("write", "5", "1017", "5", "--file", str(file)),
        ("write", "5", "1000", "--file", str(file)),
        ("read", "5", "1000", "--type", "u16", "-o", str(tmp_path / "new.bin")),
        ("write", "5", "1F50:01", "--type", "u16", "--file", str(file)),
    ):
        assert run(*arguments, *DEMO).status == ExitCode.USAGE
    assert "no --type" in run("read", "5", "1000", "--type", "u16", "-o", str(tmp_path / "new.bin"), *DEMO).err
    assert not (tmp_path / "new.bin").exists()
    (tmp_path / "indices.csv").write_text("secret 0x2301 0x00 2 wo\n")
    (tmp_path / "constants.csv").write_text("")
    (tmp_path / "PDOs.csv").write_text("")
    monkeypatch.setenv("CANOPEN_DATA", str(tmp_path))
    outcome = run("read", "5", "secret", "-o", str(file), "--force", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "write-only" in outcome.err
    assert devices.heard == []
    assert file.read_bytes() == b"1"


def test_long_transfers_show_their_progress_on_a_terminal(
    run: Run, devices: Devices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "image.bin"
    file.write_bytes(pattern(20_000))
    monkeypatch.setattr(object_files, "PATIENCE", 0.0)
    monkeypatch.setattr(object_files, "REDRAW", 0.0)
    assert "kB" not in run("write", "5", "1F50:01", "--file", str(file), *DEMO).err
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    assert "20.0/20.0 kB" in run("write", "5", "1F50:01", "--file", str(file), *DEMO).err
    devices.content = pattern(20_000)
    outcome = run("read", "5", "1F50:01", "-o", str(file), "--force", *DEMO)
    assert "20.0/? kB" in outcome.err
    assert "20.0" not in run("read", "5", "1F50:01", "-o", str(file), "--force", *DEMO, "-q").err
    monkeypatch.setattr(object_files, "PATIENCE", 1000.0)
    assert "20.0" not in run("read", "5", "1F50:01", "-o", str(file), "--force", *DEMO).err


def test_a_pipe_has_no_size(run: Run, devices: Devices, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=partial(pipe.write_bytes, pattern(3000)))
    writer.start()
    assert run("write", "5", "1F50:01", "--file", str(pipe), *DEMO).status == 0
    writer.join()
    assert devices.image == pattern(3000)
