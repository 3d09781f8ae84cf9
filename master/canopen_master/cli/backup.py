"""`canopen backup`: what a node holds, into a DCF."""

from __future__ import annotations

import datetime
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.markup import escape

from canopen_master.cli.backup_reading import (
    check_indices,
    counts_text,
    read_all,
    reading_as_json,
    reading_options,
    tell_unread,
)
from canopen_master.cli.options import NodeId, Settings, common
from canopen_master.cli.problem import ExitCode, Problem
from canopen_master.cli.running import run
from canopen_master.cli.screen import Screen, node_text
from canopen_master.cli.session import open_session
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.procedures.backup import Backup
from canopen_transports import TransportError
from canopen_transports.locator import parse_locator

if TYPE_CHECKING:
    from canopen_proto.dictionary.description import DeviceDescription


@click.command()
@click.argument("node_id", metavar="NODE", type=NodeId())
@click.option("-o", "--output", metavar="FILE.dcf", required=True, help="The new file.")
@reading_options
@common
@click.pass_obj
def backup(settings: Settings, node_id: int, output: str, indices: tuple[range, ...] | None, domains: bool) -> int:
    """Read all that a node holds into a DCF, which `canopen restore` writes back. Nothing is changed in the device.

    Its objects are those of its own file (-e), or of the data files; --walk asks a device of which nobody has a file. Exit
    status: 0 complete, 7 something that should be there could not be read.

    \b
    canopen backup 5 -o before.dcf -e drive.eds
    canopen backup 3 -o joint1.dcf -b demo
    """
    screen = settings.screen()
    check_indices(indices, settings.eds)
    check_place(output)
    found, description = run(settings, screen, lambda: _backup(settings, screen, node_id, indices, domains))
    bit_rate = bit_rate_of(settings)
    write_dcf(output, found, description, bit_rate)
    if settings.json:
        unread = [reading_as_json(each) for each in found.readings if each.value is None]
        counts = {str(result): number for result, number in found.counts.items()}
        screen.json({"node": node_id, "file": output, "bit_rate": bit_rate, "counts": counts, "not_read": unread})
    else:
        tell_unread(screen, found)
        screen.say(f"{escape(output)}: backup of {node_text(node_id)}, {counts_text(found)}")
    return ExitCode.OK if found.is_complete else ExitCode.PARTIAL


async def _backup(
    settings: Settings, screen: Screen, node_id: int, indices: tuple[range, ...] | None, domains: bool
) -> tuple[Backup, DeviceDescription | None]:
    async with open_session(settings, screen) as session:
        found = await read_all(session, screen, node_id, indices, domains)
        return found, session.description_of(node_id)


def check_place(output: str) -> None:
    """A Problem where a file cannot be written there; better before a long work than behind it."""
    folder = Path(output).parent
    if not folder.is_dir():
        raise Problem(
            ExitCode.BAD_FILE, "CO341", f"cannot write {output}: there is no folder {folder}", tries=("write elsewhere",)
        )


def bit_rate_of(settings: Settings) -> int | None:
    """kbit/s, where the bus of the options says it, and a DCF can."""
    from canopen_proto.dictionary.description import BIT_RATES

    with suppress(TransportError):
        bit_rate = parse_locator(settings.required_bus()).bitrate
        if bit_rate is not None and bit_rate // 1000 in BIT_RATES:
            return bit_rate // 1000
    return None


def write_dcf(output: str, found: Backup, description: DeviceDescription | None, bit_rate: int | None) -> None:
    """Write what was read as a DCF. description: by which it was read; None: by the data files, or by a walk.

    Raises Problem, also where the file would be the one that describes the device.
    """
    from canopen_master.cli.eds_files import write_file
    from canopen_proto.dictionary.configured import with_configured
    from canopen_proto.dictionary.describing import describe
    from canopen_proto.dictionary.description import Commissioning, FileKind
    from canopen_proto.dictionary.eds.writer import encode_eds, write_eds

    whole = describe(_present(found)) if description is None else description
    commissioning = whole.commissioning or Commissioning()
    if commissioning.node_id != found.node_id:
        commissioning = Commissioning(node_id=found.node_id)
    if bit_rate is not None:
        commissioning = replace(commissioning, bit_rate=bit_rate)
    old = whole.file_info
    now = datetime.datetime.now().astimezone()
    file_info = replace(
        old,
        file_name=Path(output).name,
        last_eds=old.last_eds or old.file_name,
        modification_time=now.strftime("%I:%M%p"),
        modification_date=now.strftime("%m-%d-%Y"),
        modified_by="canopen backup",
    )
    configured = with_configured(whole, found.values, commissioning, file_info=file_info)
    text = write_eds(configured, FileKind.DCF)
    write_file(output, encode_eds(text, whole.encoding), *(() if description is None else (description.source,)))


def _present(found: Backup) -> ObjectDictionary:
    """What the device has shown that it has: the data files describe more than one device has."""
    by_index: dict[int, dict[int, Variable]] = {}
    for each in found.readings:
        if each.data is not None or each.result.is_missing:
            by_index.setdefault(each.variable.index, {})[each.variable.subindex] = each.variable
    objects = found.dictionary.objects
    return ObjectDictionary(replace(objects[index], variables=variables) for index, variables in by_index.items())
