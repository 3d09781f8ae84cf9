"""`NetworkViews`: the network of each bus, for the doors that show it. The plan of the links is made once for each bus."""

from __future__ import annotations

from collections.abc import Mapping

import trio

from canopen_gateway.traffic.network import NetworkData, network_data, planned_links
from canopen_gateway.traffic.traffic import NetTraffic
from canopen_master import Master
from canopen_master.plain_text import clean
from canopen_proto.manager.linking import LinkPlan


class NetworkViews:
    """See this module's text. master: an open one."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._plans: dict[str, tuple[LinkPlan | None, str]] = {}
        self._planning = trio.Lock()

    async def of(self, traffic: NetTraffic, net: str, number: int, names: Mapping[int, str]) -> NetworkData:
        """Return the network of a bus; see `network_data`."""
        async with self._planning:
            if net not in self._plans:
                self._plans[net] = await trio.to_thread.run_sync(self._plan, net)
        return network_data(self._master, traffic, net, number, names, *self._plans[net])

    def _plan(self, net: str) -> tuple[LinkPlan | None, str]:
        """Make the plan of the links, in a thread: it reads files."""
        try:
            return planned_links(self._master, net), ""
        except Exception as error:  # noqa: BLE001 - whatever is wrong with a file, it is told in this view, and ends nothing
            return None, f"the links of the machine file are left out: {clean(str(error).splitlines()[0])}"
