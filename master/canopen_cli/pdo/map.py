"""`canopen pdo map`: give a PDO of a node other objects, CAN-ID, type or times, by the sequence of CiA 301 v4.2.0, 7.5.2.36."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import click

from canopen_cli.pdo.reading import pdo_of
from canopen_cli.shared.device_type import check_type
from canopen_cli.shared.dry_run import run_or_show
from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.options import Duration, NodeOfObject, Settings, TextKind, command, commanding, with_word_at_node
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.questions import confirm
from canopen_cli.shared.screen import Screen, escape, node_text
from canopen_cli.shared.session import BusSession, open_session
from canopen_cli.shared.values import find_object
from canopen_master.errors import NodeSilentError
from canopen_master.node import Node
from canopen_master.pdo_reading import PdoRead, objects_text, read_one, times_text, type_text
from canopen_proto.cob_id import check_can_id
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.multiplexer import mapping_entry
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.pdo.configure import PdoRefusedError, configure_pdo
from canopen_proto.pdo.mapping import Mapping, MappingError
from canopen_proto.pdo.multiplexed import MAPPABLE
from canopen_proto.pdo.settings import INHIBIT_UNIT, PREDEFINED, PdoSettings, cob_id_step

_CAN_ID: Final = 0x1FFF_FFFF
_HEARTBEAT: Final = 1.5
"""Seconds to listen for the state that a node is in: longer than the usual heartbeat time."""


class CanId(TextKind):
    """The CAN-ID of a PDO: 0x185, or 389."""

    name = "can-id"

    def read(self, text: str) -> int:
        try:
            can_id = int(text, 0)
        except ValueError:
            can_id = -1
        if not 0 < can_id <= 0x7FF or check_can_id(can_id) is not None:
            raise ValueError(f"{text!r} is no CAN-ID that a PDO may have: 0x181 to 0x57F, or 0x680 to 0x6DF")
        return can_id


@dataclass(frozen=True)
class MappingChange:
    """What shall be otherwise; None: as it is. off: the PDO is switched off, and nothing else changes."""

    objects: tuple[str, ...]
    can_id: int | None
    kind: int | None
    inhibit: Time | None
    timer: Time | None
    off: bool

    def applied(self, node: Node, present: PdoSettings) -> PdoSettings:
        """Return the settings that are wanted. Raises a CommandError for what cannot be."""
        if self.off:
            return present.destroyed
        entries = tuple(entry_of(node.dictionary, each, present.direction) for each in self.objects) or present.entries
        cob_id = present.cob_id & ~COB_ID_INVALID
        if self.can_id is not None:
            cob_id = cob_id & ~_CAN_ID | self.can_id
        elif check_can_id(cob_id) is not None and present.number <= len(PREDEFINED[present.direction]):
            cob_id = cob_id & ~_CAN_ID | PREDEFINED[present.direction][present.number - 1] + node.node_id
        if check_can_id(cob_id) is not None:
            raise usage("CO310", f"{present.name} has no CAN-ID that a PDO may have", tries=("--can-id 0x...",))
        wanted = replace(
            present,
            cob_id=cob_id,
            transmission_type=present.transmission_type if self.kind is None else self.kind,
            entries=entries,
            inhibit_time=self.inhibit,
            event_time=self.timer,
        )
        try:
            Mapping.from_parameters(entries, node.dictionary)
        except MappingError as error:
            raise usage("CO310", f"cannot map this into {present.name}: {error}", seen="nothing was sent") from None
        return wanted


@command("map")
@click.argument("node_id", metavar="NODE", type=NodeOfObject())
@click.argument("words", metavar="PDO [OBJECT]...", nargs=-1)
@click.option("--can-id", type=CanId(), help="Its CAN-ID: 0x1A5. By default as it is.")
@click.option("--type", "kind", type=click.IntRange(0, 255), help="Transmission type: 1 at each SYNC, 255 by events ...")
@click.option("--inhibit", type=Duration(0, 65_535 * INHIBIT_UNIT), help="The shortest time between two: 10ms.")
@click.option("--event", "timer", type=Duration(0, 65_535 * MILLISECOND), help="The longest time between two: 100ms; 0: none.")
@click.option("--off", is_flag=True, help="Switch it off.")
@click.option("--any-device", is_flag=True, help="Also if the device is not of the type that its file (-e) describes.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@commanding
def map_pdo(
    settings: Settings,
    screen: Screen,
    node_id: int,
    words: tuple[str, ...],
    can_id: int | None,
    kind: int | None,
    inhibit: Time | None,
    timer: Time | None,
    off: bool,
    any_device: bool,
    yes: bool,
) -> None:
    """Give a PDO of a node other objects, or another CAN-ID, type or time, in the order of CiA 301.

    OBJECT: a name or a number, in the order of the bytes; 6041/8 maps its lowest 8 bits. Without objects the mapping stays. The
    node becomes Pre-operational meanwhile, and is started again if it was Operational. If it refuses a step, it gets its old
    settings back. `canopen store` keeps the new ones over power-off.

    \b
    canopen pdo map 5 tpdo2 statusword position_actual_value --type 1 --dry-run
    canopen pdo map 5:tpdo1 --event 100ms --yes
    canopen pdo map 5 rpdo3 --off --yes
    """
    named = with_word_at_node(words, node_id)
    if not named:
        raise usage("CO001", "no PDO was named", tries=(f"canopen pdo show {node_id}    (those that it has)",))
    pdo, objects = pdo_of(named[0]), named[1:]
    change = MappingChange(objects, can_id, kind, inhibit, timer, off)
    if change == MappingChange((), None, None, None, None, False):
        raise usage("CO001", "nothing to change was named", tries=(f"canopen pdo show {node_id}", "canopen pdo map --help"))
    if off and (objects or change != MappingChange((), None, None, None, None, True)):
        raise usage("CO001", "--off goes alone: the PDO keeps its mapping", tries=("the same without --off",))
    question = f"set up {pdo[0]} {pdo[1]} of {node_text(node_id)}: it becomes Pre-operational (a drive stops, or coasts)"
    confirm(screen, question, yes, needed=not settings.dry_run)
    before, after, dictionary = run_or_show(settings, screen, lambda: _map(settings, screen, node_id, pdo, change, any_device))
    if settings.json:
        screen.json({"node": node_id, "before": before.as_json(dictionary), "after": after.as_json(dictionary)})
        return
    screen.say(f"[bold]{node_text(node_id)} {after.name}[/]")
    for word, each in (("before", before), ("now", after)):
        screen.fact(word, _text(each, dictionary))


def entry_of(dictionary: ObjectDictionary, text: str, direction: Direction) -> int:
    """Return the mapping entry that a user typed: an object, and perhaps how many of its bits. Raises a CommandError, or
    ObjectNotFoundError."""
    key, _, bits = text.partition("/")
    if bits and not re.fullmatch("[0-9]{1,2}", bits):
        raise usage("CO310", f"{text!r}: the bits of an object are a number, as in 6041/8")
    variable = find_object(dictionary, key, None)
    width = int(bits) if bits else variable.bit_length
    if width is None:
        raise usage("CO310", f"{variable.label} has no fixed length", tries=(f"{key}/64    (as many of its bits)",))
    if not variable.pdo_mappable or variable.access not in MAPPABLE[direction]:
        why = f"its access is {variable.access}" if variable.pdo_mappable else "its file says that it cannot be mapped"
        raise usage("CO310", f"cannot map {variable.label} into a {direction}", seen=f"{why}; nothing was sent")
    return mapping_entry(variable.mux, width)


async def _map(
    settings: Settings, screen: Screen, node_id: int, place: tuple[Direction, int], change: MappingChange, any_device: bool
) -> tuple[PdoRead, PdoRead, ObjectDictionary]:
    async with open_session(settings, screen) as session, session.claim_to_write(node_id):
        node = session.node(node_id)
        own = session.description_of(node_id)
        if own is not None and change.objects and not any_device:  # by another device's file, names are other objects
            await check_type(session, node_id, own.dictionary, own.source)
        before = await read_one(session.master, node, *place)
        if before is None or before.settings is None:
            seen = f"node {node_id} has no {place[0]} {place[1]}" if before is None else before.remark
            raise CommandError(
                ExitCode.SDO_ABORT, "CO202", f"{place[0]} {place[1]} cannot be mapped", seen=seen,
                tries=(f"canopen pdo show {node_id} --all",), node=node_id,
            )  # fmt: skip
        wanted = change.applied(node, before.settings)
        was_operational = await _is_operational(node)
        await node.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        if change.off:
            await node.write_bytes(*cob_id_step(wanted))
        else:
            await _configure(session, node, wanted)
        if was_operational:
            await node.nmt(NmtCommand.START)
        else:
            screen.say(f"{node_text(node_id)} stays Pre-operational: canopen nmt start {node_id}")
        after = await read_one(session.master, node, *place)
        assert after is not None
        return before, after, node.dictionary


async def _configure(session: BusSession, node: Node, wanted: PdoSettings) -> None:
    try:
        await session.master.run(configure_pdo(node.remote, wanted))
    except PdoRefusedError as refused:
        problem = problem_of(refused)
        problem.also = [*problem.also, f"{node_text(node.node_id)} stays Pre-operational"]
        problem.tries = (*problem.tries, f"canopen pdo show {node.node_id}", f"canopen nmt start {node.node_id}")
        raise problem from refused


async def _is_operational(node: Node) -> bool:
    """Return whether the node shows that it is Operational. One without a heartbeat shows nothing."""
    try:
        return await node.wait_for_heartbeat(_HEARTBEAT) is NmtState.OPERATIONAL
    except NodeSilentError:
        return node.nmt_state is NmtState.OPERATIONAL


def _text(read: PdoRead, dictionary: ObjectDictionary) -> str:
    pdo = read.settings
    if pdo is None:
        return read.remark
    parts: Sequence[str] = (
        pdo.can_id_text if pdo.is_valid else f"off ({pdo.can_id_text})",
        f"{type_text(pdo)} ({pdo.transmission_type})",
        times_text(read),
        objects_text(dictionary, pdo),
    )
    return escape("; ".join(each for each in parts if each))
