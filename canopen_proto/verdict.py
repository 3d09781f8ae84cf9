"""How a case of a conformance test can end: those of devices (canopen_check) and those of transports (canopen_transports)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Result(StrEnum):
    """How a case can end. REMARK: nothing is wrong, and somebody should look at it."""

    PASSED = "passed"
    REMARK = "remark"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a case ended.

    reason: one line about it; of a passed case what was seen, often empty. failures: everything that is wrong. remarks: all that
    is not as usual and not wrong.
    """

    result: Result
    reason: str = ""
    failures: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
