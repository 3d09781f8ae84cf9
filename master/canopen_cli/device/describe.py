"""`canopen device describe`: write the EDS or XDD of a device of one's own."""

from __future__ import annotations

from pathlib import Path

import click

from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data.declared import describe_device
from canopen_data.describing import EDS_VERSION
from canopen_data.description import FileInfo
from canopen_data.eds.writer import write_eds
from canopen_data.xdd.writer import write_xdd
from canopen_master.simulation.device_code import load_device

WRITERS = {".eds": write_eds, ".xdd": write_xdd}


@command()
@click.argument("path", metavar="FILE.py")
@click.option("-o", "--output", metavar="OUT", required=True, help="The new file: OUT.eds or OUT.xdd.")
def describe(settings: Settings, screen: Screen, path: str, output: str) -> None:
    """Write the EDS or XDD of a device. The Python file is run for it.

    \b
    canopen device describe station.py -o station.eds
    canopen device describe station.py -o station.xdd
    """
    write = WRITERS.get(Path(output).suffix.lower())
    if write is None:
        tries = (f"canopen device describe {path} -o {Path(path).stem}.eds",)
        raise usage("CO001", f"{output}: an .eds or an .xdd can be written", tries=tries)
    check_new_file(settings, screen, output, path)
    device = load_device(path)
    info = FileInfo(Path(output).name, 1, 0, EDS_VERSION, device.nameplate.description)
    write_file(output, write(describe_device(device, info)).encode(), path)
    if settings.json:
        screen.json({"file": path, "output": output, "class": device.__name__, "objects": len(device.dictionary.objects)})
        return
    screen.say(f"{escape(output)}: {device.__name__}, {counted(len(device.dictionary.objects), 'object')}")
