"""The linter of device descriptions: it finds what contradicts the standards, the file itself, or common sense.

The readers report what they could not read. `check` judges what was read: it takes a `DeviceDescription` from any kind of file
(EDS, DCF, XDD, XDC) and reports the faults of the device that it describes. Each rule has a code, a severity and a line of text
(`RULES`):

    error      a tool or master that believes the file will fail, or the device cannot work like this
    warning    legal or tolerable, but somebody will be surprised
    notice     a matter of form

Every rule comes from the standards or from files in the field; things that real devices do for good reason are not reported. The
families are structure (objects, lists, names), values (defaults, limits), profiles (standard objects), mappings (PDOs), cob_ids
and device (identity, commissioning, the file's head).

The CSV files of the product have a linter of their own (lint.py): their rows have neither limits nor defaults.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from itertools import chain
from typing import Final

from canopen_data.checks import cob_ids, device, mappings, profiles, structure, values
from canopen_data.checks.subject import Rule, Subject
from canopen_data.description import DeviceDescription
from canopen_data.findings import Finding, Severity
from canopen_proto.explained import counted

__all__ = ["RULES", "Rule", "check"]

_FAMILIES: Final = (device, structure, values, profiles, mappings, cob_ids)

RULES: Final[tuple[Rule, ...]] = tuple(rule for family in _FAMILIES for rule in family.RULES)
"""All rules, by family. Codes are unique."""

MAX_FINDINGS: Final = 10_000
"""Kept of one file; a small file can have hundreds of thousands."""

_CHECKS: Final = tuple(each for family in _FAMILIES for each in family.CHECKS)


def check(description: DeviceDescription) -> list[Finding]:
    """Return all findings of all rules, in the order of the file if there is one. The reader's findings are not repeated.

    MAX_FINDINGS are kept; one more gives the number and the worst severity of the others.

    A line that stands for many sub-objects (CompactSubObj) has one finding per rule, which gives the number of sub-objects.
    """
    subject = Subject(description, RULES)
    found: list[Finding] = []
    hidden, worst = 0, Severity.NOTICE
    for finding in chain.from_iterable(each(subject) for each in _CHECKS):
        if len(found) < MAX_FINDINGS:
            found.append(finding)
        else:
            hidden += 1
            worst = min(worst, finding.severity, key=list(Severity).index)
    found = sorted(_once(found, subject.shared), key=lambda finding: (finding.line, finding.column))
    if hidden:
        found.append(Finding(worst, "too-many", f"{counted(hidden, 'more finding')} not listed", description.source))
    return found


def _once(found: Iterable[Finding], shared: Collection[tuple[str, int, int]]) -> Iterator[Finding]:
    """Yield one finding for each place in `shared`, and all others."""
    first: dict[tuple[str, int, int], Finding] = {}
    more: Counter[tuple[str, int, int]] = Counter()
    for finding in found:
        place = finding.code, finding.line, finding.column
        if place not in shared:
            yield finding
        elif first.setdefault(place, finding) is not finding:
            more[place] += 1
    for place, finding in first.items():
        told = f"; the same of {counted(more[place], 'more sub-object')}" if more[place] else ""
        yield replace(finding, message=finding.message + told)
