"""Which commands claim an SDO channel of their node, and how; see canopen_master/claims/channel_claim.py."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from canopen_cli.shared import session
from canopen_master.claims.further_channels import FurtherChannels
from tests.cli.backup_world import EDS, NODE, Lasting, lasting_device
from tests.cli.cli_support import Run, runner_in_folder

Claim = tuple[int, bool, bool, tuple[int, ...]]
"""The node, whether for a few reads, whether to write, and the further channels that could be used."""


@pytest.fixture
def claims(monkeypatch: pytest.MonkeyPatch) -> list[Claim]:
    """The claims of the commands to come. The bus of `-b demo` is inside the process and needs none."""
    made: list[Claim] = []

    @asynccontextmanager
    async def claim(
        locator: str,
        node_id: int,
        patience: float = 10.0,
        *,
        brief: bool = False,
        writes: bool = False,
        further: FurtherChannels | None = None,
    ) -> AsyncIterator[None]:
        made.append((node_id, brief, writes, () if further is None else further.candidates))
        yield

    monkeypatch.setattr(session, "channel_claim", claim)
    return made


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch, run: Run) -> Lasting:
    return lasting_device(monkeypatch)


def test_what_reads_may_use_a_further_channel_of_its_file_and_what_writes_may_not(
    run: Run, world: Lasting, claims: list[Claim]
) -> None:
    assert run("backup", *NODE, *EDS, "-o", "before.dcf").status == 0
    for command, claim in (
        (("dump", *NODE, *EDS), (5, False, False, (0x1201,))),
        (("dump", *NODE), (5, False, False, ())),  # no file: no channel is known
        (("read", *NODE, "1000", *EDS), (5, True, False, (0x1201,))),
        (("info", *NODE, *EDS), (5, True, False, (0x1201,))),
        (("read", *NODE, "image", *EDS, "-o", "image.bin"), (5, False, False, (0x1201,))),
        (("compare", "5", "before.dcf", "-b", "demo"), (5, False, False, (0x1201,))),
        (("restore", *NODE, "before.dcf", "--dry-run"), (5, False, False, (0x1201,))),
        (("restore", *NODE, "before.dcf", "--yes"), (5, False, True, ())),
        (("write", *NODE, "image", *EDS, "--file", "image.bin"), (5, False, True, ())),
    ):
        claims.clear()
        assert run(*command).status == 0, command
        assert claims == [claim], command


def test_what_may_stop_a_drive_claims_nothing(run: Run, claims: list[Claim]) -> None:
    for command in (
        ("drive", "3", "stop", "-b", "demo"),
        ("drive", "3", "disable", "-b", "demo"),
        ("write", "3", "controlword", "sm_shutdown", "-b", "demo"),
        ("nmt", "stop", "3", "-b", "demo"),
    ):
        assert run(*command).status == 0, command
    assert claims == []
