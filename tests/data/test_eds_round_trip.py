"""What is written and read again is the same: for every description that CiA 306 can say, and for makers' files."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.configured import with_configured
from canopen_data.description import Commissioning, DeviceDescription, FileKind
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer import encode_eds, text_of, write_eds
from canopen_data.eds.writer_sections import sections_of
from canopen_data.xdd.reader import read_xdd
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_testing.strategies import damaged_texts, device_descriptions, values
from tests.data.test_eds_writer import SAMPLE
from tests.examples import examples
from tests.vendor_files import INI_NAMES, XDD_NAMES, load, needs_vendor_files


def facts(description: DeviceDescription) -> dict[str, Any]:
    """All that counts when two descriptions are compared."""
    names = [each.name for each in fields(description) if each.compare and each.name not in ("dictionary", "source")]
    return {name: getattr(description, name) for name in names} | {"objects": dict(description.dictionary.objects)}


@given(device_descriptions())
@examples(25)
def test_a_generated_description(described: DeviceDescription) -> None:
    written = write_eds(described)
    again = read_eds(written)
    assert facts(again) == facts(described)
    assert write_eds(again) == written


@given(device_descriptions(FileKind.DCF), device_descriptions(FileKind.DCF))
@examples(15)
def test_one_description_in_the_form_of_another(described: DeviceDescription, other: DeviceDescription) -> None:
    """A file that has nothing to do with what it is to say: then everything changes, and nothing is lost."""
    form = read_eds(write_eds(other)).document
    moved = DeviceDescription(
        **{each.name: getattr(described, each.name) for each in fields(described) if each.name != "document"}, document=form
    )
    assert facts(read_eds(write_eds(moved))) == facts(described)


@st.composite
def _settings_of(draw: st.DrawFn, dictionary: ObjectDictionary) -> dict[int, Value]:
    chosen = draw(st.lists(st.sampled_from(list(dictionary)), max_size=4)) if len(dictionary) else []
    return {variable.mux: draw(values(variable.data_type, in_file=True)) for variable in chosen}


@given(st.data())
@examples(15)
def test_a_dcf_of_a_generated_eds(data: st.DataObject) -> None:
    eds = read_eds(write_eds(data.draw(device_descriptions(FileKind.EDS))))
    dcf = with_configured(eds, data.draw(_settings_of(eds.dictionary)), Commissioning(node_id=7))
    again = read_eds(write_eds(dcf))
    assert facts(again) == facts(dcf)
    assert facts(read_eds(write_eds(again, FileKind.EDS))) == facts(eds)


@given(damaged_texts(SAMPLE), st.data())
@examples(40)
def test_a_damaged_file(text: str, data: st.DataObject) -> None:
    """Faults that nobody touched stay; what is set besides is read again."""
    read = read_eds(text)
    assert write_eds(read) == text
    dcf = with_configured(read, data.draw(_settings_of(read.dictionary)), Commissioning(node_id=7))
    assert sections_of(read_eds(write_eds(dcf))) == sections_of(dcf)


@needs_vendor_files
@pytest.mark.parametrize("name", INI_NAMES)
def test_a_makers_file(name: str) -> None:
    data = load(name)
    read = read_eds(data, name)
    assert encode_eds(write_eds(read), read.encoding) == data
    again = facts(read_eds(text_of(sections_of(read)), name))
    expected = facts(read)
    for key in ("mandatory", "optional", "manufacturer"):  # objects that no list of the file names are added
        added = [index for index in again.pop(key) if index not in expected[key]]
        assert all(index in read.dictionary.objects for index in added)
        expected.pop(key)
    assert again == expected


@needs_vendor_files
@pytest.mark.parametrize("name", XDD_NAMES)
def test_a_makers_xdd_as_eds(name: str) -> None:
    read = read_xdd(load(name), name)
    again = read_eds(write_eds(read))
    assert again.kind is FileKind.EDS
    assert not again.findings

    def on_one_line(each: Variable) -> Variable:
        return replace(each, description=" ".join(each.description.split("\n")))

    assert list(again.dictionary) == [on_one_line(each) for each in read.dictionary]
    assert (again.device_info, again.dummies) == (read.device_info, read.dummies)
