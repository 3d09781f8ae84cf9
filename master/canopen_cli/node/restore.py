"""`canopen restore`: write the settings of a DCF to a node, in the order in which a device takes them."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import Any

import click

from canopen_cli.node.backup_reading import shown
from canopen_cli.node.restore_output import show, story, tell_unread, told
from canopen_cli.shared.device_type import check_type
from canopen_cli.shared.options import NodeId, Settings, command, commanding
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.questions import confirm
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, node_text
from canopen_cli.shared.session import BusSession, open_session
from canopen_cli.shared.withholding import kept_back
from canopen_data.configured import moved_to
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.download_order import settings_of
from canopen_proto.manager.parameters.backup import ObjectRead
from canopen_proto.manager.parameters.restore import ObjectRestored, Restoration, plan_restore
from canopen_proto.manager.parameters.restore import restore as carry_out
from canopen_proto.multiplexer import Mux


@dataclass(frozen=True)
class SettingsToRestore:
    """The settings to restore. values: of `dictionary`, by mux. options: of `plan_restore`."""

    node_id: int
    path: str
    dictionary: ObjectDictionary
    values: Mapping[Mux, Value]
    options: Mapping[str, Any]
    any_device: bool
    verify: bool
    store: bool
    dry_run: bool


@command()
@click.argument("node_id", metavar="NODE", type=NodeId())
@click.argument("path", metavar="FILE")
@click.option("--verify", is_flag=True, help="Read each object back; exit status 13 where it is not what was written.")
@click.option("--store", is_flag=True, help="Have the device keep its parameters over power-off (1010:01), at the end.")
@click.option("--all", "everything", is_flag=True, help="Write also what the device has already, if it could be read.")
@click.option("--process-data", is_flag=True, help="Write set-points and outputs too: OUTPUTS SWITCH.")
@click.option("--skip", metavar="OBJECT", multiple=True, help="Leave this object out; may be repeated.")
@click.option("--to-node", "to", metavar="NODE", type=NodeId(), help="Write this node, not the file's; its COB-IDs move along.")
@click.option("--any-device", is_flag=True, help="Also to a node, or a type of device, that the file is not of.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@commanding
def restore(
    settings: Settings,
    screen: Screen,
    node_id: int,
    path: str,
    verify: bool,
    store: bool,
    everything: bool,
    process_data: bool,
    skip: tuple[str, ...],
    to: int | None,
    any_device: bool,
    yes: bool,
) -> int:
    """Write those settings of a DCF or XDC to a node that differ from its own.

    The node becomes Pre-operational meanwhile; PDOs that change are disabled first and enabled last. If something fails, the rest
    is not written, and the node stays Pre-operational. If all goes well, it is put back into the state that it was in.
    Set-points, outputs, commands and read-only objects are not written, nor objects that could not be read before. A file of
    another node-ID, or of another type of device, is refused; so is, without --force, a backup that another SDO client has
    disturbed, and a file with a setting that cannot be read. Exit status: 7 if something was left out that could not be read.

    \b
    canopen restore 5 before.dcf --dry-run
    canopen restore 5 before.dcf --verify --store --yes
    canopen restore 5 before.dcf --to-node 6
    """
    dictionary = settings_in(path, node_id, any_device, settings.encoding, forced=settings.force)
    if to is not None:
        dictionary, node_id = moved_to(dictionary, node_id, to), to
    values = settings_of(dictionary, node_id)
    options = {"everything": everything, "process_data": process_data, "skip": {dictionary.variable(key).mux for key in skip}}
    wanted = SettingsToRestore(node_id, path, dictionary, values, options, any_device, verify, store, settings.dry_run)
    question = f"restore {node_text(node_id)} from {path}: it becomes Pre-operational (a drive stops, or coasts), and is written"
    confirm(screen, question, yes, needed=not settings.dry_run)
    so_far: list[Restoration] = []
    failure: Exception | None = None
    with kept_back() as unsent:
        try:
            run(settings, screen, lambda: _restore(settings, screen, wanted, so_far), story=lambda confirmed: story(so_far))
        except Exception as error:  # noqa: BLE001 - raised below, after the list of what was written
            failure = error
    if so_far:
        show(screen, so_far[0], path, unsent=unsent if settings.dry_run else None)
    if failure is not None:
        raise told(failure, so_far, path) from failure
    return ExitCode.PARTIAL if tell_unread(screen, dictionary, so_far[0]) else ExitCode.OK


def settings_in(path: str, node_id: int, any_node: bool, encoding: str, *, forced: bool) -> ObjectDictionary:
    """Return the dictionary of a file. Raises a CommandError if the file is of another node, sets nothing, or is a backup that
    another SDO client has disturbed; DictionaryError if one of its settings cannot be read.

    any_node: take the file of another node, too. encoding: "" for a guess. forced: take also a disturbed backup, and a file with
    settings that cannot be read.
    """
    from canopen_data.backup_file import disturbance_of
    from canopen_data.findings import DictionaryError
    from canopen_data.named_files import open_description

    description = open_description(path, encoding).description
    named = description.node_id
    if named is not None and named != node_id and not any_node:
        raise usage(
            "CO128",
            f"{path} is of {node_text(named)}, not of {node_text(node_id)}",
            cause="its COB-IDs are those of the other node, and no two nodes may have the same",
            tries=(
                f"canopen restore {named} {path}",
                f"canopen restore {named} {path} --to-node {node_id}    (its COB-IDs become those of node {node_id})",
                "--any-device, to write it as it is",
            ),
        )
    others_doing = disturbance_of(description.file_info)
    if others_doing and not forced:
        raise usage(
            "CO137",
            f"{path} is a backup that another SDO client has disturbed; nothing was written",
            seen=f"it {others_doing} while the backup was made, and may have changed what was read",
            tries=(
                f"canopen backup {node_id} -o again.dcf    (with the other program ended)",
                "--force, to write it all the same",
            ),
        )
    if description.lost_settings and not forced:
        tries = (f"correct it: canopen eds lint {path}", "--force, to write the others")
        raise DictionaryError(description.lost_settings, *tries)
    if not any(each.configured is not None for each in description.dictionary):
        raise usage(
            "CO129",
            f"{path} sets nothing",
            seen=f"it is a file of kind {description.kind}, without any ParameterValue",
            tries=(
                f"canopen backup {node_id} -o before.dcf    (makes a file that does)",
                f"canopen eds to-dcf {path} --id {node_id} --set OBJECT=VALUE -o new.dcf",
            ),
        )
    return description.dictionary


async def _restore(settings: Settings, screen: Screen, wanted: SettingsToRestore, so_far: list[Restoration]) -> None:
    async with open_session(settings, screen) as session, _claim(session, wanted):
        if not wanted.any_device:
            await check_type(session, wanted.node_id, wanted.dictionary, wanted.path)
        node = session.node(wanted.node_id).remote
        planning = plan_restore(node, wanted.dictionary, wanted.values, **wanted.options)
        plan = await shown(session, screen, f"reading {node_text(wanted.node_id)}", planning, ObjectRead)
        so_far.append(Restoration(plan))
        nmt = session.master.nmt_master(session.master.bus())
        writing = carry_out(node, nmt, plan, so_far[0], verify=wanted.verify, store=wanted.store)
        await shown(session, screen, f"writing {node_text(wanted.node_id)}", writing, ObjectRestored)


def _claim(session: BusSession, wanted: SettingsToRestore) -> AbstractAsyncContextManager[None]:
    """Have the node, to write it; or a channel of it for a dry run, which only reads."""
    if wanted.dry_run:
        return session.claim(wanted.node_id, wanted.dictionary)
    return session.claim_to_write(wanted.node_id)
