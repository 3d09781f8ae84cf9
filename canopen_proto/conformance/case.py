"""What a conformance case is, and how it ends.

A case is a procedure that asks one thing of a device and says whether the device did as the standard demands. Its body states
what it expects by `expect` and the like; the first expectation that is not met ends it. What can end a body:

    it returns                 passed; what it returns is a remark for people, such as "101 heartbeats"
    Violation                  failed: the device did what it must not, or did not what it must
    any other ProcedureError   failed too: it did not answer, it refused what it has to take
    NotApplicable              the device does not have what the case is about

A body begins with a device that has just been reset and is pre-operational (`Bench.reset`); it may leave it in any state. What
it changes, a reset of the node puts back, unless the case `stores`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, NoReturn, TypeAlias

from canopen_proto.procedures.steps import Procedure, ProcedureError
from canopen_proto.sdo.abort import AbortCode, text_of

if TYPE_CHECKING:
    from canopen_proto.conformance.bench import Bench


class Result(StrEnum):
    """How a case can end."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a case ended. reason: why it failed or does not apply; of a passed one a remark, often empty."""

    result: Result
    reason: str = ""


class Violation(ProcedureError):
    """The device did what the standard forbids, or did not what it demands."""


class NotApplicable(ProcedureError):
    """The device does not have what the case is about."""


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
        """Reset the device, then ask it. Never raises a ProcedureError."""
        missing = [index for index in self.needs if not bench.dictionary.has_index(index)]
        if missing:
            return Verdict(Result.NOT_APPLICABLE, f"the dictionary has no object 0x{missing[0]:04X}")
        try:
            if self.uses_device:
                yield from bench.reset()
            remark = yield from self.body(bench)
        except NotApplicable as reason:
            return Verdict(Result.NOT_APPLICABLE, str(reason))
        except ProcedureError as failure:
            return Verdict(Result.FAILED, str(failure))
        return Verdict(Result.PASSED, remark or "")


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


def _shown(value: object) -> str:
    if isinstance(value, int):
        return f"{value} (0x{value:X})"
    return value.hex(" ") or "nothing" if isinstance(value, bytes) else repr(value)
