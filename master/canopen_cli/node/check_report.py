"""The report of `canopen check`: a table for people, JSON and JUnit's XML for programs.

JUnit: a test suite for each chapter of the cases, a test case for each case. A failed case is a failure; one that was not judged
is an error; one that does not apply or was left out is skipped; remarks are its output. Times are those of the bus: seconds from
the reset before a case to its verdict.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, Final
from xml.etree import ElementTree

from canopen_check.case import Case
from canopen_cli.shared.new_files import write_file
from canopen_cli.shared.screen import Screen, counted, escape, node_text
from canopen_master.plain_text import clean
from canopen_proto.verdict import Result, Verdict

PACKAGE: Final = "canopen.conformance"
"""The name under which a CI server groups all test cases."""
LEFT_OUT: Final = "it changes what the device stores (--storing)"

_STYLES: Final = {
    Result.PASSED: "green",
    Result.REMARK: "yellow",
    Result.FAILED: "bold red",
    Result.NOT_JUDGED: "bold yellow",
    Result.NOT_APPLICABLE: "dim",
}


@dataclass(frozen=True)
class CaseRun:
    """A case that was run. seconds: its duration."""

    case: Case
    verdict: Verdict
    seconds: float


@dataclass
class CheckReport:
    """The results of the cases. node_id: None for a file alone. total: number of cases to run; left_out: cases not run, because
    they store. file: the device's file, "" for none; begun: cases begun."""

    node_id: int | None
    total: int
    left_out: tuple[Case, ...] = ()
    file: str = ""
    begun: list[Case] = field(default_factory=list)
    runs: list[CaseRun] = field(default_factory=list)

    @property
    def counts(self) -> Counter[Result]:
        """Count the cases by their result."""
        return Counter(each.verdict.result for each in self.runs)

    @property
    def seconds(self) -> float:
        """Seconds that all cases took."""
        return sum(each.seconds for each in self.runs)

    @property
    def subject(self) -> str:
        """The device or the file that was checked, for people."""
        return node_text(self.node_id) if self.node_id is not None else self.file

    def show(self, screen: Screen) -> None:
        """Print a row for each case that was run, all offenders of cases with several, and a summary; or JSON."""
        if screen.json_output:
            screen.json(self._as_json())
            return
        columns = ("case", "", "verdict", "what was seen")
        screen.table(columns, [_row(each) for each in self.runs])
        for each in self.runs:
            _list_offenders(screen, each)
        text = f"{escape(self.subject)}: " + ", ".join(self._counted())
        screen.say(f"{text}; {self.seconds:.1f} s" if self.node_id is not None else text)
        if self.left_out:
            numbers = ", ".join(case.number for case in self.left_out)
            screen.say(f"left out, as they change what the device stores: {numbers}. --storing runs them too")
        if self.file and any(each.case.number == "1.0" and each.verdict.result is Result.FAILED for each in self.runs):
            screen.say(f"all faults of the file: canopen eds lint {escape(self.file)}")

    def _counted(self) -> Iterator[str]:
        for result in Result:
            count = self.counts[result]
            if result is Result.REMARK:
                if count:
                    yield counted(count, "remark")
            elif result in (Result.FAILED, Result.NOT_JUDGED) and count:
                yield f"{count} {result} ({', '.join(each.case.number for each in self.runs if each.verdict.result is result)})"
            elif result is not Result.NOT_JUDGED:
                yield f"{count} {result}"

    def _as_json(self) -> dict[str, Any]:
        return {
            "node": self.node_id,
            "file": self.file or None,
            "counts": {str(result): self.counts[result] for result in Result},
            "cases": [
                {
                    "number": each.case.number,
                    "name": each.case.name,
                    "title": each.case.title,
                    "result": str(each.verdict.result),
                    "reason": each.verdict.reason,
                    "failures": list(each.verdict.failures),
                    "remarks": list(each.verdict.remarks),
                    "seconds": round(each.seconds, 6),
                }
                for each in self.runs
            ],
            "left_out": [case.number for case in self.left_out],
            "not_run": self.total - len(self.runs),
        }


