"""What the body of a case expects of a device, and what it notes where that does not hold.

`expect` and the like end the body at the first thing that is wrong. `for_each` (case.py) notes what is wrong with one of many
objects and goes on with the next, so that all offenders stand in the verdict.

Three degrees, noted in `Bench.notes`: a failure; a remark, where the standard leaves open what the device may do; and what the
standard demands and CiA's own tool does not look at (`Notes.beyond`), which is a remark unless the test is strict.

Two failures depend on time: `LateOrEarly` and `NotInTime`. They are remarks if our own process was late enough to look like that.
All others are certain.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final, NoReturn

from canopen_proto.abort import AbortCode, text_of
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.procedures.steps import ProcedureError, StepTimeout
from canopen_proto.verdict import Result, Verdict

LATE: Final = 20 * MILLISECOND
"""A process that is later than this has no right to call others late: a fifth of the shortest period that is measured."""
LATE_PART: Final = 5
"""Of a wait: a process that is late by less than this part of it does not explain why nothing came."""


class Violation(ProcedureError):
    """The device did what the standard forbids, or did not do what it demands."""


class LateOrEarly(Violation):
    """The device did something at the wrong time, or too often, or not often enough. Our own lateness may look like that."""

    excuse: Time = LATE


class NotInTime(StepTimeout):
    """A frame or an answer did not come. excuse: the lateness of our own (ns) from which on that is not the device's fault."""

    def __init__(self, message: str, waited: Time) -> None:
        """waited: for how long, in ns."""
        super().__init__(message)
        self.excuse = max(waited // LATE_PART, LATE)


class NotApplicable(ProcedureError):
    """The device does not have what the case is about."""


class Notes:
    """The findings of a body so far. failures: each with the lateness of our own (ns) that excuses it; NEVER: it is certain."""

    __slots__ = ("failures", "remarks", "strict")

    def __init__(self, *, strict: bool = False) -> None:
        """strict: what goes beyond CiA's tool is a failure."""
        self.strict = strict
        self.clear()

    def clear(self) -> None:
        """Begin with another case."""
        self.failures: list[tuple[str, Time]] = []
        self.remarks: list[str] = []

    def fail(self, failure: ProcedureError) -> None:
        """Note a failure and go on."""
        self.failures.append((str(failure), failure.excuse if isinstance(failure, LateOrEarly | NotInTime) else NEVER))

    def remark(self, text: str) -> None:
        """Note what the standard leaves open."""
        if text not in self.remarks:
            self.remarks.append(text)

    def beyond(self, condition: bool, otherwise: str) -> None:
        """If the condition does not hold, note what the standard forbids and CiA's tool accepts."""
        if not condition and self.strict:
            self.fail(Violation(otherwise))
        elif not condition:
            self.remark(otherwise)

    def excused(self, lateness: Time) -> tuple[str, ...]:
        """The failures that may be due to our own process, which was late by so much."""
        return tuple(text for text, excuse in self.failures if lateness > excuse)

    def verdict(self, lateness: Time, seen: str = "") -> Verdict:
        """The verdict of these findings. lateness: of our own process, in ns. seen: the result of the body."""
        certain = tuple(text for text, excuse in self.failures if lateness <= excuse)
        excused, remarks = self.excused(lateness), tuple(self.remarks)
        late = f"this computer was late by {lateness / MILLISECOND:.0f} ms, so that the timing cannot be judged"
        if excused:
            remarks = (late, *excused, *remarks)
        if certain:
            return Verdict(Result.FAILED, _summary(certain), certain, remarks)
        if excused:
            return Verdict(Result.REMARK, f"{late}: {_summary(excused)}", (), remarks)
        if remarks:
            return Verdict(Result.REMARK, _summary(remarks), (), remarks)
        return Verdict(Result.PASSED, seen)


def expect(condition: bool, otherwise: str) -> None:
    """Go on if the condition holds, else Violation with that text."""
    if not condition:
        raise Violation(otherwise)


def expect_equal(seen: object, expected: object, what: str) -> None:
    """Go on if the two are equal, else Violation that shows both. Numbers are shown as hexadecimal."""
    if seen != expected:
        raise Violation(f"{what} is {_shown(seen)}, not {_shown(expected)}")


def expect_refusal(abort_code: int | None, valid: Collection[AbortCode], what: str) -> None:
    """Go on if an access was refused with one of these codes, else Violation. abort_code: None if it was not refused."""
    codes = " or ".join(f"0x{code:08X}" for code in valid)
    if abort_code is None:
        raise Violation(f"{what} was not refused; abort {codes} expected")
    if abort_code not in valid:
        raise Violation(f"{what} was refused with 0x{abort_code:08X} ({text_of(abort_code)}), not with {codes}")


def does_not_apply(reason: str) -> NoReturn:
    """End the case: the device does not have what it is about."""
    raise NotApplicable(reason)


def _summary(lines: tuple[str, ...]) -> str:
    """The first line, and how many follow."""
    return lines[0] if len(lines) == 1 else f"{lines[0]} (and {len(lines) - 1} more)"


def _shown(value: object) -> str:
    if isinstance(value, int):
        return f"{value} (0x{value:X})"
    return value.hex(" ") or "nothing" if isinstance(value, bytes) else repr(value)
