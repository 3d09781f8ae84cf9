"""YAML is read as data, with the line of every fault; nothing in it grows, runs or misleads."""

from __future__ import annotations

import builtins
from collections.abc import Mapping
from fractions import Fraction

import pytest

from canopen_data.findings import DictionaryError
from canopen_master.errors import PackageMissingError
from canopen_master.ros_configurations import yaml_text
from canopen_master.ros_configurations.yaml_text import MAX_BYTES, MAX_DEPTH, Value, number_of, read_yaml


def read(text: str) -> Mapping[str, Value]:
    return read_yaml(text.encode(), "a.yaml").entries


def test_values_have_text_place_and_line() -> None:
    found = read('a:\n  - {b: 0x10}\n  - "7"\nc: ~\n')
    inner = found["a"].items[0].entries["b"]
    assert (inner.kind, inner.text, inner.place, inner.line) == ("int", "0x10", "a[0].b", 2)
    assert inner.integer(0, 20) == 16
    assert found["a"].items[1].kind == "str"
    assert found["c"].kind == "null"


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("10", 10), ("-0x7F", -127), ("010", 8), ("0b11", 3), ("1_000", 1000), ("1:30", 90), ("1.5e-3", Fraction(3, 2000)),
        (".5", Fraction(1, 2)), ("+3", 3), ("0.1", Fraction(1, 10)), ("1.", 1), ("0", 0),
        ("x", None), (".inf", None), ("1e9999", None), ("9" * 401, None), ("", None), ("0x", None), ("1:75", None), ("1 2", None),
    ],
)  # fmt: skip
def test_numbers_are_those_of_yaml_1_1_and_exact(text: str, number: Fraction | None) -> None:
    assert number_of(text) == number


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: 1\nb: 2\na: 3\n", "a.yaml:3:1: error: .a: it stands in line 1 already"),
        ("x:\n  a: 1\n  a: 2\n", "a.yaml:3:1: error: x.a: it stands in line 2 already"),
        ("a: &x [1]\nc:\n  <<: *x\n", "a.yaml:1:1: error: c[0]: a map is expected"),
        ("? [1, 2]\n: 3\n", "a key is a map or a list"),
        ("a: &r [*r]\n", f"nested deeper than {MAX_DEPTH} levels, or contains itself"),
        ("a: " + "[" * 60 + "]" * 60, f"the file has more than {MAX_DEPTH} levels"),
        ("[" * 100_000, f"the file has more than {MAX_DEPTH} levels"),
        ("a: [1\nb: 2", "a.yaml:2:1: error: this is no YAML"),
        ("a: *none\n", "a.yaml:1:1: error: this is no YAML: found undefined alias"),
        ("a: 1\n---\nb: 2\n", "this is no YAML"),
        ("- 1\n", "the file: a map is expected, not a list (list)"),
        ("", "the file is empty"),
        ("a: \x01\n", "this is no YAML"),
    ],
)
def test_hostile_and_wrong_files_have_one_clear_error(text: str, said: str) -> None:
    with pytest.raises(DictionaryError) as raised:
        read(text)
    assert said in str(raised.value)


def test_an_alias_counts_as_often_as_it_is_used() -> None:
    assert read("a: &x [1, 2]\nb: *x\n")["b"].place == "b"
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]\n" for level in range(1, 12)
    )
    with pytest.raises(DictionaryError, match="with its aliases the file has more than 30000 values"):
        read(bomb)


def test_too_many_values_are_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_text, "MAX_VALUES", 100)
    assert len(read("a: [" + "x," * 90 + "]")["a"].items) == 90
    with pytest.raises(DictionaryError, match="a.yaml:3:1: error: the file has more than 100 values"):
        read("a:\n - x\n" + " - [" + "x," * 300 + "]")


def test_large_and_undecodable_files_are_not_read() -> None:
    with pytest.raises(DictionaryError, match=f"more than {MAX_BYTES} are not read"):
        read_yaml(b"#" * (MAX_BYTES + 1), "a.yaml")
    with pytest.raises(DictionaryError, match="byte 3 is not UTF-8"):
        read_yaml(b"a: \xff\n", "a.yaml")


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda value: value["text"].integer(0, 5), "text: a number is expected, not x"),
        (lambda value: value["list"].number(), "list: a number is expected, not a list"),
        (lambda value: value["number"].integer(0, 5), "number: a whole number of 0..5 is expected, not 7"),
        (lambda value: value["half"].integer(0, 5), "half: a whole number of 0..5 is expected, not 0.5"),
        (lambda value: value["number"].truth(), "number: a bool is expected, not 7 (int)"),
        (lambda value: value["list"].string(), "list: a text is expected, not a list"),
        (lambda value: value["empty"].string(), "empty: a text is expected, not nothing"),
        (lambda value: value["number"].check("map", "list"), "number: a map or list is expected, not 7 (int)"),
    ],
)
def test_wrong_types_name_key_and_value(call: object, said: str) -> None:
    found = read("text: x\nlist: [1]\nnumber: 7\nhalf: 0.5\nempty:\n")
    with pytest.raises(DictionaryError) as raised:
        call(found)  # type: ignore[operator]
    assert said in str(raised.value)


def test_without_the_package_the_line_to_install_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *arguments: object, **options: object) -> object:
        if name.startswith("ruamel"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(PackageMissingError, match=r"pip install 'canopen-proto\[yaml\]'"):
        read_yaml(b"a: 1", "a.yaml")


@pytest.mark.parametrize(
    ("text", "tag"),
    [
        ("!!python/object/apply:os.system [ls]", "python"),
        ("!degrees 90", "!degrees"),
        ("2020-01-01", "timestamp"),
        ("!!binary aGk=", "binary"),
    ],
)
def test_a_value_with_any_other_tag_is_no_value_and_the_rest_is_read(text: str, tag: str) -> None:
    entries = read_yaml(f"a: {text}\nb: 5\n".encode(), "a.yaml").entries
    assert entries["b"].integer(0, 9) == 5
    for get in (entries["a"].string, entries["a"].number, entries["a"].truth, lambda: entries["a"].check("map", "list", "str")):
        with pytest.raises(DictionaryError, match=rf"a\.yaml:1:1: error: a: a .* is expected, not a value with the tag '.*{tag}"):
            get()