def _row(each: CaseRun) -> tuple[str, ...]:
    result = each.verdict.result
    return each.case.number, each.case.title, f"[{_STYLES[result]}]{result}[/]", escape(each.verdict.reason)


def _list_offenders(screen: Screen, each: CaseRun) -> None:
    """List all offenders, unless the table has the only one."""
    for what, lines in (("failures", each.verdict.failures), ("remarks", each.verdict.remarks)):
        if len(lines) > 1 or (lines and lines[0] != each.verdict.reason):
            screen.out.print(f"\n{each.case.number}, {what}:")
            for line in lines:
                screen.out.print(f"  {escape(line)}")


def list_cases(screen: Screen, cases: Sequence[Case]) -> None:
    """List all cases that can be run, and which of them store."""
    if screen.json_output:
        names = ("number", "name", "title", "stores")
        screen.json([{name: getattr(case, name) for name in names} for case in cases])
        return
    rows = [(case.number, case.name, case.title, "stores" if case.stores else "") for case in cases]
    screen.table(("case", "name", "", ""), rows)


# ---- JUnit ----


def write_junit(path: str, report: CheckReport) -> None:
    """Write the report as a JUnit file. Raises a CommandError if it cannot be written."""
    entries = [(each.case, each) for each in report.runs] + [(case, None) for case in report.left_out]
    entries.sort(key=lambda entry: _order(entry[0]))
    root = ElementTree.Element("testsuites", {"name": clean(f"canopen check {report.subject}")})
    for chapter, cases in groupby(entries, key=lambda entry: _chapter(entry[0])):
        root.append(_suite(chapter, list(cases), report.file))
    _count(root, [each for suite in root for each in suite.iter("testcase")])
    ElementTree.indent(root)
    write_file(path, ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n", report.file)


def _order(case: Case) -> tuple[int, ...]:
    # by number: 2.10 after 2.9
    return tuple(map(int, case.number.split(".")))


def _chapter(case: Case) -> str:
    """Return the subject of a case: "SDO" of "SDO 07"."""
    return case.name.rstrip(" 0123456789")


def _suite(chapter: str, entries: Iterable[tuple[Case, CaseRun | None]], file: str) -> ElementTree.Element:
    suite = ElementTree.Element("testsuite", {"name": chapter, "package": PACKAGE})
    if file:
        properties = ElementTree.SubElement(suite, "properties")
        ElementTree.SubElement(properties, "property", {"name": "file", "value": clean(file)})
    for case, each in entries:
        suite.append(_test_case(chapter, case, each))
    _count(suite, suite.findall("testcase"))
    return suite


def _test_case(chapter: str, case: Case, each: CaseRun | None) -> ElementTree.Element:
    attributes = {
        "classname": f"{PACKAGE}.{chapter.replace(' ', '_')}",
        "name": f"{case.number} {case.title}",
        "time": f"{0.0 if each is None else each.seconds:.3f}",
    }
    element = ElementTree.Element("testcase", attributes)
    verdict = Verdict(Result.NOT_APPLICABLE, LEFT_OUT) if each is None else each.verdict
    reason = clean(verdict.reason)
    seen = [reason] if reason and verdict.result is Result.PASSED else map(clean, verdict.remarks)
    if verdict.result is Result.FAILED:
        failure = ElementTree.SubElement(element, "failure", {"message": reason, "type": "Violation"})
        failure.text = "\n".join(map(clean, verdict.failures))
    elif verdict.result is Result.NOT_JUDGED:
        ElementTree.SubElement(element, "error", {"message": reason, "type": "NotJudged"})
    elif verdict.result is Result.NOT_APPLICABLE:
        ElementTree.SubElement(element, "skipped", {"message": reason})
    text = "\n".join(seen)
    if text:
        ElementTree.SubElement(element, "system-out").text = text
    return element


def _count(element: ElementTree.Element, cases: Sequence[ElementTree.Element]) -> None:
    element.set("tests", str(len(cases)))
    for attribute, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        element.set(attribute, str(sum(1 for case in cases if case.find(tag) is not None)))
    element.set("time", f"{sum(float(case.get('time', '0')) for case in cases):.3f}")
