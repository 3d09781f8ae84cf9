"""The notes about what is wrong with a device, and the checks of a case's body that are about devices alone.

`expect` and the like (canopen_proto/verdict.py) end the body at the first failure. `for_each` (case.py) notes a failure of one of
many objects and goes on with the next, so that the verdict names all of them.

`Bench.notes` takes three degrees: a failure; a remark, if the standard leaves the behaviour open; and a violation of the standard
that CiA's own tool does not check (`Notes.beyond`), which is a remark unless the test is strict.

Two failures depend on time: `TimingError` and `NotInTimeError`. They are remarks if our own process was so late that this may be
the cause. All others are certain.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final, TypeVar

from canopen_proto.abort import AbortCode, text_of
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.procedures.steps import ProcedureError, StepTimeoutError
from canopen_proto.verdict import Result, Verdict, ViolationError, does_not_apply

T = TypeVar("T")

LATE: Final = 20 * MILLISECOND
"""If our process is later than this, it cannot call others late: a fifth of the shortest period that is measured."""
LATE_PART: Final = 5
"""If our process is late by less than a fifth of a wait, this does not explain why nothing came."""


class TimingError(ViolationError):
    """The device did something at the wrong time, or too often, or not often enough. Our own lateness may look the same."""

    excuse: Time = LATE


class NotInTimeError(StepTimeoutError):
    """A frame or an answer did not come. excuse: if our own lateness (ns) is as large, it may not be the device's fault."""

    def __init__(self, message: str, waited: Time) -> None:
        """Make the error. waited: how long the bench waited, in ns."""
        super().__init__(message)
        self.excuse = max(waited // LATE_PART, LATE)


class Notes:
    """The findings of a body so far. failures: each with the lateness of our own (ns) that excuses it; NEVER: certain."""

    __slots__ = ("failures", "remarks", "strict")

    def __init__(self, *, strict: bool = False) -> None:
        """Begin without findings. strict: violations that CiA's tool does not check are failures."""
        self.strict = strict
        self.clear()

    def clear(self) -> None:
        """Forget the findings: another case begins."""
        self.failures: list[tuple[str, Time]] = []
        self.remarks: list[str] = []

    def fail(self, failure: ProcedureError) -> None:
        """Note a failure and go on. The same one is noted once."""
        noted = str(failure), failure.excuse if isinstance(failure, TimingError | NotInTimeError) else NEVER
        if noted not in self.failures:
            self.failures.append(noted)

    def remark(self, text: str) -> None:
        """Note a behaviour that the standard leaves open. text: for people."""
        if text not in self.remarks:
            self.remarks.append(text)

    def beyond(self, condition: bool, otherwise: str) -> None:
        """If the condition does not hold, note a violation of the standard that CiA's tool accepts. otherwise: the text then."""
        if not condition and self.strict:
            self.fail(ViolationError(otherwise))
        elif not condition:
            self.remark(otherwise)

    def excused(self, lateness: Time) -> tuple[str, ...]:
        """Return the failures that may be due to our own lateness (ns)."""
        return tuple(text for text, excuse in self.failures if lateness > excuse)

    def verdict(self, lateness: Time, seen: str = "") -> Verdict:
        """Return the verdict of these findings. lateness: of our own process, in ns. seen: the result of the body."""
        certain = tuple(text for text, excuse in self.failures if lateness <= excuse)
        excused, remarks = self.excused(lateness), tuple(self.remarks)
        late = f"this computer was late by {lateness / MILLISECOND:.0f} ms, so that the timing cannot be judged"
        if excused:
            remarks = (late, *excused, *remarks)
        if certain:
            return Verdict(Result.FAILED, _summary(certain), certain, remarks)
        if excused:
            return Verdict(Result.NOT_JUDGED, f"{late}: {_summary(excused)}", (), remarks)
        if remarks:
            return Verdict(Result.REMARK, _summary(remarks), (), remarks)
        return Verdict(Result.PASSED, seen)


def some(found: list[T], otherwise: str) -> list[T]:
    """Return what was found; without any, the case does not apply. otherwise: the reason then."""
    if not found:
        does_not_apply(otherwise)
    return found


def expect_taken(abort_code: int | None, what: str) -> None:
    """Go on if an access was not refused, else raise ViolationError. abort_code: None if it was not refused. what: the access,
    for the text."""
    if abort_code is not None:
        raise ViolationError(f"{what} was refused with 0x{abort_code:08X}")


def expect_refusal(abort_code: int | None, valid: Collection[AbortCode], what: str) -> None:
    """Go on if an access was refused with one of these codes, else raise ViolationError. abort_code: None if it was not
    refused. valid: those codes. what: the access, for the text."""
    codes = " or ".join(f"0x{code:08X}" for code in dict.fromkeys(valid))
    if abort_code is None:
        raise ViolationError(f"{what} was not refused; abort {codes} expected")
    if abort_code not in valid:
        raise ViolationError(f"{what} was refused with 0x{abort_code:08X} ({text_of(abort_code)}), not with {codes}")


def _summary(lines: tuple[str, ...]) -> str:
    """Return the first line, with the number of lines that follow."""
    return lines[0] if len(lines) == 1 else f"{lines[0]} (and {len(lines) - 1} more)"
