"""What the two conformance kits share: of devices (canopen_check) and of transports (canopen_transports.conformance).

A case is run by its own kit, and ends with a `Verdict`. Its body states what it expects by `expect` and the like. The first
expectation that is not met ends the body with a `ViolationError`; a body that cannot be tried ends with `NotApplicable`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NoReturn

from canopen_proto.compiling import mypyc_attr
from canopen_proto.procedures.steps import ProcedureError


class Result(StrEnum):
    """The result of a case. REMARK: nothing is wrong, but a person should look at it. NOT_JUDGED: something went wrong, and what
    is tested may not be at fault."""

    PASSED = "passed"
    REMARK = "remark"
    FAILED = "failed"
    NOT_JUDGED = "not judged"
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


@mypyc_attr(native_class=False)
class ViolationError(ProcedureError, AssertionError):
    """What is tested did what it must not, or did not do what it must. The text says what was expected and what was seen."""


class NotApplicable(ProcedureError):
    """What is tested does not have the subject of the case."""


def does_not_apply(reason: str) -> NoReturn:
    """End the case: what is tested does not have its subject. reason: for people."""
    raise NotApplicable(reason)


def expect(condition: bool, otherwise: str) -> None:
    """Go on if the condition holds, else raise ViolationError with this text."""
    if not condition:
        raise ViolationError(otherwise)


def expect_equal(seen: object, expected: object, what: str) -> None:
    """Go on if the two are equal, else raise ViolationError, which shows both; numbers also as hexadecimal. seen, expected: those
    two. what: it is, for the text."""
    if seen != expected:
        raise ViolationError(f"{what} is {_shown(seen)}, not {_shown(expected)}")


def _shown(value: object) -> str:
    if isinstance(value, int):
        return f"{value} (0x{value:X})"
    return value.hex(" ") or "nothing" if isinstance(value, bytes) else repr(value)
