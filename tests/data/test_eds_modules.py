"""Modular devices: the objects of connected modules stand in the dictionary, and are written and read again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.checks import check
from canopen_data.configured import with_configured
from canopen_data.description import Commissioning, DeviceDescription, FileKind
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer import write_eds
from canopen_data.findings import Severity
from canopen_data.repair import repair
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import ObjectType
from canopen_proto.multiplexer import mux
from canopen_proto.pdo.mapping import Mapping
from tests.examples import examples

INPUTS = "ParameterName=Inputs\nDataType=5\nAccessType=ro\nPDOMapping=1"
COUPLER = """[2000]
ParameterName=Slots
ObjectType=7
DataType=5
AccessType=ro
PDOMapping=0
"""
OWN = """[6000]
ParameterName=Inputs of the coupler
ObjectType=8
SubNumber={}
[6000sub0]
ParameterName=count
DataType=5
AccessType=ro
DefaultValue={}
PDOMapping=0
"""
OWN_ENTRY = "[6000sub{:x}]\nParameterName=Own {}\nDataType=5\nAccessType=ro\nPDOMapping=1\n"
FIXED = """[M1FixedObjects]
NrOfEntries=2
1=0x6423
2=0x2100
[M1Fixed6423]
ParameterName=Interrupt
ObjectType=7
DataType=1
AccessType=rw
DefaultValue=1
[M1Fixed2100]
ParameterName=Calibration
ObjectType=9
SubNumber=2
[M1Fixed2100sub0]
ParameterName=n
DataType=5
AccessType=const
DefaultValue=1
[M1Fixed2100sub1]
ParameterName=Gain
DataType=4
AccessType=rw
"""


def module(number: int, index: int, *keys: str, describing: str = INPUTS) -> str:
    """A type of module that adds entries to one object."""
    name = f"M{number}SubExt{index:04X}"
    entries = "\n".join(keys)
    listed = f"[M{number}SubExtends]\nNrOfEntries=1\n1=0x{index:04X}"
    return f"[M{number}ModuleInfo]\nProductName=Module {number}\n{listed}\n[{name}]\n{describing}\n{entries}\n"


def device(*parts: str, slots: tuple[int, ...] = ()) -> DeviceDescription:
    connected = "".join(f"{slot}={number}\n" for slot, number in enumerate(slots, 1))
    count = sum(part.count("ModuleInfo]") for part in parts)
    ends = f"[SupportedModules]\nNrOfEntries={count}\n[ConnectedModules]\nNrOfEntries={len(slots)}\n{connected}"
    return read_eds("".join([COUPLER, *parts, ends if slots else ends.partition("[Conn")[0]]))


def entries(description: DeviceDescription, index: int) -> list[int]:
    found = description.dictionary.objects.get(index)
    return [] if found is None else [subindex for subindex in found.variables if subindex]


def told(description: DeviceDescription, severity: Severity = Severity.ERROR) -> list[str]:
    return [each.message for each in description.findings if each.severity is severity]


def test_two_modules_with_two_entries_each() -> None:
    found = device(module(1, 0x6000, "Count=2"), slots=(1, 1))
    whole = found.dictionary.objects[0x6000]
    assert (whole.name, whole.object_type, whole.data_type) == ("Inputs", ObjectType.ARRAY, DataType.UNSIGNED8)
    assert [each.name for each in whole.variables.values()][1:] == ["Inputs 1", "Inputs 2", "Inputs 3", "Inputs 4"]
    assert found.dictionary.variable((0x6000, 0)).default == 4
    assert found.dictionary.variable((0x6000, 4)).pdo_mappable
    assert Mapping.from_parameters([0x60000308], found.dictionary).muxes == (mux(0x6000, 3),)
    assert not told(found)
    assert "list-missing" not in [each.code for each in check(found) if "6000" in each.message]


@given(
    st.lists(st.tuples(st.integers(1, 5), st.booleans()), min_size=1, max_size=3),
    st.lists(st.integers(0, 3), max_size=10),
    st.integers(0, 9),
    st.integers(0, 1) | st.integers(4, 254),
)
@examples(300)
def test_the_entries_of_modules_are_those_of_an_oracle(
    kinds: list[tuple[int, bool]], wanted: list[int], own: int, last: int
) -> None:
    """The oracle writes down one subindex after the other, as a person would."""
    last = 0 if last <= own else last
    slots = [min(each, len(kinds)) for each in wanted]
    texts = [
        module(n, 0x6000, f"Count={f'0;{size}' if bits else size}", f"ObjExtend={last}")
        for n, (size, bits) in enumerate(kinds, 1)
    ]
    base = OWN.format(own + 1, own) + "".join(OWN_ENTRY.format(each, each) for each in range(1, own + 1))
    expected, free = [(0x6000, each) for each in range(1, own + 1)], 0
    for slot in slots:
        size, bits = kinds[slot - 1] if slot else (0, False)
        if slot and bits and free >= size:
            free -= size
            continue
        free = 8 - size if bits and slot else free if not slot else 0
        for _ in range(1 if bits else size):
            index, subindex = expected[-1] if expected else (0x6000, 0)
            expected.append((index + 1, 1) if last and subindex >= last else (index, subindex + 1))
    # the file is of a tool that knows the coupler only: each slot is named by the caller
    text = device(base, *texts).document.text  # type: ignore[union-attr]
    found = read_eds(text, connected=tuple(slots))
    present = [(index, each) for index in range(0x6000, 0x6040) for each in entries(found, index)]
    assert present == expected
    if not slots:
        return
    written = write_eds(with_configured(found, {}, Commissioning(5)))
    again = read_eds(written)
    assert [(index, each) for index in range(0x6000, 0x6040) for each in entries(again, index)] == expected
    assert again.connected_modules == tuple(slots)
    assert write_eds(again) == written


def test_fixed_objects_come_once() -> None:
    text = FIXED + module(1, 0x6000, "Count=1")
    assert 0x6423 not in device(text).dictionary.objects
    found = device(text, slots=(1, 0, 1))
    assert (found.dictionary.variable(0x6423).default, found.dictionary.variable((0x2100, 1)).name) == (True, "Gain")
    assert found.dictionary.objects[0x2100].object_type is ObjectType.RECORD
    assert entries(found, 0x6000) == [1, 2]
    assert not told(found)
    configured = with_configured(found, {mux(0x2100, 1): 7, mux(0x6423): False}, Commissioning(9))
    again = read_eds(write_eds(configured))
    assert again.dictionary.variable((0x2100, 1)).configured == 7
    assert again.dictionary.variable(0x6423).configured is False
    assert entries(again, 0x6000) == [1, 2]
    assert not told(again)


def test_nothing_is_connected_and_that_is_said() -> None:
    found = device(module(1, 0x6000, "Count=1"))
    assert entries(found, 0x6000) == []
    assert told(found, Severity.NOTICE) == [
        "in [SupportedModules]: 1 types of modules, and no [ConnectedModules]: objects of modules are not in the dictionary"
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (module(1, 0x6000), "Count is missing; the module's entries of [6000] are missing"),
        (module(1, 0x6000, "Count=x"), "Count=x is neither a number of entries nor 0;bits"),
        (module(1, 0x6000, "Count=2;4"), "Count=2;4 is neither a number of entries nor 0;bits"),
        (module(1, 0x6000, "Count=0;9"), "Count=0;9: a UNSIGNED8 does not have so many bits"),
        (module(1, 0x6000, "Count=1", "ObjExtend=255"), "ObjExtend=255 is not 0..254"),
        (module(1, 0x6000, "Count=1", "ObjectType=9"), "ObjectType=9: only a VAR can be added as an entry"),
        (module(1, 0x6000, "Count=255"), "there is no subindex left in [6000]"),
        (module(1, 0x2000, "Count=1"), "[2000] is a VAR: modules cannot add entries to it"),
        (module(2, 0x6000, "Count=1"), "slot 1 holds module 1, which the file does not describe"),
    ],
)
def test_what_cannot_be_made_is_said(text: str, message: str) -> None:
    found = device(text, slots=(1,))
    assert len(told(found)) == 1
    assert message in told(found)[0]
    assert len([each for each in found.findings if each.code == "modules"]) == 1


def test_a_file_that_has_the_entries_already_keeps_them() -> None:
    base = OWN.format(3, 2) + OWN_ENTRY.format(1, 1) + OWN_ENTRY.format(2, 2)
    found = device(base, module(1, 0x6000, "Count=1"), slots=(1, 1))
    assert entries(found, 0x6000) == [1, 2]
    assert told(found, Severity.NOTICE)[-1].endswith(
        "[6000] has 2 entries already: those of its modules are taken to be among them"
    )


def test_no_list_is_made_to_name_what_a_module_adds() -> None:
    found = device(module(1, 0x6000, "Count=2"), slots=(1,))
    repaired = read_eds(repair(found).text)
    assert (repaired.optional, repaired.manufacturer, entries(repaired, 0x6000)) == ((), (0x2000,), [1, 2])


def test_a_small_file_does_not_make_a_million_entries() -> None:
    text = "\n".join(f"{slot}=1" for slot in range(1, 600))
    found = read_eds(f"{module(1, 0x2000, 'Count=254', 'ObjExtend=254')}[ConnectedModules]\nNrOfEntries=599\n{text}\n")
    assert sum(len(each.variables) for each in found.dictionary.objects.values()) < 110_000
    assert any("compact forms stand for more" in each for each in told(found))


def test_an_eds_of_a_dcf_with_modules_has_their_objects_as_its_own() -> None:
    """Without [ConnectedModules] nothing else would make them: the writer reads what it has written, and sees that."""
    connected = device(module(1, 0x6000, "Count=2"), slots=(1, 1))
    dcf = read_eds(write_eds(with_configured(connected, {}, Commissioning(5))))
    again = read_eds(write_eds(dcf, FileKind.EDS))
    assert again.connected_modules == ()
    assert entries(again, 0x6000) == [1, 2, 3, 4]
