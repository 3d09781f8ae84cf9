"""What is written and read again is the same: for every description that CiA 306 can say, and for makers' files."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.configured import with_configured
from canopen_proto.dictionary.description import Commissioning, DeviceDescription, FileKind
from canopen_proto.dictionary.eds.reader import read_eds
from canopen_proto.dictionary.eds.writer import encode_eds, text_of, write_eds
from canopen_proto.dictionary.eds.writer_sections import sections_of
from tests.proto.generated_dictionaries import descriptions, values_of
from tests.vendor_files import INI_NAMES, load


def facts(description: DeviceDescription) -> dict[str, Any]:
    """All that counts when two descriptions are compared."""
    names = [each.name for each in fields(description) if each.compare and each.name not in ("dictionary", "source")]
    return {name: getattr(description, name) for name in names} | {"objects": dict(description.dictionary.objects)}


@given(descriptions())
@settings(max_examples=25)
def test_a_generated_description(described: DeviceDescription) -> None:
    written = write_eds(described)
    again = read_eds(written)
    assert facts(again) == facts(described)
    assert write_eds(again) == written


@given(descriptions(FileKind.DCF), descriptions(FileKind.DCF))
@settings(max_examples=15)
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
    return {variable.mux: draw(values_of(variable.data_type)) for variable in chosen}


@given(st.data())
@settings(max_examples=15)
def test_a_dcf_of_a_generated_eds(data: st.DataObject) -> None:
    eds = read_eds(write_eds(data.draw(descriptions(FileKind.EDS))))
    dcf = with_configured(eds, data.draw(_settings_of(eds.dictionary)), Commissioning(node_id=7))
    again = read_eds(write_eds(dcf))
    assert facts(again) == facts(dcf)
    assert facts(read_eds(write_eds(again, FileKind.EDS))) == facts(eds)


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
