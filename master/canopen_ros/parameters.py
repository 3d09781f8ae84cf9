"""`NodeParameters`: what the node is told by ROS parameters: a machine file, or a chain description and the rest beside it.

`PARAMETERS` has all of them, with their types, ranges and defaults; docs/ros.md lists them. A machine file says everything:
beside it only `simulate`, `buses` (other locators for its buses), `sync_interval` and the keys of the node itself may stand.

A key with dots means a table in a table, as in ROS 2: "joints.joint1.unit".
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from canopen_data import DataError
from canopen_data.findings import DictionaryError
from canopen_master.errors import ChainFileError, MasterError
from canopen_master.machine_file import MachineFile, machine_of_chains, read_machine
from canopen_master.machine_file.toml_text import machine_of_tables
from canopen_master.motion.chain_file import ChainDescription, parse_chains, read_chains
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_ros.goals import START
from canopen_ros.names import NO_FILE

BAD_PARAMETERS: Final = "CO324"

RELIABLE: Final = "reliable"
BEST_EFFORT: Final = "best_effort"


class NodeParameter(NamedTuple):
    """A parameter of the node. text: for people. default: None if there is none, or if it has several kinds of values.

    least, most: of a number. choices: of a text; none for any text.
    """

    text: str
    default: bool | float | str | None = None
    least: float | None = None
    most: float | None = None
    choices: tuple[str, ...] = ()

    def problem(self, value: object) -> str:
        """Return what is wrong with a value, as "it has to be ..."; "" if nothing is, or if only all parameters together tell."""
        if isinstance(self.default, bool):
            return "" if isinstance(value, bool) else "it has to be true or false"
        if self.least is not None and self.most is not None:
            if _is_number(value) and isinstance(value, int | float) and self.least <= value <= self.most:
                return ""
            return f"it has to be a number from {self.least:g} to {self.most:g}"
        if self.choices:
            return "" if value in self.choices else f"it has to be {' or '.join(self.choices)}"
        if self.default:
            return "" if isinstance(value, str) and value else "it has to be a text"
        return ""


PARAMETERS: Final[Mapping[str, NodeParameter]] = {
    "machine": NodeParameter("the path of a machine file (docs/machine.md), in place of chains, eds, joints and defaults", ""),
    "chains": NodeParameter("the text of a chain file, its rows as a list, or its path: arm joint1 can0 3 joint2 can0 4"),
    "buses": NodeParameter("the locators of the buses, as a list: can0=socketcan:can0; or buses.can0: socketcan:can0"),
    "sync_interval": NodeParameter("ms between two SYNCs; without it that of the machine file, or 10", least=0.1, most=10_000.0),
    "eds": NodeParameter("the file of all nodes, or eds.JOINT for each joint; without it the installed CSV files"),
    "joints": NodeParameter("settings of joints, as joints.NAME.KEY, with the keys of [joints.NAME] in a machine file"),
    "defaults": NodeParameter("settings for all joints, as defaults.KEY"),
    "simulate": NodeParameter("true: simulated devices on virtual buses, in the process of the node", False),
    "velocity_watchdog": NodeParameter(
        "seconds within which the next velocity has to come, or the joints brake", 0.1, 0.001, 10.0
    ),
    "goal_time": NodeParameter(
        "seconds behind a trajectory until the joints have to be within the tolerances of its goal", 1.0, 0.001, 3600.0
    ),
    "start_tolerance": NodeParameter("rad or m that a joint may be off where a source of motion begins", START, 1e-6, 1.0),
    "joint_states": NodeParameter("the topic of the joint states", "joint_states"),
    "joint_states_rate": NodeParameter("Hz of the joint states; 0: one at each SYNC", 0.0, 0.0, 10_000.0),
    "joint_states_reliability": NodeParameter(
        "of the joint states. reliable: every subscriber hears them; best_effort: MoveIt, which asks for reliable, hears none",
        RELIABLE,
        choices=(RELIABLE, BEST_EFFORT),
    ),
    "diagnostics_period": NodeParameter("seconds between two diagnostics if nothing changes", 1.0, 0.01, 3600.0),
    "look_period": NodeParameter("seconds between two questions for the positions of joints without power", 0.2, 0.01, 60.0),
}
"""All parameters of the node, by name."""


class ParameterError(MasterError, ValueError):
    """The parameters do not describe a machine. The text has every problem."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__(BAD_PARAMETERS, problems[0], also=problems[1:], tries=("docs/ros.md lists the parameters",))


