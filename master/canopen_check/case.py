"""What a conformance case is, and how it ends.

A case is a procedure that asks one thing of a device and says whether the device did as the standard demands. What can end its
body:

    it returns                 passed, if nothing was noted meanwhile; what it returns is told to people, such as "101 heartbeats"
    Violation                  failed: the device did what it must not, or did not do what it must
    any other ProcedureError   failed too: the device did not answer, or refused what it has to take
    NotApplicable              the device does not have what the case is about

`expect` and the like end the body at the first thing that is wrong. A body that looks at many objects uses `for_each`: it notes
what is wrong with one of them and goes on with the next, so that all offenders stand in the verdict.

Three degrees, noted in `Bench.notes`: a failure; a remark, where the standard leaves open what the device may do; and what the
standard demands and CiA's own tool does not look at (`Notes.beyond`), which is a remark unless the test is strict.

Two failures depend on time: `LateOrEarly` and `NotInTime`. They are remarks if our own process was late enough to look like that.
All others are certain.

A body begins with a device that has just been reset and was then commanded to be pre-operational (`Bench.reset`): one that
starts by itself is Operational after its boot-up. It may leave the device in any state. What it changes, a reset of the node puts
back, unless the case `stores`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final, NoReturn, TypeAlias, TypeVar

from canopen_proto.abort import AbortCode, AbortOrigin, text_of
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoFailed, StepTimeout

if TYPE_CHECKING:
    from canopen_check.bench import Bench

T = TypeVar("T")

LATE: Final = 20 * MILLISECOND
"""A process that is later than this has no right to call others late: a fifth of the shortest period that is measured."""
LATE_PART: Final = 5
"""Of a wait: a process that is late by less than this part of it does not explain why nothing came."""
MAX_ATTEMPTS: Final = 3
"""How many times a case is run whose failure may be due to our own lateness. One that stores is run once."""


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


Body: TypeAlias = "Callable[[Bench], Procedure[str | None]]"


@dataclass(frozen=True, slots=True)
class Case:
    """One case.

    number, name, title: as the conformance test calls it. body: what it does. needs: indices that the dictionary must have, else
    the case does not apply. uses_device: False where it asks nothing of the device, which is then not reset either. stores: it
    writes to 0x1010 or 0x1011, and so changes what the device keeps over power-off; a sound device has at its end what it had
    before (a case about saving), or its defaults (one about restoring).
    """

    number: str
    name: str
    title: str
    body: Body
    needs: tuple[int, ...] = ()
    uses_device: bool = True
    stores: bool = False

    def run(self, bench: Bench) -> Procedure[Verdict]:
        """Reset the device, then ask it. Never raises a ProcedureError.

        "Too late" counts only if our own process was on time: else the case is run again, and if that does not help, its verdict
        is a remark. A certain failure counts in any case.
        """
        missing = [index for index in self.needs if not bench.dictionary.has_index(index)]
        if missing:
            return Verdict(Result.NOT_APPLICABLE, f"the dictionary has no object 0x{missing[0]:04X}")
        for _ in range(1 if self.stores else MAX_ATTEMPTS):
            verdict = yield from self._run_once(bench)
            if verdict.result is Result.FAILED or not bench.notes.excused(bench.lateness):
                break
        return verdict

    def _run_once(self, bench: Bench) -> Procedure[Verdict]:
        notes = bench.notes
        notes.clear()
        bench.lateness = 0
        seen: str | None = None
        try:
            if self.uses_device:
                yield from bench.reset()
            seen = yield from self.body(bench)
        except NotApplicable as reason:
            if not notes.failures:
                return Verdict(Result.NOT_APPLICABLE, str(reason), (), tuple(notes.remarks))
        except ProcedureError as failure:
            notes.fail(failure)
        return notes.verdict(bench.lateness, seen or "")


def for_each(bench: Bench, items: Iterable[T], look: Callable[[T], Procedure[object]]) -> Procedure[int]:
    """Look at each item, whatever is wrong with the others; how many there were. What is wrong, or refused, is noted.

    A device that does not answer at all ends the case: to wait for it again and again would take minutes.
    """
    count = 0
    for item in items:
        count += 1
        try:
            yield from look(item)
        except SdoFailed as failed:
            if failed.origin is not AbortOrigin.PEER:
                raise
            bench.notes.fail(failed)
        except Violation as violation:
            bench.notes.fail(violation)
    return count


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
