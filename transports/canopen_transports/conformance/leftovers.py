"""List the threads, files and sockets that this process holds open. A closed transport has given back its own."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from pathlib import Path
from typing import Final

_DESCRIPTORS: Final = Path("/dev/fd")
_END_BY_THEMSELVES: Final = ("Trio thread", "in_thread")
"""How trio names its idle worker threads, and canopen_transports.loop those on asyncio."""


def held() -> frozenset[str]:
    """Return a text for each thread and descriptor, equal as long as it is the same one. Descriptors only on Linux and macOS."""
    threads = {
        f"thread {thread.name!r} ({thread.ident})"
        for thread in threading.enumerate()
        if not thread.name.startswith(_END_BY_THEMSELVES)
    }
    files = set()
    with suppress(OSError):
        for name in os.listdir(_DESCRIPTORS):
            with suppress(OSError):  # the descriptor that listed them is closed by now
                files.add(f"descriptor {name} ({os.readlink(_DESCRIPTORS / name)})")
    return frozenset(threads | files)
