"""`canopen eds stubs`: write a typed view of a device, by which a type checker and an IDE know its objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from canopen_cli.shared.eds_files import tell_faults
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.node_files import overlaid
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data import load_dictionary
from canopen_data.descriptions import with_names
from canopen_data.named_files import open_description
from canopen_data.stubs import identifier, stubs_of


@command()
@click.argument("path", metavar="FILE")
@click.option("-o", "--output", metavar="OUT.py", required=True, help="The new Python file.")
@click.option("--class", "class_name", metavar="NAME", help="The class in it; by default after OUT: drive.py has Drive.")
def stubs(settings: Settings, screen: Screen, path: str, output: str, class_name: str | None) -> None:
    """Write a typed view of a device: a Python file with a key for each object.

    mypy and pyright then refuse a wrong name, a wrong type, and a write to what is read-only: `node.read(Drive.statusword)` gives
    an int. Objects have the names that they have in every command, in Python's spelling.

    \b
    canopen eds stubs drive.eds -o drive.py
    canopen eds stubs drive.eds -o drive.py --overlay units.toml
    """
    if class_name is None:
        class_name = "".join(word.capitalize() for word in identifier(Path(output).stem).split("_")) or "Device"
    if not class_name.isidentifier() or identifier(class_name) != identifier(class_name).rstrip("_"):
        raise usage("CO001", f"{class_name!r} is no name of a class", tries=("--class Drive",))
    check_new_file(settings, screen, output, path)
    file = open_description(path, settings.encoding)
    description = with_names(file.description, load_dictionary()[0])
    dictionary = overlaid(description.dictionary, settings.overlays, screen)
    made = stubs_of(replace(description, dictionary=dictionary), class_name)
    write_file(output, made.text.encode(), path)
    if settings.json:
        shared = [{"name": each.name, "names": each.names} for each in made.collisions]
        screen.json({"file": path, "output": output, "class": class_name, "keys": made.count, "collisions": shared})
        return
    tell_faults(screen, file)
    for each in made.collisions:
        names = ", ".join(f"{place} {name}" for place, name in each.names.items())
        screen.say(f"[yellow]several objects are called {escape(each.name)}[/]: {escape(names)}")
    screen.say(f"{escape(output)}: {class_name}, {counted(made.count, 'key')}")
