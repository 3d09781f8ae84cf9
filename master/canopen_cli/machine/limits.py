"""The limits of the joints of a machine file, and where each of them comes from, as far as the file tells."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any, Final

from canopen_cli.shared.screen import Screen, escape
from canopen_master.machine_file import JointEntry, MachineFile
from canopen_proto.drives.axis.limits import DEFAULT_ONSET, DEFAULT_RAMP, DEFAULT_SPEED
from canopen_proto.drives.axis.settings import AxisSettings

ELSE: Final = {
    "min_position": "0x607D of the drive, if it has it",
    "max_position": "0x607D of the drive, if it has it",
    "max_speed": f"0x607F and 0x6080 of the drive, else {DEFAULT_SPEED:,} counts per s",
    "max_acceleration": f"the lower of 0x60C5 and 0x60C6 of the drive, else max_speed, reached in {DEFAULT_RAMP:g} s",
    "max_jerk": f"max_acceleration, reached in {DEFAULT_ONSET:g} s",
}
"""Where a limit comes from that the file does not have: see canopen_proto.drives.axis.limits."""
_PER: Final = {"max_speed": "/s", "max_acceleration": "/s²", "max_jerk": "/s³"}


def sources_of(machine: MachineFile, text: str) -> dict[str, dict[str, str]]:
    """Return where each limit of each joint comes from, by joint and key. text: of the machine file."""
    tables = tomllib.loads(text)
    defaults: Mapping[str, Any] = tables.get("defaults", {}).get("joints", {})
    own: Mapping[str, Mapping[str, Any]] = tables.get("joints", {})
    sources = {}
    for name in machine.joints:
        sources[name] = {
            key: f"joints.{name}" if key in own.get(name, {}) else "defaults.joints" if key in defaults else other
            for key, other in ELSE.items()
        }
    return sources


def limits_as_json(machine: MachineFile, text: str) -> dict[str, Any]:
    """Return the limits for --json: value (null: the file has none) and source, by joint and key."""
    return {
        name: {key: {"value": getattr(machine.joints[name].settings, key), "source": source} for key, source in each.items()}
        for name, each in sources_of(machine, text).items()
    }


def show_limits(screen: Screen, machine: MachineFile, text: str) -> None:
    """Show the limits of each joint, each with its source; limits that come from the same place in all joints once."""
    sources = sources_of(machine, text)
    rows = []
    for name, each in sources.items():
        given = [key for key in ELSE if getattr(machine.joints[name].settings, key) is not None]
        rows += [(escape(name), key, _shown(machine.joints[name], key), escape(each[key])) for key in given]
    if rows:
        screen.table(("joint", "limit", "value", "from"), rows, right=("value",))
    for key, other in ELSE.items():
        without = [name for name, each in sources.items() if each[key] == other]
        if without:
            names = "" if len(without) == len(sources) else f"; of {', '.join(without)}"
            screen.fact(key, f"{other}{names}")


def _shown(joint: JointEntry, key: str) -> str:
    return f"{getattr(joint.settings, key):g} {_unit(joint.settings)}{_PER.get(key, '')}"


def _unit(settings: AxisSettings) -> str:
    return "unit" if settings.unit is None else settings.unit.value
