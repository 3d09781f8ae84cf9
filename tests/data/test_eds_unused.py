"""Sections that the reader has no use for: each has a finding, whatever it is called."""

from __future__ import annotations

import tracemalloc

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_data.eds import ini
from canopen_data.eds.numbers import NOTHING, read_value
from canopen_data.eds.reader import read_eds
from canopen_data.findings import Severity
from canopen_proto.datatypes import DataType
from tests.examples import examples

OBJECT = "ParameterName=x\nObjectType=7\nDataType=5\nAccessType=rw\nDefaultValue=3\n"
HEAD = f"[1000]\n{OBJECT}"


@examples(150)
@given(st.text(st.characters(codec="ascii", exclude_characters="[]\r\n;#", exclude_categories=["Cc"]), min_size=1, max_size=12))
@example("0x2002")
@example("2002sub1")
@example("2002name")
@example("m1moduleinfo")
def test_a_section_is_read_or_found(name: str) -> None:
    """A section adds an object, or a part of the description that the standard names so, or a finding about itself."""
    plain, described = read_eds(HEAD), read_eds(f"{HEAD}[{name}]\n{OBJECT}")
    has_more = len(described.dictionary) > len(plain.dictionary)
    told = [each for each in described.findings if each.line == 7]
    known = ("fileinfo", "deviceinfo", "dummyusage", "comments", "tools", "devicecomissioning", "devicecommissioning")
    assert has_more or told or name.strip().lower() in known or name.strip().lower().startswith("m1")


@pytest.mark.parametrize(
    "name",
    [
        "0x2002",
        "2002h",
        "02002",
        "2002_",
        "20 02",
        "$2002",
        "2002var",
        "2002sub",
        "Sub2002",
        "2002sub-1",
        "2002subG",
        "2002 sub1",
    ],
)
def test_a_lost_object_is_an_error(name: str) -> None:
    (finding,) = read_eds(f"{HEAD}[{name}]\n{OBJECT}").findings
    assert (finding.severity, finding.code, finding.line) == (Severity.ERROR, "unused-section", 7)
    assert finding.message == f"[{name}] was left out; objects have the names 0001 to FFFF, sub-objects 1018sub1"


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("OptionalObject", "OptionalObjects"),
        ("Mandatory Objects", "MandatoryObjects"),
        ("DeviceInfos", "DeviceInfo"),
        ("Device_Commissioning", "DeviceComissioning"),
        ("DummyUsages", "DummyUsage"),
    ],
)
def test_a_name_like_one_of_the_standard_is_an_error(name: str, meant: str) -> None:
    (finding,) = read_eds(f"{HEAD}[{name}]\nx=1\n").findings
    assert (finding.severity, finding.message) == (Severity.ERROR, f"[{name}] was left out; is [{meant}] meant?")


def test_a_makers_own_section_is_a_notice_and_a_list_without_its_array_an_error() -> None:
    (own,) = read_eds(f"{HEAD}[Acme settings]\nx=1\n").findings
    assert (own.severity, own.message) == (Severity.NOTICE, "[Acme settings] is not a section of CiA 306, and was left out")
    (lone,) = read_eds(f"{HEAD}[1000Name]\nNrOfEntries=1\n1=x\n").findings
    assert lone.message == "[1000Name] was left out; a list of names is for a CompactSubObj, and [1000] has none"
    for used in ("Tools", "Tool1", "1F50ObjectLinks", "M1ModuleInfo", "M2Fixed6000sub1", "40", "40sub1"):
        text = f"{HEAD}[2000]\nParameterName=x\nDataType=0x40\nAccessType=ro\n[{used}]\n"
        assert not [each for each in read_eds(text).findings if each.code == "unused-section"]


# ---- values ----


@pytest.mark.parametrize("text", ["0", "0x0", "0x00"])
def test_the_default_of_a_domain_that_tools_write_is_none(text: str) -> None:
    assert read_value(text, DataType.DOMAIN) == NOTHING
    assert read_value("00", DataType.DOMAIN)[0] == b"\0"


def test_a_long_octet_string_takes_no_more_memory_than_a_few_times_its_text() -> None:
    text = "A5 " * 400_000
    tracemalloc.start()
    value, _, remark, _ = read_value(text, DataType.OCTET_STRING)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (value, remark) == (b"\xa5" * 400_000, "")
    assert peak < 4 * len(text)


def test_a_device_without_a_node_id_is_no_fault() -> None:
    dcf = f"{HEAD}[DeviceComissioning]\nNodeID=0xFF\nBaudrate=500\n"
    description = read_eds(dcf)
    assert description.commissioning is not None
    assert description.commissioning.node_id is None
    (finding,) = description.findings
    assert (finding.severity, finding.message) == (
        Severity.NOTICE, "in [DeviceComissioning]: NodeID=0xFF: the device has no node-ID yet (LSS); left out"
    )  # fmt: skip


# ---- settings that are lost ----

SETTING = "[2000]\nParameterName=x\nObjectType=7\nDataType=5\nAccessType=rw\n"
ARRAY = SETTING.replace("ObjectType=7", "ObjectType=8") + "CompactSubObj=2\n"


@pytest.mark.parametrize(
    "text",
    [
        f"{SETTING}ParameterValue=300\n",
        f"{SETTING}_ParameterBytes=01 02\n",
        f"{ARRAY}[2000Value]\nNrOfEntries=1\n1=300\n",
        f"{ARRAY}[2000Value]\nNrOfEntries=1\n3=30\n",
        f"{SETTING}[2000Value]\nNrOfEntries=1\n1=30\n",
    ],
)
def test_a_configured_value_that_is_not_in_the_dictionary_is_a_lost_setting(text: str) -> None:
    description = read_eds(text)
    assert not [each for each in description.dictionary if each.configured is not None]
    assert [each.severity for each in description.lost_settings] == [Severity.ERROR]


@pytest.mark.parametrize(
    "text",
    [
        f"{SETTING}DefaultValue=300\nLowLimit=-300\nParameterValue=5\n",
        f"{SETTING}ParameterValue=5\n_ParameterBytes=06\n",
        f"{SETTING}ParameterValue=\n",
        f"{ARRAY}[2000Value]\nNrOfEntries=1\n3=\n2=5\n",
        f"{ARRAY}[2000sub1]\nParameterName=x\nDataType=5\nAccessType=rw\nParameterValue=5\n[2000Value]\n1=6\n",
    ],
)
def test_other_faults_lose_no_setting(text: str) -> None:
    assert read_eds(text).lost_settings == ()


def test_a_file_that_is_not_read_to_its_end_loses_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ini, "MAX_SECTIONS", 1)
    (lost,) = read_eds(SETTING + SETTING.replace("2000", "2001")).lost_settings
    assert lost.code == "too-long"
