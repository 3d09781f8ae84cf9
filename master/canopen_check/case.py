"""What a conformance case is, and how it ends.

A case is a procedure that asks one thing of a device and says whether the device did as the standard demands. What can end its
body:

    it returns                 passed, if nothing was noted meanwhile; what it returns is told to people, such as "101 heartbeats"
    Violation                  failed: the device did what it must not, or did not do what it must
    any other ProcedureError   failed too: the device did not answer, or refused what it has to take
    NotApplicable              the device does not have what the case is about

How a body says what it expects: expectations.py.

A body begins with a device that has just been reset and was then commanded to be pre-operational (`Bench.reset`): one that
starts by itself is Operational after its boot-up. It may leave the device in any state. What it changes, a reset of the node puts
back, unless the case `stores`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, TypeAlias, TypeVar

from canopen_check.bench import Bench
from canopen_check.expectations import NotApplicable, Violation
from canopen_proto.abort import AbortOrigin
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoFailed
from canopen_proto.verdict import Result, Verdict

T = TypeVar("T")

MAX_ATTEMPTS: Final = 3
"""How many times a case is run whose failure may be due to our own lateness. One that stores is run once."""

Body: TypeAlias = Callable[[Bench], Procedure[str | None]]


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
