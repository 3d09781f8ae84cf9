"""Side files: what they add to a dictionary, and what is said of wrong ones."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.findings import DictionaryError, Severity
from canopen_data.overlay import lay_over, lay_tables_over
from canopen_data.toml_file import MAX_TEXT
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Constant, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.cia402.names import is_drive, with_drive_names
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from tests.examples import examples

DICTIONARY = ObjectDictionary(
    [
        standard_object(0x1000, 0x00020192),
        standard_object(0x6041),
        standard_object(0x6060),
        standard_object(0x6064),
        Object.of("text", [Variable(0x2000, 0, "text", DataType.VISIBLE_STRING)]),
        Object.of("pair", [Variable(0x2001, 1, "a", DataType.UNSIGNED8), Variable(0x2001, 2, "b", DataType.BOOLEAN)]),
        Object.of("real", [Variable(0x2002, 0, "real", DataType.REAL32)]),
    ],
    constants={0x604100: [Constant("moving", 0x8000, 0x8000), Constant("remote", 0x200, 0x200)]},
    source="drive.eds",
)

TEXT = """
[objects.6064]
aliases = ["position", "where"]
unit = "deg"
factor = 0.001
description = "where the axis is"

[objects.6041.bits]
moving = 8
ready = {mask = 0x3000, value = 0x1000}
target = {mask = 0x0400}

[objects."2001:02".values]
off = 0
on = 1

