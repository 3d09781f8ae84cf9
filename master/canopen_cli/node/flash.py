"""`canopen flash`: write a new program (firmware) into a device, by program download (CiA 302-3)."""

from __future__ import annotations

import math
from binascii import crc32
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import click
import trio
from rich.progress import DownloadColumn, TimeRemainingColumn, TransferSpeedColumn

from canopen_cli.node.backup_reading import shown
from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.options import FILE, Duration, NodeId, Settings, TextKind, command, commanding
from canopen_cli.shared.problem import CommandError, ExitCode, cannot_read
from canopen_cli.shared.questions import Questions, require_somebody
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape, node_text
from canopen_cli.shared.session import BusSession, open_session
from canopen_master.errors import BusError
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.machine import SECOND, Time
from canopen_proto.manager.programs.download import (
    CONFIRM_ADVICE,
    MAX_PROGRAM,
    DownloadLimits,
    ProgramDownload,
    ProgramDownloadError,
    ProgramProgress,
    ProgramStep,
    download_program,
    least_duration,
    look,
)
from canopen_proto.manager.programs.identity import ProgramControl
from canopen_proto.manager.programs.objects import ProgramFound
from canopen_transports import TransportError
from canopen_transports.locator import parse_locator

CRC32: Final = "crc32"
MAX_IMAGE: Final = 64 << 20
"""Bytes; no file of this size is the program of a CANopen device."""
COLUMNS: Final = (DownloadColumn, TransferSpeedColumn, TimeRemainingColumn)
BIT_RATES: Final = (1_000_000, 125_000)
"""For the estimate where the bus does not tell its own."""
UNVERIFIABLE: Final = (
    "it will be started without being verified: the device has no flash status (1F57), and --expect is not given"
)
AGAIN: Final = "the same command again: it finds out what is left to do"
STATES: Final[dict[int, str]] = {
    ProgramControl.STOP: "stopped",
    ProgramControl.START: "runs",
    ProgramControl.CLEAR: "erased",
    ProgramControl.CONFIRM: "runs on trial",
}


class Identification(TextKind):
    """A software identification: a number, or "crc32" for the CRC-32 of the file, which becomes None here."""

    name = "id"

    def read(self, text: str) -> int | str:
        if text == CRC32:
            return CRC32
        try:
            number = int(text, 0)
        except ValueError:
            number = -1
        if not 0 < number <= 0xFFFF_FFFF:
            raise ValueError(f"{text!r} is no software identification: 1 to 0xFFFFFFFF, or {CRC32}")
        return number


@dataclass(frozen=True)
class ProgramToFlash:
    """The program to write. expected: its identification, or None. confirm, limits: as of `download_program`."""

    node_id: int
    program: int
    path: Path
    image: bytes
    expected: int | None
    confirm: bool
    limits: DownloadLimits

    def is_in(self, found: ProgramFound) -> bool:
        """Return whether the device has this program already, as far as can be told."""
        return found.is_valid and self.expected is not None and found.identification == self.expected

    def is_unverifiable(self, found: ProgramFound) -> bool:
        """Return whether nothing can tell, before the start, that the new program is right."""
        return self.expected is None and found.status is None


