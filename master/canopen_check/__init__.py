"""Conformance cases: the requests to a CANopen device, and the answers that are right.

Each case of the conformance test is a procedure written against an object dictionary and any node on any bus:

    bench = Bench(network, node_id=5, dictionary)
    request_id = network.run(run_all(bench), now)        # ProcedureFinished.result: a list of (case, verdict)

    case.py         Case: its body and its result
    expectations.py what a body notes about the device; canopen_proto/verdict.py: how it checks, and the verdict
    bench.py        Bench: a device under test, and the tools to test it; probe.py: frames made by hand
    catalogue.py    all cases by number; `run_all`; the table in docs/conformance.md
    *_cases.py      the cases, one chapter each

The cases cannot show electrical and timing properties of the bus, and the behaviour of a device's inputs and outputs.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_check.bench import Bench as Bench
    from canopen_check.case import Case as Case
    from canopen_check.catalogue import CASES as CASES
    from canopen_check.catalogue import run_all as run_all
    from canopen_check.expectations import NotInTimeError as NotInTimeError
    from canopen_check.expectations import TimingError as TimingError
    from canopen_check.probe import FrameHeard as FrameHeard
    from canopen_proto.verdict import NotApplicable as NotApplicable
    from canopen_proto.verdict import Result as Result
    from canopen_proto.verdict import Verdict as Verdict
    from canopen_proto.verdict import ViolationError as ViolationError
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
