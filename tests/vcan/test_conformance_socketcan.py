"""The conformance kit on a real kernel: our own SocketCAN transport, and python-can's."""

from __future__ import annotations

import pytest

from canopen_transports.conformance import Site, TransportCase, at, openings
from tests.transports.support import cases
from tests.vcan.support import needs_vcan

pytestmark = needs_vcan

SITES = {
    "native": Site(
        at("socketcan:vcan0"),
        openings(
            "socketcan:nocan0",
            "socketcan:vcan99",
            "socketcan:lo",
            "vcan98",
            "socketcan:vcan0?filter=some",
            "socketcan:vcan0?local_loopback=true",
            "socketcan:vcan0?listen_only=true",
        ),
    ),
    "filtered": Site(at("socketcan:vcan0?filter=ids&sync=bcm")),
    "python-can": Site(at("pythoncan:socketcan:vcan0"), openings("pythoncan:socketcan:nocan0", "pythoncan:socketcan:lo")),
}


OPTIONS = {
    "native": ("eager_send", "many_at_once", "what_has_come"),
    "filtered": ("eager_send", "many_at_once", "what_has_come", "filters", "cyclic_frames"),
    "python-can": ("many_at_once",),
}
APPLY = [(name, case) for name, site in SITES.items() for case in cases(site, optional=OPTIONS[name])]


@pytest.mark.parametrize(("name", "case"), APPLY, ids=str)
def test_conformance(name: str, case: TransportCase) -> None:
    case.run(SITES[name])
