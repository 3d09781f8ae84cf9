"""All 127 cases of the conformance test, by number, and how to run them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import Final

from canopen_check import (
    block_cases,
    channel_cases,
    description_cases,
    dictionary_cases,
    emergency_cases,
    guarding_cases,
    heartbeat_cases,
    pdo_cases,
    pdo_mapping_cases,
    sdo_cases,
    state_cases,
    storing_cases,
    sync_cases,
)
from canopen_check.bench import Bench
from canopen_check.case import Case
from canopen_proto.procedures.steps import Procedure, ProcedureError
from canopen_proto.verdict import Verdict

# Chapter 8 comes last: it restores defaults, and then a device that was commissioned by a DCF no longer has the DCF's values.
CASES: Final[tuple[Case, ...]] = (
    *description_cases.CASES,
    *sdo_cases.CASES,
    *block_cases.CASES,
    *channel_cases.CASES,
    *pdo_cases.CASES,
    *pdo_mapping_cases.CASES,
    *dictionary_cases.CASES,
    *emergency_cases.CASES,
    *sync_cases.CASES,
    *guarding_cases.CASES,
    *heartbeat_cases.CASES,
    *state_cases.CASES,
    *storing_cases.CASES,
)

BY_NUMBER: Final[Mapping[str, Case]] = MappingProxyType({case.number: case for case in CASES})


def run_all(bench: Bench, cases: Iterable[Case] = CASES) -> Procedure[list[tuple[Case, Verdict]]]:
    """Run cases one after the other, each after a reset of the device; return their verdicts. A used device is reset at the
    end."""
    results: list[tuple[Case, Verdict]] = []
    for case in cases:
        verdict = yield from case.run(bench)
        results.append((case, verdict))
    if any(case.uses_device for case, _ in results):
        with suppress(ProcedureError):  # a device without a boot-up frame: the cases have told that
            yield from bench.reset()
    return results


def table() -> str:
    """Return the cases as a table in Markdown, as in docs/conformance.md."""
    rows = [f"| {case.number} | {case.name} | {case.title} | {'yes' if case.stores else ''} |" for case in CASES]
    return "\n".join(["| Number | Name | Case | Stores |", "|---|---|---|---|", *rows]) + "\n"
