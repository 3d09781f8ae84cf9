"""`canopen flash`: what it shows, what it asks, what it writes, and what it says when it cannot."""

from __future__ import annotations

import signal
from binascii import crc32
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_cli.node import flash
from canopen_cli.shared import questions, session
from canopen_cli.shared.problem import ExitCode
from canopen_master.errors import BusError
from canopen_master.simulation.serving import DEMO_LOCATOR, SimulatedDevices, simulated_devices
from canopen_proto.abort import AbortCode
from canopen_proto.indices import FLASH_STATUS
from canopen_proto.lss.messages import LssConfiguration
from canopen_proto.machine import MILLISECOND, Outbox
from canopen_proto.manager.programs.identity import FlashError, ProgramControl
from canopen_proto.sdo.access import Pending
from canopen_proto.simulation.boot_loader import BootDone, BootLoader, BootLoaderSettings, ProgramMemory
from canopen_transports import TransportError
from canopen_transports.errors import BUS_LOST
from tests.cli.cli_support import Alarm, Run
from tests.cli.command_examples import json_that_fits
from tests.core.block_pair import pattern

IMAGE = pattern(3000)
DEMO = ("-b", "demo")


class World:
    """The device of the commands to come. memory: what it keeps between two of them. alive: it has power."""

    def __init__(self) -> None:
        self.settings = BootLoaderSettings(erase_time=500 * MILLISECOND)
        self.memory = ProgramMemory()
        self.node_id = 5
        self.file = Path("firmware.bin")

    def make(self, out: Outbox) -> BootLoader:
        return BootLoader(out, self.node_id, self.settings, self.memory)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch, alarm: Alarm, tmp_path: Path) -> World:
    monkeypatch.chdir(tmp_path)
    world = World()
    world.file.write_bytes(IMAGE)

    @asynccontextmanager
    async def simulated(*arguments: object) -> AsyncIterator[SimulatedDevices]:
        async with simulated_devices({DEMO_LOCATOR: [world.make]}) as simulation:
            trio.lowlevel.spawn_system_task(alarm.ring, simulation)
            yield simulation

    monkeypatch.setattr(session, "simulated_drives", simulated)
    return world


def test_old_and_new_are_shown_and_the_program_is_written(run: Run, world: World) -> None:
    outcome = run("flash", "5", "firmware.bin", "--expect", "crc32", "--yes", *DEMO)
    assert outcome.status == ExitCode.OK, outcome.err
    assert outcome.out.splitlines() == [
        f"node 5 (0x05)     program 1 runs, identification 0x{crc32(b'the program of the factory'):08X}",
        f"the new one       firmware.bin: 3000 bytes, CRC-32 0x{crc32(IMAGE):08X}; identification 0x{crc32(IMAGE):08X}",
    ]
    assert "about 0.1 s at 1 Mbit/s, 0.4 s at 125 kbit/s" in outcome.err
    assert "3000 bytes written, in" in outcome.err
    assert f"verified: 0x1F56 is the expected one: 0x{crc32(IMAGE):08X}" in outcome.err
    assert "It is Pre-operational: canopen nmt start 5" in outcome.err
    assert world.memory.program == IMAGE


def test_what_is_there_is_not_written_again(run: Run, world: World) -> None:
    world.memory = ProgramMemory(IMAGE)
    outcome = run("flash", "5", "firmware.bin", "--expect", "crc32", *DEMO, "--yes")
    assert "it has this program already" in outcome.err
    assert "nothing was written" in outcome.err
    outcome = run("flash", "5", "firmware.bin", "--expect", hex(crc32(IMAGE)), *DEMO, "--yes", "--force", "--json")
    document = json_that_fits("flash", outcome)
    assert (document["written"], document["before"], document["after"]) == (True, crc32(IMAGE), crc32(IMAGE))


def test_dry_run_writes_nothing(run: Run, world: World) -> None:
    assert "nothing was written (--dry-run)" in run("flash", "5", "firmware.bin", "--dry-run", *DEMO).err
    assert json_that_fits("flash", run("flash", "5", "firmware.bin", "--dry-run", "--json", *DEMO))["written"] is False
    assert world.memory.program != IMAGE


