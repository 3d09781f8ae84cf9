"""Parse XML from untrusted bytes into a small tree that knows its lines and columns.

`parse` runs the standard library's expat over the whole file and keeps each element with its attributes, its text and its place.
Namespace prefixes are removed: files in the field declare the same namespace as q1, q2, as the default one, or not at all, and no
name means two things in CiA 311.

Protection against hostile files:

- a document type declaration ends the reading. It can only do harm (entities that expand to gigabytes, files and addresses that
  are fetched), and no XDD has one. Without it only the five entities of XML itself exist;
- the number of bytes, of elements, of attributes and the depth are bounded by constants;
- bytes are decoded here, by a short list of encodings, and expat gets UTF-8: the file cannot have a codec loaded.

A broken file gives the content before the break, and one error with its place.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final
from xml.parsers import expat

from canopen_data.eds.encodings import NOT_CP1252
from canopen_data.eds.ini import MAX_FILE_SIZE, Findings
from canopen_data.findings import Severity

MAX_ELEMENTS: Final = 300_000
"""A device of 2000 objects with parameters and texts has 20 000. An element takes about 300 bytes of memory."""
MAX_DEPTH: Final = 64
"""CiA 311 nests 12 deep; its parameter groups and structures may nest in each other."""
MAX_ATTRIBUTES: Final = 64
"""Of one element; CiA 311 has 14 for an object."""
MAX_TAG: Final = 1 << 16
"""Bytes of a tag that are searched for the place of an attribute; in a longer tag, findings point to its beginning."""
_DECLARATION: Final = re.compile(rb"""<\?xml[^>]{0,200}?\sencoding\s*=\s*["']([A-Za-z0-9._-]{1,40})["']""")
_DECLARATION_16: Final = {b"<\x00?\x00": "utf-16-le", b"\x00<\x00?": "utf-16-be"}
_MARKS: Final = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_ENCODINGS: Final = {
    "utf-8": "utf-8",
    "utf8": "utf-8",
    "us-ascii": "utf-8",
    "ascii": "utf-8",
    "iso-8859-1": "latin-1",
    "latin-1": "latin-1",
    "latin1": "latin-1",
    "iso-8859-15": "iso-8859-15",
    "windows-1252": "cp1252",
    "cp1252": "cp1252",
    "utf-16": "utf-8",  # no byte order mark and one byte a character: it is not UTF-16
}
_ATTRIBUTE: Final = re.compile(rb"""\s([^\s=<>"'/]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_TAG: Final = re.compile(rb"""<[^\s<>"'/]*(?:"[^"]*"|'[^']*'|[^<>"'])*""")


class Element:
    """One element: its name and its attributes without prefixes, its content, and line and column of its tag (from 1)."""

    __slots__ = ("_text", "attributes", "children", "column", "line", "name", "offset")

    def __init__(self, name: str, attributes: dict[str, str], line: int, column: int, offset: int) -> None:
        self.name = name
        self.attributes = attributes
        self.line = line
        self.column = column
        self.offset = offset  # in the file as UTF-8
        self.children: list[Element] = []
        self._text: list[str] = []

    def add_text(self, text: str) -> None:
        """Add a piece of its own text."""
        self._text.append(text)

    @property
    def text(self) -> str:
        """Its own text, without white space around it."""
        return "".join(self._text).strip()

    def get(self, attribute: str) -> str:
        """Return the value of an attribute, without white space around it; "" if there is none."""
        return self.attributes.get(attribute, "").strip()

    def all(self, name: str) -> Iterator[Element]:
        """Return its children of that name."""
        return (each for each in self.children if each.name == name)

    def first(self, *path: str) -> Element | None:
        """Return the first child of that name; of several names, its first child of the next one, and so on."""
        found: Element | None = self
        for name in path:
            found = next(found.all(name), None) if found is not None else None
        return found


class XddFindings(Findings):
    """The findings about one file, each with its place. text: the file as UTF-8."""

    def __init__(self, source: str) -> None:
        super().__init__(source)
        self.text = b""

    def about(self, severity: Severity, code: str, message: str, element: Element, attribute: str = "") -> None:
        """Add a finding about an element, or about one of its attributes. code: of the finding. message: for people. attribute:
        "" for the element itself."""
        if not self.full(severity):
            self.add(severity, code, message, *place_in(self.text, element, attribute))

    def error(self, code: str, message: str, element: Element, attribute: str = "") -> None:
        """Add an error: something was left out. code, message, attribute: as of `about`."""
        self.about(Severity.ERROR, code, message, element, attribute)

    def warning(self, code: str, message: str, element: Element, attribute: str = "") -> None:
        """Add a warning: something was read, but is not in order. code, message, attribute: as of `about`."""
        self.about(Severity.WARNING, code, message, element, attribute)


def place_in(text: bytes, element: Element, attribute: str = "") -> tuple[int, int]:
    """Return line and column of an attribute's value in the file as UTF-8; of the element if it has no such attribute."""
    tag = _TAG.match(text, element.offset, element.offset + MAX_TAG) if attribute in element.attributes else None
    if tag is not None:
        for match in _ATTRIBUTE.finditer(text, element.offset, tag.end()):
            if _local(match[1].decode("utf-8", "replace")) == attribute:
                start = match.start(2) if match[2] is not None else match.start(3)
                lines = re.split(rb"\r\n|\r|\n", text[element.offset : start])
                first = element.column if len(lines) == 1 else 1
                return element.line + len(lines) - 1, first + len(lines[-1].decode("utf-8", "replace"))
    return element.line, element.column


def parse(data: bytes, findings: XddFindings) -> tuple[Element | None, str]:
    """Return the root element of a file, or None, and the encoding used. Never raises. data: the file's bytes."""
    if len(data) > MAX_FILE_SIZE:
        message = f"the file has {len(data)} bytes, more than {MAX_FILE_SIZE // 1024**2} MiB; nothing was read"
        findings.add(Severity.ERROR, "too-large", message)
        return None, "utf-8"
    text, encoding = _decode(data, findings)
    findings.text = text.encode("utf-8")
    parser = expat.ParserCreate("utf-8")
    builder = _Builder(parser, findings)
    try:
        parser.Parse(findings.text, True)
    except _Enough:
        pass
    except expat.ExpatError as error:
        message = f"this is not well-formed XML: {expat.ErrorString(error.code)}"
        if builder.root is not None:
            message += "; what follows was not read"
        findings.add(Severity.ERROR, "xml", message, error.lineno, error.offset + 1)
    return builder.root, encoding


def _decode(data: bytes, findings: XddFindings) -> tuple[str, str]:
    """Return the file's text without its byte order mark, and the encoding: the one that it names, else one that fits."""
    encoding = next((name for mark, name in _MARKS.items() if data.startswith(mark)), "")
    if not encoding:
        declared = _DECLARATION.match(data[:300])
        named = declared[1].decode("ascii").lower() if declared is not None else "utf-8"
        encoding = _DECLARATION_16.get(data[:4]) or _ENCODINGS.get(named, "")
        if not encoding:
            findings.add(Severity.WARNING, "encoding", f"the encoding {named!r} is not known here; read as UTF-8", 1, 1)
            encoding = "utf-8"
    try:
        return data.decode(encoding), encoding
    except UnicodeDecodeError as error:
        start = error.start
    fitting = "latin-1" if NOT_CP1252.search(data) else "cp1252"
    message = f"the byte 0x{data[start]:02X} cannot be read as {encoding}; the whole file was read as {fitting}"
    findings.add(Severity.WARNING, "encoding", message, data.count(b"\n", 0, start) + 1, start - data.rfind(b"\n", 0, start))
    return data.decode(fitting), fitting


class _Enough(Exception):
    """The signal to stop reading."""


class _Builder:
    """The maker of the tree from expat's calls."""

    def __init__(self, parser: expat.XMLParserType, findings: XddFindings) -> None:
        self.root: Element | None = None
        self._parser = parser
        self._findings = findings
        self._open: list[Element] = []
        self._count = 0
        parser.buffer_text = True
        parser.StartDoctypeDeclHandler = self._doctype
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text

    def _stop(self, code: str, message: str) -> None:
        line, column = self._parser.CurrentLineNumber, self._parser.CurrentColumnNumber + 1
        self._findings.add(Severity.ERROR, code, f"{message}; what follows was not read", line, column)
        raise _Enough

    def _doctype(self, *_: object) -> None:
        self._stop("doctype", "a document type declaration (<!DOCTYPE) has no place in an XDD, and may be an attack")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MAX_ELEMENTS:
            self._stop("too-many", f"there are more than {MAX_ELEMENTS} elements")
        if len(self._open) >= MAX_DEPTH:
            self._stop("too-deep", f"the elements are nested more than {MAX_DEPTH} deep")
        if len(attributes) > MAX_ATTRIBUTES:
            self._stop("too-many", f"one element has more than {MAX_ATTRIBUTES} attributes")
        parser = self._parser
        own = {_local(key): value for key, value in attributes.items()}
        place = parser.CurrentLineNumber, parser.CurrentColumnNumber + 1, parser.CurrentByteIndex
        element = Element(_local(name), own, *place)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)

    def _end(self, _: str) -> None:
        self._open.pop()

    def _text(self, text: str) -> None:
        self._open[-1].add_text(text)


def _local(name: str) -> str:
    return name.rpartition(":")[2]
