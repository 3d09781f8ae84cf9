"""The option --overlay: side files with units, names of values and bits, and aliases; see canopen_data/overlay.py.

canopen read 5 position -e drive.eds --overlay units.toml
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from canopen_cli.shared.problem import ExitCode, Problem
from canopen_cli.shared.screen import Screen
from canopen_data.overlay import lay_over
from canopen_proto.dictionary import ObjectDictionary

MAX_FILE_SIZE: Final = 16 * 1024 * 1024
"""Bytes, as for all data files. A larger file is not one of ours."""


def read_text(path: Path) -> str:
    """Read a text file that the user names. Raises Problem."""
    try:
        if path.stat().st_size > MAX_FILE_SIZE:
            raise Problem(ExitCode.BAD_FILE, "CO330", f"{path} has more than {MAX_FILE_SIZE} bytes", cause="it is another file")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise Problem(ExitCode.BAD_FILE, "CO330", f"{path} is not UTF-8 text", seen=str(error)) from None
    except OSError as error:
        failed = f"cannot read {path}: {error.strerror or error}"
        raise Problem(ExitCode.BAD_FILE, "CO330", failed, tries=("check the path",)) from None


def overlaid(dictionary: ObjectDictionary, paths: Iterable[str], screen: Screen) -> ObjectDictionary:
    """Return the dictionary with these side files laid over it, the later over the earlier.

    With -v, names without an object are told.

    Raises Problem if a file cannot be read, DictionaryError for its faults.
    """
    for path in paths:
        dictionary, findings = lay_over(dictionary, read_text(Path(path)), path)
        for finding in findings:
            screen.detail(str(finding))
    return dictionary
