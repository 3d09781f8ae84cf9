"""Parse the form of an EDS or DCF: sections, keys, lines and columns. Any text is accepted.

An EDS is an INI file of Windows (CiA 306-1 v1.4.0, 4.2): `[section]`, `key=value`, and comments, which are lines that begin with
a semicolon. That format has no standard; the reading function of Windows is its only authority. So here, too:

- names of sections and keys are the same in any case; blanks around names, keys and values do not count;
- of two sections with one name, and of two equal keys in a section, the first counts; the other is not read (an error);
- everything after the first `=` is the value, semicolons included.

Beyond that: a line that begins with `#` is a comment too (a notice: other tools take it for a key); text after the bracket of a
section is left out; any other line is a warning. Lines end with LF, CR LF or CR, in any mix.

encodings.py turns bytes into text.

Speed: most of a file is repetition. In a maker's file, half to nine tenths of the sections repeat another one except for their
name. So the text after a first line `ParameterName=` is parsed once for all equal sections (`Body`), and otherwise each distinct
line once (`_ParsedLines`). The spelling of keys, and columns, are found on request.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from canopen_data.eds.encodings import LINE_END
from canopen_data.findings import Finding, Severity
from canopen_proto.explained import counted

MAX_FILE_SIZE: Final = 16 * 1024 * 1024
"""Bytes. The largest EDS in the field are below 2 MiB."""
MAX_LINES: Final = 1_000_000
"""A file of MAX_FILE_SIZE has this many lines if they are as short as those of an EDS (17 characters on average)."""
MAX_SECTIONS: Final = 100_000
"""Of one file; it also bounds the variables with sections. A section and the objects made of it take up to 1500 bytes of
memory."""
MAX_FINDINGS: Final = 1000
"""Findings kept of one file; further ones are counted."""
MAX_QUOTED: Final = 60
"""Characters of the file that a finding quotes."""

_SECTION: Final = re.compile(r"\n[ \t]*\[")
_OBJECT: Final = re.compile(r"([0-9a-f]{4})(?:sub([0-9a-f]{1,8})|(name|value|denotation))?", re.ASCII)
_HASH_LINE: Final = re.compile(r"\n([ \t]*)#")
_OTHER_SPELLING: Final = {"devicecommissioning": "devicecomissioning"}
"""The standard prints the name with one m; half of the tools write two."""

_ODD: Final = "\n"
"""The key of lines that make no sense; no line has a line feed in it."""
_TITLE: Final = "parametername"
_NOTHING: Final = ("", "")
_JUNK: Final = (_ODD, "")
_SUB: Final = frozenset(("sub", "Sub", "SUB"))
_SUBINDICES: Final = {
    text: number for number in range(256) for text in (f"{number:x}", f"{number:X}", f"{number:02x}", f"{number:02X}")
}


class Findings:
    """The findings about one file, each with its place; bounded. source: the file's name."""

    def __init__(self, source: str) -> None:
        self.source = source
        self._list: list[Finding] = []
        self._hidden = 0
        self._worst = Severity.NOTICE

    def full(self, severity: Severity) -> bool:
        """Return whether there is no room for another finding, and count it if so: its text need not be made."""
        if len(self._list) < MAX_FINDINGS:
            return False
        self._hidden += 1
        self._worst = min(self._worst, severity, key=list(Severity).index)
        return True

    def add(self, severity: Severity, code: str, message: str, line: int = 0, column: int = 0) -> None:
        """Add a finding. line, column: from 1; 0 = the whole file. code: of the finding. message: for people."""
        if not self.full(severity):
            self._list.append(Finding(severity, code, message, self.source, line, column))

    def in_section(self, section: Section | None, key: str, severity: Severity, code: str, message: str) -> None:
        """Add a finding about a key of a section, "" for the section as a whole; None: about the whole file."""
        if not self.full(severity):
            place, where = ((0, 0), "") if section is None else (section.place_of(key), f"in [{quoted(section.name)}]: ")
            self._list.append(Finding(severity, code, f"{where}{message}", self.source, *place))

    def all(self) -> tuple[Finding, ...]:
        """Return the findings in the order of the file."""
        found = sorted(self._list, key=lambda each: (each.line, each.column))
        if self._hidden:
            found.append(Finding(self._worst, "too-many", f"{counted(self._hidden, 'more finding')} not listed", self.source))
        return tuple(found)


