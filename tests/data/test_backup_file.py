"""A backup as a file: what a device held comes back byte for byte on another one, or the object is named."""

from __future__ import annotations

import struct
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.backup_file import backup_file
from canopen_data.configured import with_configured
from canopen_data.describing import describe
from canopen_data.description import Commissioning
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer import write_eds
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, Value, size_of
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.download_order import settings_of
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.machine import Time
from canopen_proto.manager.parameters.backup import Backup, Reading, ReadResult, back_up, same_value
from canopen_proto.manager.parameters.restore import plan_restore, restore
from tests.examples import examples
from tests.manager.restore_bench import Bench

TYPES = {0x2000 + each: each for each in DataType}
DESCRIBED = ObjectDictionary(
    [standard_object(0x1000, 0x191)]
    + [Object.of(f"of {each.name}", [Variable(index, 0, f"of {each.name}", each)]) for index, each in TYPES.items()]
)

ODD_TEXTS = (
    b"",
    b" ",
    b"name\0\0",
    b" led",
    b"two\r\nlines",
    b"tab\tbed",
    b"\x1b[31m",
    b"M\xfcller",
    "Müller".encode(),
    b"\xff\xfe",
)
ODD_TEXTS += (b";=[x]", b"$NODEID+1", b"\x80\x9d", "設定".encode("cp932"), "\u202e".encode())
REALS = [float("nan"), float("inf"), float("-inf"), -0.0, 5.1]
ODD = {
    DataType.REAL32: [struct.pack("<f", each) for each in REALS] + [b"\x01\0\x80\x7f"],
    DataType.REAL64: [struct.pack("<d", each) for each in REALS],
    DataType.BOOLEAN: [b"\0", b"\1", b"\xff"],
}


def any_bytes(data_type: DataType) -> st.SearchStrategy[bytes]:
    """Whatever a device may answer for an object of that type, a wrong length now and then."""
    size = size_of(data_type)
    if size is None:
        return st.sampled_from(ODD_TEXTS) | st.binary(max_size=12) | st.text(max_size=6).map(lambda text: text.encode("utf-8"))
    return st.binary(min_size=size, max_size=size) | st.sampled_from([*ODD.get(data_type, [bytes(size)]), b""])


def holding(held: dict[int, bytes]) -> Bench:
    """A device whose objects of DESCRIBED are these bytes, whatever their types make of them."""
    bench = Bench(DESCRIBED)
    reads = bench.device.read

    def write(index: int, subindex: int, data: bytes, now: Time) -> None:
        held[index] = bytes(data)

    bench.device.read = lambda index, sub, now: held[index] if index in held else reads(index, sub, now)  # type: ignore[method-assign]
    bench.device.write = write  # type: ignore[method-assign]
    return bench


@examples(30)
@given(st.fixed_dictionaries({index: any_bytes(each) for index, each in TYPES.items()}))
def test_a_backup_restores_every_byte_or_names_the_object(held: dict[int, bytes]) -> None:
    source = holding(dict(held))
    backup = source.run(back_up(source.remote, domains=True))
    file = backup_file(backup, describe(DESCRIBED))
    named = {each.variable.index for each in (*file.lost, *(one for one in backup.readings if one.result.is_missing))}
    description = read_eds(file.data, strict=True)
    fresh = {index: b"\x77" * (size_of(each) or 1) for index, each in TYPES.items()} | {0x2001: b"\0"}
    bench = holding(fresh)
    plan = bench.run(plan_restore(bench.remote, description.dictionary, settings_of(description.dictionary, 5)))
    bench.run(restore(bench.remote, bench.nmt, plan, verify=True))
    assert {index: data for index, data in fresh.items() if index not in named} == {
        index: data for index, data in held.items() if index not in named
    }
    fits = {index for index, each in TYPES.items() if size_of(each) in (None, len(held[index]))}
    exact = {DataType.BOOLEAN, DataType.REAL32, DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE, DataType.UNICODE_STRING}
    assert not {index for index in named & fits if TYPES[index] not in exact}


