"""`canopen drive inputs NODE|outputs|probe`: digital inputs and outputs, touch probes. None of them moves the drive."""

from __future__ import annotations

import re
from collections.abc import Mapping

import click

from canopen_cli.drive.session import command_drive, read_drive, unit_of_command
from canopen_cli.shared.options import Duration, Settings, command, commanding
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.screen import Screen
from canopen_proto.drives import axis as procedures
from canopen_proto.drives.axis import ProbeReading, ProbeSource
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.digital_io import brake_of
from canopen_proto.drives.axis.identity import identify
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import SECOND, Time
from canopen_proto.multiplexer import Mux, index_of
from canopen_proto.procedures.objects import read_if_present
from canopen_proto.procedures.steps import Cancelled, Procedure

_BITS = 32
_CHANGE = re.compile(r"([0-9]{1,2})=([01])")
_INPUTS = {0: "negative limit switch", 1: "positive limit switch", 2: "home switch", 3: "interlock"}
_OUTPUTS = {0: "brake: 1 holds"}
_SOURCES = {"input": ProbeSource.INPUT, "index": ProbeSource.INDEX, "selected": ProbeSource.SELECTED}


@command()
def inputs(settings: Settings, screen: Screen) -> None:
    """Show the digital inputs of a drive (0x60FD).

    \b
    canopen drive inputs 3 -b demo
    """
    word = read_drive(settings, screen, lambda node: _read_own(node, objects.DIGITAL_INPUTS, "digital inputs"))
    if settings.json:
        screen.json({"inputs": word, "active": [_name(_INPUTS, bit) for bit in range(_BITS) if word >> bit & 1]})
        return
    _show_bits(screen, _INPUTS, word)


@command()
@click.argument("changes", metavar="[BIT=0|1]...", nargs=-1)
@click.option("--cannot-fall", is_flag=True, help="The brake may be opened: this axis cannot fall.")
@commanding
def outputs(settings: Settings, screen: Screen, changes: tuple[str, ...], cannot_fall: bool) -> None:
    """Show the digital outputs of a drive (0x60FE); with BIT=0 or BIT=1 set some of them.

    A bit that is set here is also set in the mask (0x60FE:02): from then on the drive leaves this output to the master. The
    others stay as they are.

    \b
    canopen drive outputs 5 -b can0
    canopen drive outputs 5 16=1 -b can0
    """
    wanted = _changes(changes)

    def read(node: AxisNode) -> Procedure[tuple[int, int | None]]:
        word = yield from _read_own(node, objects.DIGITAL_OUTPUTS, "digital outputs")
        mask = yield from read_if_present(node, objects.DIGITAL_OUTPUT_MASK)
        return word, mask if isinstance(mask, int) else None

    def change(axis: Axis) -> Procedure[tuple[int, int | None]]:
        yield from identify(axis)
        yield from read(axis.node)
        brake = brake_of(axis)
        if not cannot_fall and wanted.get(brake.bit, brake.value) != brake.value:
            raise usage(
                "CO120",
                f"output {brake.bit} is the brake of drive {axis.node.node_id}: nothing would hold the axis behind this command",
                tries=("--cannot-fall, for an axis that cannot fall", "set_outputs in a program that keeps the drive enabled"),
            )
        yield from procedures.set_outputs(axis, {bit: bool(value) for bit, value in wanted.items()}, cannot_fall=cannot_fall)
        return (yield from read(axis.node))

    word, mask = command_drive(settings, screen, change) if wanted else read_drive(settings, screen, read)
    if settings.json:
        screen.json({"outputs": word, "mask": mask})
        return
    _show_bits(screen, _OUTPUTS, word, mask)