class NoMachineError(ParameterError):
    """There is neither a machine file nor a chain description."""

    def __init__(self) -> None:
        super().__init__((NO_FILE,))


@dataclass(frozen=True, slots=True)
class NodeParameters:
    """See this module's text. machine: as read, with everything that the parameters say about it."""

    machine: MachineFile
    simulate: bool = False
    velocity_watchdog: float = 0.1
    goal_time: float = 1.0
    start_tolerance: float = START
    joint_states: str = "joint_states"
    joint_states_rate: float = 0.0
    joint_states_reliability: str = RELIABLE
    diagnostics_period: float = 1.0
    look_period: float = 0.2

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> NodeParameters:
        """Return the parameters that a mapping gives. Raises ParameterError with all problems, NoMachineError without a
        machine."""
        tables = _nested(values)
        problems: list[str] = []
        problems += [f"there is no parameter {key!r}{did_you_mean(key, PARAMETERS)}" for key in tables if key not in PARAMETERS]
        wrong = {key: PARAMETERS[key].problem(value) for key, value in tables.items() if key in PARAMETERS and value is not None}
        problems += [f"{key} is {tables[key]!r}; {problem}" for key, problem in wrong.items() if problem]
        own = {each.name for each in fields(cls)} - {"machine"}
        given: dict[str, Any] = {
            key: float(tables[key]) if PARAMETERS[key].least is not None else tables[key]
            for key, problem in wrong.items()
            if key in own and not problem
        }
        if wrong.get("sync_interval"):
            del tables["sync_interval"]
        machine = _machine(tables, problems)
        if problems:
            raise ParameterError(problems)
        assert machine is not None
        return cls(machine, **given)


def _nested(values: Mapping[str, object]) -> dict[str, Any]:
    """Return the values with dotted keys as tables in tables; names of buses may have dots of their own."""
    nested: dict[str, Any] = {}
    for key, value in values.items():
        name, _, rest = key.partition(".")
        given = _nested({rest: value}) if rest else _nested(value) if isinstance(value, Mapping) and name != "buses" else value
        before = nested.get(name)
        nested[name] = _merged(before, given) if isinstance(before, dict) and isinstance(given, dict) else given
    return nested


def _merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    both = {**one, **other}
    for key in one.keys() & other.keys():
        if isinstance(one[key], dict) and isinstance(other[key], dict):
            both[key] = _merged(one[key], other[key])
    return both


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _machine(tables: Mapping[str, Any], problems: list[str]) -> MachineFile | None:
    """Return the machine; None with a problem."""
    locators = _locators(tables.get("buses"), problems)
    interval = tables.get("sync_interval")
    if tables.get("machine"):
        problems += [f"{key} and machine exclude each other: the file says it" for key in _OF_CHAINS if tables.get(key)]
        try:
            machine = read_machine(str(tables["machine"]))
        except (DataError, DictionaryError) as error:
            problems.append(str(error))
            return None
        problems += [f"{machine.source} has no bus {name!r}" for name in locators if name not in machine.buses]
        buses = {name: replace(bus, locator=locators.get(name, bus.locator)) for name, bus in machine.buses.items()}
        return _with_cycle(replace(machine, buses=buses), interval)
    chains = _chains(tables.get("chains"), problems)
    if chains is None:
        return None
    return _of_chains(chains, tables, locators, interval, problems)


_OF_CHAINS: Final = ("chains", "eds", "joints", "defaults")


def _with_cycle(machine: MachineFile, interval: float | None) -> MachineFile:
    if interval is None:
        return machine
    cycle = round(interval * MILLISECOND)
    chains = {
        name: replace(chain, settings=replace(chain.settings, cycle_time=cycle / SECOND))
        for name, chain in machine.chains.items()
    }
    return replace(machine, master=replace(machine.master, cycle=cycle), chains=chains)


