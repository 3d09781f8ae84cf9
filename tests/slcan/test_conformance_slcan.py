"""The conformance kit on slcan adapters at pseudo-terminals."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import trio

from canopen_transports import Transport
from canopen_transports.conformance import Site, SiteBus, TransportCase, openings
from tests.examples import takes_all
from tests.transports.support import cases

if sys.platform == "win32":
    pytest.skip("pseudo-terminals are POSIX's alone", allow_module_level=True)

from tests.slcan.adapter import Adapter, SimulatedBus
from tests.slcan.test_slcan import opened


@asynccontextmanager
async def simulated() -> AsyncIterator[SiteBus]:
    with tempfile.TemporaryDirectory() as folder:
        simulated = SimulatedBus(Path(folder))
        plugged: dict[int, Adapter] = {}

        async def join(place: int) -> Transport:
            if place in plugged:
                simulated.unplug(plugged.pop(place))
            plugged[place] = simulated.plug(f"tty{place}")
            with trio.CancelScope(shield=True):
                return await opened(plugged[place])

        try:
            yield SiteBus(join)
        finally:
            simulated.close()


SITE = Site(
    simulated,
    openings("slcan:/dev/no-such-line", "slcan:", "slcan:/dev/null@500k?sleep_after_open=0", "slcan:/dev/no@50M"),
    burst=200,  # of what a serial line loses nobody knows
    stream=2_000 if takes_all() else 500,  # at the speed of a serial line in Python
)


@pytest.mark.thorough(6)
@pytest.mark.parametrize("case", cases(SITE, optional=("many_at_once",)), ids=str)
def test_conformance(case: TransportCase) -> None:
    case.run(SITE)
