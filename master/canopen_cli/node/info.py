"""`canopen info`: show identity, NMT state, errors and PDOs of a node, and what a drive does."""

from __future__ import annotations

import contextlib
from typing import Any

import click

from canopen_cli.shared.options import NodeId, Settings, command
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, node_text
from canopen_cli.shared.session import BusSession, open_session
from canopen_data.description import DeviceDescription
from canopen_master.device_types import DRIVE_PROFILE, profile_of
from canopen_master.errors import NodeSilentError
from canopen_master.identity_facts import Facts, identity_facts, read_standard
from canopen_master.node import Node
from canopen_proto import indices
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.drives.cia402.modes import describe_status, mode_name, supported_modes
from canopen_proto.error_codes import error_text, register_names
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.multiplexer import mapped
from canopen_proto.pdo.configure import InvalidPdoError, read_pdo
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.procedures.objects import ABSENT, unless_refused

MAX_HISTORY = 8
MAX_PDOS_SHOWN = 8
"""PDOs shown in each direction. A device may have 512, and the first ones show the idea."""
MAX_WAIT = 2.0
"""Seconds for a heartbeat that shows the NMT state."""


@command()
@click.argument("node_id", metavar="NODE", type=NodeId())
def info(settings: Settings, screen: Screen, node_id: int) -> None:
    """Show a node's identity, state, errors and PDOs.

    With -e FILE, also tell whether it is the device that the file describes.

    \b
    canopen info 3 -b demo
    canopen info 5 -e drive.eds -b socketcan:can0
    """
    facts = run(settings, screen, lambda: _info(settings, screen, node_id))
    if settings.json:
        screen.json({"node": node_id, **{name.replace(" ", "_").replace("-", "_"): raw for name, (raw, _) in facts.items()}})
        return
    screen.data(f"[bold]{node_text(node_id)}[/]")
    for name, (_, text) in facts.items():
        screen.fact(name, text)


async def _info(settings: Settings, screen: Screen, node_id: int) -> Facts:
    async with open_session(settings, screen) as session, session.turn(node_id):
        node = session.node(node_id)
        facts = await identity_facts(node, session.description_of(node.node_id))
        await _add_health(node, facts)
        await _add_pdos(session, node, facts)
        if profile_of(facts["device type"][0]) == DRIVE_PROFILE:
            await _add_drive(node, facts)
        return facts


async def _add_health(node: Node, facts: Facts) -> None:
    period = await read_standard(node, indices.PRODUCER_HEARTBEAT_TIME)
    if node.nmt_state is None and isinstance(period, int) and period:
        with contextlib.suppress(NodeSilentError):
            await node.wait_for_heartbeat(min(1.5 * period / 1000, MAX_WAIT))
    state = node.nmt_state
    if state is not None:
        facts["NMT state"] = (state.name, state.name.lower().replace("_", "-"))
    if isinstance(period, int):
        facts["heartbeat"] = (period, f"each {period} ms" if period else "off")
    register = await read_standard(node, indices.ERROR_REGISTER)
    if isinstance(register, int):
        names = ", ".join(register_names(register)) if register else "no error"
        facts["error register"] = (register, f"{names}  (0x{register:02X})")
    count = await read_standard(node, indices.PREDEFINED_ERROR_FIELD)
    history = []
    for subindex in range(1, min(count, MAX_HISTORY) + 1 if isinstance(count, int) else 1):
        entry = await read_standard(node, indices.PREDEFINED_ERROR_FIELD, subindex)
        if isinstance(entry, int):
            history.append(entry & 0xFFFF)
    if history:
        facts["last errors"] = (history, ", ".join(f"0x{code:04X} {error_text(code)}" for code in history))


async def _add_pdos(session: BusSession, node: Node, facts: Facts) -> None:
    """Read the PDOs that the device has set up. Those that are not valid are left out."""
    for direction in Direction:
        for number in range(1, MAX_PDOS_SHOWN + 1):
            try:
                settings = await session.master.run(unless_refused(read_pdo(node.remote, direction, number), ABSENT))
            except InvalidPdoError as strange:
                facts[f"{direction}{number}"] = (None, str(strange))
                continue
            if settings is None:
                break
            if not settings.cob_id & COB_ID_INVALID:
                facts[f"{direction}{number}"] = _pdo(settings, session.description_of(node.node_id))


def _pdo(settings: PdoSettings, description: DeviceDescription | None) -> tuple[dict[str, Any], str]:
    entries = [mapped(entry) for entry in settings.entries]
    objects = [f"{index:04X}:{subindex:02X}" for index, subindex, _ in entries]
    can_id = settings.cob_id & 0x1FFFFFFF
    raw = {"can_id": can_id, "transmission_type": settings.transmission_type, "objects": objects}
    dictionary = None if description is None else description.dictionary
    called = [_object_name(dictionary, index, subindex) for index, subindex, _ in entries]
    names = [name if called.count(name) == 1 else f"{place} {name}" for name, place in zip(called, objects, strict=True)]
    return raw, f"0x{can_id:X}, type {settings.transmission_type}: {', '.join(names) or 'nothing'}"


def _object_name(dictionary: ObjectDictionary | None, index: int, subindex: int) -> str:
    """Return the name of an object in the device's own file, else in the standard."""
    own = None if dictionary is None else dictionary.get(index, subindex)
    variable = own or find_standard(index, subindex)
    return f"{index:04X}:{subindex:02X}" if variable is None else variable.name


async def _add_drive(node: Node, facts: Facts) -> None:
    mode = await read_standard(node, 0x6061)
    statusword = await read_standard(node, 0x6041)
    if isinstance(statusword, int):
        words = describe_status(statusword, mode if isinstance(mode, int) else None)
        facts["statusword"] = (statusword, f"{', '.join(words)}  (0x{statusword:04X})")
    if isinstance(mode, int):
        facts["mode"] = (mode, mode_name(mode))
    modes = await read_standard(node, 0x6502)
    if isinstance(modes, int):
        facts["supported modes"] = (modes, ", ".join(mode_name(each) for each in supported_modes(modes)) + f"  (0x{modes:08X})")
    position = await read_standard(node, 0x6064)
    if isinstance(position, int):
        facts["position"] = (position, f"{counted(position, 'count')}")
    error = await read_standard(node, 0x603F)
    if isinstance(error, int) and error:
        facts["drive error"] = (error, f"0x{error:04X} {error_text(error)}")