class Entry(NamedTuple):
    """One `key=value` as in the file. line, column: of the value, from 1."""

    key: str
    value: str
    line: int
    column: int


class Body:
    """The shared content of sections that differ in their names only. values: by key in small letters; the last key comes first.

    made: what a reader has made of it, for use with the next such section; None = nothing.
    """

    __slots__ = ("made", "values")

    def __init__(self, values: dict[str, str]) -> None:
        self.values = values
        self.made: tuple[Any, ...] | None = None


class Section:
    """One section. name: as spelt in the file, without blanks around it. line: of the name, from 1.

    title: its ParameterName, if that is the first key; body: all other keys. `values` has all of them.
    """

    __slots__ = ("_places", "_text", "body", "line", "name", "title")

    def __init__(self, name: str, line: int, text: str, body: Body, title: str | None) -> None:
        self.name = name
        self.line = line
        self.body = body
        self.title = title
        self._text = text  # from the name up to the line before the next section
        self._places: dict[str, tuple[int, int]] | None = None  # of all keys, once somebody asks for one

    @property
    def values(self) -> Mapping[str, str]:
        """The values by key in small letters, without blanks around; of two equal keys, the first. The last key comes first."""
        return self.body.values if self.title is None else {**self.body.values, _TITLE: self.title}

    @property
    def entries(self) -> Iterator[Entry]:
        """Yield all entries in the order of the file, including those that do not count."""
        known = _ParsedLines()
        for number, line in enumerate(self._text.split("\n")[1:], start=self.line + 1):
            folded, value = known[line]
            if folded not in ("", _ODD):
                key, _, behind = line.partition("=")
                yield Entry(key.strip(), value, number, len(line) - len(behind.lstrip()) + 1)

    def without(self, keys: Iterable[str]) -> Section:
        """Return the section without some keys, in small letters."""
        body = Body({key: value for key, value in self.body.values.items() if key not in keys})
        return Section(self.name, self.line, self._text, body, self.title)

    def get(self, key: str) -> str | None:
        """Return the value of a key, in upper or lower case. None if there is no such key."""
        return self.values.get(key.lower())

    def place_of(self, key: str) -> tuple[int, int]:
        """Return line and column of a value; of the section's name if there is no such key."""
        if self._places is None:
            self._places = {}
            for number, line in enumerate(self._text.split("\n")[1:], start=self.line + 1):
                spelt, equals, value = line.partition("=")
                if equals and (folded := spelt.strip().lower()):
                    self._places.setdefault(folded, (number, len(line) - len(value.lstrip()) + 1))
        return self._places.get(key.lower(), (self.line, 1))


