"""Any bytes into the XDD reader: findings or a description, nothing else, and no more work than the file is long."""

from __future__ import annotations

import random
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.description import DeviceDescription
from canopen_data.eds import ini
from canopen_data.eds.ini import MAX_FILE_SIZE, MAX_FINDINGS
from canopen_data.findings import DictionaryError, Severity
from canopen_data.xdd import elements, read_xdd, reader
from tests.data.xdd_files import read, told, var, xdd

GOOD = xdd(
    var('dataType="0005" accessType="ro" defaultValue="5" lowLimit="1" objFlags="1"')
    + var('uniqueIDRef="P" PDOmapping="TPDO"', "2001", "other")
    + '<CANopenObject index="1018" name="i" objectType="9" subNumber="1"><CANopenSubObject subIndex="00" objectType="7"/>'
    "</CANopenObject>",
    '<dataTypeList><enum uniqueID="E"><enumValue value="1"><label>on</label></enumValue><USINT/></enum></dataTypeList>'
    '<parameterList><parameter uniqueID="P" access="readWrite"><dataTypeIDRef uniqueIDRef="E"/><defaultValue value="$NODEID+1"/>'
    '<allowedValues><range><minValue value="0"/><maxValue value="9"/></range></allowedValues></parameter></parameterList>',
    layers='<dummyUsage><dummy entry="Dummy0005=1"/></dummyUsage>',
    network='<NetworkManagement><CANopenGeneralFeatures granularity="8"/><deviceCommissioning nodeID="5"/></NetworkManagement>',
)


def check(data: bytes) -> DeviceDescription:
    """Read it; whatever it is, what comes of it can be used."""
    description = read_xdd(data, "any.xdd")
    for variable in description.dictionary:
        variable.encode(variable.initial_of(5)) if not variable.adds_node_id else variable.initial_of(5)
        assert description.place_of(variable.index, variable.subindex, "DefaultValue")[0] >= 1
    assert len(description.findings) <= MAX_FINDINGS + 1
    try:
        read_xdd(data, "any.xdd", strict=True)
    except DictionaryError as error:
        assert error.findings[0].severity is Severity.ERROR
        assert error.findings[0] in description.findings
    else:
        assert Severity.ERROR not in {each.severity for each in description.findings}
    return description


@given(st.binary(max_size=200))
def test_any_bytes(data: bytes) -> None:
    assert check(data).findings


@given(st.data())
def test_a_file_that_is_cut_joined_or_changed(data: st.DataObject) -> None:
    content = bytearray(GOOD)
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(content)))
        length = data.draw(st.integers(0, 30))
        content[start : start + length] = data.draw(
            st.sampled_from([b"", b"<", b"/>", b'"', b"&#0;", b"0x", b"\xff", b"$NODEID", b"-1"])
        )
    check(bytes(content))


def test_the_good_one_is_good() -> None:
    description = check(GOOD)
    assert [each.code for each in description.findings] == ["data-type", "access"]
    assert len(description.dictionary) == 3


def test_values_of_all_sorts() -> None:
    source = random.Random(5)
    for _ in range(300):
        code = source.choice(["01", "02", "05", "07", "08", "09", "0A", "0B", "0C", "0D", "0F", "11", "15", "1B", "20", "xx"])
        text = "".join(source.choices("0123456789abcdefx+-. $NODEID", k=source.randrange(12)))
        check(xdd(var(f'dataType="{code}" accessType="rw" defaultValue="{text}" highLimit="{text}" actualValue="{text}"')))


LAUGHS = (
    b"""<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY lol "lol">%s]><ISO15745ProfileContainer>&lol9;</ISO15745ProfileContainer>"""
)
ENTITIES = b"".join(
    b'<!ENTITY lol%d "%s">' % (n, b"&lol%s;" % (str(n - 1).encode() if n > 1 else b"") * 10) for n in range(1, 10)
)


@pytest.mark.parametrize(
    "data",
    [
        LAUGHS % ENTITIES,
        b'<!DOCTYPE a [<!ENTITY x "' + b"x" * 100_000 + b'">]><a>' + b"&x;" * 50_000 + b"</a>",
        b'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><a>&x;</a>',
        b'<!DOCTYPE a SYSTEM "http://localhost/a.dtd"><a/>',
        b'<!DOCTYPE a [<!ATTLIST a b CDATA "c">]><a/>',
    ],
    ids=["laughs", "quadratic", "external", "dtd", "attributes"],
)
def test_no_document_type(data: bytes) -> None:
    tracemalloc.start()
    description = check(data)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert [each.code for each in description.findings] == ["doctype"]
    assert peak < 4_000_000


def test_an_entity_that_nobody_declared() -> None:
    assert [each.code for each in check(b"<a>&x;</a>").findings] == ["not-xdd", "xml"]


def test_bounds_of_the_tree(monkeypatch: pytest.MonkeyPatch) -> None:
    assert [each.code for each in check(b"<a>" * 100_000).findings] == ["not-xdd", "too-deep"]
    many = b"<a " + b" ".join(b'x%d=""' % n for n in range(100)) + b"/>"
    assert [each.code for each in check(many).findings] == ["too-many"]
    monkeypatch.setattr(elements, "MAX_ELEMENTS", 10)
    assert [each.code for each in check(b"<a>" + b"<b/>" * 11 + b"</a>").findings] == ["not-xdd", "too-many"]


def test_a_file_that_is_too_large() -> None:
    description = check(b" " * (MAX_FILE_SIZE + 1))
    assert [each.code for each in description.findings] == ["too-large"]


