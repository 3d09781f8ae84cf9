"""The conformance kit on what python-can needs no adapter for: its virtual bus, read by a thread, and UDP multicast, by a socket;
both also as seen by a member that only listens."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import pytest

from canopen_proto.frame import Frame
from canopen_transports import Transport, open_transport
from canopen_transports.conformance import NotApplicable, Site, SiteBus, TransportCase, at, openings
from canopen_transports.conformance.bench import TransportBench
from tests.transports.multicast import free_locator, need_multicast
from tests.transports.support import cases

VIRTUAL = "pythoncan:virtual:conformance of canopen_transports"


class SilentMember(SiteBus):
    """The member that is tried only listens; another one, of the usual kind, speaks."""

    def __init__(self, locator: str) -> None:
        super().__init__(self.cannot_speak)
        self.locator = locator

    async def cannot_speak(self, place: int) -> Transport:
        raise NotApplicable("who only listens does not send")

    async def hearer(self, bench: TransportBench, frames: Sequence[Frame]) -> Transport:
        speaker = bench.keep(await open_transport(self.locator))
        more = "&" if "?" in self.locator else "?"
        silent = bench.keep(await open_transport(f"{self.locator}{more}listen_only=true"))
        bench.say(speaker, frames)
        return silent


@asynccontextmanager
async def silent_on_virtual() -> AsyncIterator[SiteBus]:
    yield SilentMember(VIRTUAL)


@asynccontextmanager
async def multicast() -> AsyncIterator[SiteBus]:
    async with at(free_locator())() as bus:
        yield bus


@asynccontextmanager
async def silent_on_multicast() -> AsyncIterator[SiteBus]:
    yield SilentMember(free_locator())


UNREACHABLE = openings(
    "udp_multicast:192.0.2.1",
    "udp_multicast:here",
    "udp_multicast?port=port",
    "udp_multicast?hop_limit",
    "udp_multicast?fd=true",
    "udp_multicast?receive_own_messages=1",
)
WITHOUT_DRIVER = openings(
    "pythoncan:virtuall:x", "pythoncan:", "kvaser:0@500k", "vector:0@500k", "ixxat:0", "gs_usb:0", "socketcand:can0", "neovi:1"
)

SITES = {
    "virtual": Site(at(VIRTUAL), WITHOUT_DRIVER),
    "silent on virtual": Site(silent_on_virtual),
    "multicast": Site(multicast, UNREACHABLE),
    "silent on multicast": Site(silent_on_multicast),
}


APPLY = [
    (name, case)
    for name, site in SITES.items()
    for case in cases(site, hears_only=name.startswith("silent"), optional=("many_at_once",))
]


@pytest.mark.thorough(8)
@pytest.mark.parametrize(("name", "case"), APPLY, ids=str)
def test_conformance(name: str, case: TransportCase) -> None:
    if "multicast" in name:
        need_multicast()
    case.run(SITES[name])
