"""Chapter 1 of the conformance test: the device's file, without the device (CiA 306-1 v1.4.0, CiA 311).

All other cases rely on the file, so a mistake in it may look like one of the device. The reader and the linter decide what is an
error, and what is only a warning (canopen_data/checks).
"""

from __future__ import annotations

from typing import Final

from canopen_check.bench import Bench
from canopen_check.case import Case
from canopen_data.checks import check
from canopen_data.findings import Severity
from canopen_proto.explained import counted
from canopen_proto.procedures.steps import Procedure
from canopen_proto.verdict import ViolationError, does_not_apply


def check_file(bench: Bench) -> Procedure[str]:
    """1.0: the file can be read and checked without an error. The number of warnings is reported."""
    yield from ()  # no step: the device is not asked
    if bench.description is None:
        does_not_apply("there is no file of the device")
    found = [*bench.description.findings, *check(bench.description)]
    for each in found:
        if each.severity is Severity.ERROR:
            bench.notes.fail(ViolationError(str(each)))
    warnings = sum(1 for each in found if each.severity is Severity.WARNING)
    return counted(warnings, "warning") if warnings else ""


CASES: Final = (Case("1.0", "EDS checker", "Check the EDS file", check_file, uses_device=False),)
