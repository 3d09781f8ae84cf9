"""What users type: node-IDs, times, lists, values; each mistake says what was perhaps meant."""

from __future__ import annotations

import click
import pytest

from canopen_cli.node.objects import read
from canopen_cli.shared.options import Breakdown, Duration, NodeIds, Seconds, Settings, node_id_of
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.values import as_json, hex_text, parse_value, value_text
from canopen_data import load_dictionary
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import ConstantNotFoundError, Object, ObjectDictionary, Variable


@pytest.mark.parametrize(("text", "node_id"), [("16", 16), ("0x10", 16), ("0X7f", 127), (" 5 ", 5), ("007", 7)])
def test_node_ids_are_decimal_and_hexadecimal_with_0x(text: str, node_id: int) -> None:
    assert node_id_of(text) == node_id


@pytest.mark.parametrize(
    ("text", "failed", "hint"),
    [
        ("200", "node-ID 200 is outside 1..127", ""),
        ("0", "node-ID 0 is outside 1..127", ""),
        ("0x80", "node-ID 0x80 is outside 1..127", ""),
        ("128", "outside 1..127", ""),
        ("1a", "'1a' is not a node-ID", "0x1a"),
        ("axis1", "'axis1' is not a node-ID", ""),
    ],
)
def test_impossible_node_ids(text: str, failed: str, hint: str) -> None:
    with pytest.raises(CommandError) as caught:
        node_id_of(text)
    assert (caught.value.exit_code, caught.value.code) == (ExitCode.USAGE, "CO120")
    assert failed in caught.value.failed
    assert hint in " ".join(caught.value.tries)


@pytest.mark.parametrize(("text", "ids"), [("3-5", (3, 4, 5)), ("1,0x10", (1, 16)), ("3,3-4", (3, 4))])
def test_lists_of_node_ids(text: str, ids: tuple[int, ...]) -> None:
    assert NodeIds().convert(text, None, None) == ids
    assert NodeIds().convert(ids, None, None) == ids


@pytest.mark.parametrize("text", ["1-200", "0-5", "1,axis"])
def test_a_list_with_an_impossible_node_id_is_no_reason_for_a_scan(text: str) -> None:
    with pytest.raises(CommandError) as caught:
        NodeIds().convert(text, None, None)
    assert caught.value.tries[0] == "1-127    (all node-IDs)"


def test_a_list_that_runs_backwards() -> None:
    with pytest.raises(CommandError, match="runs backwards") as caught:
        NodeIds().convert("8-3", None, None)
    assert caught.value.tries == ("3-8",)


@pytest.mark.parametrize(
    ("text", "ns"), [("500ms", 500_000_000), ("2s", 2 * 10**9), (".5s", 5 * 10**8), ("1500us", 1_500_000), ("1min", 60 * 10**9)]
)
def test_times(text: str, ns: int) -> None:
    assert Duration().convert(text, None, None) == ns
    assert Duration().convert(ns, None, None) == ns


@pytest.mark.parametrize("text", ["", "fast", "-1s", "5 hours", "0", "1us", "99999999s"])
def test_what_is_no_time(text: str) -> None:
    with pytest.raises(click.BadParameter):
        Duration().convert(text, None, None)


@pytest.mark.parametrize("text", ["4", "0.5", "10"])
def test_a_time_without_its_unit_is_not_guessed(text: str) -> None:
    with pytest.raises(click.BadParameter, match=f"'{text}' has no unit: {text}ms or {text}s"):
        Duration().convert(text, None, None)
    assert Duration(0).convert("0", None, None) == 0


def test_a_number_alone_is_seconds_for_a_timeout_as_for_how_long() -> None:
    """`--timeout 5` was refused, and `--for 5` was not."""
    assert Duration(is_seconds=True).convert("5", None, None) == 5 * 10**9
    assert Duration(is_seconds=True).convert("500ms", None, None) == 5 * 10**8
    assert Seconds().convert("5", None, None) == 5.0
    (timeout,) = [each for each in read.params if each.name == "timeout"]
    assert timeout.type.convert("5", None, None) == 5 * 10**9


