"""The conformance kit on python-can's pcan backend, with the stand-in for the maker's library."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from canopen_transports import Transport, open_transport
from canopen_transports.conformance import Site, SiteBus, TransportCase, openings
from tests.transports.support import cases


async def join(place: int) -> Transport:
    return await open_transport(f"pcan:PCAN_USBBUS{place + 1}@1M")


@asynccontextmanager
async def cabled() -> AsyncIterator[SiteBus]:
    yield SiteBus(join)


SITE = Site(
    cabled,
    openings(
        "pcan:PCAN_USBBUS9",
        "pcan:PCAN_USBUS1",
        "pcan:PCAN_USBBUS1@300k",
        "pcan:PCAN_USBBUS1?listen_only=perhaps",
        "/dev/pcan99",
    ),
)


@pytest.mark.thorough(6)
@pytest.mark.usefixtures("peak")
@pytest.mark.parametrize("case", cases(SITE, optional=("many_at_once",)), ids=str)
def test_conformance(case: TransportCase) -> None:
    case.run(SITE)
