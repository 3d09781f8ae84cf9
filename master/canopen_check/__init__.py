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
