"""The options and kinds of argument that all commands share.

`common` adds -b, -e, --overlay, --encoding, --timeout, --trace, --force, --json, -q, -v and --no-color to a command. They may
also stand before the command's name (`canopen -b can0 scan`); after it they win. CANOPEN_BUS names the bus if no
option does.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

import click

from canopen_cli.importing import importing
from canopen_cli.problem import Problem, usage
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.machine import MILLISECOND, Time

if TYPE_CHECKING:
    import trio

    from canopen_cli.screen import Screen
    from canopen_proto.procedures.grip import Grip

    Kind: TypeAlias = click.ParamType[Any, Any]
else:
    Kind = click.ParamType  # generic since click 8.4 only

F = TypeVar("F", bound=Callable[..., Any])

BUS_VARIABLE: Final = "CANOPEN_BUS"
DEMO: Final = "demo"
"""The bus on which six simulated drives live, in the same process."""


@dataclass
class Settings:
    """The values of the common options. eds: files of devices as they were typed, see device_files.py. overlays: side files, see
    overlays.py. trace: the file that records the traffic of the bus. encoding: of device files, "" for a guess. force: overwrite
    files, and nothing else. clock: a test's virtual one. late: a problem to be shown after the results of the command. master_id:
    the node-ID of our heartbeat, which the drives that we enable watch. dry_run: show the frames, and send nothing but reads."""

    bus: str | None = None
    eds: tuple[str, ...] = ()
    overlays: tuple[str, ...] = ()
    timeout: Time | None = None
    trace: Path | None = None
    encoding: str = ""
    force: bool = False
    json: bool = False
    verbosity: int = 0
    no_color: bool = False
    clock: trio.abc.Clock | None = None
    late: Problem | None = None
    master_id: int | None = None
    dry_run: bool = False

    @property
    def grip(self) -> Grip:
        """How enabled drives notice that this program is gone."""
        from canopen_proto.procedures.grip import DEFAULT_GRIP, Grip

        return DEFAULT_GRIP if self.master_id is None else Grip(node_id=self.master_id)

    def screen(self) -> Screen:
        """The screen that the command writes to."""
        with importing():
            from canopen_cli.screen import Screen
        return Screen(json_output=self.json, verbosity=self.verbosity, color=not self.no_color)

    def named_bus(self) -> str | None:
        """Return the bus of -b or CANOPEN_BUS, or None."""
        return self.bus or os.environ.get(BUS_VARIABLE) or None

    def required_bus(self, first: str = "-b demo                        six simulated drives, for trying things out") -> str:
        """Return the bus as `named_bus` does. Raises a Problem if there is none. first: what to try first."""
        bus = self.named_bus()
        if bus is None:
            raise usage(
                "CO121",
                "no bus was named",
                tries=(
                    first,
                    "-b socketcan:can0              Linux, any adapter that the kernel knows",
                    "-b pcan:PCAN_USBBUS1@500k      PEAK adapters",
                    f"export {BUS_VARIABLE}=can0       once for all commands",
                ),
            )
        return bus


class NodeId(Kind):
    """A node-ID: decimal, or hexadecimal with 0x."""

    name = "node"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        return value if isinstance(value, int) else node_id_of(str(value))


class NodeIds(Kind):
    """Several node-IDs: "1-32,40"."""

    name = "node-ids"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        if isinstance(value, tuple):
            return value
        ids: dict[int, None] = {}
        for part in str(value).split(","):
            first, dash, last = part.partition("-")
            low = node_id_of(first)
            high = node_id_of(last) if dash else low
            if high < low:
                raise usage("CO120", f"{part.strip()!r} runs backwards", tries=(f"{last.strip()}-{first.strip()}",))
            ids.update(dict.fromkeys(range(low, high + 1)))
        return tuple(ids)


class Duration(Kind):
    """A time: "500ms", "2s", "100us"; only 0 needs no unit. In ns."""

    name = "time"

    def __init__(self, low: Time = MILLISECOND, high: Time = 24 * 3600 * 10**9) -> None:
        self.low = low
        self.high = high

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Time:
        if isinstance(value, int):
            return value
        from canopen_data.durations import parse_duration

        try:
            time = parse_duration(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)
        if not self.low <= time <= self.high:
            self.fail(f"{value} is outside {_time_text(self.low)} to {_time_text(self.high)}", param, ctx)
        return time


class Encoding(Kind):
    """The encoding of a text: "gbk", "cp932", "cp1252"."""

    name = "encoding"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from canopen_data.eds.encodings import is_encoding

        if not is_encoding(str(value)):
            self.fail(f"{value!r} is not an encoding such as gbk, cp932 or cp1252", param, ctx)
        return str(value)


class Fault(Kind):
    """The simulated drive that breaks down, and when: "5@2.0"."""

    name = "node@seconds"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, float]:
        if isinstance(value, tuple):
            return value
        node, at, seconds = str(value).partition("@")
        try:
            time = float(seconds)
        except ValueError:
            time = -1.0
        if not at or not 0 <= time < 1e6:
            self.fail(f"{value!r} is not of the form NODE@SECONDS, such as 5@2.0", param, ctx)
        return node_id_of(node), time


def node_id_of(text: str) -> int:
    """Return the node-ID in a text. Raises a Problem (CO120) that says what was perhaps meant."""
    text = text.strip()
    try:
        node_id = int(text, 16 if text.lower().startswith("0x") else 10)
    except ValueError:
        hint = (f"0x{text}, if it is hexadecimal",) if re.fullmatch("[0-9A-Fa-f]{1,2}", text) else ()
        raise usage("CO120", f"{text!r} is not a node-ID: 1 to {MAX_NODE_ID}, or hexadecimal with 0x", tries=hint) from None
    if 1 <= node_id <= MAX_NODE_ID:
        return node_id
    raise usage("CO120", f"node-ID {text} is outside 1..{MAX_NODE_ID}", tries=("canopen scan    (who is there?)",))


def _time_text(time: Time) -> str:
    return f"{time / 10**9:g} s" if time >= 10**9 else f"{time / 10**6:g} ms"


def _store(ctx: click.Context, param: click.Parameter, value: Any) -> None:
    """Keep the value of an option in the settings, under the option's name."""
    settings, name = ctx.ensure_object(Settings), str(param.name)
    if name in ("eds", "overlays"):  # may be repeated
        setattr(settings, name, getattr(settings, name) + value)
    elif name == "quiet":
        settings.verbosity = -1 if value else settings.verbosity
    elif value not in (None, False):
        setattr(settings, name, value)


