"""`canopen eds to-dcf` and `eds to-cdcf`: make the settings of one device from the description of its type."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import click

from canopen_cli.shared.eds_files import tell_faults
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import NodeId, Settings, command, option_group
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.values import as_json, object_json, parse_value, place_text, value_text
from canopen_data.configured import with_configured
from canopen_data.description import BIT_RATES, Commissioning, DeviceDescription, FileKind
from canopen_data.eds.writer import encode_eds, write_eds
from canopen_data.findings import DictionaryError
from canopen_data.named_files import DescriptionFile, open_description
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.concise import pack_concise
from canopen_proto.dictionary.download_order import download_order, settings_of
from canopen_proto.dictionary.model import Variable
from canopen_proto.multiplexer import index_of, subindex_of

Setting = tuple[Variable, Value]
MAX_MODULE: Final = 0xFFFF
MAX_TRIES: Final = 5
"""Modules that an error lists."""


_settings: Final = option_group(
    click.argument("path", metavar="FILE"),
    click.option("--id", "node_id", metavar="N", type=NodeId(), help="The device's node-ID; a DCF may have it already."),
    click.option("--set", "assignments", metavar="OBJECT=VALUE", multiple=True, help="A setting; may be repeated."),
    click.option("-o", "--output", metavar="OUT", required=True, help="The new file."),
)
"""The options that name the device and its settings."""


@command(name="to-dcf")
@_settings
@click.option("--bitrate", type=click.Choice([str(each) for each in BIT_RATES]), help="kbit/s.")
@click.option("--name", "node_name", help="What the device is called in its network.")
@click.option("--modules", metavar="N,...", help="Modular device: the number of the module in each slot; 0 for an empty one.")
def to_dcf(
    settings: Settings,
    screen: Screen,
    path: str,
    node_id: int | None,
    assignments: tuple[str, ...],
    output: str,
    bitrate: str | None,
    node_name: str | None,
    modules: str | None,
) -> None:
    """Make a DCF: this device, with this node-ID and these settings.

    \b
    canopen eds to-dcf drive.eds --id 5 --bitrate 500 --set 1017=200 -o axis5.dcf
    canopen eds to-dcf coupler.eds --id 6 --modules 1,1,4 -o coupler6.dcf
    """
    check_new_file(settings, screen, output, path)
    slots = _slots(modules)
    file = open_description(path, settings.encoding, slots)
    description = file.description
    known = {each.number: each.product_name for each in description.modules}
    if unknown := sorted({each for each in slots if each} - known.keys()):
        tries = tuple(f"{number}: {name}" for number, name in known.items()) or ("leave out --modules",)
        raise usage("CO001", f"{path} describes no module {unknown[0]}", tries=tries[:MAX_TRIES])
    commissioning = commissioned(description, node_id, path)
    if bitrate is not None:
        commissioning = replace(commissioning, bit_rate=int(bitrate))
    supported = description.device_info.bit_rates
    if commissioning.bit_rate is not None and supported and commissioning.bit_rate not in supported:
        screen.say(f"[yellow]the file does not list {commissioning.bit_rate} kbit/s among what the device supports[/]")
    if node_name is not None:
        commissioning = replace(commissioning, node_name=node_name)
    chosen = _assigned(file, assignments)
    configured = with_configured(description, {variable.mux: value for variable, value in chosen}, commissioning)
    text = write_eds(configured, FileKind.DCF)
    write_file(output, encode_eds(text, description.encoding), path)
    if settings.json:
        document = {"file": path, "output": output, "node": commissioning.node_id, "bit_rate": commissioning.bit_rate}
        screen.json(document | {"settings": [_as_json(each) for each in chosen]})
        return
    tell_faults(screen, file)
    for variable, value in chosen:
        screen.say(f"  {place_text(variable)} {escape(variable.name)} = {escape(value_text(variable, value))}")
    screen.say(f"{escape(output)}: DCF of node {commissioning.node_id}, {counted(len(chosen), 'new setting')}")


@command(name="to-cdcf")
@_settings
def to_cdcf(
    settings: Settings, screen: Screen, path: str, node_id: int | None, assignments: tuple[str, ...], output: str
) -> None:
    """Make a concise DCF: the bytes that object 0x1F22 of a configuration manager takes.

    It holds the values that the DCF configures and those of --set, in an order in which the device can take them.

    \b
    canopen eds to-cdcf axis5.dcf -o axis5.cdcf
    canopen eds to-cdcf drive.eds --id 5 --set 1017=200 -o axis5.cdcf
    """
    check_new_file(settings, screen, output, path)
    file = open_description(path, settings.encoding)
    if file.description.lost_settings:
        raise DictionaryError(file.description.lost_settings, f"correct it: canopen eds lint {path}")
    commissioning = commissioned(file.description, node_id, path)
    assert commissioning.node_id is not None
    dictionary = file.description.dictionary
    chosen = {variable.mux: value for variable, value in _assigned(file, assignments)}
    order = download_order(dictionary, settings_of(dictionary, commissioning.node_id) | chosen, commissioning.node_id)
    left = [(f"{index_of(key):04X}:{subindex_of(key):02X}", reason) for key, reason in sorted(order.left_out.items())]
    data = pack_concise(order.writes)
    write_file(output, data, path)
    if settings.json:
        left_out = [{"object": place, "reason": reason} for place, reason in left]
        document = {"file": path, "output": output, "node": commissioning.node_id, "bytes": len(data)}
        screen.json(document | {"writes": len(order.writes), "left_out": left_out})
        return
    tell_faults(screen, file)
    for place, reason in left:
        screen.detail(f"left out: {place}, {reason}")
    if not order.writes:
        screen.say("[yellow]nothing is configured[/]: name settings with --set, or take a DCF with ParameterValue entries")
    screen.say(f"{escape(output)}: {counted(len(order.writes), 'write')}, {counted(len(data), 'byte')}")


def _slots(text: str | None) -> tuple[int, ...]:
    """Return the numbers of --modules."""
    parts = [] if text is None else [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and int(part) <= MAX_MODULE for part in parts):
        raise usage("CO001", f"--modules {text}: it is a list of numbers", tries=("--modules 1,1,4",))
    return tuple(map(int, parts))


def commissioned(description: DeviceDescription, node_id: int | None, path: str) -> Commissioning:
    """Return how a device is set up in its network. node_id: replaces that of the file. Raises a CommandError without one."""
    commissioning = description.commissioning or Commissioning()
    if node_id is not None:
        return replace(commissioning, node_id=node_id)
    if commissioning.node_id is None:
        raise usage("CO120", f"{path} names no node-ID", tries=("--id 5",))
    return commissioning


def _assigned(file: DescriptionFile, assignments: tuple[str, ...]) -> list[Setting]:
    """Return the values of --set. Raises CommandError, ObjectNotFoundError, ConstantNotFoundError, ValueRangeError."""
    dictionary = file.description.dictionary
    found: list[Setting] = []
    for text in assignments:
        key, equals, value_shown = text.partition("=")
        if not equals:
            raise usage("CO001", f"{text!r} is not of the form OBJECT=VALUE", tries=("--set 1017=200",))
        variable = dictionary.variable(key.strip())
        value = parse_value(dictionary, variable, value_shown.strip())
        if not variable.access.writable:
            raise usage("CO303", f"{variable.label} is {variable.access}: it cannot be written")
        variable.encode(value)
        variable.check_limits(value)
        found.append((variable, value))
    return found


def _as_json(setting: Setting) -> dict[str, Any]:
    variable, value = setting
    return object_json(variable) | {"value": as_json(variable, value)}
