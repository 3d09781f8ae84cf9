"""`canopen serve`: let other programs and networks use a machine."""

from __future__ import annotations

from typing import Final

import click

from canopen_cli.shared.lazy import LazyGroup

COMMANDS: Final = {
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


@click.group(cls=LazyGroup, table=COMMANDS)
def serve() -> None:
    """Let other programs and networks use a machine: read-only, unless --allow says more."""
