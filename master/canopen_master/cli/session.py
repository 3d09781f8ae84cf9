"""What most commands begin with: the dictionary, the bus of the options, a master on it, and for `-b demo` the drives too."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

from canopen_data import load_dictionary
from canopen_master.cli.fleet import DEMO_LOCATOR, DEMO_NODES, simulated_fleet
from canopen_master.cli.options import DEMO, Settings
from canopen_master.cli.screen import Screen
from canopen_master.master import SDO_TIMEOUT, Master
from canopen_master.node import Node
from canopen_master.session import open_master
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.findings import Severity
from canopen_proto.machine import SECOND
from canopen_proto.network import Network


class Session:
    """An open master and its dictionary."""

    def __init__(self, master: Master, dictionary: ObjectDictionary) -> None:
        self.master = master
        self.dictionary = dictionary

    def node(self, node_id: int) -> Node:
        """A node of the only bus."""
        return self.master.node(node_id)

    @property
    def network(self) -> Network:
        """The core's network on that bus."""
        return self.master.bus().network


def read_dictionary(screen: Screen) -> ObjectDictionary:
    """The object dictionary. That a file of the user's is used is told; warnings about it are told with -v."""
    dictionary, findings = load_dictionary()
    for finding in findings:
        if finding.severity is Severity.NOTICE:
            screen.say(f"[dim]{finding.source}: {finding.message}[/]")
        else:
            screen.detail(str(finding))
    return dictionary


@asynccontextmanager
async def open_session(settings: Settings, screen: Screen) -> AsyncIterator[Session]:
    """A master on the bus of the options, while the block runs. Raises Problem, BusError, DictionaryError, DataError."""
    bus = settings.required_bus()
    dictionary = read_dictionary(screen)
    timeout = SDO_TIMEOUT if settings.timeout is None else settings.timeout / SECOND
    async with AsyncExitStack() as stack:
        if bus == DEMO:
            await stack.enter_async_context(simulated_fleet((DEMO_LOCATOR, node_id) for node_id in DEMO_NODES))
            bus = DEMO_LOCATOR
        master = await stack.enter_async_context(open_master(bus, sdo_timeout=timeout, dictionary=dictionary))
        yield Session(master, dictionary)
