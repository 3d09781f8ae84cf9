"""Which commands claim an SDO channel of their node, and how; see canopen_master/claims/channel_claim.py."""

from __future__ import annotations

import os
import socket
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager, closing
from pathlib import Path

import pytest

from canopen_cli.net import boot as net_boot
from canopen_cli.shared import session
from canopen_cli.shared.problem import ExitCode
from canopen_master.claims import channel_claim
from canopen_master.claims.further_channels import FurtherChannels
from tests.cli.backup_world import EDS, NODE, Lasting, lasting_device
from tests.cli.cli_support import Alarm, Run, runner_in_folder

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


MACHINE = """
[buses.can0]

[nodes]
left = { id = 3, boot = { mandatory = true } }
right = { id = 4, boot = { mandatory = true } }
"""


@pytest.fixture
def states(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The nodes whose NMT state is claimed by the commands to come."""
    made: list[int] = []

    @asynccontextmanager
    async def claim(locator: str, node_ids: Iterable[int], patience: float = 2.0) -> AsyncIterator[None]:
        made.extend(node_ids)
        yield

    monkeypatch.setattr(session, "state_claim", claim)
    monkeypatch.setattr(net_boot, "state_claim", claim)
    return made


def test_what_resets_nodes_or_writes_a_program_claims_their_nmt_state(run: Run, alarm: Alarm, states: list[int]) -> None:
    Path("cell.toml").write_text(MACHINE)
    Path("firmware.bin").write_bytes(b"program")
    for command, nodes in (
        (("net", "boot", "cell.toml", "--yes", "-b", "demo"), [3, 4]),
        (("net", "boot", "cell.toml", "--dry-run", "-b", "demo"), []),
        (("flash", "3", "firmware.bin", "--yes", "-b", "demo"), [3]),
    ):
        states.clear()
        run(*command)
        assert states == nodes, command


@pytest.mark.skipif(not hasattr(socket, "SO_PEERCRED"), reason="only Linux has abstract sockets with a name behind")
def test_a_network_is_not_booted_while_another_program_has_one_of_its_nodes(run: Run) -> None:
    Path("cell.toml").write_text(MACHINE)
    bus = f"tcp:127.0.0.1:{os.getpid()}"
    name = channel_claim._name_of(bus, 4)
    assert name is not None
    with closing(channel_claim._Claims(name)) as other:
        other.take(channel_claim.NMT_STATE)
        outcome = run("net", "boot", "cell.toml", "--yes", "-b", bus)
    assert (outcome.status, "CO208" in outcome.err) == (ExitCode.SDO_ABORT, True), outcome.err
    assert "another program resets and starts node 4" in outcome.err
    assert f"process {os.getpid()} (" in outcome.err


def test_what_may_stop_a_drive_claims_nothing(run: Run, claims: list[Claim], states: list[int]) -> None:
    for command in (
        ("drive", "3", "stop", "-b", "demo"),
        ("drive", "3", "disable", "-b", "demo"),
        ("write", "3", "controlword", "sm_shutdown", "-b", "demo"),
        ("nmt", "stop", "3", "-b", "demo"),
    ):
        assert run(*command).status == 0, command
    assert (claims, states) == ([], [])
