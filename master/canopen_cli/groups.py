"""The groups of the command that have nothing but commands: each with its table, in the order of `canopen --help`.

The commands are in rooms, one for each group. `canopen drive`, `canopen log` and the like do more, and have groups of their own.
"""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

NODE: Final = {"list": ("node.list:list_nodes", "List the nodes of a machine file; with -b or --look also which are there.")}


@click.group(cls=LazyGroup, table=NODE)
def node() -> None:
    """The nodes of a machine file: list them, and look which are there.

    \b
    canopen node list cell.toml
    canopen node list cell.toml --look
    """


PDO: Final = {
    "show": ("pdo.show", "Show the PDOs of a node: CAN-ID, when they are sent, times, and their objects by name."),
    "map": ("pdo.map:map_pdo", "Give a PDO of a node other objects, or another CAN-ID, type or time, in the order of CiA 301."),
    "check": ("pdo.check", "Compare the PDOs of nodes: who sends to whom, lengths, CAN-IDs with two senders, PDOs nobody takes."),
}


@click.group(cls=LazyGroup, table=PDO)
def pdo() -> None:
    """The PDOs of nodes: show them, map one, compare those of several nodes.

    \b
    canopen pdo show 3 -b demo
    canopen pdo map 5 tpdo2 statusword 6064 --event 100ms --dry-run
    canopen pdo check -b demo
    """


EMCY: Final = {
    "watch": ("emcy.watch", "Show emergencies in words as they come, of all nodes or of one, until Ctrl-C."),
    "history": ("emcy.history", "Show a node's error register (0x1001) and its last errors (0x1003), the newest first."),
    "clear": ("emcy.history", "Have a node forget its last errors: 0 is written to 0x1003:00."),
}


@click.group(cls=LazyGroup, table=EMCY)
def emcy() -> None:
    """Emergencies of a bus, and the error history of a node.

    \b
    canopen emcy watch -b demo
    canopen emcy history 3 -b demo
    """


LSS: Final = {
    "scan": ("lss.find", "Find the devices without a node-ID, and show their addresses."),
    "identify": ("lss.find", "Find all devices of a type, with and without a node-ID."),
    "inquire": ("lss.find", "Show the LSS address and the node-ID of one device."),
    "set-id": ("lss.set", "Give one device a node-ID, or another one."),
    "store": ("lss.set", "Let one device store its node-ID and bit rate."),
    "assign": ("lss.set", "Give all devices without a node-ID theirs, in order or by a table."),
    "set-bitrate": ("lss.rate", "Change the bit rate of all devices of a bus."),
}


@click.group(cls=LazyGroup, table=LSS)
def lss() -> None:
    """Give devices their node-ID and bit rate over the bus itself (CiA 305).

    \b
    canopen bus serve                               the first terminal: a bus without hardware
    canopen sim --id 255,255,255 -b tcp             the second: three drives without a node-ID
    canopen lss assign --ids 10-20 -b tcp           the third
    """


NET: Final = {
    "init": ("net.init", "Write a machine file of the nodes that a scan finds."),
    "check": ("net.check", "Compare each node with the machine file; nothing is written."),
    "boot": ("net.boot", "Reset, check, configure and start the nodes of a machine file."),
    "watch": ("net.boot", "Boot the nodes, then boot those that come back, and react to lost ones, until Ctrl-C."),
    "links": ("net.links", "Show the PDOs for the links of a machine file: CAN-IDs, mappings, transmission types."),
}


@click.group(cls=LazyGroup, table=NET)
def net() -> None:
    """The network of a machine file: check it, boot it, watch it (CiA 302-2).

    \b
    canopen net init -o cell.toml -b can0     from a scan
    canopen net check cell.toml               is each node as the file says? Nothing is written
    canopen net boot cell.toml                reset, check, configure, start; with -b demo simulated
    canopen net links cell.toml               the PDOs by which its nodes feed each other
    """


