"""`canopen device new`: make a device of one's own, a Python file to go on from."""

from __future__ import annotations

import keyword
import re
from importlib import resources
from pathlib import Path
from typing import Final

import click

from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, escape

SUFFIX: Final = ".py"
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9]*(?:[-_ ][A-Za-z0-9]+)*")


@command()
@click.argument("name")
def new(settings: Settings, screen: Screen, name: str) -> None:
    """Make a device: a Python file that passes `canopen check` as it is.

    NAME: of the device, such as io_station; the file is io_station.py, the class IoStation.

    \b
    canopen device new io_station
    canopen sim io_station.py --id 5 -b udp_multicast
    """
    folder, stem = Path(name).parent, Path(name).name.removesuffix(SUFFIX)
    words = re.split("[-_ ]", stem)
    module = "_".join(words).lower()
    if _NAME.fullmatch(stem) is None or keyword.iskeyword(module):
        seen = "a name is made of letters, digits and underscores, and begins with a letter"
        raise usage("CO001", f"{name!r} is no name of a device", seen=seen, tries=("canopen device new io_station",))
    path = str(folder / (module + SUFFIX))
    class_name = "".join(word[:1].upper() + word[1:] for word in words)
    check_new_file(settings, screen, path)
    write_file(path, skeleton(module, class_name, " ".join(words)).encode())
    if settings.json:
        screen.json({"file": path, "class": class_name})
        return
    screen.say(f"{escape(path)}: the device {class_name}")
    screen.say(f"serve it with  canopen sim {escape(path)} --id 5 -b udp_multicast")


def skeleton(module: str, class_name: str, product_name: str) -> str:
    """Return the text of the skeleton, which is a device itself, with these names."""
    text = (resources.files("canopen_cli.device") / "skeleton.py").read_text(encoding="utf-8")
    text = text.replace('Nameplate("Skeleton"', f'Nameplate("{product_name}"').replace('"""Skeleton:', f'"""{product_name}:')
    return text.replace("skeleton", module).replace("Skeleton", class_name)
