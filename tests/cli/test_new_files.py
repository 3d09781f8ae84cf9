"""Files that commands write: nothing that is there is overwritten without asking."""

from __future__ import annotations

import errno
import io
import os
import stat
import sys
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import IO

import pytest

from canopen_cli.device.new import skeleton
from canopen_cli.shared.problem import ExitCode
from canopen_data.descriptions import load_description
from canopen_master.whole_file import whole_file
from canopen_proto.abort import AbortCode
from tests.cli.backup_world import Lasting, answering, change, lasting_device
from tests.cli.cli_support import Run, runner_in_folder
from tests.core.devices import TEXT
from tests.manager.restore_bench import GAIN

OLD = "what was there"
DEMO = ("-b", "demo")
COMMANDS = {
    "backup": ("backup", "5", "-e", "device.eds", *DEMO, "-o", "OUT.dcf"),
    "dump": ("dump", "5", "-e", "device.eds", *DEMO, "-o", "OUT.json"),
    "read": ("read", "5", "2003", "-e", "device.eds", *DEMO, "-o", "OUT.bin"),
    "trace": ("read", "5", "1000", *DEMO, "--trace", "OUT.log"),
    "stubs": ("eds", "stubs", "device.eds", "-o", "OUT.py"),
    "to-dcf": ("eds", "to-dcf", "device.eds", "--id", "5", "-o", "OUT.dcf"),
    "describe": ("device", "describe", "device.py", "-o", "OUT.eds"),
    "to-cdcf": ("eds", "to-cdcf", "device.eds", "--id", "5", "-o", "OUT.bin"),
    "to-dbc": ("eds", "to-dbc", "device.eds", "--id", "5", "-o", "OUT.dbc"),
    "doc": ("eds", "doc", "device.eds", "-o", "OUT.html"),
    "fix": ("eds", "fix", "device.eds", "-o", "OUT.eds"),
    "convert": ("log", "convert", "in.log", "OUT.trc"),
    "check": ("check", "device.eds", "--junit", "OUT.xml"),
}


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch, run: Run) -> Lasting:
    Path("in.log").write_text("(1.000000) can0 705#05\n")
    Path("device.py").write_text(skeleton("device", "Device", "Device"))
    return lasting_device(monkeypatch)