def test_a_fault_is_a_node_and_a_time() -> None:
    assert Breakdown().convert("5@2.5", None, None) == (5, 2.5)
    assert Breakdown().convert((5, 2.5), None, None) == (5, 2.5)
    for text in ("5", "5@", "5@soon", "5@-1", "5@nan"):
        with pytest.raises(click.BadParameter):
            Breakdown().convert(text, None, None)


def test_a_bus_has_to_be_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CANOPEN_BUS", raising=False)
    with pytest.raises(CommandError) as caught:
        Settings().required_bus()
    assert caught.value.exit_code is ExitCode.USAGE
    assert any("-b demo" in each for each in caught.value.tries)
    monkeypatch.setenv("CANOPEN_BUS", "can0")
    assert Settings().required_bus() == "can0"
    assert Settings(bus="demo").required_bus() == "demo"


# ---- values ----


def variable(data_type: DataType) -> Variable:
    return Variable(0x2000, 0, "thing", data_type)


def dictionary_of(data_type: DataType) -> ObjectDictionary:
    return ObjectDictionary([Object.of("thing", [variable(data_type)])])


@pytest.mark.parametrize(
    ("data_type", "text", "value"),
    [
        (DataType.UNSIGNED16, "12", 12),
        (DataType.UNSIGNED16, "0x0C", 12),
        (DataType.UNSIGNED16, "007", 7),
        (DataType.INTEGER8, "-5", -5),
        (DataType.REAL32, "1.5", 1.5),
        (DataType.BOOLEAN, "true", True),
        (DataType.BOOLEAN, "off", False),
        (DataType.VISIBLE_STRING, "12", "12"),
        (DataType.OCTET_STRING, "01ff", b"\x01\xff"),
        (DataType.DOMAIN, "0x01", b"\x01"),
    ],
)
def test_values_are_read_by_the_type_of_the_object(data_type: DataType, text: str, value: object) -> None:
    assert parse_value(dictionary_of(data_type), variable(data_type), text) == value


def test_constants_by_name() -> None:
    dictionary, _ = load_dictionary()
    controlword = dictionary.variable("controlword")
    assert parse_value(dictionary, controlword, "sm_shutdown") == 6
    with pytest.raises(ConstantNotFoundError, match="sm_shutdown"):
        parse_value(dictionary, controlword, "sm_shutdwn")


@pytest.mark.parametrize("data_type", [DataType.OCTET_STRING, DataType.TIME_OF_DAY])
def test_what_cannot_be_meant(data_type: DataType) -> None:
    with pytest.raises(CommandError) as caught:
        parse_value(dictionary_of(data_type), variable(data_type), "xyz")
    assert caught.value.code == "CO304"


def test_values_as_text() -> None:
    assert value_text(variable(DataType.UNSIGNED16), 592) == "592"
    assert value_text(variable(DataType.VISIBLE_STRING), "drive") == "'drive'"
    assert value_text(variable(DataType.OCTET_STRING), b"\x01\xff") == "01 ff"
    assert value_text(variable(DataType.DOMAIN), bytes(1000)).endswith("(1000 bytes)")
    assert hex_text(variable(DataType.UNSIGNED16), 592) == "0x0250"
    assert hex_text(variable(DataType.INTEGER8), -1) == "0xFF"
    assert hex_text(variable(DataType.REAL32), 1.5) == ""
    assert hex_text(variable(DataType.BOOLEAN), True) == ""
    assert as_json(variable(DataType.DOMAIN), b"\x01") == "01"
    assert as_json(variable(DataType.UNSIGNED8), 5) == 5
    assert as_json(variable(DataType.REAL32), 1.5) == 1.5


@pytest.mark.parametrize(
    ("text", "shown", "octets"),
    [
        ("plain", "'plain'", ""),
        ("\xc3\xbc", "'ü'", "C3 BC"),  # two devices that say the same to people, and are not the same
        ("\xfc", "'ü'", "FC"),
        ("\x1b[31m", "'\\x1b[31m'", "1B 5B 33 31 6D"),
    ],
)
def test_texts_of_devices_are_shown_for_people_and_what_is_not_clean_as_bytes(text: str, shown: str, octets: str) -> None:
    own = variable(DataType.VISIBLE_STRING)
    assert value_text(own, text) == shown
    assert hex_text(own, text) == octets
    assert own.encode(text) == (bytes.fromhex(octets) or b"plain")
