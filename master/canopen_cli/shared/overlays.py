"""The option --overlay: side files with units, names of values and bits, and aliases; see canopen_data/overlay.py.

canopen read 5 position -e drive.eds --overlay units.toml
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from canopen_cli.shared.screen import Screen
from canopen_data.named_files import read_text
from canopen_data.overlay import lay_over
from canopen_proto.dictionary import ObjectDictionary


def overlaid(dictionary: ObjectDictionary, paths: Iterable[str], screen: Screen) -> ObjectDictionary:
    """Return the dictionary with these side files laid over it, the later over the earlier.

    With -v, names without an object are told.

    Raises UnusableFile if a file cannot be read, DictionaryError for its faults.
    """
    for path in paths:
        dictionary, findings = lay_over(dictionary, read_text(Path(path)), path)
        for finding in findings:
            screen.detail(str(finding))
    return dictionary
