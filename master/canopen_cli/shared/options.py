"""The options and kinds of argument that all commands share.

`command` makes one that has -b, -m, -e, --overlay, --encoding, --timeout, --trace, --force, --json, -q, -v and --no-color. They
may also stand before the command's name (`canopen -b can0 scan`); after it they win. CANOPEN_BUS names the bus, and
CANOPEN_MACHINE the machine file, if no option does; behind these the configuration file does (configuration.py).
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

import click

from canopen_cli.shared.chosen_machine import BUS_VARIABLE, MACHINE_VARIABLE, NUMBER, ChosenMachine
from canopen_cli.shared.importing import importing
from canopen_cli.shared.problem import CommandError, usage
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.machine import MILLISECOND, SECOND, Time

if TYPE_CHECKING:
    import trio

    from canopen_cli.shared.screen import Screen
    from canopen_master.machine_file import JointEntry, MachineFile
    from canopen_proto.drives.axis.watchdog import Watchdog

    Kind: TypeAlias = click.ParamType[Any, Any]
else:
    Kind = click.ParamType  # generic since click 8.4 only

F = TypeVar("F", bound=Callable[..., Any])

_PLAIN: Final = re.compile(r"[0-9]*\.?[0-9]+")
_COMMON_FLAGS: Final = "-b, -m, -e, --json, -v ..."
_OBJECT: Final = "canopen.object"
"""The key, in `click.Context.meta`, of an object that stands at its node."""
_NODE_ID: Final = re.compile(r"0[xX][0-9A-Fa-f]+|[0-9]+")
FILE: Final = click.Path(dir_okay=False, path_type=Path)
"""A file, perhaps one that is not there yet."""
DEMO: Final = "demo"
"""The bus on which six simulated drives live, in the same process."""


@dataclass
class Settings:
    """The values of the common options. eds: files of devices as they were typed, see device_files.py. overlays: side files, see
    canopen_data/overlay.py. trace: the file that records the traffic of the bus. encoding: of device files, "" for a guess.
    force: overwrite files; `flash` also writes a program that the device has already. clock: a test's virtual one. late: a
    problem to be shown after the results of the command. notes: what a Screen is to say at the end, with --json. master_id: the
    node-ID of our heartbeat, which the drives that we enable watch. dry_run: show the frames, and send nothing but reads."""

    bus: str | None = None
    machine: Path | None = None
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
    late: CommandError | None = None
    master_id: int | None = None
    dry_run: bool = False
    notes: list[str] = field(default_factory=list)
    chosen: ChosenMachine = field(default_factory=ChosenMachine)

    @property
    def watchdog(self) -> Watchdog | None:
        """How enabled drives notice that this program is gone; None if the machine file says that they shall not."""
        from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, Watchdog

        if self.master_id is not None:
            return Watchdog(node_id=self.master_id)
        machine = self.machine_file()
        return DEFAULT_WATCHDOG if machine is None else machine.master.watchdog

    @property
    def sdo_timeout(self) -> float | None:
        """Seconds for one answer of a node, by --timeout or the machine file; None if neither says it."""
        machine = self.machine_file()
        time = self.timeout if self.timeout is not None or machine is None else machine.master.timeout
        return None if time is None else time / SECOND

    def typed_bus(self) -> tuple[str | None, str | None]:
        """Return what -b and -m of another command have to be for the same bus; None: not needed."""
        bus = self.bus or (self.chosen.bus if self.chosen.has_several else None)
        return bus or None, None if self.machine is None else str(self.machine)

    def origin_of_bus(self) -> str:
        """Return who named the bus, in words, if neither -b nor a machine file did; "" if they did, or nobody."""
        if self.bus or self.chosen.bus:
            return ""
        if bus := os.environ.get(BUS_VARIABLE):
            return f"{BUS_VARIABLE}={bus} named this bus"
        configuration = self.chosen.configuration
        return f"{configuration.path} named this bus" if configuration.bus else ""

    def screen(self) -> Screen:
        """The screen that the command writes to."""
        with importing():
            from canopen_cli.shared.screen import Screen
        return Screen(json_output=self.json, verbosity=self.verbosity, color=not self.no_color, notes=self.notes)

    def machine_file(self) -> MachineFile | None:
        """Return the machine of -m or CANOPEN_MACHINE, or None. Raises DataError, DictionaryError."""
        return self.chosen.file(self.machine, self.bus)

    def machine_on_bus(self) -> tuple[MachineFile | None, str]:
        """Return the machine, and the name of its bus that this command is about; "" if there is none, or it is not clear."""
        machine = self.machine_file()
        if machine is not None:
            self.chosen.locator(machine, self.bus)
        return machine, self.chosen.bus

    def told_bitrate(self) -> int | None:
        """Return the bit rate that the machine file gives the bus of this command, bit/s; None if it gives none."""
        machine, bus = self.machine_on_bus()
        return machine.buses[bus].bitrate if machine is not None and bus in machine.buses else None

    def joint(self, node_id: int, axis: int = 0) -> JointEntry | None:
        """Return the joint of an axis of a node on the bus that this command is about, or None."""
        machine, bus = self.machine_on_bus()
        return None if machine is None else machine.joint_on(machine.node_at(bus, node_id), axis)

    def has_file(self, node_id: int) -> bool:
        """Return whether -e or the machine file names the device's own file of a node."""
        machine, bus = self.machine_on_bus()
        node = None if machine is None else machine.node_at(bus, node_id)
        return bool(self.eds) or (node is not None and bool(node.device.file))

    def is_node(self, text: str) -> bool:
        """Return whether a text that could also be a file means a node: it is a number, or a name in the machine file."""
        if _NODE_ID.fullmatch(text):
            return True
        machine = None if Path(text).exists() else self.machine_file()
        return machine is not None and machine.node_of(text) is not None

    def names_node(self, text: str) -> bool:
        """Return whether a text is a node-ID, or a name in the machine file; the index of an object has four digits."""
        if _NODE_ID.fullmatch(text):
            return int(text, 16 if text[1:2] in "xX" else 10) <= MAX_NODE_ID and len(text) != len("1018")
        machine = self.machine_file()
        return machine is not None and machine.node_of(text) is not None

    def node_id(self, text: str, *, any_axis: bool = False) -> int:
        """Return the node-ID in a text, or that of the joint or node of this name in the machine file. Raises a CommandError.

        any_axis: see ChosenMachine.
        """
        machine = None if NUMBER.fullmatch(text) else self.machine_file()
        if machine is not None:
            return self.chosen.node_id(machine, text.strip(), any_axis=any_axis)
        try:
            return node_id_of(text)
        except CommandError as error:
            if self.machine is None and self.bus and (other := os.environ.get(MACHINE_VARIABLE)) and not NUMBER.fullmatch(text):
                error.seen = f"-b {self.bus} is no bus of {other}: {MACHINE_VARIABLE} does not count then"
                error.tries = (f"-m {other} -b {self.bus}: the machine, with that bus in the place of its own", *error.tries)
            raise

    def named_bus(self) -> str | None:
        """Return the bus that this command is about: of the machine file, else of -b or CANOPEN_BUS; None if it is not clear."""
        machine = self.machine_file()
        if machine is not None:
            return self.chosen.locator(machine, self.bus)
        return self.bus or os.environ.get(BUS_VARIABLE) or self.chosen.configuration.bus

    def required_bus(self, first: str = "-b demo                        six simulated drives, for trying things out") -> str:
        """Return the bus as `named_bus` does. Raises a CommandError if there is none. first: what to try first."""
        bus, machine = self.named_bus(), self.machine_file()
        if bus is None and machine is not None:
            raise self.chosen.unclear(machine)
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


