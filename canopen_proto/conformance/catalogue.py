"""All 127 cases of the conformance test, by number, and how to run them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Final

from canopen_proto.conformance import (
    block_cases,
    channel_cases,
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
from canopen_proto.conformance.bench import Bench
from canopen_proto.conformance.case import Case, Verdict
from canopen_proto.procedures.steps import Procedure

EDS_CHECK: Final = Case("1.0", "EDS checker", "Check the EDS file", None, waits_for="a reader of EDS files")

CASES: Final[tuple[Case, ...]] = (
    EDS_CHECK,
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
    *storing_cases.CASES,
    *state_cases.CASES,
)

BY_NUMBER: Final[Mapping[str, Case]] = MappingProxyType({case.number: case for case in CASES})


def run_all(bench: Bench, cases: Iterable[Case] = CASES) -> Procedure[list[tuple[Case, Verdict]]]:
    """Run cases one after the other, each on a device that was just reset; the device is reset at the end too."""
    results: list[tuple[Case, Verdict]] = []
    for case in cases:
        verdict = yield from case.run(bench)
        results.append((case, verdict))
    yield from bench.reset()
    return results


def table() -> str:
    """The cases as a table in Markdown: what docs/conformance.md holds."""
    rows = ["| Number | Name | Case | State |", "|---|---|---|---|"]
    for case in CASES:
        state = "built" if case.body is not None else f"not built yet: {case.waits_for}"
        rows.append(f"| {case.number} | {case.name} | {case.title} | {state} |")
    return "\n".join(rows) + "\n"
