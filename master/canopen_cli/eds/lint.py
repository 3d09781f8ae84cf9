"""`canopen eds lint`: report all faults of device descriptions, each with line, column and the line itself."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Final

import click

from canopen_cli.shared.eds_files import counts_of, counts_text, finding_as_json, finding_lines
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data import DataError
from canopen_data.checks import RULES, check
from canopen_data.description import FileKind
from canopen_data.findings import Finding, Severity
from canopen_data.named_files import DescriptionFile, open_description
from canopen_data.repair import repair

MAX_REPAIRED: Final = 5000
"""Objects of a file whose repairs are counted: that takes ten times the time and memory of all checks."""


@dataclass(frozen=True)
class _Report:
    """The result for one file. file: None if it could not be read; then `problem` says why."""

    path: str
    file: DescriptionFile | None
    findings: list[Finding]
    problem: CommandError | None = None

    def as_json(self) -> dict[str, Any]:
        if self.file is None:
            return {"file": self.path, "error": self.problem.as_json() if self.problem is not None else None}
        counts = counts_of(self.findings)
        return {
            "file": self.path,
            "kind": str(self.file.description.kind),
            "encoding": self.file.description.encoding,
            "objects": len(self.file.description.dictionary.objects),
            **{f"{severity}s": number for severity, number in counts.items()},
            "findings": [finding_as_json(each) for each in self.findings],
        }


@command()
@click.argument("paths", metavar="FILE...", nargs=-1)
@click.option("--strict", is_flag=True, help="Notices count too: exit status 1 where there is any finding.")
@click.option("--max-errors", type=click.IntRange(min=0), default=50, show_default=True, help="Findings shown per file; 0: all.")
@click.option("--rules", is_flag=True, help="List the rules that are checked, and end.")
def lint(settings: Settings, screen: Screen, paths: tuple[str, ...], strict: bool, max_errors: int, rules: bool) -> int:
    """Check device descriptions: EDS, DCF, XDD, XDC.

    One pass reports everything: faults of the file's form, and contradictions to CiA 301, CiA 306 or within the file.

    Exit status: 0 clean (or notices only), 1 errors or warnings, 6 a file that cannot be read.

    \b
    canopen eds lint drive.eds
    canopen eds lint *.eds --json
    """
    if rules:
        return _list_rules(screen)
    if not paths:
        raise click.UsageError("Missing argument 'FILE...'.")
    reports = []
    for path in paths:
        with _told(screen, path):
            reports.append(_report(path, settings.encoding))
    if settings.json:
        documents = [report.as_json() for report in reports]
        screen.json(documents if len(documents) > 1 else documents[0])
    else:
        for report in reports:
            _show(screen, report, max_errors)
    if any(report.problem is not None for report in reports):
        return ExitCode.BAD_FILE
    counting = set(Severity) if strict else {Severity.ERROR, Severity.WARNING}
    found = any(finding.severity in counting for report in reports for finding in report.findings)
    return ExitCode.DIFFERENT if found else ExitCode.OK


def _list_rules(screen: Screen) -> int:
    if screen.json_output:
        screen.json([{"code": rule.code, "severity": str(rule.severity), "text": rule.text} for rule in RULES])
    else:
        rows = [(rule.code, str(rule.severity), escape(rule.text)) for rule in sorted(RULES)]
        screen.table(("rule", "severity", "what it is about"), rows)
    return ExitCode.OK


def _report(path: str, encoding: str) -> _Report:
    try:
        file = open_description(path, encoding)
    except DataError as error:
        from canopen_cli.shared.failures import problem_of  # it imports the layers of the bus

        return _Report(path, None, [], problem_of(error))
    found = [*file.description.findings, *check(file.description)]
    found.sort(key=lambda each: (each.line, each.column))
    return _Report(path, file, found)


def _show(screen: Screen, report: _Report, most: int) -> None:
    if report.problem is not None:
        screen.problem(report.problem)
        return
    assert report.file is not None
    lines = report.file.lines
    shown = report.findings[: most or None]
    for finding in shown:
        for line in finding_lines(finding, lines):
            screen.out.print(line, soft_wrap=True, highlight=False)
    hidden = len(report.findings) - len(shown)
    if hidden:
        screen.say(f"... and {counted(hidden, 'finding')} more: --max-errors 0 shows all")
    description = report.file.description
    kind = f"{description.kind}, {description.encoding}, {counted(len(description.dictionary.objects), 'object')}"
    screen.say(f"[bold]{escape(report.path)}[/] ({kind}): {counts_text(counts_of(report.findings))}")
    if report.findings and description.kind in (FileKind.EDS, FileKind.DCF):
        command = f"canopen eds fix {escape(report.path)} --dry-run"
        if len(description.dictionary.objects) > MAX_REPAIRED:
            screen.say(f"  what can be repaired without guessing: {command}")
        elif repairs := len(repair(description).repairs):
            screen.say(f"  {counted(repairs, 'repair')} without guessing: {command}")


def _told(screen: Screen, path: str) -> AbstractContextManager[object]:
    """Show on a terminal which file is being read and checked; a large one takes seconds."""
    return screen.err.status(escape(path)) if screen.draws else nullcontext()
