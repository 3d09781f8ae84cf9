"""The results of conformance cases: of devices (canopen_check) and of transports (canopen_transports)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Result(StrEnum):
    """The result of a case. REMARK: nothing is wrong, but a person should look at it."""

    PASSED = "passed"
    REMARK = "remark"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result of one case, with its reasons.

    reason: one line about it; for a passed case the observation, often empty. failures: everything that is wrong. remarks:
    everything that is unusual but not wrong.
    """

    result: Result
    reason: str = ""
    failures: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
