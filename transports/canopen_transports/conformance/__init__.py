"""What every transport must do, as cases that any transport can be asked: ours, and yours.

    python -m canopen_transports.conformance virtual:trial        one that `open_transport` opens

    @asynccontextmanager
    async def my_bus() -> AsyncIterator[Bus]:                      one of your own: how a fresh bus is made
        hub = MyHub()
        yield Bus(lambda place: hub.join())                        and how one more member joins it

    @pytest.mark.parametrize("case", CASES, ids=str)
    def test_my_transport(case: Case) -> None:
        case.run(Site(my_bus))

What is promised stands in `canopen_transports.transport`. No pytest is needed: `run_all` gives a verdict for each case, and
`Case.run` raises `Violation`, an AssertionError that says what was expected and what was seen, or `NotApplicable`.

    bench.py        Site, Bus: where a transport is tried; Bench: the tools of a case; frames.py: what is sent
    case.py         Case; expectations.py: how its body says what it expects; leftovers.py: what a transport must not leave behind
    *_cases.py      the cases, a chapter each; catalogue.py: all of them, `run_all`

**Never run it on a bus with drives.** The cases send frames of every kind, as fast as they can, NMT commands among them.

No case waits in order to see that nothing comes: a later frame proves that nothing came before it. What is random comes from
seeds. What cannot be shown: whether a frame that a bus took reaches the other end of a real cable.
"""

from canopen_transports.conformance.bench import Bus, Site, at, openings
from canopen_transports.conformance.case import Case
from canopen_transports.conformance.catalogue import CASES, run_all
from canopen_transports.conformance.expectations import NotApplicable, Violation

__all__ = ["CASES", "Bus", "Case", "NotApplicable", "Site", "Violation", "at", "openings", "run_all"]