def test_bounds_of_objects_and_findings(monkeypatch: pytest.MonkeyPatch) -> None:
    many = "".join(var('dataType="0005" accessType="ro"', f"{0x2000 + n:04X}") for n in range(20))
    monkeypatch.setattr(reader, "MAX_OBJECTS", 10)
    description = read(many)
    assert len(description.dictionary) == 10
    assert told(description) == ["14:1 error too-many"]
    monkeypatch.setattr(ini, "MAX_FINDINGS", 5)
    description = read(many.replace('accessType="ro"', ""))
    assert len(description.findings) == 6
    assert description.findings[-1].severity is Severity.ERROR
    assert "6 more" in description.findings[-1].message


def test_what_many_share_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    read_values: list[str] = []
    read_value = reader.value_of

    def counted(text: str, *others: object, **named: object) -> object:
        read_values.append(text)
        return read_value(text, *others, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(reader, "value_of", counted)
    shared = "".join(var('uniqueIDRef="P"', f"{0x2000 + n:04X}", f"n{n}") for n in range(3000))
    values = "".join(f'<value value="{n}"><label>v{n}</label></value>' for n in range(300))
    big = "00" * 100_000
    for kind, default in (("UINT", "7"), ("BITSTRING", big)):
        process = (
            f'<parameterList><parameter uniqueID="P"><{kind}/><defaultValue value="{default}"/>'
            f"<allowedValues>{values}</allowedValues></parameter></parameterList>"
        )
        assert len(read(shared, process).dictionary) == 3000
    assert len(read_values) == 1 + 256 + 1


def test_types_that_branch_without_end() -> None:
    declared = '<varDeclaration><dataTypeIDRef uniqueIDRef="{}"/></varDeclaration>'
    types = "".join(f'<struct uniqueID="T{n}">{declared.format(f"T{(n + 1) % 40}") * 255}</struct>' for n in range(40))
    process = (
        f'<dataTypeList>{types}</dataTypeList><parameterList><parameter uniqueID="P"><dataTypeIDRef uniqueIDRef="T0"/>'
        "</parameter></parameterList>"
    )
    description = read(var('uniqueIDRef="P"'), process)
    assert len(description.findings) < 300
    chain = "".join(f'<parameter uniqueID="P{n}" templateIDRef="P{n + 1}"/>' for n in range(5000))
    assert read(var('uniqueIDRef="P0"'), f"<parameterList>{chain}</parameterList>").findings


def test_many_dynamic_channels() -> None:
    channel = '<dynamicChannel dataType="0005" accessType="readOnly" startIndex="A000" endIndex="A03F"/>'
    description = read(layers=f"<dynamicChannels>{channel * 1100}</dynamicChannels>")
    assert len(description.dynamic_channels) == 1024
    assert [each.code for each in description.findings] == ["too-many"]


@pytest.mark.parametrize(
    ("encoding", "declared", "read_as"),
    [
        ("utf-8", "utf-8", "utf-8"),
        ("utf-8-sig", "utf-8", "utf-8-sig"),
        ("utf-16", "utf-16", "utf-16"),
        ("utf-16-le", "utf-16", "utf-16-le"),
        ("utf-16-be", "utf-16", "utf-16-be"),
        ("latin-1", "ISO-8859-1", "latin-1"),
        ("cp1252", "windows-1252", "cp1252"),
    ],
)
def test_encodings(encoding: str, declared: str, read_as: str) -> None:
    text = xdd(var('dataType="0005" accessType="ro"', name="größe")).decode().replace('"utf-8"', f'"{declared}"')
    description = read_xdd(text.encode(encoding))
    assert not description.findings
    assert description.encoding == read_as
    assert "größe" in description.dictionary
    assert description.place_of(0x2000, 0, "AccessType") == (4, 85)


@pytest.mark.parametrize(("extra", "read_as"), [(b"", "cp1252"), (b"\x81", "latin-1")])
def test_a_file_that_is_not_in_the_encoding_that_it_says(extra: bytes, read_as: str) -> None:
    data = xdd(var('dataType="0005" accessType="ro"', name="größe")).decode().encode("cp1252") + b"<!-- %s -->" % extra
    description = check(data)
    assert told(description) == ["4:37 warning encoding"]
    assert description.encoding == read_as
    assert "größe" in description.dictionary


def test_an_encoding_that_nobody_knows() -> None:
    description = check(GOOD.replace(b'"utf-8"', b'"zlib_codec"'))
    assert description.findings[0].code == "encoding"
    assert len(description.dictionary) == 3


def test_a_file_that_breaks_off() -> None:
    data = xdd(var('dataType="0005" accessType="ro"') + var('dataType="0005" accessType="ro"', "2001"))
    description = check(data[: data.index(b'index="2001"')])
    assert [each.code for each in description.findings] == ["xml"]
    assert list(description.dictionary.objects) == [0x2000]


@pytest.mark.parametrize(
    ("data", "codes"),
    [
        (b"", ["xml"]),
        (b"[FileInfo]\r\nFileName=x.eds\r\n", ["xml"]),
        (b"<html/>", ["not-xdd"]),
        (b"<ISO15745ProfileContainer/>", ["no-objects"]),
    ],
)
def test_files_of_another_kind(data: bytes, codes: list[str]) -> None:
    assert [each.code for each in check(data).findings] == codes


def test_a_tag_that_is_too_long_to_look_into() -> None:
    description = check(xdd(var(f'denotation="{"x" * 100_000}" dataType="0005" accessType="zz"')))
    assert told(description) == ["4:1 warning access"]
