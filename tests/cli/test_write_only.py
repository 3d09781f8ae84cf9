"""`canopen write` to objects that can be written and not read: by the file, or only by the device."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from tests.cli.backup_world import EDS, NODE, Lasting, lasting_device
from tests.cli.cli_support import Run, runner_in_folder
from tests.manager.restore_bench import SECRET

OBJECT = f"{SECRET:04X}"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch, run: Run) -> Lasting:
    return lasting_device(monkeypatch)


def test_what_only_the_device_calls_write_only_is_written(run: Run, world: Lasting) -> None:
    Path("device.eds").write_text(Path("device.eds").read_text().replace("AccessType=wo", "AccessType=rw"))
    outcome = run("write", *NODE, OBJECT, "7", *EDS, "--json")
    assert outcome.status == ExitCode.OK
    assert (outcome.json["previous"], outcome.json["value"], outcome.json["verified"]) == (None, 7, False)
    assert world.values[SECRET << 8] == 7


@pytest.mark.parametrize("access", ["wo", "rw"])
def test_it_cannot_be_verified_and_is_not_written_then(run: Run, world: Lasting, access: str) -> None:
    Path("device.eds").write_text(Path("device.eds").read_text().replace("AccessType=wo", f"AccessType={access}"))
    outcome = run("write", *NODE, OBJECT, "7", *EDS, "--verify")
    assert outcome.status == ExitCode.USAGE
    assert "is write-only: it cannot be read back" in outcome.err
    assert (SECRET, 0) not in world.writes
    assert world.values.get(SECRET << 8, 0) == 0


def test_nor_is_a_file(run: Run, world: Lasting) -> None:
    Path("two.bin").write_bytes(b"\x07\x00")
    outcome = run("write", *NODE, OBJECT, "--file", "two.bin", *EDS, "--verify")
    assert outcome.status == ExitCode.USAGE
    assert "is write-only: it cannot be read back" in outcome.err
    assert world.values.get(SECRET << 8, 0) == 0
    assert run("write", *NODE, OBJECT, "--file", "two.bin", *EDS).status == ExitCode.OK
    assert world.values[SECRET << 8] == 7
