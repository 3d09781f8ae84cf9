"""`canopen ros`: what belongs to ROS. The nodes themselves are started by roslaunch and ros2 launch: docs/ros.md."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Iterator
from importlib import resources
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from pathlib import Path, PurePosixPath

import click

from canopen_cli.shared.lazy import NamingGroup
from canopen_cli.shared.new_files import write_file
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_ros.robot_files import URDF, robot_files

PACKAGE = "ros_canopen"
MACHINE = "machine.toml"
_LAUNCH = {
    "launch/canopen.launch": (
        '<arg name="machine" default=""/>',
        f'<arg name="machine" default="$(find {PACKAGE})/config/{MACHINE}"/>',
    ),
    "launch/canopen.launch.py": ('"machine": ("",', f'"machine": (str(PACKAGE / "config" / "{MACHINE}"),'),
}
_URDF = '"urdf" / "six_joints.urdf"', f'"urdf" / "{PurePosixPath(URDF).name}"'
_CONTROLLER = '"arm_controller"'
"""In the launch files of a machine: its file is the default in place of none."""
_OF_THE_EXAMPLE = ("launch/single_device.launch", "config/single_device.yaml", "config/controllers.yaml", "urdf/six_joints.urdf")
_SCRIPTS = "scripts/"
_LONGEST_LINE = 127
"""Of a script's first line, which names its interpreter; older kernels cut it there."""


@click.group(cls=NamingGroup)
def ros() -> None:
    """ROS: write a package with launch files for a machine."""


@command(group=ros)
@click.argument("folder", metavar="DIR", type=click.Path(file_okay=False, path_type=Path))
def init(settings: Settings, screen: Screen, folder: Path) -> None:
    """Write the ROS package ros_canopen into a folder: its package.xml, launch files, parameters, an example URDF.

    With -m FILE it is about that machine: the machine file and the files that it names are copied into the package, and its
    joints and limits make a URDF, controllers of ros2_control, and MoveIt's SRDF and limits. What no machine file tells (where
    the joints are mounted, their efforts, a limit that is not set) is listed as to be filled in. Without -m it is about the
    manual's arm of six joints. A package that is there already is not overwritten. It is one for catkin and ament.

    \b
    canopen ros init ros -m cell.toml
    """
    package = folder / PACKAGE
    if package.exists():
        tries = ("another folder", f"remove {package} first")
        raise usage("CO135", f"{package} is there already, and was not overwritten", seen="nothing was done", tries=tries)
    files = dict(_files(settings.machine))
    missing: tuple[str, ...] = ()
    if settings.machine is not None:
        files |= _machine_files(settings)
        machine = settings.machine_file()
        assert machine is not None
        robot = robot_files(machine)
        files |= robot.files
        missing = robot.missing
        if robot.controllers:
            launch = "launch/canopen.launch.py"
            text = files[launch].decode()
            for before, after in (_URDF, (_CONTROLLER, json.dumps(list(robot.controllers.values())).strip("[]"))):
                assert before in text
                text = text.replace(before, after)
            files[launch] = text.encode()
    for name, content in files.items():
        path = package / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CommandError(ExitCode.BAD_FILE, "CO341", f"cannot make {path.parent}: {error.strerror}") from error
        write_file(str(path), content)
        if name.startswith(_SCRIPTS):
            path.chmod(0o755)
    if settings.json:
        screen.json({"package": str(package), "files": sorted(files), "to_fill_in": list(missing)})
        return
    about = "an arm of six joints" if settings.machine is None else str(settings.machine)
    screen.say(f"{escape(str(package))}: {counted(len(files), 'file')}, for {escape(about)}")
    for line in missing:
        screen.say(f"to be filled in: {escape(line)}")
    for line in _next_steps(package):
        screen.say(escape(line))


def _files(machine: Path | None) -> Iterator[tuple[str, bytes]]:
    """Return the files of the package by their names in it. machine: the launch files take it, if there is one."""
    for name, file in _walk(resources.files("canopen_ros") / "package", ""):
        content = file.read_bytes()
        if machine is not None and name in _OF_THE_EXAMPLE:
            continue
        if machine is not None and name in _LAUNCH:
            before, after = _LAUNCH[name]
            assert before in content.decode()
            content = content.decode().replace(before, after).encode()
        if name.startswith(_SCRIPTS):
            content = _with_interpreter(content)
        yield name, content


def _walk(folder: Traversable, place: str) -> Iterator[tuple[str, Traversable]]:
    for each in sorted(folder.iterdir(), key=lambda each: each.name):
        if each.is_dir() and each.name != "__pycache__":
            yield from _walk(each, f"{place}{each.name}/")
        elif each.is_file() and not each.name.endswith((".pyc", "__init__.py")):
            yield f"{place}{each.name}", each


def _with_interpreter(script: bytes) -> bytes:
    """Return a script that runs in this environment, which has canopen-proto."""
    line = f"#!{sys.executable}"
    if len(line) > _LONGEST_LINE or " " in line:
        return script
    _, _, rest = script.partition(b"\n")
    return line.encode() + b"\n" + rest


def _machine_files(settings: Settings) -> dict[str, bytes]:
    """Return the machine file and the files beside it that it names. Raises CommandError, DataError, DictionaryError."""
    machine = settings.machine_file()
    path = settings.machine
    assert machine is not None
    assert path is not None
    found = {f"config/{MACHINE}": _content(path)}
    for node in machine.nodes.values():
        for name in filter(None, (node.device.file, node.device.script, *node.device.overlays)):
            beside = path.parent / name
            if not beside.is_file():
                continue  # a sample, which comes with canopen-proto
            if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
                tries = (f"put it beside {path}, and name it so",)
                raise usage("CO123", f"{name} is not beside {path}: the package would not have it", tries=tries)
            found[f"config/{name}"] = _content(beside)
    return found


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise CommandError(ExitCode.BAD_FILE, "CO330", f"cannot read {path}: {error.strerror}") from error


def _next_steps(package: Path) -> Iterator[str]:
    """Return what to run next, for both versions of ROS."""
    absolute = package.absolute()
    parent, launch = shlex.quote(str(absolute.parent)), shlex.quote(str(absolute / "launch" / "canopen.launch.py"))
    yield "next, with simulated drives:"
    for version, module, launching in (
        ("ROS 1", "rospy", f"ROS_PACKAGE_PATH={parent}:$ROS_PACKAGE_PATH roslaunch {PACKAGE} canopen.launch simulate:=true"),
        ("ROS 2", "rclpy", f"ros2 launch {launch} python:={shlex.quote(sys.executable)} simulate:=true"),
    ):
        missing = "" if find_spec(module) is not None else f"    (this Python does not see {module} yet: docs/ros.md)"
        yield f"  {version}: {launching}{missing}"
    if os.environ.get("ROS_DISTRO"):
        yield f"  this shell has ROS {os.environ['ROS_DISTRO']}"