[objects.modes_of_operation.values]
creep = -2
"""


def test_what_a_side_file_adds() -> None:
    dictionary, findings = lay_over(DICTIONARY, TEXT, "units.toml")
    assert findings == []
    position = dictionary.variable("position")
    assert (position.index, position.unit, position.factor, position.description) == (0x6064, "deg", 0.001, "where the axis is")
    assert dictionary.variable("where") == dictionary.variable("position_actual_value") == position
    assert dictionary.constants_of(0x6041) == (
        Constant("moving", 0x100, 0x100),  # in place of the one that was there
        Constant("ready", 0x3000, 0x1000),
        Constant("target", 0x400, 0x400),
        Constant("remote", 0x200, 0x200),
    )
    assert dictionary.names_of((0x2001, 2), 1) == ("on",)
    assert dictionary.constant_value(0x6060, "creep") == -2
    assert dictionary.names_of(0x6060, -2) == ("creep",)
    assert dictionary.source == "drive.eds"
    assert [variable.mux for variable in dictionary] == [variable.mux for variable in DICTIONARY]
    assert dictionary.variable((0x2001, 1)) == DICTIONARY.variable((0x2001, 1))


def test_two_tables_of_one_object_and_two_side_files() -> None:
    text = '[objects.6064]\nunit = "deg"\n[objects.position_actual_value]\naliases = ["position"]\n'
    dictionary, _ = lay_over(DICTIONARY, text)
    dictionary, _ = lay_over(dictionary, '[objects.position]\nfactor = 2\naliases = ["position", "x"]\n')
    position = dictionary.variable("x")
    assert (position.unit, position.factor, position.aliases) == (
        "deg",
        2.0,
        (*DICTIONARY.variable(0x6064).aliases, "position", "x"),
    )


def test_an_object_that_the_dictionary_lacks_is_a_warning() -> None:
    dictionary, findings = lay_over(DICTIONARY, '[objects.statusword]\nunit = "x"\n[objects.statuswort]\nunit = "x"\n', "u.toml")
    assert [(each.severity, each.source) for each in findings] == [(Severity.WARNING, "u.toml")]
    assert "objects.statuswort: object 'statuswort' is not in the dictionary (drive.eds); did you mean statusword" in str(
        findings[0]
    )
    assert dictionary.variable(0x6041).unit == "x"


def test_an_empty_side_file_changes_nothing() -> None:
    dictionary, findings = lay_over(DICTIONARY, "")
    assert list(dictionary) == list(DICTIONARY)
    assert findings == []


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("[objects\n", "1:9: error: Expected ']' at the end of a table declaration"),
        ("a = 1\nb = \n", "2:5: error: Invalid value"),
        ('a = 1\nb = "', "2:1: error: Unterminated string"),
    ],
)
def test_a_text_that_is_no_toml(text: str, error: str) -> None:
    with pytest.raises(DictionaryError) as caught:
        lay_over(DICTIONARY, text, "u.toml")
    assert caught.value.failed == f"u.toml:{error} [toml]"


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("[object.6041]\n", "object: there is no such table; did you mean objects?"),
        ("objects = 5\n", "objects: a table is expected, not 5"),
        ("[objects]\n6041 = 5\n", "objects.6041: a table is expected, not 5"),
        ("[objects.6064]\nunti = 5\n", "objects.6064.unti: there is no such entry; did you mean unit?"),
        ("[objects.6064]\nunit = 5\n", "objects.6064.unit: a text is expected, not 5"),
        ("[objects.6064]\nfactor = 0\n", "objects.6064.factor: a number other than 0 is expected, not 0"),
        ("[objects.6064]\nfactor = nan\n", "objects.6064.factor: a number other than 0 is expected, not nan"),
        (
            "[objects.2000]\nfactor = 1\n",
            "objects.2000.factor: a factor is for numbers (text (0x2000:00) is VISIBLE_STRING), not 1",
        ),
        ("[objects.6064]\naliases = 'a'\n", "objects.6064.aliases: a list of names is expected, not 'a'"),
        ("[objects.6064]\naliases = [' ']\n", "objects.6064.aliases: a list of names is expected, not [' ']"),
        ("[objects.6064]\naliases = ['StatusWord']\n", "objects.6064.aliases: 'StatusWord' means statusword (0x6041:00) already"),
        (
            "[objects.2002.bits]\na = 1\n",
            "objects.2002: names of values and bits are for integers, and real (0x2002:00) is REAL32",
        ),
        ("[objects.6041.values]\n'a b' = 65536\n", "objects.6041.values.'a b': a number of 16 bits is expected, not 65536"),
        ("[objects.6041]\nbits = 1\n", "objects.6041.bits: a table is expected, not 1"),
    ],
)
def test_what_is_wrong_is_named(text: str, error: str) -> None:
    with pytest.raises(DictionaryError) as caught:
        lay_over(DICTIONARY, text, "u.toml")
    assert caught.value.failed == f"u.toml: error: {error} [overlay]"


@pytest.mark.parametrize("value", ["16", "-1", "true", "'x'", "{mask = 0}", "{mask = 1, value = 2}", "{mask = 1, x = 2}", "{}"])
def test_bits_that_cannot_be(value: str) -> None:
    with pytest.raises(DictionaryError, match=r"bits\.a: a bit number of 0\.\.15 or \{mask = "):
        lay_over(DICTIONARY, f"[objects.6041.bits]\na = {value}\n")


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 100_000, "a = " + "9" * 10_000, "#" * (MAX_TEXT + 1), "a = 1" + "0" * 400 + ".0e9"]
)
def test_hostile_texts(text: str) -> None:
    with pytest.raises(DictionaryError):
        lay_over(DICTIONARY, text)


@pytest.mark.parametrize(
    ("odd", "told"),
    [
        ("[" * 100_000, "arrays or tables are nested too deep"),
        ("[1,\n[" + "{a = [" * 5_000, "arrays or tables are nested too deep"),
        ("9" * 10_000, "Exceeds the limit"),
        ("1e-400", "1e-400 is too small"),
        ("[\n1e400\n]", "1e400 is too large"),
    ],
)
@pytest.mark.parametrize("behind", ["", "\n[objects.6042]\nunit = 'x'\n", "\n???\n"])
def test_what_tomllib_tells_without_a_place_has_its_line(odd: str, told: str, behind: str) -> None:
    with pytest.raises(DictionaryError) as caught:
        lay_over(DICTIONARY, f"# 1e-400\n[objects.6041]\nfactor = {odd}{behind}", source="u.toml")
    line = 3 + odd.count("\n", 0, odd.find("1e400") if "1e400" in odd else None)
    assert caught.value.failed.startswith(f"u.toml:{line}:1: error: {told}")


def test_all_errors_in_one_pass() -> None:
    with pytest.raises(DictionaryError) as caught:
        lay_over(
            DICTIONARY,
            "x = 1\n[objects.6041]\nunit = 1\nfactor = 1" + "0" * 400 + "\n[objects.6041.bits]\na = 99\n[objects.9999]\n",
        )
    assert len(caught.value.findings) == 4


VALUES = st.recursive(
    st.one_of(st.integers(), st.floats(), st.booleans(), st.text(max_size=5), st.just("deg")),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner, max_size=3)),
    max_leaves=4,
)
ENTRIES = st.dictionaries(
    st.sampled_from(["aliases", "unit", "factor", "description", "values", "bits", "x"]),
    st.one_of(VALUES, st.dictionaries(st.text(max_size=5), st.one_of(VALUES, st.fixed_dictionaries({"mask": VALUES})))),
)
OBJECTS = st.dictionaries(st.one_of(st.sampled_from(["6041", "6064", "2001:01", "text"]), st.text(max_size=9)), ENTRIES)


@examples(40)
@given(st.one_of(OBJECTS.map(lambda objects: {"objects": objects}), st.dictionaries(st.text(max_size=5), VALUES)))
def test_any_tables_are_a_dictionary_or_findings(tables: dict[str, Any]) -> None:
    try:
        dictionary, findings = lay_tables_over(DICTIONARY, tables)
    except DictionaryError as error:
        assert all(str(each) for each in error.findings)
    else:
        assert all(each.severity is Severity.WARNING for each in findings)
        assert len(dictionary) == len(DICTIONARY)


@given(st.text(max_size=40))
def test_any_text_is_a_dictionary_or_findings(text: str) -> None:
    try:
        lay_over(DICTIONARY, text)
    except DictionaryError as error:
        assert str(error)


# ---- the words of CiA 402


def test_a_drive_has_names_without_any_side_file() -> None:
    dictionary = with_drive_names(drive_dictionary())
    assert dictionary.names_of(0x6041, 0x0637) == ("operation_enable", "voltage_enabled", "remote", "target_reached")
    assert dictionary.names_of(0x6061, 6) == ("homing_mode", "hm")
    assert dictionary.constant_value(0x6060, "csp") == 8
    assert dictionary.constant_value(0x6040, "sm_shutdown") == 6
    assert dictionary.names_of(0x6040, 0x80) == ("fault_reset",)


def test_names_that_are_there_stay() -> None:
    dictionary = with_drive_names(DICTIONARY)
    assert dictionary.constant(0x6041, "moving").mask == 0x8000
    assert [each.name for each in dictionary.constants_of(0x6041)].count("remote") == 1


def test_further_axes_have_the_same_names() -> None:
    dictionary = with_drive_names(ObjectDictionary([standard_object(index) for index in (0x6040, 0x6041, 0x6841)]))
    assert dictionary.names_of(0x6841, 0x40) == ("switch_on_disabled",)


@pytest.mark.parametrize(
    ("objects", "answer"),
    [
        ([standard_object(0x1000, 0x00420192)], True),
        ([standard_object(0x1000, 0x00020191), standard_object(0x6040), standard_object(0x6041)], False),
        ([standard_object(0x1000, 0), standard_object(0x6040), standard_object(0x6041)], True),
        ([standard_object(0x6040), standard_object(0x6041)], True),
        ([standard_object(0x6041)], False),
        ([Object.of("type", [Variable(0x1000, 0, "type", DataType.VISIBLE_STRING, default="drive")])], False),
        ([], False),
    ],
)
def test_what_is_a_drive(objects: list[Object], answer: bool) -> None:
    dictionary = ObjectDictionary(objects)
    assert is_drive(dictionary) is answer
    assert (with_drive_names(dictionary) is dictionary) is not answer