SERVE: Final = {
    "ascii": (
        "serve.ascii:serve_ascii",
        "Serve a machine as a text gateway (CiA 309-3), until Ctrl-C.",
    ),
    "mcp": ("serve.assistant:serve_mcp", "Let an assistant read a machine, by the Model Context Protocol."),
    "mqtt": ("serve.mqtt:serve_mqtt", "Tell an MQTT broker what a machine does, one way: states, values, emergencies."),
    "web": ("serve.web:serve_web", "Serve a machine as a page in a browser, and by HTTP, until Ctrl-C."),
    "zenoh": (
        "serve.zenoh:serve_zenoh",
        "Bring the buses of this computer into a fleet, on Zenoh, until Ctrl-C.",
    ),
}


@click.group(cls=LazyGroup, table=SERVE)
def serve() -> None:
    """Let other programs and networks use a machine: read-only, unless --allow says more."""


FLEET: Final = {
    "ls": ("fleet.looking", "List the buses and nodes of a fleet, as their bridges see them."),
    "read": ("fleet.looking", "Read objects of nodes of a fleet, side by side."),
    "watch": ("fleet.watching", "Tell what happens in a fleet, until Ctrl-C: who comes and goes, states, emergencies."),
    "halt": ("fleet.halting", "Stop what moves, at one place or everywhere."),
    "web": ("fleet.web", "Serve the machines of a fleet as a page in a browser, and by HTTP, until Ctrl-C."),
    "record": (
        "fleet.record",
        "Record a fleet as Parquet, by site, node and hour, until Ctrl-C: PDOs, states, emergencies, who comes and goes.",
    ),
    "query": ("fleet.query", "Ask what a fleet was: a list of what was recorded, values of nodes and objects, or SQL."),
    "router": ("fleet.router", "Pass on what bridges and viewers of a fleet say, until Ctrl-C."),
}


@click.group(cls=LazyGroup, table=FLEET)
def fleet() -> None:
    """Many buses on many computers, which `canopen serve zenoh` brings together.

    \b
    canopen serve zenoh --site hall-2 -b demo --listen tcp/127.0.0.1:7447     the first terminal
    canopen fleet ls                                                        the second
    canopen fleet read '*/*/*' 1008

    A place is SITE/BUS/NODE; * stands for each.
    """


DEVICE: Final = {
    "new": ("device.new", "Make a device: a Python file that passes `canopen check` as it is."),
    "describe": ("device.describe", "Write the EDS or XDD of a device."),
}


@click.group(cls=LazyGroup, table=DEVICE)
def device() -> None:
    """Devices of one's own, written in Python: make one, write its file.

    \b
    canopen device new station                        station.py
    canopen device describe station.py -o station.eds
    canopen sim station.py --id 5 -b udp_multicast    serves it
    """


EDS: Final = {
    "lint": ("eds.lint", "Check device descriptions: EDS, DCF, XDD, XDC."),
    "show": ("eds.show", "Show what a device description says: EDS, DCF, XDD, XDC."),
    "diff": ("eds.diff", "Compare two device descriptions by meaning: EDS, DCF, XDD, XDC, in any mixture."),
    "fix": ("eds.fix", "Repair an EDS or DCF: counts and lists, missing types, forms of numbers, duplicate sections, encoding."),
    "doc": ("eds.doc", "Make one readable page of a device description: HTML that needs nothing else, or Markdown."),
    "stubs": ("eds.stubs", "Write a typed view of a device: a Python file with a key for each object."),
    "to-dcf": ("eds.dcf", "Make a DCF: this device, with this node-ID and these settings."),
    "to-cdcf": ("eds.dcf", "Make a concise DCF: the bytes that object 0x1F22 of a configuration manager takes."),
    "to-dbc": ("eds.dbc", "Make a DBC of a device's PDOs, heartbeat and emergencies, for log tools that know no EDS."),
}


@click.group(cls=LazyGroup, table=EDS)
def eds() -> None:
    """Device descriptions: EDS, DCF, XDD and XDC files.

    \b
    canopen eds lint drive.eds              what is wrong with it, with line and column
    canopen eds show drive.eds statusword   what it says
    canopen eds doc drive.eds -o drive.html one page to read
    """
