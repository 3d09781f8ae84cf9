"""Decode the bytes of a file, and find out their encoding.

CiA 306 names no encoding. Bytes become text as UTF-8 (with or without a byte order mark), or UTF-16 with its mark. Any other file
is in one of the old encodings of Windows, and does not name it. GBK (Chinese) or cp932 (Japanese) is guessed if the bytes are
plausible for it and for no western text: two or more of its common characters side by side. Western texts have single ones, among
ASCII letters. Everything else is Windows-1252, or Latin-1 if a byte has no meaning there. So every byte has a character, and no
file is refused. Each encoding other than UTF-8 is a finding, and the caller may name the encoding.

A guess is taken only if encoding the text again gives the same bytes.

Source: the standard library's encodings; the rest is experience with files.
"""

from __future__ import annotations

import re
from typing import Final

NOT_CP1252: Final = re.compile(rb"[\x81\x8d\x8f\x90\x9d]")
LINE_END: Final = re.compile(r"\r\n|\r|\n")
_KANA_AND_KANJI: Final = re.compile("[\u3000-\u30ff\u4e00-\u9fff\uff01-\uff5e]")
_NOT_ASCII_RUN: Final = re.compile(r"[^\x00-\x7f]+")
_COMMON: Final = 0.8
"""For a guess, the least share of common characters among those beyond ASCII, and of characters that stand side by side."""
_NAMES: Final = {"cp1252": "Windows-1252", "latin-1": "Latin-1 (ISO 8859-1)", "gbk": "GBK (Chinese)", "cp932": "cp932 (Japanese)"}


def is_encoding(name: str) -> bool:
    """Return whether there is a text encoding of that name: "gbk", "cp932", "cp1251", "latin-1"."""
    try:
        return isinstance(b"a".decode(name), str)
    except (LookupError, UnicodeError):
        return False


def text_of(data: bytes, encoding: str = "") -> tuple[str, str, tuple[str, int, int] | None]:
    """Return a file's text, the encoding used, and a remark: a message, with line and column (from 1) of the first character that
    is not UTF-8. The remark is None for plain UTF-8.

    encoding: the one to use, "" = guess. Bytes that it does not have are replaced, and the remark says so.
    """
    if encoding:
        try:
            return data.decode(encoding), encoding, None
        except UnicodeDecodeError as error:
            remark = _remark(data, error, f"not {encoding}, as it should be; characters were replaced")
            return data.decode(encoding, "replace"), encoding, remark
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace"), "utf-16", None
    marked = data.startswith(b"\xef\xbb\xbf")
    try:
        return (data[3:] if marked else data).decode(), "utf-8-sig" if marked else "utf-8", None
    except UnicodeDecodeError as error:
        guess = _guess(data)
        chosen = guess or ("latin-1" if NOT_CP1252.search(data) else "cp1252")
        how = f"{_NAMES[chosen]}, which is a guess: --encoding names another one" if guess else _NAMES[chosen]
        return data.decode(chosen), chosen, _remark(error.object, error, f"not UTF-8; read as {how}")


def _remark(data: bytes, error: UnicodeDecodeError, message: str) -> tuple[str, int, int]:
    before = LINE_END.split(data[: error.start].decode("latin-1"))
    return message, len(before), len(before[-1]) + 1


def _guess(data: bytes) -> str:
    """Return an East Asian encoding that the bytes are plausible for; "" if there is none."""
    for encoding, is_common in (("gbk", _is_common_chinese), ("cp932", _is_common_japanese)):
        try:
            text = data.decode(encoding)
            if text.encode(encoding) != data:
                continue
        except UnicodeError:
            continue
        runs = _NOT_ASCII_RUN.findall(text)
        count = sum(map(len, runs))
        common = sum(1 for run in runs for each in run if is_common(each))
        side_by_side = sum(len(run) for run in runs if len(run) > 1)
        if common >= _COMMON * count and side_by_side >= _COMMON * count:
            return encoding
    return ""


def _is_common_chinese(character: str) -> bool:
    """Return whether it is a symbol or one of the 3755 usual characters (level 1) of GB 2312: the rows up to D7 of GBK."""
    octets = character.encode("gbk")
    return 0xA1 <= octets[0] <= 0xD7 and octets[-1] >= 0xA1


def _is_common_japanese(character: str) -> bool:
    return _KANA_AND_KANJI.fullmatch(character) is not None
