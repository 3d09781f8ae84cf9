"""Show the findings of device descriptions, with the lines that they are about."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data.findings import Finding, Severity
from canopen_data.named_files import DescriptionFile
from canopen_master.plain_text import clean

MAX_SHOWN: Final = 120
"""Characters of a line shown around a finding: an XML file may be one single line."""

_STYLES: Final = {Severity.ERROR: "bold red", Severity.WARNING: "bold yellow", Severity.NOTICE: "bold cyan"}


def tell_faults(screen: Screen, file: DescriptionFile) -> None:
    """Say in one line how many faults the file has, if any."""
    errors = sum(1 for each in file.description.findings if each.severity is Severity.ERROR)
    if errors:
        screen.say(f"[yellow]{escape(file.path)}: {counted(errors, 'error')} in it[/]; canopen eds lint {escape(file.path)}")


# ---- findings ----


def finding_lines(finding: Finding, lines: list[str]) -> list[str]:
    """Return a finding as rich's markup: what is wrong, and below it the line with a mark at the place."""
    where = f"{finding.source}:{finding.line}:{finding.column}" if finding.line else finding.source
    style = _STYLES[finding.severity]
    head = f"[bold]{escape(where)}[/]: [{style}]{finding.severity}[/] CO301 {escape(finding.message)}"
    shown = [f"{head} [dim]\\[{escape(finding.code)}][/]"]
    if 1 <= finding.line <= len(lines):
        text, mark = _window(lines[finding.line - 1], finding.column)
        number = str(finding.line)
        shown.append(f"[dim]{number:>6} |[/] {escape(text)}")
        shown.append(f"[dim]{'':>6} |[/] {' ' * mark}[{style}]^[/]")
    return shown


def _window(line: str, column: int) -> tuple[str, int]:
    """Return the part of a line around a column (from 1), and the place of the mark below it."""
    mark = min(max(column - 1, 0), len(line))
    start = 0 if len(line) <= MAX_SHOWN else max(0, min(mark - MAX_SHOWN // 2, len(line) - MAX_SHOWN))
    return clean(line[start : start + MAX_SHOWN]), len(clean(line[start:mark]))


def finding_as_json(finding: Finding) -> dict[str, Any]:
    """Return a finding for --json."""
    return {
        "file": finding.source,
        "line": finding.line,
        "column": finding.column,
        "severity": str(finding.severity),
        "code": finding.code,
        "message": finding.message,
    }


def counts_of(findings: Iterable[Finding]) -> dict[Severity, int]:
    """Count the findings of each severity."""
    counts = dict.fromkeys(Severity, 0)
    for each in findings:
        counts[each.severity] += 1
    return counts


def counts_text(counts: Mapping[Severity, int]) -> str:
    """Return a text such as "2 errors, 1 warning"."""
    parts = [counted(number, str(severity)) for severity, number in counts.items() if number]
    return ", ".join(parts) or "nothing found"
