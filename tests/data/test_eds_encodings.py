"""The characters of a file: what its bytes are read as, and what is said of it."""

from __future__ import annotations

import pytest

from canopen_data.eds.encodings import is_encoding, text_of
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer import encode_eds, write_eds
from canopen_data.reading import read_description

WESTERN = "not UTF-8; read as Windows-1252"


@pytest.mark.parametrize(
    ("data", "text", "encoding", "found"),
    [
        (b"[A]", "[A]", "utf-8", None),
        ("[ä]".encode(), "[ä]", "utf-8", None),
        (b"\xef\xbb\xbf[A]", "[A]", "utf-8-sig", None),
        ("[ä]".encode("utf-16"), "[ä]", "utf-16", None),
        (b"[A]\r\nN=\xb5m\n", "[A]\r\nN=µm\n", "cp1252", (WESTERN, 2, 3)),
        (b"N=\x80", "N=€", "cp1252", (WESTERN, 1, 3)),
        (b"N=\xb5\x81", "N=µ\x81", "latin-1", ("not UTF-8; read as Latin-1 (ISO 8859-1)", 1, 3)),
        (b"\xef\xbb\xbf\xff", "ï»¿ÿ", "cp1252", (WESTERN, 1, 1)),
    ],
)
def test_encodings(data: bytes, text: str, encoding: str, found: tuple[str, int, int] | None) -> None:
    assert text_of(data) == (text, encoding, found)


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("ParameterName=设备类型\nDenotation=控制字\nLine1=电机的最大速度（转/分）", "gbk"),
        ("ParameterName=伺服驱动器", "gbk"),
        ("ParameterName=デバイス名\nLine1=最大速度の設定値。", "cp932"),
        ("ParameterName=制御ワード", "cp932"),
        ("ParameterName=設定", "cp932"),
    ],
)
def test_east_asian_files_are_guessed_and_the_guess_is_told(text: str, encoding: str) -> None:
    data = text.encode(encoding)
    read, chosen, remark = text_of(data)
    assert (read, chosen) == (text, encoding)
    assert remark is not None
    assert "which is a guess: --encoding names another one" in remark[0]
    assert read.encode(chosen) == data


@pytest.mark.parametrize(
    "text",
    [
        "Größe", "Länge über alles", "Fußgängerübergänge", "Température maximale à l'entrée", "señal de posición", "função",
        "0..100 °C, ±5 %", "µm", "© 2013 Müller & Söhne", "Kühlkörper", "größter Wert", "über", "öß", "naïve", "çã", "Ærø", "°°",
    ],
)  # fmt: skip
def test_western_files_are_no_guess(text: str) -> None:
    assert text_of(f"ParameterName={text}\n".encode("cp1252"))[:2] == (f"ParameterName={text}\n", "cp1252")


def test_the_caller_names_the_encoding() -> None:
    data = "[DeviceInfo]\nVendorName=Привод\n[1000]\nParameterName=тип\nDataType=7\nAccessType=ro\n".encode("cp1251")
    description = read_description(data, "x.eds", encoding="cp1251")
    assert description.device_info.vendor_name == "Привод"
    assert description.encoding == "cp1251"
    assert description.findings == ()
    assert encode_eds(write_eds(description), description.encoding) == data
    (finding,) = read_eds(data, encoding="utf-8").findings
    assert finding.message == "not utf-8, as it should be; characters were replaced"
    assert (finding.line, finding.column) == (2, 12)


def test_names_of_encodings() -> None:
    assert [each for each in ("gbk", "cp932", "latin-1", "UTF-8", "rot13", "base64", "nonsense", "") if is_encoding(each)] == [
        "gbk", "cp932", "latin-1", "UTF-8"
    ]  # fmt: skip


@pytest.mark.parametrize("encoding", ["latin-1", "cp1252", "ascii", "gbk"])
def test_a_text_that_the_old_encoding_lacks_makes_the_file_utf_8(encoding: str) -> None:
    for text in ("ParameterName=plain", "ParameterName=20 €", "ParameterName=größer ≥"):
        data = encode_eds(text, encoding)
        try:
            expected = text.encode(encoding)
        except UnicodeEncodeError:
            expected = text.encode()
        assert data == expected
