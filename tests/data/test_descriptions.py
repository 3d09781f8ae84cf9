"""Device descriptions from files: their sort by content, the samples, names of the data files laid over them."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_data import MAX_FILE_SIZE, DataError, load_dictionary
from canopen_data.description import DeviceDescription, FileKind
from canopen_data.descriptions import load_description, load_description_with_names, read_file, samples
from canopen_data.findings import DictionaryError
from canopen_data.reading import read_description
from canopen_proto.datatypes import DataType
from tests.data.xdd_files import VAR, var, xdd

XML = xdd(var('dataType="0005" accessType="ro"'))


@pytest.mark.parametrize("before", [b"", b"\xef\xbb\xbf", b" \r\n\t"])
def test_xml_by_its_content(before: bytes) -> None:
    assert read_description(before + XML).kind is FileKind.XDD


def test_xml_of_two_bytes_a_character() -> None:
    text = XML.decode().replace("utf-8", "utf-16")
    for encoding in ("utf-16", "utf-16-be"):
        description = read_description(text.encode(encoding), "my.xdd")
        assert (description.kind, list(description.dictionary.objects)) == (FileKind.XDD, [0x2000])


@pytest.mark.parametrize("data", [b"", b"[FileInfo]\nFileName=a.eds\n", b"\x00\x01", "[FileInfo]".encode("utf-16")])
def test_anything_else_is_a_text_of_sections(data: bytes) -> None:
    assert read_description(data, "a").kind is FileKind.EDS


def test_strict() -> None:
    with pytest.raises(DictionaryError, match="my.xdd"):
        read_description(b"<html/>", "my.xdd", strict=True)


# ---- files ----


@pytest.mark.parametrize("name", samples())
def test_samples_have_no_fault(name: str) -> None:
    description = load_description(name, strict=True)
    assert not description.findings
    assert description.source == name
    assert name.endswith(description.kind.lower())


def test_a_file_goes_before_a_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sample_io.xdd").write_bytes(XML)
    assert read_file("sample_io.xdd") == XML
    assert list(load_description(tmp_path / "sample_io.xdd").dictionary.objects) == [0x2000]


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"# A page\n\nSee [the other](page.md).\n",
        b"\x7fELF\x02\x01\x00\xff" * 50,
        b"<ISO15745ProfileContainer><broken",
        b"<html><body/></html>",
        b"[FileInfo]\nFileName=a.eds\n",
    ],
)
def test_a_file_without_any_object_is_never_taken_for_a_device(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "README.md"
    path.write_bytes(content)
    for load in (load_description, load_description_with_names):
        with pytest.raises(DataError, match=r"CO301: .*README\.md describes no object") as caught:
            load(path)
        assert "no EDS, DCF, XDD or XDC" in str(caught.value)


def test_a_file_with_one_object_is_taken_however_bad_it_is(tmp_path: Path) -> None:
    path = tmp_path / "bad.eds"
    path.write_bytes(b"junk\n[1000]\nDataType=junk\n")
    assert list(load_description(path).dictionary.objects) == [0x1000]


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(
        DataError,
        match="there is no file .*none.xdd'\n  try:   .*\n  or:    use a sample: sample_drive.eds, sample_io",
    ):
        read_file(tmp_path / "none.xdd")
    with pytest.raises(DataError, match="cannot read"):
        read_file(tmp_path)
    with pytest.raises(DataError, match="cannot read"):
        read_file("a\0b")
    (tmp_path / "large").write_bytes(bytes(MAX_FILE_SIZE + 1))
    with pytest.raises(DataError, match="larger than 16 MiB"):
        read_file(tmp_path / "large")


def test_the_sample_devices() -> None:
    general, one = load_description("sample_io.xdd"), load_description("sample_io.xdc")
    assert (general.kind, one.kind, general.commissioning) == (FileKind.XDD, FileKind.XDC, None)
    assert one.commissioning is not None
    assert (one.commissioning.node_id, one.commissioning.bit_rate) == (5, 250)
    assert general.device_info == one.device_info
    text = general.dictionary.variable("Filter time")
    assert (text.data_type, text.unit, text.factor, text.high_limit) == (DataType.UNSIGNED16, "ms", 0.1, 10000)
    assert one.dictionary.variable("Filter time").initial_of(5) == 100
    assert one.dictionary.variable((0x1800, 1)).initial_of(5) == 0x40000185
    assert general.dictionary.names_of("Transmission mode", 2) == ("cyclic",)


# ---- names of the data files ----


def described(folder: Path, device_type: str) -> DeviceDescription:
    """A device with one object of each area, with the names of the data files."""
    path = folder / "device.xdd"
    objects = (("1000", "Kind", device_type), ("1017", "Beat", "5"), ("2000", "Own", "1"), ("6041", "Zustand", "0"))
    line = 'dataType="0007" accessType="rw" defaultValue="{}"'
    process = (
        '<parameterList><parameter uniqueID="P"><UDINT/><allowedValues><value value="1"><label>one</label></value>'
        "</allowedValues></parameter></parameterList>"
    )
    content = "".join(VAR.format(index, name, line.format(value) + ' uniqueIDRef="P"') for index, name, value in objects)
    path.write_bytes(xdd(content, process))
    return load_description_with_names(path, folder=folder)


def test_a_drive_gets_all_names(tmp_path: Path) -> None:
    dictionary = described(tmp_path, "0x20192").dictionary
    assert dictionary.variable("statusword") is dictionary.variable("Zustand") is dictionary.get(0x6041)
    assert dictionary.variable("producer_heartbeat_time").names == ("producer_heartbeat_time", "Beat")
    assert dictionary.matches("statusword", "switch_on_disabled", 0x0240)
    assert dictionary.names_of("statusword", 1)[-1] == "one"
    assert "Own" in dictionary


def test_another_device_gets_those_of_communication_objects(tmp_path: Path) -> None:
    dictionary = described(tmp_path, "0x30191").dictionary
    assert dictionary.variable(0x1017).name == "producer_heartbeat_time"
    assert dictionary.variable(0x6041).names == ("Zustand",)
    assert dictionary.names_of("Zustand", 1) == ("one",)
    assert dictionary.names_of("Own", 1) == ("one",)
    assert "statusword" not in dictionary
    assert [each.index for each in dictionary] == [0x1000, 0x1017, 0x2000, 0x6041]


@pytest.mark.parametrize(("code", "is_drive"), [("0006", True), ("0005", False)])
def test_a_file_that_does_not_say_its_profile(tmp_path: Path, code: str, is_drive: bool) -> None:
    path = tmp_path / "device.xdd"
    words = "".join(VAR.format(index, f"word {index}", f'dataType="{code}" accessType="rw"') for index in ("6040", "6041"))
    path.write_bytes(xdd(words))
    assert ("statusword" in load_description_with_names(path).dictionary) is is_drive


def test_the_files_own_names_only(tmp_path: Path) -> None:
    described(tmp_path, "0x20192")
    dictionary = load_description_with_names(tmp_path / "device.xdd", overlay=False).dictionary
    assert dictionary.variable(0x6041).names == ("Zustand",)
    assert load_dictionary(tmp_path)[0].variable("statusword").index == 0x6041
