"""`canopen info`: show identity, NMT state, errors and PDOs of a node, and what a drive does."""

from __future__ import annotations

import contextlib
from typing import Any

import click

from canopen_cli.shared.device_types import DRIVE_PROFILE, device_type_text, profile_of
from canopen_cli.shared.file_identity import IDENTITY, differences, identity_in
from canopen_cli.shared.options import NodeId, Settings, common
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, node_text
from canopen_cli.shared.session import BusSession, open_session
from canopen_data.description import DeviceDescription
from canopen_master.errors import NodeSilentError, SdoRefusedError
from canopen_master.node import Node
from canopen_proto import indices
from canopen_proto.datatypes import DataType, Value, ValueRangeError, decode, text_for_people
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.drives.cia402.modes import describe_status, mode_name, supported_modes
from canopen_proto.error_codes import error_text, register_names
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.multiplexer import mapped
from canopen_proto.pdo.configure import InvalidPdoError, read_pdo
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.procedures.steps import SdoTransferError

MAX_HISTORY = 8
MAX_PDOS_SHOWN = 8
"""PDOs shown in each direction. A device may have 512, and the first ones show the idea."""
MAX_WAIT = 2.0
"""Seconds for a heartbeat that shows the NMT state."""

Facts = dict[str, tuple[Any, str]]
"""Facts about a node: a name for people -> (value for --json, text for people)."""


@click.command()
@click.argument("node_id", metavar="NODE", type=NodeId())
@common
@click.pass_obj
def info(settings: Settings, node_id: int) -> None:
    """Show a node's identity, state, errors and PDOs.

    With -e FILE, also tell whether it is the device that the file describes.
    """
    screen = settings.screen()
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
        facts = await identity_facts(session, node)
        await _add_health(node, facts)
        await _add_pdos(session, node, facts)
        if profile_of(facts["device type"][0]) == DRIVE_PROFILE:
            await _add_drive(node, facts)
        return facts


async def identity_facts(session: BusSession, node: Node) -> Facts:
    """Return what a node says it is, and whether its file (if it has one) is that of such a device."""
    # Every device has this object: if the node does not answer, it is not there, and the error says so.
    device_type = int.from_bytes(await node.read_bytes(indices.DEVICE_TYPE), "little")
    facts: Facts = {"device type": (device_type, f"{device_type_text(device_type)}  (0x{device_type:08X})")}
    for name, index in (
        ("name", indices.MANUFACTURER_DEVICE_NAME),
        ("hardware version", indices.MANUFACTURER_HARDWARE_VERSION),
        ("software version", indices.MANUFACTURER_SOFTWARE_VERSION),
    ):
        text = await _standard(node, index)
        if isinstance(text, str) and (shown := text_for_people(text, DataType.VISIBLE_STRING).rstrip("\0 ")):
            facts[name] = (shown, shown)
    for subindex, name in IDENTITY:
        number = await _standard(node, indices.IDENTITY_OBJECT, subindex)
        if isinstance(number, int):
            facts[name] = (number, f"0x{number:08X}")
    description = session.description_of(node.node_id)
    if description is not None:
        facts["file"] = _compared(description, facts, node.node_id)
    return facts


def _compared(description: DeviceDescription, facts: Facts, node_id: int) -> tuple[dict[str, Any], str]:
    """Compare the identity of the node with its file. A number that the file lacks, or has as 0, fits every node."""
    known = identity_in(description, node_id)
    different = differences(known, {name: raw for name, (raw, _) in facts.items() if isinstance(raw, int)})
    is_compared = any(name in facts for name in known)
    raw = {
        "name": description.source,
        "matches": not different if is_compared else None,
        "different": [each._asdict() for each in different],
    }
    if not is_compared:
        return raw, f"{description.source}: it gives no identity of the device"
    if not different:
        return raw, f"{description.source}: MATCH"
    return raw, f"{description.source}: ANOTHER DEVICE by {', '.join(map(str, different))}"


async def _add_health(node: Node, facts: Facts) -> None:
    period = await _standard(node, indices.PRODUCER_HEARTBEAT_TIME)
    if node.nmt_state is None and isinstance(period, int) and period:
        with contextlib.suppress(NodeSilentError):
            await node.wait_for_heartbeat(min(1.5 * period / 1000, MAX_WAIT))
    state = node.nmt_state
    if state is not None:
        facts["NMT state"] = (state.name, state.name.lower().replace("_", "-"))
    if isinstance(period, int):
        facts["heartbeat"] = (period, f"each {period} ms" if period else "off")
    register = await _standard(node, indices.ERROR_REGISTER)
    if isinstance(register, int):
        names = ", ".join(register_names(register)) if register else "no error"
        facts["error register"] = (register, f"{names}  (0x{register:02X})")
    count = await _standard(node, indices.PREDEFINED_ERROR_FIELD)
    history = []
    for subindex in range(1, min(count, MAX_HISTORY) + 1 if isinstance(count, int) else 1):
        entry = await _standard(node, indices.PREDEFINED_ERROR_FIELD, subindex)
        if isinstance(entry, int):
            history.append(entry & 0xFFFF)
    if history:
        facts["last errors"] = (history, ", ".join(f"0x{code:04X} {error_text(code)}" for code in history))


async def _add_pdos(session: BusSession, node: Node, facts: Facts) -> None:
    """Read the PDOs that the device has set up. Those that are not valid are left out."""
    for direction in Direction:
        for number in range(1, MAX_PDOS_SHOWN + 1):
            try:
                settings = await session.master.run(read_pdo(node.remote, direction, number))
            except SdoTransferError as failed:
                if failed.abort_code in ABSENT:
                    break
                raise
            except InvalidPdoError as strange:
                facts[f"{direction}{number}"] = (None, str(strange))
                continue
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
    mode = await _standard(node, 0x6061)
    statusword = await _standard(node, 0x6041)
    if isinstance(statusword, int):
        words = describe_status(statusword, mode if isinstance(mode, int) else None)
        facts["statusword"] = (statusword, f"{', '.join(words)}  (0x{statusword:04X})")
    if isinstance(mode, int):
        facts["mode"] = (mode, mode_name(mode))
    modes = await _standard(node, 0x6502)
    if isinstance(modes, int):
        facts["supported modes"] = (modes, ", ".join(mode_name(each) for each in supported_modes(modes)) + f"  (0x{modes:08X})")
    position = await _standard(node, 0x6064)
    if isinstance(position, int):
        facts["position"] = (position, f"{position} counts")
    error = await _standard(node, 0x603F)
    if isinstance(error, int) and error:
        facts["drive error"] = (error, f"0x{error:04X} {error_text(error)}")


async def _standard(node: Node, index: int, subindex: int = 0) -> Value | None:
    """Read an object with the type of the standard; None if the device refuses."""
    try:
        data = await node.read_bytes(index, subindex)
    except SdoRefusedError:
        return None
    variable = find_standard(index, subindex)
    data_type = variable.data_type if variable is not None else DataType.OCTET_STRING
    try:
        return decode(data, data_type)
    except ValueRangeError:
        return None