def _locators(value: object, problems: list[str]) -> dict[str, str]:
    """Return the locators by the names of the buses."""
    pairs: list[tuple[object, object]] = []
    if isinstance(value, Mapping):
        pairs = list(value.items())
    elif isinstance(value, list | tuple):
        for each in value:
            if isinstance(each, Mapping) and set(each) == {"name", "locator"}:
                pairs.append((each["name"], each["locator"]))
            elif isinstance(each, str) and "=" in each:
                name, _, locator = each.partition("=")
                pairs.append((name.strip(), locator.strip()))
            else:
                problems.append(f"buses: {each!r} is neither {{name:, locator:}} nor NAME=LOCATOR")
    elif value is not None:
        problems.append(f"buses is {value!r}; it has to be a list of {{name:, locator:}}, or of NAME=LOCATOR")
    problems += [f"buses: {name!r}: {locator!r} is no locator" for name, locator in pairs if not isinstance(locator, str)]
    return {str(name): str(locator) for name, locator in pairs}


def _chains(value: object, problems: list[str]) -> tuple[ChainDescription, ...] | None:
    """Return the chains of a text, of rows, or of a file. Raises NoMachineError if there is nothing."""
    if value in (None, "", [], ()):
        raise NoMachineError
    try:
        if isinstance(value, str):
            return read_chains(value) if len(value.split()) == 1 else parse_chains(value)
        if isinstance(value, list | tuple):
            lines = [row if isinstance(row, str) else " ".join(map(str, row)) for row in value]
            return parse_chains("\n".join(lines))
    except (ChainFileError, DataError) as error:
        problems.append(str(error))
        return None
    problems.append(f"chains is {value!r}; it has to be the text of a chain file, a list of its rows, or its path")
    return None


def _of_chains(
    chains: Sequence[ChainDescription],
    tables: Mapping[str, Any],
    locators: Mapping[str, str],
    interval: float | None,
    problems: list[str],
) -> MachineFile | None:
    """Return the machine of chains with all that stands beside them."""
    used = {joint.bus for chain in chains for joint in chain.joints}
    if len(used) == 1 and len(locators) == 1:  # the name of an only bus does not matter
        locators = dict.fromkeys(used, next(iter(locators.values())))
    problems += [f"buses: no chain has a bus {name!r}{did_you_mean(name, used)}" for name in locators if name not in used]
    plain = machine_of_chains(chains, locators)
    files = _files(tables.get("eds"), plain, problems)
    joints, defaults = (_table(key, tables.get(key), problems) for key in ("joints", "defaults"))
    joints = {name: _table(f"joints.{name}", settings, problems) for name, settings in joints.items()}
    unknown = [name for name in joints if name not in plain.joints]
    problems += [f"joints: there is no joint {name!r}{did_you_mean(name, plain.joints)}" for name in unknown]
    described: dict[str, Any] = {
        "buses": {name: {"locator": bus.locator} for name, bus in plain.buses.items()},
        "nodes": {
            name: {"bus": node.bus, "id": node.node_id, **({"file": files[name]} if name in files else {})}
            for name, node in plain.nodes.items()
        },
        "joints": {name: {"node": joint.node, **joints.get(name, {})} for name, joint in plain.joints.items()},
        "chains": {name: {"joints": list(chain.joints)} for name, chain in plain.chains.items()},
    }
    if defaults:
        described["defaults"] = {"joints": defaults}
    try:
        machine = machine_of_tables(described, "the parameters", Path())
    except DictionaryError as error:
        problems.append(str(error))
        return None
    return _with_cycle(machine, interval)


def _table(key: str, value: object, problems: list[str]) -> dict[str, Any]:
    """Return a table of settings, empty with a problem."""
    if isinstance(value, dict):
        return value
    if value is not None:
        problems.append(f"{key} is {value!r}; it has to be a table of settings")
    return {}


def _files(value: object, machine: MachineFile, problems: list[str]) -> dict[str, str]:
    """Return the file of each node."""
    if not value:
        return {}
    if isinstance(value, str):
        return dict.fromkeys(machine.nodes, value)
    if isinstance(value, Mapping):
        unknown = [str(name) for name in value if name not in machine.nodes]
        problems += [f"eds: there is no joint {name!r}{did_you_mean(name, machine.nodes)}" for name in unknown]
        return {str(name): str(file) for name, file in value.items()}
    problems.append(f"eds is {value!r}; it has to be a file, or a file for each joint")
    return {}
