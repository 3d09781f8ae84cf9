"""Faulty EDS files repaired: each fault alone, what is left alone, and that the meaning stays."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.checks import check
from canopen_data.description import FileKind
from canopen_data.difference import compare
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer import write_eds
from canopen_data.repair import repair
from canopen_proto.machine import LocalProtocolError
from tests.check.checked_device import clean
from tests.examples import examples

TEXT = write_eds(clean())
GAIN = TEXT[TEXT.index("[2000]") : TEXT.index("[2001]")]


def test_a_clean_file_stays_as_it_is() -> None:
    repaired = repair(read_eds(TEXT))
    assert repaired.text == TEXT
    assert repaired.repairs == ()


@pytest.mark.parametrize(
    ("old", "new", "code", "message"),
    [
        ("SupportedObjects=4", "SupportedObjects=9", "count", "[ManufacturerObjects]: SupportedObjects=9 is 4"),
        ("SupportedObjects=4\n", "", "count", "[ManufacturerObjects]: SupportedObjects=4 added"),
        ("4=0x2003\n", "", "list", "[ManufacturerObjects]: 0x2003 added"),
        ("4=0x2003\n", "4=0x2003\n5=0x2009\n", "list",
         "[ManufacturerObjects]: 0x2009 taken out, which has no section or is in another list"),
        ("4=0x2003\n", "5=0x2003\n", "list", "[ManufacturerObjects]: renumbered"),
        ("SubNumber=3\n", "SubNumber=7\n", "count", "[1016]: SubNumber=7 is 3"),
        ("SubNumber=3\n", "", "count", "[1016]: SubNumber=3 added"),
        ("AccessType=rw\nDefaultValue=5\n", "DefaultValue=5\n", "missing-key",
         "[2000]: AccessType=rw written down, as it was read"),
        ("AccessType=rw\nDefaultValue=5\n", "AccessType=\nDefaultValue=5\n", "missing-key",
         "[2000]: AccessType=rw written down, as it was read"),
        ("AccessType=rw\nDefaultValue=5\n", "AccessType=RW\nDefaultValue=5\n", "access-form", "[2000]: AccessType=RW is rw"),
        ("$NODEID+0x200", "$NodeID + 0x200", "number", "[1400sub1]: DefaultValue=$NodeID + 0x200 is $NODEID+0x200"),
        (GAIN, GAIN + GAIN, "duplicate-section", "taken out"),
    ],
)  # fmt: skip
def test_a_fault_is_repaired(old: str, new: str, code: str, message: str) -> None:
    faulty = TEXT.replace(old, new, 1)
    before = read_eds(faulty, "drive.eds")
    repaired = repair(before)
    assert {each.code for each in repaired.repairs} <= {code, "count"}
    assert any(each.code == code and each.message.endswith(message) for each in repaired.repairs)
    assert all(each.line and each.source == "drive.eds" for each in repaired.repairs)
    assert repaired.text == TEXT
    assert repaired.description.dictionary.objects == before.dictionary.objects
    assert repair(repaired.description).repairs == ()


def test_a_missing_list_is_added() -> None:
    start = TEXT.index("[ManufacturerObjects]")
    faulty = TEXT[:start] + TEXT[TEXT.index("[2000]") :]
    repaired = repair(read_eds(faulty))
    assert [each.message for each in repaired.repairs] == ["[ManufacturerObjects] added: SupportedObjects=4"]
    assert repaired.description.manufacturer == (0x2000, 0x2001, 0x2002, 0x2003)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("DefaultValue=5\n", "DefaultValue=101\n"),  # outside its limits
        ("DefaultValue=5\n", ""),
        ("0x60410010", "0x20090010"),  # no such object
        ("1=0x2000\n2=0x2001\n", "2=0x2001\n1=0x2000\n"),  # the number counts, not the place
        (GAIN, GAIN + GAIN.replace("Gain", "Other")),  # which one is meant?
        (GAIN, GAIN + GAIN.replace("[2000]\n", "[2000]\n; why\n")),  # a comment may tell something
        ("AccessType=rw\nDefaultValue=5\n", "AccessType=maybe\nDefaultValue=5\n"),
        ("SubNumber=3\n", "SubNumber=3\nCompactSubObj=0\n"),
    ],
)
def test_what_nobody_can_know_is_left_alone(old: str, new: str) -> None:
    faulty = TEXT.replace(old, new, 1)
    assert faulty != TEXT
    repaired = repair(read_eds(faulty))
    assert repaired.text == faulty
    assert repaired.repairs == ()


def test_compact_objects_stay_compact() -> None:
    compact = "[2010]\nParameterName=Many\nObjectType=0x8\nDataType=0x0005\nAccessType=rw\nPDOMapping=0\nCompactSubObj=3\n"
    faulty = TEXT.replace("4=0x2003\n", "4=0x2003\n5=0x2010\n").replace("SupportedObjects=4", "SupportedObjects=5") + compact
    repaired = repair(read_eds(faulty))
    assert repaired.text == faulty
    assert len(repaired.description.dictionary.objects[0x2010].variables) == 4


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\xef\xbb\xbf" + TEXT.encode(), "the byte order mark at its beginning is taken out"),
        (TEXT.replace("Acme", "M\u00fcller").encode("cp1252"), "written as UTF-8; it was cp1252"),
        (TEXT.encode("utf-16"), "written as UTF-8; it was utf-16"),
    ],
)
def test_the_encoding_is_repaired(data: bytes, message: str) -> None:
    repaired = repair(read_eds(data))
    assert [each.message for each in repaired.repairs] == [message]
    assert read_eds(repaired.text.encode()).findings == ()


def test_many_places_are_told_in_short() -> None:
    extra = "".join(
        f"[30{number:02X}]\nParameterName=N{number}\nObjectType=0x7\nDataType=0x0005\nAccessType=rw\n" for number in range(9)
    )
    (first, *_) = repair(read_eds(TEXT + extra)).repairs
    assert first.message.endswith("0x3000, 0x3001, 0x3002, 0x3003, 0x3004, 0x3005 and 3 more added")


def test_only_eds_and_dcf_are_repaired() -> None:
    with pytest.raises(LocalProtocolError):
        repair(clean(FileKind.XDD))


LINES = TEXT.split("\n")


@examples(30)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["drop", "twice", "swap", "change"]),
            st.integers(0, len(LINES) - 1),
            st.integers(0, len(LINES) - 1),
            st.sampled_from(
                ["=", "=0xZZ", "=$NODEID", "AccessType=RO", "[2000]", "SubNumber=4294967295", "1=0x1000", "\ufeff", "\x85"]
            ),
        ),
        max_size=12,
    )
)
def test_any_faults_are_repaired_or_left(changes: list[tuple[str, int, int, str]]) -> None:
    lines = list(LINES)
    for action, one, other, text in changes:
        first, second = one % len(lines), other % len(lines)
        if action == "drop" and len(lines) > 1:
            del lines[first]
        elif action == "twice":
            lines.insert(second, lines[first])
        elif action == "swap":
            lines[first], lines[second] = lines[second], lines[first]
        else:
            lines[first] = text
    before = read_eds("\n".join(lines))
    repaired = repair(before)
    assert compare(before, repaired.description) == []
    assert len(check(repaired.description)) <= len(check(before))
    assert not repair(repaired.description).repairs
