"""What this process holds open: threads, files, sockets. A transport that is closed has given back its own."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from pathlib import Path
from typing import Final

_DESCRIPTORS: Final = Path("/dev/fd")
_TRIO_KEEPS: Final = "Trio thread"
"""How trio names its worker threads that have nothing to do; they end by themselves."""


def held() -> frozenset[str]:
    """In words that are equal as long as it is the same. Descriptors only where the system shows them (Linux, macOS)."""
    threads = {
        f"thread {thread.name!r} ({thread.ident})" for thread in threading.enumerate() if not thread.name.startswith(_TRIO_KEEPS)
    }
    files = set()
    with suppress(OSError):
        for name in os.listdir(_DESCRIPTORS):
            with suppress(OSError):  # the one by which they are listed is closed by now
                files.add(f"descriptor {name} ({os.readlink(_DESCRIPTORS / name)})")
    return frozenset(threads | files)
