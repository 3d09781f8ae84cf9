"""Conformance cases: what a CANopen device is asked, and which of its answers are right.

Each case of the conformance test is a procedure written against an object dictionary and any node on any bus:

    bench = Bench(network, node_id=5, dictionary)
    request_id = network.run(run_all(bench), now)        # ProcedureFinished.result: a list of (case, verdict)

    case.py         Case: what a case is, and how it ends; expectations.py: how a body says what it expects
    bench.py        Bench: a device under test, and the tools to ask it; probe.py: frames made by hand
    catalogue.py    all cases by number; `run_all`; the table in docs/conformance.md
    *_cases.py      the cases, a chapter each

What it cannot show: electrical and timing properties of the bus, and whatever a device does at its inputs and outputs.
"""