class EdsDocument:
    """The original file; see `description.Document`. text: all of it, without a byte order mark. encoding: as `codecs` names it.

    sections: all of them in the file's order. named: by name in small letters (see `fold`), the first of each name, without the
    objects. objects: sections of objects, by index; subs: of sub-objects, by index and subindex; lists: of names, values and
    denotations of sub-objects, by index and "name", "value" or "denotation".
    """

    def __init__(self, text: str, encoding: str, findings: Findings) -> None:
        self.text = text
        self.encoding = encoding
        self.sections: list[Section] = []
        self.named: dict[str, Section] = {}
        self.objects: dict[int, Section] = {}
        self.subs: dict[int, dict[int, Section]] = {}
        self.lists: dict[tuple[int, str], Section] = {}
        if "\r" in text:
            text = text.replace("\r\n", "\n").replace("\r", "\n")
        if text.count("\n") > MAX_LINES:
            text = "\n".join(text.split("\n", MAX_LINES)[:MAX_LINES])
            findings.add(Severity.ERROR, "too-long", f"there are more than {MAX_LINES} lines; the rest was not read", MAX_LINES)
        self._read(text, findings)

    @property
    def newline(self) -> str:
        """The line end of the first line; a line feed if there is none."""
        found = LINE_END.search(self.text)
        return "\n" if found is None else found[0]

    def section(self, name: str) -> Section | None:
        """Return the section of that name, in any spelling (`fold`), that counts."""
        folded = fold(name)
        found = _OBJECT.fullmatch(folded)
        if found is None:
            return self.named.get(folded)
        index = int(found[1], 16)
        if found[2] is not None:
            return self.subs.get(index, {}).get(int(found[2], 16))
        return self.objects.get(index) if found[3] is None else self.lists.get((index, found[3]))

    def place_of(self, index: int, subindex: int | None = None, field: str = "") -> tuple[int, int]:
        """Return the place; see `description.Document`. For a sub-object in compact form it is that of its own name or value, if
        any. field: a key of its section, "" for the section itself."""
        section = self.objects.get(index)
        if subindex is not None:
            sub = self.subs.get(index, {}).get(subindex)
            if sub is not None:
                return sub.place_of(field)
            key = str(subindex)
            entries = self.lists.get((index, _LIST_OF.get(field.lower(), "name")))
            if entries is not None and key in entries.values:
                return entries.place_of(key)
        if section is None:
            section = next(iter(self.subs.get(index, {}).values()), None)
            return (0, 0) if section is None else (section.line, 1)
        return section.place_of(field)

    def _read(self, text: str, findings: Findings) -> None:
        """Parse the text. Lines before the first section belong to none."""
        known = _ParsedLines()
        bodies: dict[str, Body] = {}
        indices: dict[str, int] = {}
        text = "\n" + text
        head, *parts = _SECTION.split(text, MAX_SECTIONS + 1)
        line = head.count("\n")
        _report(head.split("\n")[1:], 1, known, findings, "")
        for part in parts[:MAX_SECTIONS]:
            line += 1
            pieces = part.split("\n", 2)
            header = pieces[0]
            first, tail = pieces[1:] if len(pieces) == 3 else ("".join(pieces[1:]), "")
            name, bracket, behind = header.partition("]")
            if behind or not bracket:
                name = _odd_header(name, bracket, behind, line, findings)
            name = name.strip()
            title = first[14:].strip() if first[:14] == "ParameterName=" else None  # a short cut for the usual spelling
            body = bodies.get(tail) if title is not None else None
            if body is None:
                if title is None:
                    key, value = known[first]
                    title = value if key == _TITLE else None
                body = _body(title, first, tail, name, line, known, bodies, findings)
            section = Section(name, line, part, body, title)
            self.sections.append(section)
            first = self._place(section, indices)
            if first is not section and not findings.full(Severity.ERROR):
                message = f"[{quoted(name)}] is in line {first.line} already; this one was left out"
                findings.add(Severity.ERROR, "section-twice", message, line, 1)
            line += part.count("\n")
        if len(parts) > MAX_SECTIONS:
            message = f"there are more than {MAX_SECTIONS} sections; the rest was not read"
            findings.add(Severity.ERROR, "too-long", message, line + 1, 1)
        if known.hash:
            _report_hash(text, findings)

    def _place(self, section: Section, indices: dict[str, int]) -> Section:
        """File a section by its subject. Return the section that counts: this one, or an earlier one. indices: those read so
        far."""
        name = section.name
        digits = name[:4]
        index = indices.get(digits)
        if index is not None and name[4:7] in _SUB and (subindex := _SUBINDICES.get(name[7:])) is not None:
            subs = self.subs.get(index)
            if subs is None:
                subs = self.subs[index] = {}
            return subs.setdefault(subindex, section)
        if index is not None and len(name) == 4:
            return self.objects.setdefault(index, section)
        name = name.lower()
        found = _OBJECT.fullmatch(name)
        if found is None:
            return self.named.setdefault(_OTHER_SPELLING.get(name, name), section)
        index = indices[digits] = int(digits, 16)
        if len(name) == 4:
            return self.objects.setdefault(index, section)
        if found[3] is not None:
            return self.lists.setdefault((index, found[3]), section)
        return self.subs.setdefault(index, {}).setdefault(int(found[2], 16), section)


_LIST_OF: Final = {"parametername": "name", "defaultvalue": "value", "parametervalue": "value", "denotation": "denotation"}


class _ParsedLines(dict[str, tuple[str, str]]):
    """Each distinct line, parsed. hash: whether one begins with `#`."""

    def __init__(self) -> None:
        super().__init__()
        self.hash = False

    def __missing__(self, line: str) -> tuple[str, str]:
        key, equals, value = line.partition("=")
        key = key.strip().lower()
        if not key:
            pair = _JUNK if equals else _NOTHING
        elif key[0] in ";#":
            pair = _NOTHING
            self.hash |= key[0] == "#"
        else:
            pair = (key, value.strip()) if equals else _JUNK
        self[line] = pair
        return pair