def test_it_has_to_be_confirmed(run: Run, world: World) -> None:
    outcome = run("flash", "5", "firmware.bin", *DEMO)
    assert (outcome.status, "CO122" in outcome.err, outcome.out) == (ExitCode.USAGE, True, "")


def test_no_is_no(run: Run, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    async def answer() -> bytes:
        return b"n\n"

    monkeypatch.setattr(questions, "read_input", answer)
    monkeypatch.setattr("canopen_cli.shared.questions.is_asked", lambda screen: True)
    outcome = run("flash", "5", "firmware.bin", *DEMO)
    assert "Write it? The old program is erased." in outcome.err
    assert (outcome.status, "by you: nothing was written" in outcome.err) == (ExitCode.INTERRUPTED, True)
    assert world.memory.program != IMAGE


class WithoutStatus(BootLoader):
    """It has no flash status, and shows the same identification for ever."""

    identification = 7  # type: ignore[assignment]

    def read(self, index: int, subindex: int, now: int) -> bytes | AbortCode | Pending:
        return AbortCode.NO_SUCH_OBJECT if index == FLASH_STATUS else super().read(index, subindex, now)


def test_what_nothing_verifies_is_told_before_and_after(run: Run, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    world.settings = BootLoaderSettings(holds_clear=True, erase_time=50 * MILLISECOND, program_time=0)
    world.make = lambda out: WithoutStatus(out, 5, world.settings, world.memory)  # type: ignore[method-assign]
    outcome = run("flash", "5", "firmware.bin", "--yes", *DEMO)
    assert outcome.status == ExitCode.OK
    assert "it will be started without being verified: the device has no flash status (1F57)" in outcome.err
    assert "not verified: nothing has shown that the new program runs" in outcome.err
    assert "Try: canopen flash 5 firmware.bin --expect" in outcome.err
    document = json_that_fits("flash", run("flash", "5", "firmware.bin", "--yes", "--json", *DEMO))
    assert (document["verified"], document["verified_by"]) == (False, None)

    async def answer() -> bytes:
        return b"n\n"

    monkeypatch.setattr(questions, "read_input", answer)
    monkeypatch.setattr("canopen_cli.shared.questions.is_asked", lambda screen: True)
    assert "Nothing will verify it. Write it?" in run("flash", "5", "firmware.bin", *DEMO).err


def test_ctrl_c_says_in_which_state_the_device_is_and_the_next_command_goes_on(run: Run, world: World, alarm: Alarm) -> None:
    alarm.set((0.4, signal.SIGINT))
    outcome = run("flash", "5", "firmware.bin", "--expect", "crc32", "--yes", *DEMO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert 'it was at "clear"' in outcome.err
    assert "its old program is erased, or about to be" in outcome.err
    assert "the same command again" in outcome.err
    assert world.memory.program is None
    outcome = run("flash", "5", "firmware.bin", "--expect", "crc32", "--yes", *DEMO)
    assert (outcome.status, world.memory.program) == (ExitCode.OK, IMAGE)


def test_a_bus_that_is_lost_says_so_too(run: Run, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = flash.shown

    async def cut_off(*arguments: Any, **options: Any) -> None:
        with trio.move_on_after(0.4):
            await whole(*arguments, **options)
        raise BusError("virtual:demo", TransportError(BUS_LOST, "virtual:demo", "cannot receive on virtual:demo"))

    monkeypatch.setattr(flash, "shown", cut_off)
    outcome = run("flash", "5", "firmware.bin", "--yes", *DEMO)
    assert (outcome.status, 'it was at "clear"' in outcome.err) == (ExitCode.BUS_FAULT, True)
    assert "its old program is erased, or about to be" in outcome.err
    assert "the same command again" in outcome.err


def test_a_wrong_image(run: Run, world: World) -> None:
    outcome = run("flash", "5", "firmware.bin", "--expect", "0x12345678", "--yes", *DEMO)
    assert outcome.status == ExitCode.VERIFY_MISMATCH
    assert 'error CO214: the program download to node 5 ended at "verify"' in outcome.err
    assert "the device: it has a program that was not started" in outcome.err
    world.settings = BootLoaderSettings(judge=lambda image: FlashError.UNKNOWN_FORMAT)
    outcome = run("flash", "5", "firmware.bin", "--yes", *DEMO)
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "0x00000004: the format of the data is unknown" in outcome.err


def test_a_flash_that_stays_busy(run: Run, world: World) -> None:
    world.settings = BootLoaderSettings(program_time=10**15)
    error = run("flash", "5", "firmware.bin", "--limit", "3s", "--yes", "--json", *DEMO).error
    assert (error["code"], error["seen"]) == ("CO214", "its flash stays busy (0x1F57:01), for 3 s now")
    assert "the device: all of the new program was sent; the device has not said that it is right" in error["also"]


def test_confirm_of_zephyr(run: Run, world: World) -> None:
    world.settings = BootLoaderSettings(trial=True)
    outcome = run("flash", "5", "firmware.bin", "--expect", "crc32", "--yes", *DEMO)
    assert "runs on trial; confirm it" in outcome.err
    assert world.memory.is_on_trial
    world.memory = ProgramMemory()
    outcome = run("flash", "5", "firmware.bin", "--expect", "crc32", "--confirm", "--yes", *DEMO)
    assert (outcome.status, world.memory.is_on_trial, world.memory.program) == (ExitCode.OK, False, IMAGE)


def test_a_boot_loader_with_another_node_id_is_named(run: Run, world: World) -> None:
    class Elsewhere(BootLoader):
        """Its boot loader has node-ID 1."""

        def _on_boot_done(self, done: BootDone, now: int) -> None:
            self.take_stored(LssConfiguration(1))
            super()._on_boot_done(done, now)

    world.settings = BootLoaderSettings(jumps=(ProgramControl.STOP,))
    world.make = lambda out: Elsewhere(out, 5, world.settings, world.memory)  # type: ignore[method-assign]
    outcome = run("flash", "5", "firmware.bin", "--limit", "2s", "--yes", *DEMO)
    assert outcome.status == ExitCode.NO_ANSWER
    assert "node 1 (0x01) has appeared meanwhile" in outcome.err
    assert "canopen lss scan" in outcome.err


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (("no.bin",), "CO340", "cannot read no.bin: No such file"),
        (("empty.bin",), "CO340", "empty.bin is no program"),
        (("long.bin",), "CO340", "it has more than 4000 bytes"),
        (("firmware.bin", "--expect", "0"), "CO001", "no software identification"),
        (("firmware.bin", "--program", "255"), "CO001", "255"),
    ],
)
def test_mistakes(
    run: Run, world: World, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], code: str, text: str
) -> None:
    monkeypatch.setattr(flash, "MAX_IMAGE", 4000)
    Path("long.bin").write_bytes(bytes(4001))
    Path("empty.bin").touch()
    outcome = run("flash", "5", *arguments, "--yes", *DEMO)
    assert code in outcome.err
    assert text in outcome.err


def test_a_device_without_a_boot_loader_and_one_that_is_not_there(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "image.bin"
    file.write_bytes(IMAGE)
    assert "it has no program control (0x1F51:01)" in run("flash", "5", str(file), "--yes", *DEMO).err
    outcome = run("flash", "9", str(file), "--yes", *DEMO)
    assert (outcome.status, "does not answer reading 0x1F57:01" in outcome.err) == (ExitCode.NO_ANSWER, True)


@pytest.mark.parametrize("arguments", [("5,6", "--boot-loader"), ("--id", "5,6", "--boot-loader")])
def test_sim_serves_boot_loaders(run: Run, arguments: tuple[str, ...]) -> None:
    outcome = run("sim", *arguments, "-b", "virtual:loaders", "--seconds", "0.2", "--json")
    assert outcome.json["nodes"] == [5, 6]
    assert "2 boot loaders on virtual:loaders" in outcome.err
    assert f"runs the program 0x{crc32(b'the program of the factory'):08X}" in outcome.err
    held = run("sim", *arguments, "--hold-clear", "--erase-time", "50ms", "-b", "virtual:loaders", "--seconds", "0.1", "--json")
    assert held.json["nodes"] == [5, 6]
    assert "--hold-clear and --erase-time are for boot loaders" in run("sim", "5", "--hold-clear", "-b", "virtual:loaders").err
    assert "CO127" in run("sim", "5", "--id", "6", "--boot-loader", "-b", "virtual:loaders").err
