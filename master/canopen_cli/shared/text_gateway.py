"""The session of a command over a text gateway: `-b gw:HOST:PORT`, see over_text.py."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import Settings
from canopen_cli.shared.screen import Screen
from canopen_gateway.ascii import RemoteGateway, open_remote_gateway
from canopen_master.master import SDO_TIMEOUT


class TextSession:
    """An open text gateway, and the files of the devices behind it."""

    def __init__(self, gateway: RemoteGateway, files: NodeFiles, sdo_timeout: float) -> None:
        self.gateway = gateway
        self.files = files
        self.sdo_timeout = sdo_timeout


@asynccontextmanager
async def open_text(settings: Settings, screen: Screen) -> AsyncIterator[TextSession]:
    """Connect to the text gateway of the options while the block runs. Raises NoGatewayError, GatewayRefusedError."""
    files = NodeFiles(settings, screen)
    async with open_remote_gateway(settings.required_bus()) as gateway:
        if settings.sdo_timeout is not None:
            await gateway.set_sdo_timeout(settings.sdo_timeout)
        yield TextSession(gateway, files, settings.sdo_timeout or SDO_TIMEOUT)