@pytest.mark.thorough(4)
@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_there_is_not_overwritten_without_asking(
    run: Run, world: Lasting, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    command = COMMANDS[name]
    target = output_of(name)
    target.write_text(OLD)
    outcome = run(*command)
    assert outcome.status == ExitCode.USAGE
    assert f"error CO135: {target} is there already" in outcome.err
    assert "--force" in outcome.err
    assert world.state is None  # nobody was asked
    monkeypatch.setattr(sys, "stdin", Terminal("n\n"))
    monkeypatch.setenv("FORCE_COLOR", "1")  # a terminal
    assert run(*command).status == ExitCode.INTERRUPTED
    assert target.read_text() == OLD
    monkeypatch.setattr(sys, "stdin", Terminal("y\n"))
    assert run(*command).status in (0, 1)
    assert target.read_bytes() != OLD.encode()
    target.write_text(OLD)
    monkeypatch.delenv("FORCE_COLOR")
    assert run(*command, "--force").status in (0, 1)
    assert target.read_bytes() != OLD.encode()


class Terminal(io.StringIO):
    """A stdin on which somebody types."""

    def isatty(self) -> bool:
        return True


def output_of(name: str) -> Path:
    return Path(next(each for each in COMMANDS[name] if each.startswith("OUT.")))


@pytest.mark.skipif(sys.platform != "linux", reason="a pipe that holds a whole file is Linux's alone")
@pytest.mark.thorough(3)
@pytest.mark.parametrize("name", COMMANDS)
def test_a_pipe_is_written_to(run: Run, world: Lasting, name: str) -> None:
    """Nobody is asked, and the pipe is a pipe afterwards."""
    import fcntl

    target = output_of(name)
    os.mkfifo(target)
    reader = os.open(target, os.O_RDONLY | os.O_NONBLOCK)
    try:
        fcntl.fcntl(reader, fcntl.F_SETPIPE_SZ, 1 << 20)  # the whole file has room in it
        assert run(*COMMANDS[name]).status in (0, 1)
        assert len(os.read(reader, 1 << 20)) > 3
    finally:
        os.close(reader)
    assert target.is_fifo()
    assert names() == {"device.eds", "device.py", "in.log", target.name}


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege")
@pytest.mark.thorough(3)
@pytest.mark.parametrize("name", COMMANDS)
def test_a_link_leads_to_what_is_written(run: Run, world: Lasting, name: str) -> None:
    """What it leads to keeps its permissions. A file that is called like a part of it is somebody's own."""
    target = output_of(name)
    Path("kept").mkdir()
    kept, own = Path("kept", target.name), Path("kept", f"{target.name}.part")
    target.symlink_to(kept)
    Path(f"{target.name}.part").write_text(OLD)
    own.write_text(OLD)
    kept.write_text(OLD)
    kept.chmod(0o640)
    assert run(*COMMANDS[name], "--force").status in (0, 1)
    assert target.is_symlink()
    assert kept.read_bytes() != OLD.encode()
    assert stat.S_IMODE(kept.stat().st_mode) == 0o640
    assert (own.read_text(), Path(f"{target.name}.part").read_text()) == (OLD, OLD)
    assert names() == {"device.eds", "device.py", "in.log", "kept", target.name, f"{target.name}.part"}
    assert names("kept") == {kept.name, own.name}


def names(folder: str = ".") -> set[str]:
    return {each.name for each in Path(folder).iterdir()}


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege")
def test_a_link_to_nothing_yet_makes_its_file(run: Run, world: Lasting) -> None:
    Path("link.dcf").symlink_to("new.dcf")
    assert run("backup", "5", "-e", "device.eds", *DEMO, "-o", "link.dcf").status == 0
    assert Path("link.dcf").is_symlink()
    assert Path("new.dcf").read_text().startswith("[FileInfo]")
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(Path("new.dcf").stat().st_mode) == 0o666 & ~umask


def test_a_file_that_is_not_written_to_the_end_is_as_it_was(run: Run) -> None:
    """Whatever keeps it from that, Ctrl-C too."""
    for content in (None, OLD):
        target = Path("OUT.bin")
        if content is not None:
            target.write_text(content)
        with suppress(KeyboardInterrupt), whole_file(target) as file:
            file.write(b"half of")
            raise KeyboardInterrupt
        assert names() == ({target.name} if content else set())
        assert not content or target.read_text() == content


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("name", ["backup", "read", "doc"])
def test_a_file_that_another_program_makes_meanwhile_is_not_overwritten(
    run: Run, world: Lasting, monkeypatch: pytest.MonkeyPatch, name: str, links: bool
) -> None:
    def crowded(path: str, **options: bool) -> AbstractContextManager[IO[bytes]]:
        Path(path).write_text(OLD)
        return whole_file(path, **options)

    def no_links(*_: object) -> None:
        raise OSError(errno.EPERM, "this file system has none")

    monkeypatch.setattr("canopen_cli.shared.new_files.whole_file", crowded)
    if not links:
        monkeypatch.setattr(os, "link", no_links)
    output = Path(COMMANDS[name][-1])
    outcome = run(*COMMANDS[name])
    assert (outcome.status, output.read_text()) == (ExitCode.USAGE, OLD), outcome.err
    assert "is there now, and was not overwritten" in outcome.err
    assert not [each for each in names() if each.endswith(".part")]
    output.unlink()
    assert run(*COMMANDS[name], "--force").status == 0
    assert output.read_bytes() != OLD.encode()


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege")
def test_what_cannot_be_written(run: Run, world: Lasting) -> None:
    Path("folder").mkdir()
    Path("folder", "loop").symlink_to("loop")
    for output in ("folder", "folder/loop", "in.log/x.html"):
        assert run("eds", "doc", "device.eds", "-o", output).status == ExitCode.BAD_FILE
        assert run("read", "5", "1000", *DEMO, "-o", output).status == ExitCode.BAD_FILE
    assert run("read", "5", "1000", *DEMO, "--trace", "in.log/x.log").status == ExitCode.BAD_FILE
    assert names("folder") == {"loop"}


# ---- what a backup and a restore keep ----


def test_a_folder_that_may_not_be_looked_into(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Root may look into each folder, so the system's refusal is put in its place."""
    stat_of = Path.stat

    def refuse(path: Path, **options: bool) -> os.stat_result:
        if "closed" in path.parts:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return stat_of(path, **options)

    monkeypatch.setattr(Path, "stat", refuse)
    for path in ("closed/sub/out.bin", "closed/out.bin"):
        status, _, stderr = run("read", "3", "1000", *DEMO, "-o", path)
        assert status == ExitCode.PERMISSION
        assert f"CO109: cannot write {path}: Permission denied" in stderr
        assert "try:   another folder" in stderr


def test_a_backup_keeps_bytes_and_compare_and_restore_see_them(run: Run, world: Lasting) -> None:
    held = "\xc3\xbc \x1b\r\n"
    world.values = {TEXT << 8: held, GAIN << 8: float("nan")}
    backup = ("backup", "5", "-e", "device.eds", *DEMO, "-o", "before.dcf")
    assert run(*backup).status == 0
    assert load_description("before.dcf").dictionary.variable(TEXT).configured == held
    assert run("compare", "5", "before.dcf", *DEMO).status == 0
    world.values |= {TEXT << 8: "\xfc", GAIN << 8: 2.0}
    outcome = run("compare", "5", "before.dcf", *DEMO)
    assert outcome.status == ExitCode.DIFFERENT
    assert "'ü' (FC)" in outcome.out
    assert "'ü \\x1b\\r\\n' (C3 BC 20 1B 0D 0A)" in outcome.out
    rows = {row["index"]: row for row in run("compare", "5", "before.dcf", *DEMO, "--json").json}
    assert (rows[TEXT]["left_hex"], rows[TEXT]["right_hex"]) == ("FC", "C3 BC 20 1B 0D 0A")
    assert run("restore", "5", "before.dcf", *DEMO, "--yes", "--verify").status == 0
    assert world.values[TEXT << 8] == held
    for name in ("all.csv", "all.json"):
        assert run("dump", "5", "-e", "device.eds", *DEMO, "-o", name).status == 0
        assert not [each for each in Path(name).read_text() if not each.isprintable() and each != "\n"]
        assert "C3 BC 20 1B 0D 0A" in Path(name).read_text()


def test_what_a_file_cannot_keep_is_named(run: Run, world: Lasting) -> None:
    world.prepare = lambda node: answering(node, {GAIN: b"\x01\0\x80\x7f"})  # a signalling NaN
    outcome = run("backup", "5", "-e", "device.eds", *DEMO, "-o", "before.dcf")
    assert outcome.status == ExitCode.PARTIAL
    assert "not exact in the file: 2012:00 gain: bytes 01 00 80 7f" in outcome.err
    document = run("backup", "5", "-e", "device.eds", *DEMO, "-o", "again.dcf", "--json").json
    assert [each["index"] for each in document["not_exact"]] == [GAIN]


def test_an_old_backup_lends_nothing_to_a_new_one(run: Run, world: Lasting) -> None:
    assert run("backup", "5", "-e", "device.eds", *DEMO, "-o", "old.dcf").status == 0
    world.prepare = lambda node: answering(node, {GAIN: AbortCode.DEVICE_STATE})
    assert run("backup", "5", "-e", "old.dcf", *DEMO, "-o", "new.dcf").status == ExitCode.PARTIAL
    gain = load_description("new.dcf").dictionary.variable("gain")
    assert (gain.configured, gain.not_read) == (None, "refused")
    world.prepare = lambda node: None
    world.values[GAIN << 8] = 7.0
    outcome = run("restore", "5", "new.dcf", *DEMO, "--yes")
    assert outcome.status == 0
    assert "the file has no value, since it could not be read then: 2012:00 (gain)" in outcome.err
    assert world.values[GAIN << 8] == 7.0


def test_a_backup_without_a_file_has_the_pdos_of_the_device(run: Run, world: Lasting) -> None:
    assert run("backup", "5", *DEMO, "-o", "whole.dcf").status == 0
    found = load_description("whole.dcf").dictionary
    pdos = {index for index in world.dictionary.objects if 0x1400 <= index < 0x1C00}
    assert pdos <= set(found.objects)
    assert all(found.variable((index, 1)).configured is not None for index in pdos)


def test_a_restore_leaves_alone_what_it_could_not_read(run: Run, world: Lasting) -> None:
    change(run, world)
    world.prepare = lambda node: answering(node, {GAIN: AbortCode.DEVICE_STATE, 0x1801: AbortCode.HARDWARE_ERROR})
    outcome = run("restore", "5", "before.dcf", *DEMO, "--yes")
    assert outcome.status == ExitCode.PARTIAL
    assert "left alone, since it could not be read: 1801:01" in outcome.err
    assert world.writes == [(TEXT, 0)]


def test_the_settings_of_one_node_go_to_another(run: Run, world: Lasting) -> None:
    change(run, world)
    moved = Path("before.dcf").read_text().replace("NodeID=5", "NodeID=9").replace("0x00000285", "0x00000289")
    Path("nine.dcf").write_text(moved)
    assert "canopen restore 9 nine.dcf --to-node 5" in run("restore", "5", "nine.dcf", *DEMO, "--yes").err
    outcome = run("restore", "9", "nine.dcf", "--to-node", "5", *DEMO, "--yes")
    assert outcome.status == 0
    assert world.values[0x1801_01] == 0x285
    assert "node 5 (0x05)" in outcome.err
