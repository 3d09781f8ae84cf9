"""`Case`: a conformance case, and its result.

A case is a procedure that tests one point of a device and says whether the device does what the standard demands. Its body ends
in one of these ways:

    it returns                 passed, if no failure was noted; the returned text is shown to people, such as "101 heartbeats"
    ViolationError             failed: the device did what it must not, or did not do what it must
    any other ProcedureError   failed too: the device did not answer, or refused what it has to accept
    NotApplicable              the device does not have the subject of the case

canopen_proto/verdict.py and expectations.py have the checks that a body uses.

When a body begins, the device has just been reset and then commanded to Pre-operational (`Bench.reset`): a device that starts by
itself is Operational after its boot-up. The body may leave the device in any state: a reset of the node undoes all changes,
unless the case `stores`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, TypeAlias, TypeVar

from canopen_check.bench import Bench
from canopen_proto.abort import AbortOrigin
from canopen_proto.explained import counted
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoTransferError
from canopen_proto.verdict import NotApplicable, Result, Verdict, ViolationError

T = TypeVar("T")

MAX_ATTEMPTS: Final = 3
"""How often a case is run, at most, if its failure may be due to our own lateness. A case that stores is run once."""

Body: TypeAlias = Callable[[Bench], Procedure[str | None]]


@dataclass(frozen=True, slots=True)
class Case:
    """One case of the conformance test.

    number, name, title: as in the conformance test. body: its procedure. needs: indices that the dictionary must have, else the
    case does not apply. uses_device: False if it needs no device; then the device is not reset. stores: it writes to 0x1010 or
    0x1011, and so changes what the device keeps without power; a sound device has its old values at the end (a case about
    saving), or its defaults (a case about restoring).
    """

    number: str
    name: str
    title: str
    body: Body
    needs: tuple[int, ...] = ()
    uses_device: bool = True
    stores: bool = False

    def run(self, bench: Bench) -> Procedure[Verdict]:
        """Reset the device, then run the body; return the verdict. Never raises a ProcedureError.

        "Too late" counts only if our own process was on time. Else the case is run again, and if that does not help, it is not
        judged. A certain failure always counts, unless another master has commanded the device meanwhile: then it is not judged.
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
        bench.bystander.forget()
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
        verdict = notes.verdict(bench.lateness, seen or "")
        command = bench.bystander.command
        if verdict.result is not Result.FAILED or command is None:
            return verdict
        other = f"another master is on the bus and sent {command}, so that the device cannot be judged"
        return Verdict(Result.NOT_JUDGED, f"{other}: {verdict.reason}", (), (other, *verdict.failures, *verdict.remarks))


def for_each(bench: Bench, items: Iterable[T], look: Callable[[T], Procedure[object]], what: str = "object") -> Procedure[str]:
    """Check each item, whatever is wrong with the others; return their number, such as "3 objects". Failures and refusals are
    noted. look: makes the check of an item. what: an item, in the singular.

    If the device does not answer at all, the case ends: to wait for each item would take minutes.
    """
    count = 0
    for item in items:
        count += 1
        try:
            yield from look(item)
        except SdoTransferError as failed:
            if failed.origin is not AbortOrigin.PEER:
                raise
            bench.notes.fail(failed)
        except ViolationError as violation:
            bench.notes.fail(violation)
    return counted(count, what)
