"""`canopen demo --web`: the page of the web door, on the six simulated joints."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Final

from canopen_cli.serve.served import serve_door
from canopen_cli.serve.web import tell_web_door
from canopen_cli.shared.options import Settings
from canopen_cli.shared.screen import Screen
from canopen_gateway import GatewayService, Permission, open_gateway
from canopen_gateway.web import WebDoor, bind_web_door
from canopen_master.demonstration.task import CHAINS, DemonstrationTask
from canopen_master.session import open_master
from canopen_master.simulation.serving import simulated_drives
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import Unit

ALLOWED: Final = frozenset({Permission.WRITE, Permission.MOTION, Permission.NMT})
"""The joints are simulated, so a newcomer may try what moves them."""
DEGREES: Final = AxisSettings(unit=Unit.DEGREE, counts_per_unit=1000.0, max_speed=30.0)
"""A simulated joint counts in thousandths of a degree."""


def show_in_browser(settings: Settings, screen: Screen, port: int, seconds: float) -> None:
    """Serve the page until Ctrl-C. port: 0 for any free one. seconds: end after this time; inf: not by itself."""

    def tell(door: WebDoor, service: GatewayService) -> None:
        tell_web_door(settings, screen, door, service)
        _open_page(screen, door.url)

    serve_door(settings, screen, lambda: bind_web_door(port=port), open_simulated_arm, tell, seconds)


@asynccontextmanager
async def open_simulated_arm() -> AsyncIterator[GatewayService]:
    """Have a gateway to the simulated arm of the demonstration while the block runs; nobody has given it power yet."""
    task = DemonstrationTask(chains=CHAINS)
    description = task.chosen_chain()
    locators = task.locators(description)
    joints = tuple(replace(joint, bus=locators[joint.bus]) for joint in description.joints)
    async with (
        simulated_drives((joint.bus, joint.node_id) for joint in joints),
        open_master(*dict.fromkeys(locators.values())) as master,
        open_gateway(master, allow=ALLOWED) as service,
    ):
        master.chain(replace(description, joints=joints), axes=DEGREES)
        yield service


def _open_page(screen: Screen, url: str) -> None:
    """Open the address where a desktop is; elsewhere a browser of the terminal could take it over."""
    has_desktop = sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if has_desktop and sys.stdout.isatty():
        webbrowser.open(url)
    else:
        screen.say("Open it in a browser of this computer; Ctrl-C ends it.")
