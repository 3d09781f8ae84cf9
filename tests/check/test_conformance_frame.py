"""The frame of the conformance cases: the probe, the bench, the catalogue and its table in the docs."""

from __future__ import annotations

import re
from pathlib import Path

from canopen_check.case import Case
from canopen_check.catalogue import BY_NUMBER, CASES, run_all, table
from canopen_check.probe import MAX_HEARD, RawProbe
from canopen_proto.frame import Frame
from canopen_proto.machine import Outbox
from canopen_proto.procedures.steps import Procedure, StepTimeoutError, act
from canopen_proto.verdict import NotApplicable, Result, ViolationError, expect_equal
from tests.check.conformance_rig import Fault, Site
from tests.core.full_device import full_device

PAGE = Path(__file__).parent.parent.parent / "docs" / "conformance.md"


def ends(error: Exception | str | None) -> Case:
    def body(bench: object) -> Procedure[str | None]:
        yield from act(lambda now: None)
        if isinstance(error, Exception):
            raise error
        return error

    return Case("0.1", "Test 01", "ends", body)


def test_all_127_cases_are_there() -> None:
    assert len(CASES) == len(BY_NUMBER) == 127
    chapters = [tuple(map(int, case.number.split("."))) for case in CASES]
    assert len({case.name for case in CASES}) == 127
    assert {chapter for chapter, _ in chapters} == set(range(1, 11))
    assert all(case.title for case in CASES)


def test_what_stores_says_so() -> None:
    """What the standard's tool does with 0x1010 and 0x1011; a case that writes there and does not say so would do it unasked."""
    stored = {case.number for case in CASES if case.stores}
    assert stored == {"2.30", "6.8", "6.10", *(f"8.{number}" for number in range(1, 10))}
    site = Site()
    site.result_of(lambda bench: run_all(bench, [case for case in CASES if not case.stores]))
    written = [text for text in site.frames() if re.match("605#(2.|C.)1[01]10(?!00)", text)]
    assert written == []


def test_the_docs_hold_the_table() -> None:
    """Run `python -m tests.check.test_conformance_frame` in the repository to write it anew."""
    assert table() in PAGE.read_text(encoding="utf-8")


def test_how_a_case_ends() -> None:
    site = Site()
    assert site.run(ends(None)).result is Result.PASSED
    assert site.run(ends("fine")).reason == "fine"
    assert site.run(ends(ViolationError("wrong"))).result is Result.FAILED
    assert site.run(ends(StepTimeoutError("late"))).reason == "late"
    assert site.run(ends(NotApplicable("none"))).result is Result.NOT_APPLICABLE


def test_a_sound_device_passes_all_in_one_run() -> None:
    results = Site().result_of(lambda bench: run_all(bench))
    assert [case for case, _ in results] == list(CASES)
    assert [(case.number, verdict.reason) for case, verdict in results if verdict.result is Result.FAILED] == []


def test_a_case_needs_its_objects() -> None:
    verdict = Site(truth=full_device(without=(0x1017,))).run(Case("0.3", "Test 03", "needs", ends(None).body, (0x1000, 0x1017)))
    assert verdict.result is Result.NOT_APPLICABLE
    assert "0x1017" in verdict.reason


def test_a_device_that_is_not_there() -> None:
    site = Site()
    site.world.leave(site.device)
    assert "boot-up" in site.run(ends(None)).reason


def test_a_device_that_never_boots_rightly_has_verdicts_all_the_same() -> None:
    site = Site(Fault("no boot-up", sent=[("705#00", None)]))
    ((_, verdict),) = site.result_of(lambda bench: run_all(bench, [BY_NUMBER["9.1"]]))
    assert verdict.failures == ("the boot-up frame did not come within 5 s",)


def test_values_are_shown_so_that_people_can_read_them() -> None:
    for seen, expected, said in (
        (16, 17, "x is 16 (0x10), not 17 (0x11)"),
        (b"", b"\x01", "x is nothing, not 01"),
        ("a", "b", "x is 'a', not 'b'"),
    ):
        try:
            expect_equal(seen, expected, "x")
        except ViolationError as violation:
            assert str(violation) == said


def test_probe() -> None:
    probe = RawProbe(Outbox(), [0x123])
    assert list(probe.can_ids()) == [0x123]
    probe.listen_also(0x124)
    probe.listen_also(0x124)
    assert list(probe.can_ids()) == [0x123, 0x124]
    for text in ("123#01", "124#02", "123#03"):
        probe.receive(Frame.parse(text), 7)
    assert [str(heard.frame) for heard in probe.take_all(0x123)] == ["123#01", "123#03"]
    assert probe.take(0x123) is None
    assert (probe.take(0x124) or probe.out.events[0]).node_id == 0
    for _ in range(MAX_HEARD + 1):
        probe.receive(Frame.parse("123#"), 8)
    assert len(probe.heard) == MAX_HEARD
    probe.listen([0x125])
    assert not probe.heard
    probe.send(Frame.parse("125#R1"), 9)
    assert [str(frame) for frame in probe.out.frames] == ["125#R1"]


def main() -> None:
    page = PAGE.read_text(encoding="utf-8")
    head = page.partition("| Number")[0]
    PAGE.write_text(head + table(), encoding="utf-8")


if __name__ == "__main__":
    main()
