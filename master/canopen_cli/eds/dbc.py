"""`canopen eds to-dbc`: the PDOs of a device as a DBC, for log tools that know no EDS."""

from __future__ import annotations

import click

from canopen_cli.eds.dcf import commissioned
from canopen_cli.shared.eds_files import tell_faults
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.node_files import overlaid
from canopen_cli.shared.options import NodeId, Settings, command
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data.dbc import ENCODING, dbc_of
from canopen_data.named_files import open_description


@command(name="to-dbc")
@click.argument("path", metavar="FILE")
@click.option("--id", "node_id", metavar="N", type=NodeId(), help="The device's node-ID; a DCF may have it already.")
@click.option("--name", default="", help="What the device is called in the DBC.  [default: node5]")
@click.option("-o", "--output", metavar="OUT", required=True, help="The new file.")
def to_dbc(settings: Settings, screen: Screen, path: str, node_id: int | None, name: str, output: str) -> None:
    """Make a DBC of a device's PDOs, heartbeat and emergencies, for log tools that know no EDS.

    PDOs are those of the file: of an EDS by its defaults, of a DCF as configured. --overlay gives units and factors, which become
    those of the signals. What a DBC cannot say is told.

    \b
    canopen eds to-dbc drive.eds --id 5 -o drive5.dbc
    canopen eds to-dbc axis5.dcf --overlay units.toml -o axis5.dbc
    """
    check_new_file(settings, screen, output, path)
    file = open_description(path, settings.encoding)
    commissioning = commissioned(file.description, node_id, path)
    assert commissioning.node_id is not None
    dictionary = overlaid(file.description.dictionary, settings.overlays, screen)
    made = dbc_of(dictionary, commissioning.node_id, name or commissioning.node_name or "")
    write_file(output, made.text.encode(ENCODING), path)
    if settings.json:
        document = {"file": path, "output": output, "node": commissioning.node_id, "messages": made.messages}
        screen.json(document | {"signals": made.signals, "left_out": [each._asdict() for each in made.left_out]})
        return
    tell_faults(screen, file)
    for each in made.left_out:
        screen.say(f"  [dim]left out:[/] {escape(each.what)}: {escape(each.reason)}")
    screen.say(f"{escape(output)}: {counted(made.messages, 'message')}, {counted(made.signals, 'signal')}")
