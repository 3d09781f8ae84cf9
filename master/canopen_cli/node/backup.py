"""`canopen backup`: write all values of a node into a DCF."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from canopen_cli.node.backup_reading import (
    check_indices,
    read_all,
    reading_as_json,
    reading_options,
    tell_unread,
)
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import NodeId, Settings, command
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, escape, node_text
from canopen_cli.shared.session import open_session
from canopen_master.identity_facts import DEVICE_TYPE, IDENTITY, differences, identity_in
from canopen_master.way_back import bit_rate_for_dcf, counts_text, dcf_of
from canopen_proto.indices import DEVICE_TYPE as DEVICE_TYPE_OBJECT
from canopen_proto.indices import IDENTITY_OBJECT
from canopen_proto.manager.parameters.backup import Backup, Reading
from canopen_proto.manager.parameters.walk import COMMUNICATION
from canopen_proto.multiplexer import mux
from canopen_transports import TransportError
from canopen_transports.locator import parse_locator

if TYPE_CHECKING:
    from canopen_data.description import DeviceDescription


@command()
@click.argument("node_id", metavar="NODE", type=NodeId())
@click.option("-o", "--output", metavar="FILE.dcf", required=True, help="The new file.")
@reading_options
def backup(
    settings: Settings, screen: Screen, node_id: int, output: str, indices: tuple[range, ...] | None, domains: bool
) -> int:
    """Read all values of a node into a DCF, which `canopen restore` writes back. Nothing is changed in the device.

    If another SDO client uses the node's channel meanwhile, the backup says so, and `restore` wants --force for it.
    Its objects are those of its own file (-e). Without one, the communication objects and PDOs are looked for one by one, and
    those of the data files are read; with --walk, all objects that answer at its indices. Exit status 7: an object could not be
    read, the file cannot hold its exact bytes, or another client was heard.

    \b
    canopen backup 5 -o before.dcf -e drive.eds
    canopen backup 3 -o joint1.dcf -b demo
    """
    check_indices(indices, settings.eds)
    check_new_file(settings, screen, output)
    if indices is not None:
        indices = (COMMUNICATION, *indices)  # without the PDOs it would be no backup
    found, description = run(settings, screen, lambda: read_node(settings, screen, node_id, indices, domains))
    bit_rate = bit_rate_of(settings)
    lost = write_dcf(output, found, description, bit_rate)
    other = _other_device(found, description, node_id)
    if other:
        screen.say(f"[yellow]{escape(other)}[/]")
    if settings.json:
        unread = [reading_as_json(each) for each in found.readings if each.value is None]
        counts = {str(result): number for result, number in found.counts.items()}
        document = {"node": node_id, "file": output, "bit_rate": bit_rate, "counts": counts, "not_read": unread}
        document["other_client"] = found.others_doing or None
        screen.json(document | {"not_exact": [reading_as_json(each) for each in lost]})
    else:
        tell_unread(screen, found, lost)
        screen.say(f"{escape(output)}: backup of {node_text(node_id)}, {counts_text(found)}")
    return ExitCode.OK if found.is_complete and not lost and not other else ExitCode.PARTIAL


def _other_device(found: Backup, description: DeviceDescription | None, node_id: int) -> str:
    """Return where the device contradicts the file by which it was read, in words; "" if it does not."""
    if description is None:
        return ""
    read = {each.variable.mux: each.value for each in found.readings if isinstance(each.value, int) and each.value}  # 0: not told
    places = {DEVICE_TYPE: mux(DEVICE_TYPE_OBJECT), **{name: mux(IDENTITY_OBJECT, sub) for sub, name in IDENTITY[:2]}}
    different = differences(identity_in(description, node_id), {name: read[key] for name, key in places.items() if key in read})
    if not different:
        return ""
    return f"{description.source} is the file of ANOTHER DEVICE, by {', '.join(map(str, different))}: it may have other objects"


async def read_node(
    settings: Settings, screen: Screen, node_id: int, indices: tuple[range, ...] | None, domains: bool
) -> tuple[Backup, DeviceDescription | None]:
    """Read what a node holds, as `read_all` does, and return its own file with it."""
    async with open_session(settings, screen) as session, session.claim(node_id):
        found = await read_all(session, screen, node_id, indices, domains)
        return found, session.description_of(node_id)


def bit_rate_of(settings: Settings) -> int | None:
    """Return the bit rate in kbit/s if the bus of the options gives it and a DCF can hold it, else None."""
    with suppress(TransportError):
        return bit_rate_for_dcf(parse_locator(settings.required_bus()).bitrate)
    return None


def write_dcf(output: str, found: Backup, description: DeviceDescription | None, bit_rate: int | None) -> tuple[Reading, ...]:
    """Write what was read as a DCF. Return what the file could not hold as it was read. output: the path. bit_rate: kbit/s, None:
    not known.

    description: the one used for reading; None: the data files, or a walk. Raises CommandError, also if the file is the one that
    describes the device.
    """
    made = dcf_of(found, description, Path(output).name, bit_rate, "canopen backup")
    write_file(output, made.data, *(() if description is None else (description.source,)))
    return made.lost