@command()
@click.argument("node_id", metavar="NODE", type=NodeId())
@click.argument("path", metavar="IMAGE", type=FILE)
@click.option("--program", type=click.IntRange(1, MAX_PROGRAM), default=1, show_default=True, help="Which program of the device.")
@click.option(
    "--expect",
    type=Identification(),
    help=f"The identification (1F56) of the new program: a number; or {CRC32}, if the device shows that of the file.",
)
@click.option("--confirm", is_flag=True, help="Zephyr with MCUboot: keep the new program beyond the next reset (0x80 in 1F51).")
@click.option("--limit", type=Duration(SECOND), help="For one operation of its flash, and for its boot.  [default: 30s, 20s]")
@click.option("--yes", is_flag=True, help="Do not ask.")
@commanding
def flash(
    settings: Settings,
    screen: Screen,
    node_id: int,
    path: Path,
    program: int,
    expect: int | str | None,
    confirm: bool,
    limit: Time | None,
    yes: bool,
) -> int:
    """Write a new program (firmware) into a device that takes it by CiA 302-3, and start it.

    The file is written as it is. The device becomes Pre-operational, its old program is erased, and it boots at the end. If
    something fails or is interrupted, the same command again finds out what is left to do. With --expect nothing is written to a
    device that runs this program already (unless --force), and a program that shows another identification is not started.
    Without it only a change of 1F56, 100A or 1018:03 shows that the new program runs: if none changes, it is "not verified".

    \b
    canopen flash 5 firmware.bin --expect 0x12345678 -b can0
    canopen sim 5 --boot-loader -b udp_multicast      a device to try it on
    canopen flash 5 new.bin --expect crc32 -b udp_multicast
    """
    image = image_in(path)
    limits = DownloadLimits() if limit is None else replace(DownloadLimits(), busy=limit, start=limit)
    expected = crc32(image) if expect == CRC32 else expect
    assert not isinstance(expected, str)
    wanted = ProgramToFlash(node_id, program, path, image, expected, confirm, limits)
    require_somebody(screen, f"write a program into {node_text(node_id)}: its old one is erased", yes or settings.dry_run)
    so_far = ProgramDownload(len(image))
    questions = Questions(screen, agrees=yes)
    try:
        run(settings, screen, lambda: _flash(settings, screen, questions, wanted, so_far), story=lambda _: story(so_far))
    except ProgramDownloadError as failed:
        problem = problem_of(failed)
        if failed.so_far.step is not ProgramStep.LOOK and not failed.is_mismatch:
            problem.tries = (*problem.tries, AGAIN)
        raise problem from failed
    except (BusError, TransportError) as lost:
        for each in story(so_far):
            lost.add_note(each)
        raise
    return ExitCode.OK


def image_in(path: Path) -> bytes:
    """Return the content of a file. Raises a CommandError if it cannot be a program."""
    try:
        with path.open("rb") as file:
            image = file.read(MAX_IMAGE + 1)  # not the size that the file tells: that of /dev/zero is 0
    except OSError as error:
        raise cannot_read(path, error) from error
    if not 0 < len(image) <= MAX_IMAGE:
        seen = f"it has more than {MAX_IMAGE} bytes" if image else "it is empty"
        raise CommandError(ExitCode.BAD_FILE, "CO340", f"{path} is no program", seen=seen, tries=("check the path",))
    return image


def story(so_far: ProgramDownload) -> list[str]:
    """Tell in which state an interrupted download has left the device, and how to go on."""
    if so_far.found is None:
        return ["nothing was written"]
    if so_far.is_done:
        return [f"the program is written; {so_far.remark or 'it runs'}"]
    share = f", {so_far.delivered} of {counted(so_far.size, 'byte')}" if 0 < so_far.delivered < so_far.size else ""
    return [f'it was at "{so_far.step}"{share}', f"the device: {so_far.left}", AGAIN]


async def _flash(
    settings: Settings, screen: Screen, questions: Questions, wanted: ProgramToFlash, so_far: ProgramDownload
) -> None:
    async with (
        open_session(settings, screen) as session,
        session.claim_to_write(wanted.node_id),
        session.claim_state(wanted.node_id),
    ):
        node, nmt = session.node(wanted.node_id).remote, session.master.nmt_master(session.master.bus())
        found = await session.master.run(look(node, wanted.program))
        if not settings.json:
            _show_plan(settings, screen, wanted, found)
        if settings.dry_run:
            screen.say("nothing was written (--dry-run)")
            if settings.json:
                screen.json(_as_json(wanted, found, None))
            return
        is_there = wanted.is_in(found) and not settings.force
        if not is_there or found.control != ProgramControl.START:
            what = "Start it?" if is_there else "Write it? The old program is erased."
            what = f"Nothing will verify it. {what}" if wanted.is_unverifiable(found) else what
            if not await questions.may(f"{what} The device boots (a drive stops, or coasts)."):
                raise CommandError(ExitCode.INTERRUPTED, "CO132", "by you: nothing was written")
        downloading = download_program(
            node,
            nmt,
            wanted.image,
            so_far,
            program=wanted.program,
            expected_id=wanted.expected,
            force=settings.force,
            unverified=questions.agrees or wanted.is_unverifiable(found),  # asked above
            confirm=wanted.confirm,
            limits=wanted.limits,
        )
        begun, present = trio.current_time(), _heard_nodes(session)
        try:
            await shown(session, screen, node_text(wanted.node_id), downloading, ProgramProgress, columns=COLUMNS)
        except ProgramDownloadError as failed:
            for each in sorted(_heard_nodes(session) - present) if failed.is_silent else ():
                failed.add_note(f"{node_text(each)} has appeared meanwhile: is it the boot loader of this device?")
            raise
        _show_result(settings, screen, wanted, found, so_far, trio.current_time() - begun)


