"""Repair the faults of an EDS or DCF that can be repaired without guessing.

The lenient reader takes a faulty file in its most likely meaning, and says so. `repair` writes that meaning down: after it, a
strict reader understands the file as ours does already. Faults whose remedy is unknown (a missing default, a wrong limit, a
mapping of a missing object) stay; `checks` reports them.

    duplicate-section   the second of two identical sections is removed
    list                lists of objects name each object that has a section once, and no others; a missing list is added
    count               SupportedObjects, SubNumber, NrOfEntries, Lines are set to the number of entries
    missing-key         ObjectType, DataType and AccessType are written down as they were read
    number              a number that is not in a form of CiA 306 ("$NodeID + 0x200", "0x07 ;") is rewritten
    access-form         AccessType in small letters
    encoding            UTF-8 without byte order mark

The rest of the file stays as it is, letter for letter. The repaired text is read again before it is returned: if it does not say
the same as the file did, the repairs are dropped.

Source: CiA 306-1 v1.4.0, 4.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Final

from canopen_data.description import DeviceDescription
from canopen_data.eds.ini import EdsDocument, Section, fold
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer_document import LINE, changed_text
from canopen_data.eds.writer_sections import OBJECT_LISTS, Entries, Sections, sections_of
from canopen_data.findings import Finding, Severity, first_of
from canopen_proto import indices
from canopen_proto.datatypes import DataType, is_integer
from canopen_proto.dictionary.model import ObjectDictionary
from canopen_proto.dictionary.objects import Access, Variable
from canopen_proto.machine import LocalProtocolError

__all__ = ["Repaired", "repair"]

_COUNTS: Final = ("SupportedObjects", "SubNumber", "NrOfEntries", "Lines")
_WRITTEN_DOWN: Final = ("ObjectType", "DataType", "AccessType")
_NUMBERS: Final = ("ObjectType", "DataType", "LowLimit", "HighLimit", "DefaultValue", "ParameterValue", "PDOMapping", "ObjFlags")
_VALUES: Final = ("LowLimit", "HighLimit", "DefaultValue", "ParameterValue")
_NUMBER: Final = re.compile(r"(\$NODEID\+)?(0[xX][0-9A-Fa-f]+|-?[0-9]+)", re.ASCII)
_PLACE: Final = re.compile(r"([0-9A-Fa-f]{4})(?:sub([0-9A-Fa-f]{1,2}))?")
_COMPACT: Final = "compactsubobj"


@dataclass(frozen=True, slots=True)
class Repaired:
    """A repaired file. text: to be written as UTF-8. repairs: each with its place in the old file. description: read from the
    text."""

    text: str
    repairs: tuple[Finding, ...]
    description: DeviceDescription


def repair(description: DeviceDescription) -> Repaired:
    """Repair the file that a description was read from. Raises LocalProtocolError if that is not an EDS or DCF."""
    document = description.document
    if not isinstance(document, EdsDocument):
        raise LocalProtocolError(f"only an EDS or a DCF can be repaired, no {description.kind}")
    wanted = _with_right_lists(_with_sections(description))
    goal = sections_of(wanted)
    work = _Repairs(description)
    text = document.text
    shorter = work.without_duplicates(document)
    if shorter != text and sections_of(_with_sections(read_eds(shorter))) == sections_of(_with_sections(description)):
        text = shorter
        again = read_eds(text).document
        assert isinstance(again, EdsDocument)
        document = again
    else:
        work.repairs.clear()
    before, after = work.changes(document, goal)
    changed = changed_text(document, before, after) if before != after else text
    if sections_of(_with_sections(read_eds(changed))) == goal:
        text = changed
    else:
        work.repairs[:] = [each for each in work.repairs if each.code == "duplicate-section"]
    work.encoding()
    return Repaired(text, tuple(sorted(work.repairs, key=lambda each: each.line)), read_eds(text, description.source))


def _with_sections(description: DeviceDescription) -> DeviceDescription:
    """Return the description without the objects that have no section: no list is to name what CompactPDO or a module makes."""
    dictionary = description.dictionary
    made = [index for index in dictionary.objects if description.place_of(index) == (0, 0)]
    if not made:
        return description
    listed = {*description.mandatory, *description.optional, *description.manufacturer}
    kept = [each for index, each in dictionary.objects.items() if index not in made or index in listed]
    return replace(description, dictionary=ObjectDictionary(kept, source=dictionary.source))


def _with_right_lists(description: DeviceDescription) -> DeviceDescription:
    """Return the description with its object lists repaired: no duplicates, no missing objects. `sections_of` adds objects that
    no list names."""
    seen: set[int] = set()
    lists = []
    for listed in (description.mandatory, description.optional, description.manufacturer):
        kept = [index for index in dict.fromkeys(listed) if index in description.dictionary.objects and index not in seen]
        seen.update(kept)
        lists.append(tuple(kept))
    mandatory, optional, manufacturer = lists
    return replace(description, mandatory=mandatory, optional=optional, manufacturer=manufacturer)


class _Repairs:
    """The repairs of one file."""

    def __init__(self, description: DeviceDescription) -> None:
        self.description = description
        self.repairs: list[Finding] = []

    def _tell(self, code: str, message: str, line: int = 0, column: int = 0) -> None:
        self.repairs.append(Finding(Severity.NOTICE, code, message, self.description.source, line, column))

    def encoding(self) -> None:
        """Report the change to UTF-8, if there is one."""
        encoding = self.description.encoding
        if encoding == "utf-8-sig":
            self._tell("encoding", "the byte order mark at its beginning is taken out")
        elif encoding != "utf-8":
            self._tell("encoding", f"written as UTF-8; it was {encoding}")

    def without_duplicates(self, document: EdsDocument) -> str:
        """Return the text without sections that only repeat an earlier one."""
        lines: list[str] = LINE.findall(document.text)
        first: dict[str, Section] = {}
        for section in document.sections:
            twin = first.setdefault(fold(section.name), section)
            if twin is section or _said(twin) != _said(section):
                continue
            last = max([section.line, *(entry.line for entry in section.entries)])
            if any(line.lstrip().startswith(";") for line in lines[section.line : last]):
                continue  # its content may matter
            while last < len(lines) and not lines[last].strip():
                last += 1
            for number in range(section.line, last + 1):
                lines[number - 1] = ""
            text = f"[{section.name}] stands at line {twin.line} already, word for word: taken out"
            self._tell("duplicate-section", text, section.line, 1)
        return "".join(lines)

    def changes(self, document: EdsDocument, goal: Sections) -> tuple[Sections, Sections]:
        """Return the file's content before and after, which differ in the repairs only."""
        standing: dict[str, dict[str, tuple[str, int, int]]] = {}
        lines: dict[str, int] = {}
        for section in document.sections:
            if fold(section.name) in standing:
                continue  # the first one counts
            lines[fold(section.name)] = section.line
            entries = standing[fold(section.name)] = {}
            for entry in section.entries:
                entries.setdefault(entry.key.casefold(), (entry.value, entry.line, entry.column))
        before: Sections = {}
        after: Sections = {}
        for name, wanted in goal.items():
            there = standing.get(fold(name))
            if there is None:
                if name in OBJECT_LISTS:
                    self._tell("list", f"[{name}] added: {_listed(wanted)}")
                    after[name] = wanted
                continue
            old, new = dict(wanted), dict(wanted)
            if name in OBJECT_LISTS:
                self._list(name, wanted, there, lines[fold(name)], old)
            else:
                for key, text in wanted.items():
                    self._entry(name, key, text, there, lines[fold(name)], old, new)
            before[name], after[name] = old, new
        return before, after

    def _list(self, name: str, wanted: Entries, there: dict[str, tuple[str, int, int]], line: int, old: Entries) -> None:
        """Rewrite a list of objects whose numbers or count are wrong, and tell what was changed.

        name: of its section. wanted: the entries as they should be, by key. there: those of the file, by key: value, line,
        column. line: of the section, from 1. old: the entries that the new ones replace; it is changed.
        """
        numbered = {key: value for key, (value, _, _) in there.items() if key.isdecimal()}
        named = {key: text for key, text in wanted.items() if key.isdecimal()}
        is_same = numbered.keys() == named.keys() and all(_same_number(numbered[key], named[key]) for key in named)
        if not is_same:
            had = [number for text in numbered.values() if (number := _number_of(text)) is not None]
            has = [int(text, 16) for text in named.values()]
            gone = [f"0x{number:04X}" for number in dict.fromkeys(had) if number not in has]
            come = [f"0x{number:04X}" for number in has if number not in had]
            parts = [f"{first_of(come)} added"] if come else []
            parts += [f"{first_of(gone)} taken out, which has no section or is in another list"] if gone else []
            parts += ["renumbered"] if not parts else []
            self._tell("list", f"[{name}]: {', '.join(parts)}", line, 1)
            old.clear()
            old.update(numbered)
        count = there.get("supportedobjects")
        if count is None:
            old.pop("SupportedObjects", None)
            self._tell("count", f"[{name}]: SupportedObjects={wanted['SupportedObjects']} added", line, 1)
        else:
            old["SupportedObjects"] = wanted["SupportedObjects"]
            self._count(name, "SupportedObjects", wanted["SupportedObjects"], count, old)

    def _count(self, name: str, key: str, text: str, there: tuple[str, int, int], old: Entries) -> None:
        value, line, column = there
        if not _same_number(value, text):
            self._tell("count", f"[{name}]: {key}={value} is {text}", line, column)
            old[key] = value

    def _entry(
        self,
        name: str,
        key: str,
        text: str,
        there: dict[str, tuple[str, int, int]],
        line: int,
        old: Entries,
        new: Entries,
    ) -> None:
        """Keep or repair one key of a section that is not a list."""
        found = there.get(key.casefold())
        place = _PLACE.fullmatch(name)
        if key in _COUNTS:
            if not self._is_counted(place, there):
                return
            if found is not None:
                self._count(name, key, text, found, old)
            elif place is not None:
                del old[key]
                self._tell("count", f"[{name}]: {key}={text} added", line, 1)
            else:
                del old[key], new[key]
            return
        if place is None or found is None or not found[0].strip():
            if place is not None and key in _WRITTEN_DOWN and self._is_counted(place, there):
                if found is None:
                    del old[key]
                else:
                    old[key] = found[0]
                self._tell("missing-key", f"[{name}]: {key}={text} written down, as it was read", *(found or ("", line, 1))[1:])
            return
        value, at, column = found
        if key == "AccessType" and value != text and value.strip().casefold() in set(Access):
            self._tell("access-form", f"[{name}]: AccessType={value} is {text}", at, column)
            old[key] = value
        elif key in _NUMBERS and not _NUMBER.fullmatch(value) and self._is_number(place, key):
            self._tell("number", f"[{name}]: {key}={value} is {text}", at, column)
            old[key] = value

    def _is_counted(self, place: re.Match[str] | None, there: dict[str, tuple[str, int, int]]) -> bool:
        """Return whether an object's section says everything about it, that is, whether it has no compact form."""
        if place is None or place[2] is not None:
            return True
        compact = there.get(_COMPACT)
        if compact is not None and _number_of(compact[0]) != 0:
            return False
        return not (self.description.device_info.compact_pdo and int(place[1], 16) in indices.PDO_RECORDS)

    def _is_number(self, place: re.Match[str], key: str) -> bool:
        """Return whether a key holds a whole number in this object."""
        if key not in _VALUES:
            return True
        variable: Variable | None = self.description.dictionary.get(int(place[1], 16), int(place[2] or "0", 16))
        return variable is not None and (is_integer(variable.data_type) or variable.data_type is DataType.BOOLEAN)


def _said(section: Section) -> list[tuple[str, str]]:
    return [(entry.key.casefold(), entry.value.strip()) for entry in section.entries]


def _number_of(text: str) -> int | None:
    """Return a number in a form of CiA 306: decimal, hexadecimal with 0x, octal with 0. None if the text is no number."""
    folded = text.strip().lower()
    base = 16 if folded.startswith("0x") else 8 if folded.startswith("0") and len(folded) > 1 else 10
    try:
        return int(folded, base)
    except ValueError:
        return None


def _same_number(text: str, wanted: str) -> bool:
    return _number_of(text) == _number_of(wanted)


def _listed(entries: Entries) -> str:
    return f"SupportedObjects={entries['SupportedObjects']}"
