"""Message classes that Debian's ROS 1 does not have, made from the definitions in interfaces/ by ROS's own generator, genpy.

A class that the user has installed is used, not replaced. Ours have the same type and md5 sum as the published ones, which is all
that ROS 1 compares. Other processes (`rosservice call`) need the classes too: `python -m canopen_ros.ros1.messages FOLDER` writes
them, for `PYTHONPATH=FOLDER`.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple

DEFINITIONS: Final = Path(__file__).parent / "interfaces"
"""PACKAGE/NAME.msg, .srv or .action; only fields and constants, on which the md5 sums rest."""

SEPARATOR: Final = "=" * 80
"""Stands in a class's `_full_text` before the definition of each message that it uses."""


class GeneratedModule(NamedTuple):
    """One generated module. kind: "msg" or "srv"."""

    package: str
    kind: str
    name: str
    text: str


def messages_of_action(name: str, text: str) -> dict[str, str]:
    """Return the definitions of the seven messages of an action, each after those that it uses. name: of the action, without its
    package. text: of its file.

    Source: http://wiki.ros.org/actionlib, and genaction.py of package actionlib_msgs.
    """
    goal, result, feedback = text.split("---\n")
    status = "Header header\nactionlib_msgs/GoalStatus status\n"
    return {
        f"{name}Goal": goal,
        f"{name}Result": result,
        f"{name}Feedback": feedback,
        f"{name}ActionGoal": f"Header header\nactionlib_msgs/GoalID goal_id\n{name}Goal goal\n",
        f"{name}ActionResult": f"{status}{name}Result result\n",
        f"{name}ActionFeedback": f"{status}{name}Feedback feedback\n",
        f"{name}Action": "".join(f"{name}Action{part} action_{part.lower()}\n" for part in ("Goal", "Result", "Feedback")),
    }


def packages() -> list[str]:
    """Return the packages with classes that the node needs and Debian lacks."""
    return sorted(folder.name for folder in DEFINITIONS.iterdir() if folder.is_dir())


def generate(package: str) -> Iterator[GeneratedModule]:
    """Generate the modules of all definitions of a package. Raises ImportError without ROS 1 (genpy, genmsg)."""
    genmsg, generator = (importlib.import_module(name) for name in ("genmsg", "genpy.generator"))
    context = genmsg.MsgContext.create_default()
    definitions = DEFINITIONS / package
    messages = {path.stem: path.read_text() for path in sorted(definitions.glob("*.msg"))}
    for path in sorted(definitions.glob("*.action")):
        messages |= messages_of_action(path.stem, path.read_text())
    for name, text in messages.items():
        spec = genmsg.msg_loader.load_msg_from_string(context, text, f"{package}/{name}")
        register_used(context, spec.types)
        yield GeneratedModule(package, "msg", name, "\n".join(generator.msg_generator(context, spec, {})))
    for path in sorted(definitions.glob("*.srv")):
        spec = genmsg.msg_loader.load_srv_from_string(context, path.read_text(), f"{package}/{path.stem}")
        yield GeneratedModule(package, "srv", path.stem, "\n".join(generator.srv_generator(context, spec, {})))


def register_used(context: Any, types: list[str]) -> None:
    """Take the definitions of messages of other packages from their installed classes: Debian has no .msg files. context: of
    genmsg. types: of the fields, as the definitions have them."""
    genmsg = importlib.import_module("genmsg")
    for each in types:
        full_name = genmsg.msgs.bare_msg_type(each)
        if genmsg.msgs.is_builtin(full_name) or context.is_registered(full_name):
            continue
        package, name = full_name.split("/")
        used = getattr(importlib.import_module(f"{package}.msg"), name)
        spec = genmsg.msg_loader.load_msg_from_string(context, used._full_text.partition(SEPARATOR)[0], full_name)
        register_used(context, spec.types)


def install() -> None:
    """Make all classes importable in this process. Does nothing for packages that are installed."""
    for package in packages():
        try:
            importlib.import_module(package)
        except ModuleNotFoundError as error:
            if error.name != package:
                raise
            make(package)


def make(package: str) -> None:
    """Make a package's modules in memory."""
    top = sys.modules[package] = ModuleType(package)
    for kind in ("msg", "srv"):
        module = sys.modules[f"{package}.{kind}"] = ModuleType(f"{package}.{kind}")
        setattr(top, kind, module)
    for source in generate(package):
        namespace: dict[str, Any] = {"__name__": f"{package}.{source.kind}._{source.name}"}
        exec(compile(source.text, f"<{package}/{source.name}>", "exec"), namespace)
        made = {name: value for name, value in namespace.items() if getattr(value, "_type", "").startswith(f"{package}/")}
        vars(sys.modules[f"{package}.{source.kind}"]).update(made)


def write(folder: Path) -> None:
    """Write the packages as Python sources, for other processes: `PYTHONPATH=FOLDER rosservice call ...`."""
    for package in packages():
        for source in generate(package):
            parent = folder / package / source.kind
            parent.mkdir(parents=True, exist_ok=True)
            (folder / package / "__init__.py").touch()
            (parent / f"_{source.name}.py").write_text(source.text + "\n", encoding="utf-8")
        for parent in (folder / package).glob("*/"):
            modules = sorted(path.stem for path in parent.glob("_[!_]*.py"))
            (parent / "__init__.py").write_text("".join(f"from .{module} import *\n" for module in modules), encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m canopen_ros.ros1.messages FOLDER")
    write(Path(sys.argv[1]))
    print(f"Try: export PYTHONPATH={sys.argv[1]}:$PYTHONPATH")
