"""Write changes into an existing file: order, spelling, number forms, comments and blank lines stay.

`before` and `after` are the old and the new content of the file, as sections (writer_sections.py). If both have the same text for
a key, the file's line stays exactly as it is, faults included. Else

- a changed text replaces the old one in its line; a hexadecimal number stays hexadecimal, with as many digits;
- a new key goes after the one that it follows in the standard's order; a new section after the section that it follows;
- a key or section that is gone is removed wherever it occurs in the file.

Sub-objects in a compact form (CompactSubObj, CompactPDO) have no section of their own. If one changes, the whole object is
rewritten, sub-object by sub-object, in its old place.

Sections that the description has no field for (tools, object links, a maker's own) are never touched.
"""

from __future__ import annotations

import re
from typing import Final

from canopen_data.eds.ini import EdsDocument, Entry, Section, fold
from canopen_data.eds.writer_sections import Entries, Sections

_OBJECT: Final = re.compile(r"([0-9a-f]{4})(?:sub[0-9a-f]+|name|value|denotation)?")
_HEX: Final = re.compile(r"0[xX]([0-9A-Fa-f]+)")
_NUMBER: Final = re.compile(r"0[xX][0-9A-Fa-f]+|0|[1-9][0-9]*")
LINE: Final = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")


def changed_text(document: EdsDocument, before: Sections, after: Sections) -> str:
    """Return the document's text with every difference between `before` and `after` applied."""
    editor = _Editor(document)
    changed = {name for name in {**before, **after} if before.get(name) != after.get(name)}
    rewritten = {_object_of(fold(name)) for name in changed if name in before and fold(name) not in editor.places} - {""}
    appended = rewritten - {_object_of(name) for name in editor.places}
    rewritten -= appended
    for index in sorted(rewritten):
        editor.rewrite(index, after)
    previous = ""
    for name, entries in after.items():
        owner = _object_of(fold(name))
        if owner not in rewritten and fold(name) not in editor.places and (owner in appended or name in changed):
            editor.add_section(name, entries, previous)
        elif owner not in rewritten and name in changed:
            editor.change(name, before.get(name, {}), entries)
        if fold(name) in editor.places:
            previous = name
    for name in before:
        if name not in after and _object_of(fold(name)) not in rewritten:
            editor.remove(name)
    return editor.text()


def foreign_text(document: EdsDocument, known: Sections) -> str:
    """Return the sections that a description has no field for, as they are in the file; lines end with a line feed. known: the
    sections that it has fields for."""
    editor = _Editor(document)
    names = {fold(name) for name in known}
    objects = {_object_of(name) for name in names} - {""}
    blocks = (
        [line.rstrip("\r\n") for line in editor.lines[section.line - 1 : editor.end_of(section)]]
        for section in document.sections
        if fold(section.name) not in names and _object_of(fold(section.name)) not in objects
    )
    return "".join("\n".join(["", *block, ""]) for block in blocks)


def _object_of(folded: str) -> str:
    """Return the index, as text, of the object that a section belongs to; "" for others."""
    found = _OBJECT.fullmatch(folded)
    return "" if found is None else found[1]


class _Editor:
    """The lines of a file, and the changes to make. Lines count from 1; 0 is the place before the first."""

    def __init__(self, document: EdsDocument) -> None:
        self.lines: list[str] = LINE.findall(document.text)
        self.places: dict[str, list[Section]] = {}
        for section in document.sections:
            self.places.setdefault(fold(section.name), []).append(section)
        self._replaced: dict[int, str] = {}
        self._removed: set[int] = set()
        self._keys_behind: dict[int, list[str]] = {}
        self._sections_behind: dict[int, list[str]] = {}
        self._added: dict[str, int] = {}  # new sections, and the line after which they go
        self._newline = document.newline

    def text(self) -> str:
        """Return the changed text of the file."""
        parts: list[str] = []
        for number, line in enumerate(["", *self.lines]):
            if number and number not in self._removed:
                parts.append(self._replaced.get(number, line))
            new = [*self._keys_behind.get(number, ()), *self._sections_behind.get(number, ())]
            if new and parts and parts[-1][-1] not in "\r\n":
                parts.append(self._newline)
            parts += new
        return "".join(parts)

    @staticmethod
    def end_of(section: Section) -> int:
        """Return the line of the section's last entry, or of its name if it has none."""
        return max([section.line, *(entry.line for entry in section.entries)])

    def change(self, name: str, before: Entries, after: Entries) -> None:
        """Change the section that counts from `before` to `after`."""
        section = self.places[fold(name)][0]
        entries: dict[str, list[Entry]] = {}
        for entry in section.entries:
            entries.setdefault(entry.key.lower(), []).append(entry)
        line = section.line
        for key, text in after.items():
            found = entries.get(key.lower(), [])
            if before.get(key) != text:
                for entry in found:
                    self._set(entry, text)
                if not found:
                    self._keys_behind.setdefault(line, []).append(f"{key}={text}{self._newline}")
            line = found[0].line if found else line
        for key in before.keys() - after.keys():
            self._removed.update(entry.line for entry in entries.get(key.lower(), []))

    def _set(self, entry: Entry, text: str) -> None:
        """Replace an entry's value, in the form of the old one."""
        line = self._replaced.get(entry.line, self.lines[entry.line - 1])
        start = entry.column - 1
        self._replaced[entry.line] = line[:start] + _in_form_of(entry.value, text) + line[start + len(entry.value) :]

    def add_section(self, name: str, entries: Entries, previous: str) -> None:
        """Add a section after `previous`; "" at the beginning."""
        folded = fold(previous)
        line = self._added.get(folded, 0)
        if self.places.get(folded):
            line = self.end_of(self.places[folded][-1])
        self._add(line, [(name, entries)], closed=not line)

    def rewrite(self, index: str, after: Sections) -> None:
        """Replace all sections of an object with those of `after`."""
        mine = [section for section in self._sections() if _object_of(fold(section.name)) == index]
        for section in mine:
            self._take_out(section)
        new = [(name, entries) for name, entries in after.items() if _object_of(fold(name)) == index]
        self._add(mine[0].line - 1 if mine else 0, new, closed=True)

    def remove(self, name: str) -> None:
        """Remove a section wherever it occurs in the file."""
        for section in self.places.get(fold(name), ()):
            self._take_out(section)

    def _sections(self) -> list[Section]:
        return sorted((each for sections in self.places.values() for each in sections), key=lambda section: section.line)

    def _take_out(self, section: Section) -> None:
        """Remove a section with the blank lines that follow it, so that none pile up."""
        last = self.end_of(section)
        while last < len(self.lines) and not self.lines[last].strip():
            last += 1
        self._removed.update(range(section.line, last + 1))

    def _add(self, line: int, sections: list[tuple[str, Entries]], *, closed: bool) -> None:
        """Add sections after a line. closed: another section follows, so the blank line goes after them, else before them."""
        lines = self._sections_behind.setdefault(line, [])
        for name, entries in sections:
            block = [f"[{name}]", *(f"{key}={text}" for key, text in entries.items())]
            block = [*block, ""] if closed else ["", *block]
            lines += [f"{each}{self._newline}" for each in block]
            self._added[fold(name)] = line
            self.places.setdefault(fold(name), [])


def _in_form_of(old: str, new: str) -> str:
    """Return a number in the form of another one, if both are plain numbers and the other is hexadecimal; else as it is."""
    form = _HEX.fullmatch(old)
    if form is None or not _NUMBER.fullmatch(new):
        return new
    digits = f"{int(new, 0):0{len(form[1])}X}"
    return old[:2] + (digits.lower() if form[1].islower() else digits)
