"""Compiles the stand-in for PCAN-Basic, and lets python-can find it."""

from __future__ import annotations

import atexit
import ctypes
import functools
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

SOURCE = Path(__file__).with_name("pcanbasic.c")
COMPILER = shutil.which("gcc") or shutil.which("cc")
needs_compiler = pytest.mark.skipif(COMPILER is None or sys.platform != "linux", reason="no C compiler, or this is not Linux")

CHANNEL_1 = 0x51

BUS_LIGHT, BUS_HEAVY, BUS_OFF, PASSIVE = 0x4, 0x8, 0x10, 0x40000
OVERRUN, QUEUE_OVERRUN = 0x2, 0x40


@functools.cache
def _compiled() -> str:
    """The path of the library."""
    assert COMPILER is not None
    folder = tempfile.mkdtemp(prefix="pcanbasic")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = Path(folder) / "libpcanbasic.so"
    command = [COMPILER, "-shared", "-fPIC", "-O1", "-Wall", "-Wextra", "-Werror", "-pthread", "-o", str(path), str(SOURCE)]
    subprocess.run(command, check=True, timeout=60)
    return str(path)


def stand_in(monkeypatch: pytest.MonkeyPatch) -> ctypes.CDLL:
    """The library, fresh, which python-can finds while this test runs."""
    path = _compiled()
    monkeypatch.setattr("can.interfaces.pcan.basic.find_library", {"pcanbasic": path}.get)
    library = ctypes.CDLL(path)
    library.stand_in_clear()
    return library