def _heard_nodes(session: BusSession) -> set[int]:
    return {each for each in range(1, MAX_NODE_ID + 1) if session.network.heard(each).time is not None}


# ---- what it shows ----


def _show_plan(settings: Settings, screen: Screen, wanted: ProgramToFlash, found: ProgramFound) -> None:
    """Show what the device has, and what it is to get."""
    control = found.control or 0
    state = STATES.get(control, f"0x{control:02X}")
    status = "" if found.is_valid or found.status is None else f"; flash status: {found.status.text}"
    old = f"program {wanted.program} {state}, identification {_id_text(found.identification)}{status}"
    screen.fact(node_text(wanted.node_id), old)
    new = f"{counted(len(wanted.image), 'byte')}, CRC-32 0x{crc32(wanted.image):08X}"
    expected = "not compared (--expect)" if wanted.expected is None else f"0x{wanted.expected:08X}"
    screen.fact("the new one", f"{wanted.path}: {new}; identification {expected}")
    if wanted.is_in(found) and not settings.force:
        screen.say("it has this program already")
    else:
        screen.say(f"[dim]{_estimate(settings, len(wanted.image))}[/]")
    if wanted.is_unverifiable(found):
        screen.say(f"[yellow]{UNVERIFIABLE}[/]")


def _estimate(settings: Settings, size: int) -> str:
    """Return how long it takes, in words."""
    bitrate = None
    with suppress(TransportError):
        bitrate = parse_locator(settings.required_bus()).bitrate
    rates = BIT_RATES if bitrate is None else (bitrate,)
    times = ", ".join(f"{math.ceil(least_duration(size, rate) * 10 / SECOND) / 10:g} s at {_rate_text(rate)}" for rate in rates)
    return f"about {times}, twice that without block transfer; and the time for erasing and checking"


def _rate_text(bitrate: int) -> str:
    return f"{bitrate / 1e6:g} Mbit/s" if bitrate >= 1_000_000 else f"{bitrate / 1e3:g} kbit/s"


def _show_result(
    settings: Settings, screen: Screen, wanted: ProgramToFlash, found: ProgramFound, so_far: ProgramDownload, seconds: float
) -> None:
    if settings.json:
        screen.json(_as_json(wanted, found, so_far) | {"seconds": round(seconds, 3)})
        return
    who = node_text(wanted.node_id)
    if not so_far.is_needed:
        screen.say(f"{who}: it runs, nothing was written")
    else:
        what = f"{counted(so_far.size, 'byte')} written" if so_far.writes else "it was there already, and was started"
        rewritten = f", the data {so_far.writes} times" if so_far.writes > 1 else ""
        ids = f"{_id_text(found.identification)} [bold]→ {_id_text(so_far.id_after)}[/]"
        screen.say(f"{who}: {what}{rewritten}, in {seconds:.1f} s. Identification {ids}")
        screen.say(f"It is Pre-operational: canopen nmt start {wanted.node_id}")
    if so_far.verified_by:
        screen.say(f"verified: {so_far.verified_by}")
    if so_far.remark:
        screen.say(f"[yellow]{escape(so_far.remark)}[/]")
        options = [] if so_far.verified_by else ["--expect, with the identification of the new program"]
        options += ["--confirm, with the same --expect"] if CONFIRM_ADVICE in so_far.remark else []
        for each in options:
            screen.say(f"Try: canopen flash {wanted.node_id} {escape(str(wanted.path))} {each}")


def _id_text(identification: int | None) -> str:
    return "none" if not identification else f"0x{identification:08X}"


def _as_json(wanted: ProgramToFlash, found: ProgramFound, so_far: ProgramDownload | None) -> dict[str, Any]:
    return {
        "node": wanted.node_id,
        "program": wanted.program,
        "file": str(wanted.path),
        "size": len(wanted.image),
        "crc32": crc32(wanted.image),
        "expected": wanted.expected,
        "before": found.identification,
        "state_before": found.control,
        "after": None if so_far is None else so_far.id_after,
        "verified": so_far is not None and bool(so_far.verified_by),
        "verified_by": (so_far.verified_by or None) if so_far is not None else None,
        "written": so_far is not None and so_far.writes > 0,
        "remark": (so_far.remark or None) if so_far is not None else None,
    }
