"""The form of an EDS: bytes, sections, keys, lines and columns."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.eds.ini import MAX_FINDINGS, Body, EdsDocument, Entry, Findings, Section, fold
from canopen_data.findings import Severity

HASH = "a comment begins with ';'; this line and all others that begin with '#' were taken for comments"


def opened(text: str) -> tuple[EdsDocument, list[str]]:
    """A document, and what was found."""
    findings = Findings("x.eds")
    document = EdsDocument(text, "utf-8", findings)
    return document, [str(each) for each in findings.all()]


def test_sections_keys_lines_and_columns() -> None:
    document, found = opened("; a comment\n\n[First]\nOne = 1 \n two=  2=3;4\n\n [Second]\nThree=\n")
    first, second = document.sections
    assert (first.name, first.line, dict(first.values)) == ("First", 3, {"one": "1", "two": "2=3;4"})
    assert list(first.entries) == [Entry("One", "1", 4, 7), Entry("two", "2=3;4", 5, 8)]
    assert (second.name, second.line, dict(second.values)) == ("Second", 7, {"three": ""})
    assert first.get("ONE") == "1"
    assert first.get("none") is None
    assert first.place_of("Two") == (5, 8)
    assert first.place_of("none") == (3, 1)
    assert found == []


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_lines_end_in_any_way(newline: str) -> None:
    document, found = opened(newline.join(["[A]", "Key=1", "", "[B]", "Key=2", ""]))
    assert [(each.name, each.line, dict(each.values)) for each in document.sections] == [
        ("A", 1, {"key": "1"}),
        ("B", 4, {"key": "2"}),
    ]
    assert document.newline == newline
    assert found == []


def test_a_mix_of_line_ends_counts_as_lines() -> None:
    document, _ = opened("[A]\r\nKey=1\r[B]\nKey=2\r\n\r\n[C]")
    assert [(each.name, each.line) for each in document.sections] == [("A", 1), ("B", 3), ("C", 6)]
    assert opened("")[0].newline == "\n"


def test_other_line_breaks_of_unicode_are_none() -> None:
    document, _ = opened("[A]\nName=a\x0bb\x85c\u2028d\n")
    assert document.sections[0].values == {"name": "a\x0bb\x85c\u2028d"}


def test_what_is_odd() -> None:
    _, found = opened("early\nkey=1\n# hash\n[A] tail\njunk\nOne=1\none=2\n=3\n# again\n[B\nx=1\n[C] ; fine\n[a]\nOne=4\n")
    assert found == [
        "x.eds:1:1: warning: 'early' is neither a section nor key=value nor a comment; left out [junk]",
        "x.eds:2:1: warning: 'key=1' is before the first section; left out [junk]",
        f"x.eds:3:1: notice: {HASH} [comment]",
        "x.eds:4:4: warning: 'tail' after [A] was left out [junk]",
        "x.eds:5:1: warning: 'junk' is neither a section nor key=value nor a comment; left out [junk]",
        "x.eds:7:1: error: one of [A] is in line 6 already; this one was left out [key-twice]",
        "x.eds:8:1: warning: '=3' is neither a section nor key=value nor a comment; left out [junk]",
        "x.eds:10:1: warning: [B has no bracket at its end [bracket]",
        "x.eds:13:1: error: [a] is in line 4 already; this one was left out [section-twice]",
    ]


def test_the_first_of_two_counts() -> None:
    document, _ = opened("[1000]\nName=a\nNAME=b\n[1000]\nName=c\n[1000sub01]\n[1000sub1]\nName=d\n")
    assert document.objects[0x1000].values == {"name": "a"}
    assert document.subs[0x1000][1].line == 6
    assert [entry.value for entry in document.objects[0x1000].entries] == ["a", "b"]


def test_a_section_by_any_spelling_of_its_name() -> None:
    document, _ = opened("[DeviceCommissioning]\n[1A00]\n[1a00SUB0f]\n[1A00Name]\n[Tools]\n")
    found = [document.section(name) for name in ("devicecomissioning", " 1a00", "1A00subF", "1a00NAME", "tools")]
    assert [each.line for each in found if each is not None] == [1, 2, 3, 4, 5]
    assert document.section("1A01") is document.section("1A00sub1") is document.section("x") is None
    assert fold("1A00sub0F") == "1a00subf"


def test_places() -> None:
    text = "[1000]\nDefaultValue= 5\n[1003]\nCompactSubObj=2\n[1003Name]\n1=one\n[1003Value]\n1=7\n[1018sub1]\nName=x\n"
    document, _ = opened(text)
    assert document.place_of(0x1000) == (1, 1)
    assert document.place_of(0x1000, 0, "defaultvalue") == (2, 15)
    assert document.place_of(0x1000, 0, "LowLimit") == (1, 1)
    assert document.place_of(0x1003, 1, "ParameterName") == (6, 3)
    assert document.place_of(0x1003, 1, "ParameterValue") == (8, 3)
    assert document.place_of(0x1003, 2, "CompactSubObj") == (4, 15)
    assert document.place_of(0x1018, 1) == (9, 1)
    assert document.place_of(0x1018, 2) == document.place_of(0x1018) == (9, 1)
    assert document.place_of(0x1019) == document.place_of(0x1019, 1, "DefaultValue") == (0, 0)


# ---- findings ----


def test_findings_are_bounded_and_the_worst_is_told() -> None:
    findings = Findings("x")
    for line in range(MAX_FINDINGS, 0, -1):
        findings.add(Severity.NOTICE, "some", "text", line)
    findings.add(Severity.ERROR, "worse", "text", 1)
    findings.add(Severity.WARNING, "bad", "text", 1)
    all_of_them = findings.all()
    assert [each.line for each in all_of_them] == [*range(1, MAX_FINDINGS + 1), 0]
    assert str(all_of_them[-1]) == "x: error: 2 more findings not listed [too-many]"


@given(st.text(alphabet="[]=;# \n\rab", max_size=60))
def test_any_text_has_all_its_lines(text: str) -> None:
    """Sections stand where they say they do, and entries too."""
    document, _ = opened(text)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    for section in document.sections:
        assert lines[section.line - 1].lstrip().startswith("[")
        for entry in section.entries:
            assert lines[entry.line - 1][entry.column - 1 :].startswith(entry.value)
            assert section.values[entry.key.lower()] is not None


def test_the_places_of_many_findings_take_one_look_at_the_section() -> None:
    """A list of thousands of objects may have a finding in each line."""

    class Text(str):
        looks = 0

        def split(self, *args: Any, **named: Any) -> list[str]:
            Text.looks += 1
            return super().split(*args, **named)

    text = Text("ManufacturerObjects]\n" + "\n".join(f"{number} = x" for number in range(1000)) + "\n5 = twice")
    section = Section("ManufacturerObjects", 7, text, Body({}), None)
    for number in range(1000):
        assert section.place_of(str(number)) == (8 + number, len(f"{number} = x"))
    assert section.place_of("none") == (7, 1)
    assert Text.looks == 1
