"""The conformance kit: cases that check what every transport must do. Use it for a transport of your own, too.

    python -m canopen_transports.conformance virtual:trial        a transport that `open_transport` opens

    @asynccontextmanager
    async def my_bus() -> AsyncIterator[SiteBus]:                  your own transport: how to make a fresh bus
        hub = MyHub()
        yield SiteBus(lambda place: hub.join())                    and how one more member joins it

    @pytest.mark.parametrize("case", CASES, ids=str)
    def test_my_transport(case: TransportCase) -> None:
        case.run(Site(my_bus))

`canopen_transports.transport` states the promises. No pytest is needed: `run_all` gives a verdict for each case.
`TransportCase.run` raises `NotApplicable`, or `ViolationError`: an AssertionError that says what was expected and what was seen.

    bench.py        Site, SiteBus: where a transport is tried; TransportBench: the tools of a case
    frames.py       the frames that are sent, and how a case says which it expects; the rest: canopen_proto/verdict.py
    case.py         TransportCase, and what a closed transport must not hold
    *_cases.py      the cases, one chapter each; catalogue.py: all of them, `run_all`

**Never run it on a bus with drives.** The cases send frames of every kind as fast as they can, NMT commands among them.

No case waits to see that nothing comes: a later frame proves that nothing came before it. Random choices come from seeds. The kit
cannot show whether a frame that a bus took reaches the other end of a real cable.
"""

from canopen_proto.verdict import NotApplicable, ViolationError
from canopen_transports.conformance.bench import Site, SiteBus, at, openings
from canopen_transports.conformance.case import TransportCase
from canopen_transports.conformance.catalogue import CASES, run_all

__all__ = ["CASES", "NotApplicable", "Site", "SiteBus", "TransportCase", "ViolationError", "at", "openings", "run_all"]
