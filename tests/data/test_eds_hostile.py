"""Any bytes into the EDS reader: findings or a description, nothing else, and no more work than the file is long."""

from __future__ import annotations

import tracemalloc

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_data.description import DeviceDescription
from canopen_data.eds import compact, ini, read_eds, reader
from canopen_data.eds.ini import MAX_FINDINGS
from canopen_data.findings import DictionaryError
from fuzz.targets import eds_files

MEBIBYTE = 1 << 20
WORDS = [
    *("[", "]", "=", ";", "#", "\n", "\r\n", "\r", " ", "\x00", "\ufeff", "$NODEID", "+", "0x", "sub", "Name", "Value", "-", "_"),
    *("1000", "2000", "1A00", "0000", "FFFF", "ff", "255", "4294967295", "08", "-1", "1.5", "ä", "€", "\ud800"),
    *(
        "\n[2000]\n",
        "\n[2000sub1]\n",
        "\n[2000Value]\n",
        "\n[DeviceInfo]\nCompactPDO=255\nNrOfRXPDO=999999\n",
        "\n[DummyUsage]\n",
    ),
    *("ParameterName=", "ObjectType=", "DataType=", "AccessType=", "DefaultValue=", "ParameterValue=", "LowLimit=", "SubNumber="),
    *("CompactSubObj=", "ObjFlags=", "Factor=", "Dummy0005=", "NrOfEntries=", "SupportedObjects=", "Lines=", "Line1="),
    *("\n[M1ModuleInfo]\n", "\n[M1SubExt2000]\n", "\n[DynamicChannels]\nType1=5\nRange1=", "\n[DeviceComissioning]\nNodeID="),
]


def whole(description: DeviceDescription) -> None:
    """All of it can be used."""
    assert len(description.findings) <= MAX_FINDINGS + 1
    assert all(str(each).isprintable() for each in description.findings)


@given(st.binary(max_size=300))
@example(b"\xff\xfe[\x00")
@example(b"\xef\xbb\xbf\xff")
def test_any_bytes(data: bytes) -> None:
    whole(read_eds(data, "any.eds"))
    eds_files(data)


@given(st.lists(st.sampled_from(WORDS), max_size=60).map("".join))
def test_any_words_of_the_format(text: str) -> None:
    whole(read_eds(text, "any.eds"))
    try:
        read_eds(text, "any.eds", strict=True)
    except DictionaryError as error:
        assert len(error.findings) == 1


# ---- bounds ----


def test_compact_forms_stand_for_a_bounded_number_of_variables() -> None:
    section = "[{:04X}]\nParameterName=x\nObjectType=8\nDataType=5\nAccessType=rw\nCompactSubObj=255\n"
    description = read_eds("".join(section.format(index) for index in range(0x2000, 0x2400)))
    assert len(description.dictionary) <= compact.MAX_MADE
    assert [each.message for each in description.findings if each.code == "too-long"] == [
        f"compact forms stand for more than {compact.MAX_MADE} variables; the rest was not made"
    ]
    pdos = read_eds("[DeviceInfo]\nCompactPDO=255\nNrOfRXPDO=4294967295\nNrOfTXPDO=4294967295\n")
    assert len(pdos.dictionary.objects) == 4 * 512


def test_many_compact_pdos_share_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compact, "MAX_MADE", 20)
    pdos = read_eds("[DeviceInfo]\nCompactPDO=255\nNrOfRXPDO=4\nNrOfTXPDO=4\n", "x")
    assert list(pdos.dictionary.objects) == [0x1400, 0x1600]
    assert "x: error: compact forms stand for more than 20 variables; the rest was not made [too-long]" in map(str, pdos.findings)


def test_a_file_is_read_up_to_a_size_and_a_number_of_lines_and_sections(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "MAX_FILE_SIZE", MEBIBYTE)
    long = read_eds(b"[1000]\nDataType=7\nAccessType=ro\n" + b";" * MEBIBYTE, "x")
    assert [str(each) for each in long.findings] == [
        "x: error: the file has more than 1 MiB; only its beginning was read [too-long]"
    ]
    monkeypatch.setattr(ini, "MAX_LINES", 3)
    lines = read_eds("[1000]\nDataType=7\nAccessType=ro\nDefaultValue=1\n[1001]\n", "x")
    assert (list(lines.dictionary.objects), lines.dictionary.variable((0x1000, 0)).default) == ([0x1000], None)
    assert "x:3:0: error: there are more than 3 lines; the rest was not read [too-long]" in map(str, lines.findings)
    monkeypatch.setattr(ini, "MAX_LINES", 1000)
    monkeypatch.setattr(ini, "MAX_SECTIONS", 2)
    sections = read_eds("[1000]\n[1001]\n[1002]\n[1003]\n", "x")
    assert list(sections.dictionary.objects) == [0x1000, 0x1001]
    assert "x:3:1: error: there are more than 2 sections; the rest was not read [too-long]" in map(str, sections.findings)


def test_modules_are_bounded() -> None:
    description = read_eds("".join(f"[M{number}ModuleInfo]\n" for number in range(1, 1100)))
    assert len(description.modules) == 1000
    assert any("there are 1099 modules" in each.message for each in description.findings)


HOSTILE = {
    "sections": "[a]\n",
    "objects": "[{0:04X}]\n",
    "subs": "[2000sub{0:X}]\n",
    "junk": "junk {0}\n",
    "keys": "k{0}=\n",
    "one key": "k=\n",
    "line feeds": "\n",
    "brackets": "[",
    "hash": "#\n",
    "one line": "x",
    "values": "[{0:04X}]\nDataType=7\nAccessType=rw\nDefaultValue=x{1:x}\nParameterValue=y\nLowLimit=z\n",
    "lists": "[OptionalObjects]\n{1}=0x{0:x}\n",
    "nodeid": "[{0:04X}]\nDataType=7\nDefaultValue=$NODEID$NODEID$NODEID$NODEID\n",
}


def hostile(kind: str, size: int) -> str:
    """About so many characters of it."""
    piece = HOSTILE[kind]
    pieces = range(size // len(piece))
    return "".join(piece.format(number & 0xFFFF, number) for number in pieces) if "{" in piece else piece * len(pieces)


@pytest.mark.thorough(6)
@pytest.mark.parametrize("kind", HOSTILE)
def test_memory_is_bounded_by_the_size_of_the_file(kind: str) -> None:
    """Tens of times the file; most where every line is a section. The bounds of ini.py limit this for large files."""
    data = "[1000]\n" + hostile(kind, MEBIBYTE // 32)
    tracemalloc.start()
    description = read_eds(data, "x")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    whole(description)
    assert peak < 300 * len(data)


def test_no_pattern_takes_more_than_the_length_of_its_line() -> None:
    for text in ("0 " * 50_000, "$NODEID+" * 10_000, "00" * 100_000 + "x", "#" * 100_000, " " * 100_000 + "x", "1" * 100_000):
        for data_type in (5, 8, 0xA, 0xC):
            read_eds(f"[2000]\nDataType={data_type}\nAccessType=rw\nDefaultValue={text}\nLowLimit={text}\nObjFlags={text}\n")