def _body(
    title: str | None,
    first: str,
    tail: str,
    name: str,
    line: int,
    known: _ParsedLines,
    bodies: dict[str, Body],
    findings: Findings,
) -> Body:
    """Return the body of a section. first: its first line, with its title if it has one; tail: what follows.

    bodies: by tail, those of sections with a title and without a fault.
    """
    if title is not None and (body := bodies.get(tail)) is not None:
        return body
    lines = tail.split("\n")
    if title is None:
        lines.insert(0, first)
    values = dict(map(known.__getitem__, reversed(lines)))  # reversed: of two equal keys the first must stay
    values.pop("", None)
    body = Body(values)
    shorter = len(values) != len(lines) - lines.count("")
    if _ODD in values or (title is not None and _TITLE in values) or (shorter and _repeats(lines, values, known)):
        values.pop(_ODD, None)
        if title is not None:
            values.pop(_TITLE, None)
            lines.insert(0, first)
        _report(lines, line + 1, known, findings, name)
    elif title is not None:
        bodies[tail] = body
    return body


def _repeats(lines: list[str], values: dict[str, str], known: _ParsedLines) -> bool:
    """Return whether a key occurs twice. Comments may repeat."""
    return len(values) != sum(1 for key, _ in map(known.__getitem__, lines) if key)


def _report(lines: Iterable[str], number: int, known: _ParsedLines, findings: Findings, section: str) -> None:
    """Report the faults in the lines of a section ("": before the first section). number: of the first line."""
    seen: dict[str, int] = {}
    for line_number, line in enumerate(lines, start=number):
        key, _ = pair = known[line]
        if not key:
            continue
        if pair is _JUNK or not section:
            if not findings.full(Severity.WARNING):
                fault = "is neither a section nor key=value nor a comment" if pair is _JUNK else "is before the first section"
                findings.add(Severity.WARNING, "junk", f"{quoted(line)!r} {fault}; left out", line_number, _first_column(line))
            continue
        first = seen.setdefault(key, line_number)
        if first != line_number and not findings.full(Severity.ERROR):
            message = f"{quoted(key)} of [{quoted(section)}] is in line {first} already; this one was left out"
            findings.add(Severity.ERROR, "key-twice", message, line_number, _first_column(line))


def _report_hash(text: str, findings: Findings) -> None:
    """Report the first comment that begins with `#`."""
    found = _HASH_LINE.search(text)
    if found is not None:
        line = text.count("\n", 0, found.end())
        message = "a comment begins with ';'; this line and all others that begin with '#' were taken for comments"
        findings.add(Severity.NOTICE, "comment", message, line, len(found[1]) + 1)


def _first_column(line: str) -> int:
    return len(line) - len(line.lstrip()) + 1


def _odd_header(name: str, bracket: str, rest: str, line: int, findings: Findings) -> str:
    """Return the name in a line `[name] rest` or `[name`."""
    if bracket:
        rest = rest.strip()
        if rest and rest[0] not in ";#":
            message = f"{quoted(rest)!r} after [{quoted(name)}] was left out"
            findings.add(Severity.WARNING, "junk", message, line, len(name) + 3)
        return name
    findings.add(Severity.WARNING, "bracket", f"[{quoted(name)} has no bracket at its end", line, 1)
    return name.partition(";")[0].partition("#")[0]


def fold(name: str) -> str:
    """Return a section's name in one spelling: small letters, no leading zeros of a subindex, "comissioning" with one m."""
    folded = name.strip().lower()
    found = _OBJECT.fullmatch(folded)
    if found is None or found[2] is None:
        return _OTHER_SPELLING.get(folded, folded)
    return f"{found[1]}sub{int(found[2], 16):x}"


def quoted(text: str) -> str:
    """Return a piece of the file for the text of a finding: bounded, one line, printable."""
    text = text.strip()
    if len(text) > MAX_QUOTED:
        text = f"{text[:MAX_QUOTED]}..."
    return text if text.isprintable() else ascii(text)[1:-1]