def _option(*names: str, **attributes: Any) -> Callable[[Any], Any]:
    return click.option(*names, callback=_store, expose_value=False, **attributes)


def enabling(command: F) -> F:
    """Add the option that commands have which enable drives."""
    from canopen_proto.procedures.grip import DEFAULT_GRIP

    help_text = f"The node-ID of our own heartbeat, by which drives notice that we are gone.  [default: {DEFAULT_GRIP.node_id}]"
    added: F = _option("--master-id", type=NodeId(), help=help_text)(command)
    return added


def commanding(command: F) -> F:
    """Add the option of commands that command drives: see rehearsal.py."""
    added: F = _option("--dry-run", is_flag=True, help="Only read the drive, and show the frames that would be sent.")(command)
    return added


def common(command: F) -> F:
    """Add the options that every command has. The command takes `settings` by `@click.pass_obj`."""
    options: list[Callable[[F], F]] = [
        _option(
            "-b",
            "--bus",
            metavar="BUS",
            help=f"The bus: demo, socketcan:can0, pcan:PCAN_USBBUS1@500k, slcan:/dev/ttyACM0@250k ...  [env: {BUS_VARIABLE}]",
        ),
        _option(
            "-e",
            "--eds",
            multiple=True,
            metavar="[NODE=]FILE",
            help="The device's own file (EDS, DCF, XDD, XDC), which names its objects; once for each device.",
        ),
        _option(
            "--overlay",
            "overlays",
            multiple=True,
            metavar="FILE.toml",
            help="Units and factors, names of values and bits, aliases, laid over what describes the device.",
        ),
        _option("--encoding", type=Encoding(), help="Of device files that are not UTF-8: gbk, cp932 ... By default a guess."),
        _option("--timeout", type=Duration(), help="For one answer of a node: 500ms, 2s."),
        _option(
            "--trace",
            type=click.Path(dir_okay=False, path_type=Path),
            metavar="FILE",
            help="Record all traffic on the bus meanwhile: .log (candump's), .asc, .blf, .trc.",
        ),
        _option("--force", is_flag=True, help="Overwrite files that are there already (-o, --trace ...)."),
        _option("--json", is_flag=True, help="Results and errors as JSON."),
        _option("-q", "--quiet", is_flag=True, help="Only results and errors."),
        _option("-v", "--verbose", "verbosity", count=True, help="Tell more; -vv with tracebacks."),
        _option("--no-color", is_flag=True, help="No colours (as NO_COLOR)."),
    ]
    for option in reversed(options):
        command = option(command)
    return command