@command()
@click.option("--probe", "number", type=click.IntRange(1, 2), default=1, help="Which touch probe.  [default: 1]")
@click.option("--edge", type=click.Choice(["positive", "negative", "both"]), default="positive", help="[default: positive]")
@click.option("--source", type=click.Choice(list(_SOURCES)), default="input", help="input, index pulse, or as 0x60D0 selects.")
@click.option("--limit", type=Duration(), default=60 * SECOND, help="How long to wait for the edge.  [default: 60s]")
@commanding
def probe(settings: Settings, screen: Screen, number: int, edge: str, source: str, limit: Time) -> None:
    """Arm a touch probe (0x60B8), wait for its edge, and show the position there. It moves nothing: move the drive meanwhile.

    \b
    canopen drive probe 5 --edge positive -b can0
    """
    unit, scale = unit_of_command(settings, None)

    def procedure(axis: Axis) -> Procedure[ProbeReading]:
        yield from identify(axis)
        yield from _read_own(axis.node, objects.TOUCH_PROBE_FUNCTION, "touch probes")
        try:
            yield from procedures.arm_probe(
                axis, number, positive=edge != "negative", negative=edge != "positive", source=_SOURCES[source]
            )
            screen.say(f"touch probe {number} of drive {axis.node.node_id} is armed; Ctrl-C disarms it")
            reading = yield from procedures.wait_for_probe(axis, number, timeout=limit)
        except (Cancelled, Exception):
            yield from procedures.disarm_probe(axis, number)
            raise
        yield from procedures.disarm_probe(axis, number)
        return reading

    reading = command_drive(settings, screen, procedure, scale=scale, ends=False)
    if settings.json:
        screen.json({"probe": number, **reading._asdict(), "unit": unit})
        return
    for name, position in reading._asdict().items():
        if position is not None:
            screen.fact(f"{name} edge", f"at {position:.10g} {unit}")


def _read_own(node: AxisNode, mux: Mux, what: str) -> Procedure[int]:
    """Read an object that CiA 402 leaves to the maker. Raises a CommandError that says why if there is none."""
    value = yield from read_if_present(node, mux)
    if isinstance(value, int):
        return value
    number, device = f"0x{index_of(node.on_device(mux)):04X}", f"drive {node.node_id}"
    if mux in node.dictionary:
        raise CommandError(
            ExitCode.SDO_ABORT,
            "CO202",
            f"{device} has no {what}: it has no object {number}",
            seen=f"it refused to tell {number}, which its dictionary describes",
            cause="not every drive has this object: CiA 402 leaves it to the maker",
            tries=("-e FILE    its own file says what it has", f"canopen info {node.node_id}    which device it is"),
        )
    seen = f"{number} is not in the dictionary of {device}; nothing was sent"
    tries = (
        "-e FILE, if another file describes the device",
        f"canopen read {node.node_id} {number} --type u32    whether it has one",
    )
    raise usage("CO302", f"{device} has no {what}", seen=seen, cause="its file describes none", tries=tries)


def _changes(texts: tuple[str, ...]) -> Mapping[int, int]:
    """Return bit -> value of what the command line says."""
    wanted: dict[int, int] = {}
    for text in texts:
        found = _CHANGE.fullmatch(text)
        if found is None or int(found[1]) >= _BITS:
            raise usage("CO120", f"{text!r} sets no output", tries=("16=1 sets output 16, 16=0 clears it: 0 to 31",))
        wanted[int(found[1])] = int(found[2])
    return wanted


def _name(names: Mapping[int, str], bit: int) -> str:
    return names.get(bit, f"the maker's {bit}" if bit >= 16 else f"reserved {bit}")


def _show_bits(screen: Screen, names: Mapping[int, str], word: int, mask: int | None = None) -> None:
    """Show the bits that the standard names, and the others that are set, here or in the mask."""
    shown = [bit for bit in range(_BITS) if bit in names or (word | (mask or 0)) >> bit & 1]
    rows = [(str(bit), _name(names, bit), str(word >> bit & 1)) for bit in shown]
    if mask is None:
        screen.table(("bit", "name", "value"), rows)
        return
    owners = ("the drive", "the master")
    screen.table(
        ("bit", "name", "value", "set by"), [(*row, owners[mask >> bit & 1]) for row, bit in zip(rows, shown, strict=True)]
    )