def test_what_was_not_read_is_marked_and_inherited_from_nowhere() -> None:
    old = with_configured(describe(DESCRIBED), {0x2007_00: 7, 0x2005_00: 5, 0x2006_00: 6}, Commissioning(node_id=5))
    described = read_eds(write_eds(old))
    bench = holding({0x2007: b"\x09\0\0\0", 0x2006: b"\x01"})
    reads = bench.device.read
    bench.device.read = lambda index, sub, now: (  # type: ignore[method-assign]
        AbortCode.DEVICE_STATE if index == 0x2005 else reads(index, sub, now)
    )
    backup = bench.run(back_up(bench.remote))
    assert not backup.is_complete
    made = read_eds(backup_file(backup, described).data, strict=True).dictionary
    assert made.variable(0x2007).configured == 9
    marks = {each.index: each.not_read for each in made if each.not_read}
    assert marks == {0x2005: "refused", 0x2006: "wrong length", 0x200F: "domain"}
    assert not {0x2005_00, 0x2006_00, 0x200F_00} & settings_of(made, 5).keys()
    with_defaults = made.with_objects([Object.of("d", [replace(made.variable(0x2005), default=3)])])
    assert 0x2005_00 not in settings_of(with_defaults, 5, defaults=True)


def test_a_backup_reads_well_whatever_the_encoding_of_the_devices_file_is() -> None:
    """Nothing in a file says that it is Russian; its backup is UTF-8 then."""
    bench = holding({0x2009: "Привод".encode()})
    backup = bench.run(back_up(bench.remote, only=[DESCRIBED.variable(0x2009)]))
    file = backup_file(backup, replace(describe(DESCRIBED), encoding="cp1251"))
    assert file.lost == ()
    assert "ParameterValue=Привод" in file.data.decode("utf-8")


@pytest.mark.parametrize(
    ("data_type", "value", "lines"),
    [
        (DataType.VISIBLE_STRING, "plain text", ["ParameterValue=plain text"]),
        (DataType.VISIBLE_STRING, "", ["_ParameterBytes="]),
        (DataType.VISIBLE_STRING, " a\tb\n", ["ParameterValue=a b", "_ParameterBytes=20 61 09 62 0A"]),
        (DataType.VISIBLE_STRING, "\xc3\xbc\x1b", ["ParameterValue=ü?", "_ParameterBytes=C3 BC 1B"]),
        (DataType.OCTET_STRING, b"", ["_ParameterBytes="]),
        (DataType.OCTET_STRING, b"\x01\x02", ["ParameterValue=01 02"]),
        (DataType.REAL32, float("nan"), ["_ParameterBytes=00 00 C0 7F"]),
        (DataType.REAL32, 1.5, ["ParameterValue=1.5"]),
    ],
)
def test_the_form_of_values_that_a_line_cannot_hold(data_type: DataType, value: Value, lines: list[str]) -> None:
    variable = Variable(0x2000, 0, "own", data_type)
    description = describe(ObjectDictionary([Object.of("own", [variable])]))
    text = write_eds(with_configured(description, {0x2000_00: value}, Commissioning(node_id=5)))
    assert [line for line in text.splitlines() if "Parameter" in line and "Name" not in line] == lines
    read = read_eds(text)
    assert read.findings == ()
    assert same_value(variable, read.dictionary.variable(0x2000).configured, value)
    assert write_eds(read) == text


@pytest.mark.parametrize(
    ("octets", "text", "value", "finding"),
    [
        ("20 61", "b", "b", "does not agree with ParameterValue 'b', which counts"),
        ("2", "b", "b", "is no VISIBLE_STRING in pairs of hexadecimal digits"),
        ("zz", "", None, "is no VISIBLE_STRING in pairs of hexadecimal digits"),
    ],
)
def test_a_value_that_somebody_has_changed_counts(octets: str, text: str, value: Value | None, finding: str) -> None:
    variable = Variable(0x2000, 0, "own", DataType.VISIBLE_STRING, Access.RW, configured=" a")
    written = write_eds(replace(describe(ObjectDictionary([Object.of("own", [variable])])), commissioning=Commissioning(5)))
    changed = written.replace("_ParameterBytes=20 61", f"_ParameterBytes={octets}")
    read = read_eds(changed.replace("ParameterValue=a\n", f"ParameterValue={text}\n" if text else ""))
    assert read.dictionary.variable(0x2000).configured == value
    assert [finding in each.message for each in read.findings] == [True]


def test_an_object_that_the_device_refused_stands_in_the_file_with_the_reason() -> None:
    """Without a description, the file has what the device has shown to exist: a refusal shows that, an absent object does not."""
    variables = [DESCRIBED.variable(index) for index in list(TYPES)[:3]]
    readings = [
        Reading(variables[0], ReadResult.READ, variables[0].encode(True), True),
        Reading(variables[1], ReadResult.REFUSED),
        Reading(variables[2], ReadResult.ABSENT),
    ]
    written = read_eds(backup_file(Backup(5, DESCRIBED, readings), None).data).dictionary
    assert [index in written.objects for index in list(TYPES)[:3]] == [True, True, False]
    assert written.variable(variables[1].index).not_read == "refused"