class TextKind(Kind):
    """A kind of argument that its text tells. What is no text was read before, and stays."""

    def read(self, text: str) -> Any:
        """Return the value of a text. Raises a ValueError or a CommandError that says what is wrong with it."""
        raise NotImplementedError

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not isinstance(value, str):
            return value
        try:
            return self.read(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


_SEVERAL: Final = re.compile(r"all|\d+([-,]\d+)+")
"""A text that means several nodes."""


class NodeId(Kind):
    """A node-ID: decimal, or hexadecimal with 0x. With a machine file also the name of a joint or a node."""

    name = "node"
    any_axis = False

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if isinstance(value, int):
            return value
        settings = None if ctx is None else ctx.find_object(Settings)
        try:
            return node_id_of(str(value)) if settings is None else settings.node_id(str(value), any_axis=self.any_axis)
        except CommandError as error:
            if _SEVERAL.fullmatch(str(value)):
                error.tries = ("the same for each of them: this command is about one node at a time",)
            if value == "all" and ctx is not None and any("--all" in each.opts for each in ctx.command.params):
                error.tries = ("--all    (all nodes of the bus)",)
            if ctx is not None and Path(str(value)).suffix and any("--log" in each.opts for each in ctx.command.params):
                error.tries = (f"--log {value}    (if it is a recording)", *error.tries)
            raise


class DriveId(NodeId):
    """A node-ID, or the name of a joint that may be a further axis of its node."""

    any_axis = True


class NodeOfObject(NodeId):
    """A node, perhaps with an object or a PDO of it: "5", "5:6041", "lift:statusword", "5:tpdo1". `with_named_object` and
    `with_word_at_node` have it."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        return super().convert(value if ctx is None else without_object(str(value), ctx), param, ctx)


def without_object(text: str, ctx: click.Context) -> str:
    """Return the node in a text such as "5:6041". `with_named_object` has the object."""
    node, colon, key = text.partition(":")
    if colon:
        ctx.meta[_OBJECT] = key
    return node


def with_named_object(words: tuple[str, ...], place: object) -> tuple[str, ...]:
    """Return the objects that the words behind the node name, as `with_word_at_node` does. Raises a CommandError if there is
    none."""
    if not (found := with_word_at_node(words, place)):
        path = click.get_current_context().command_path
        raise usage("CO001", "no object was named", tries=(f"{path} {place} statusword",))
    return found


def with_word_at_node(words: tuple[str, ...], place: object) -> tuple[str, ...]:
    """Return the words behind the node, the first of which may stand at the node: objects, or PDOs. Raises a CommandError if one
    is of another node. place: the node, as the user may type it."""
    context = click.get_current_context()
    settings, key = context.find_object(Settings), context.meta.get(_OBJECT)
    found = [] if key is None else [key]
    for word in words:
        node, colon, its_own = word.partition(":")
        if not colon or settings is None or not settings.names_node(node):
            found.append(word)
        elif settings.node_id(node) == place:
            found.append(its_own)
        else:
            tries = (f"{context.command_path} {word}    (in a command of its own)",)
            raise usage("CO001", f"{word} is not of node {place}, which this command is about", tries=tries)
    return tuple(found)


ALL_NODES: Final = f"1-{MAX_NODE_ID}    (all node-IDs)"


class NodeIds(TextKind):
    """Several node-IDs: "1-32,40"."""

    name = "node-ids"

    def read(self, text: str) -> tuple[int, ...]:
        ids: dict[int, None] = {}
        for part in text.split(","):
            first, dash, last = part.partition("-")
            low = node_id_of(first, ALL_NODES)
            high = node_id_of(last, ALL_NODES) if dash else low
            if high < low:
                raise usage("CO120", f"{part.strip()!r} runs backwards", tries=(f"{last.strip()}-{first.strip()}",))
            ids.update(dict.fromkeys(range(low, high + 1)))
        return tuple(ids)


class Duration(TextKind):
    """A time: "500ms", "2s", "100us"; only 0 needs no unit. In ns. is_seconds: a number alone is seconds, as of `Seconds`."""

    name = "time"

    def __init__(self, low: Time = MILLISECOND, high: Time = 24 * 3600 * 10**9, *, is_seconds: bool = False) -> None:
        self.low = low
        self.high = high
        self.is_seconds = is_seconds

    def read(self, text: str) -> Time:
        from canopen_data.durations import parse_duration

        is_plain = self.is_seconds and _PLAIN.fullmatch(text.strip())
        time = parse_duration(f"{text.strip()}s" if is_plain else text)
        if not self.low <= time <= self.high:
            raise ValueError(f"{text} is outside {_time_text(self.low)} to {_time_text(self.high)}")
        return time


class Seconds(TextKind):
    """How long something goes on: "10s", "500ms"; a number alone is seconds. In seconds, within a range."""

    name = "time"

    def __init__(self, low: float = 0.0, high: float = math.inf, *, low_open: bool = False) -> None:
        self.low = low
        self.high = high
        self.low_open = low_open

    def read(self, text: str) -> float:
        from canopen_data.durations import parse_duration

        plain = text.strip()
        seconds = float(plain) if _PLAIN.fullmatch(plain) else parse_duration(plain) / SECOND
        if not self.low <= seconds <= self.high or (self.low_open and seconds == self.low):
            least = "above" if self.low_open else "at least"
            most = f" and at most {self.high:g} s" if self.high < math.inf else ""
            raise ValueError(f"{text} is not {least} {self.low:g} s{most}")
        return seconds


class FiniteRange(click.FloatRange):
    """A number within a range; nan and inf are none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number: float = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


class Encoding(TextKind):
    """The encoding of a text: "gbk", "cp932", "cp1252"."""

    name = "encoding"

    def read(self, text: str) -> str:
        from canopen_data.eds.encodings import is_encoding

        if not is_encoding(text):
            raise ValueError(f"{text!r} is not an encoding such as gbk, cp932 or cp1252")
        return text


class Breakdown(TextKind):
    """The simulated drive that breaks down, and when: "5@2.0"."""

    name = "node@seconds"

    def read(self, text: str) -> tuple[int, float]:
        node, at, seconds = text.partition("@")
        try:
            time = float(seconds)
        except ValueError:
            time = -1.0
        if not at or not 0 <= time < 1e6:
            raise ValueError(f"{text!r} is not of the form NODE@SECONDS, such as 5@2.0")
        return node_id_of(node), time


def node_id_of(text: str, instead: str = "canopen scan    (who is there?)") -> int:
    """Return the node-ID in a text. instead: what to try. Raises a CommandError (CO120) that says what was perhaps meant."""
    text = text.strip()
    try:
        node_id = int(text, 16 if text.lower().startswith("0x") else 10)
    except ValueError:
        node, colon, _ = text.partition(":")
        hint: tuple[str, ...] = (f"0x{text}, if it is hexadecimal",) if re.fullmatch("[0-9A-Fa-f]{1,2}", text) else ()
        if colon and node.isdecimal():
            hint = (f"{node}    (the node alone: this command is about no single object)",)
        elif not hint:
            hint = (instead, "-m FILE.toml    (a machine file gives nodes names)")
        raise usage("CO120", f"{text!r} is not a node-ID: 1 to {MAX_NODE_ID}, or hexadecimal with 0x", tries=hint) from None
    if 1 <= node_id <= MAX_NODE_ID:
        return node_id
    raise usage("CO120", f"node-ID {text} is outside 1..{MAX_NODE_ID}", tries=(instead,))


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


def option_group(*options: Callable[[Any], Any]) -> Callable[[F], F]:
    """Return what adds several options to a command, whose help has them in this order."""

    def add(command: F) -> F:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def together(name: str, make: Callable[..., Any], *options: Callable[[Any], Any]) -> Callable[[F], F]:
    """Return what adds several options to a command, which gets one argument of this name for all of them. make: takes the values
    of these options, and of others of the command, by their names."""
    taken = tuple(signature(make).parameters)

    def add(command: F) -> F:
        @wraps(command)
        def run(*arguments: Any, **values: Any) -> Any:
            values[name] = make(**{each: values.pop(each) for each in taken if each in values})
            return command(*arguments, **values)

        added: Any = run
        return option_group(*options)(added)  # type: ignore[no-any-return]

    return add


def _option(*names: str, **attributes: Any) -> Callable[[F], F]:
    return click.option(*names, callback=_store, expose_value=False, **attributes)


class CommonOption(click.Option):
    """An option that every command has. The page of `canopen` itself explains it; the others have one line for all of them."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        if ctx.parent is None:
            return super().get_help_record(ctx)
        return (_COMMON_FLAGS, "Common options: see `canopen --help`.") if self.name == "bus" else None


def lasting(help_text: str = "End after this time, instead of by Ctrl-C: 10s.", **attributes: Any) -> Callable[[F], F]:
    """Add the option by which all commands take how long they go on. The command takes `seconds`.

    attributes: `low`, `high` and `low_open` of the time, in seconds; and what click.option takes. Without a default it is inf.
    """
    if not attributes.get("required"):
        attributes.setdefault("default", math.inf)
    bounds = {name: attributes.pop(name) for name in ("low", "high", "low_open") if name in attributes}
    return click.option("--for", "--seconds", "seconds", type=Seconds(**bounds), help=help_text, **attributes)


def until_text(seconds: float) -> str:
    """Return how long a command goes on, for people. seconds: by --for."""
    return "until Ctrl-C" if seconds == math.inf else f"for {seconds:g} s"


def enabling(command: F) -> F:
    """Add the option that commands have which enable drives."""
    from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG

    default = DEFAULT_WATCHDOG.node_id
    help_text = f"The node-ID of our own heartbeat, by which drives notice that we are gone.  [default: {default}]"
    added: F = _option("--master-id", type=NodeId(), help=help_text)(command)
    return added


commanding: Final = _option("--dry-run", is_flag=True, help="Only read, and show what would be sent: frames, or steps in words.")
"""The option of commands that change something on the bus: see withholding.py, and rehearsal.py for those of drives."""


def without_dry_run(why: str, *tries: str) -> Callable[[F], F]:
    """Add --dry-run to a command for which it has no meaning: it is refused, with words. why: for the help, too. tries: what to
    do instead."""

    def refuse(ctx: click.Context, param: click.Parameter, value: bool) -> None:
        if value:
            raise usage("CO123", f"{ctx.command_path} has no --dry-run: {why}", seen="nothing was sent", tries=tries)

    return click.option("--dry-run", is_flag=True, expose_value=False, callback=refuse, help=f"Refused here: {why}.")


def _common_option(*names: str, **attributes: Any) -> Callable[[F], F]:
    return _option(*names, cls=CommonOption, **attributes)


def _with_screen(command: F) -> F:
    """Give a command the settings and the screen."""

    @click.pass_obj
    @wraps(command)
    def run(settings: Settings, *arguments: Any, **values: Any) -> Any:
        return command(settings, settings.screen(), *arguments, **values)

    added: Any = run
    return added  # type: ignore[no-any-return]


common_options: Final = option_group(
    _common_option(
        "-b",
        "--bus",
        metavar="BUS",
        help=f"The bus: demo, socketcan:can0, pcan:PCAN_USBBUS1@500k, slcan:/dev/ttyACM0@250k ...  [env: {BUS_VARIABLE}]",
    ),
    _common_option(
        "-m",
        "--machine",
        type=FILE,
        metavar="FILE.toml",
        help=f"The machine file: buses, devices, joints, chains, by their names.  [env: {MACHINE_VARIABLE}]",
    ),
    _common_option(
        "-e",
        "--eds",
        multiple=True,
        metavar="[NODE=]FILE",
        help="The device's own file (EDS, DCF, XDD, XDC), which names its objects; once for each device.",
    ),
    _common_option(
        "--overlay",
        "overlays",
        multiple=True,
        metavar="FILE.toml",
        help="Units and factors, names of values and bits, aliases, laid over what describes the device.",
    ),
    _common_option("--encoding", type=Encoding(), help="Of device files that are not UTF-8: gbk, cp932 ... By default a guess."),
    _common_option("--timeout", type=Duration(is_seconds=True), help="For one answer of a node: 500ms, 2s; also 2, as --for."),
    _common_option(
        "--trace",
        type=FILE,
        metavar="FILE",
        help="Record all traffic on the bus meanwhile: .log (candump's), .asc, .blf, .trc, .pcap, .pcapng.",
    ),
    _common_option("--force", is_flag=True, help="Overwrite files that are there already (-o, --trace ...)."),
    _common_option("--json", is_flag=True, help="Results and errors as JSON."),
    _common_option("-q", "--quiet", is_flag=True, help="Only results and errors."),
    _common_option("-v", "--verbose", "verbosity", count=True, help="Tell more; -vv with tracebacks."),
    _common_option("--no-color", is_flag=True, help="No colours (as NO_COLOR)."),
)
"""The options that every command has. The settings have their values."""


def _common_params() -> list[click.Parameter]:
    @click.command()
    @common_options
    def bearer() -> None:
        """Has these alone."""

    return bearer.params


def command(
    name: str | None = None, *, cls: type[click.Command] = click.Command, group: click.Group | None = None
) -> Callable[[Callable[..., Any]], click.Command]:
    """As click.command. The command has the common options, and gets `settings` and `screen` as its first arguments. group: to
    which it is added."""

    def make(function: Callable[..., Any]) -> click.Command:
        made: click.Command = click.command(name, cls)(_with_screen(function))
        made.params += _common_params()
        if group is not None:
            group.add_command(made)
        return made

    return make
