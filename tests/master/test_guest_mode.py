"""The master on trio as a guest of another loop: asyncio's, and Qt's by the text of docs/asyncio.md."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_master import open_master, powerballs
from canopen_master.simulation import simulated_devices, simulated_drives
from canopen_transports.loop import current_loop

LIMIT = 60.0
"""Seconds for one wait, on a busy computer."""
PAGE = (Path(__file__).parents[2] / "docs" / "asyncio.md").read_text(encoding="utf-8")


@contextmanager
def within_limit(what: str) -> Iterator[None]:
    try:
        with trio.fail_after(LIMIT):
            yield
    except trio.TooSlowError:
        raise AssertionError(f"not within {LIMIT:g} s: {what}") from None


def test_under_asyncio_with_a_master_of_asyncio_beside_it() -> None:
    """The host cancels the guest while a drive moves. Each master finds its own loop, though both run in one thread."""
    scope = trio.CancelScope()
    told: list[object] = []

    async def guest() -> None:
        async with simulated_drives([("virtual:guest", 3)]) as drives:
            with scope:
                async with open_master("virtual:guest") as master, trio.open_nursery() as nursery:
                    arm = master.load_chains(text="arm joint1 can0 3\n")["arm"]
                    await arm.initialise()
                    await arm.home()
                    nursery.start_soon(arm.move, [5.0])
                    with within_limit("the drive moves"):
                        while not drives.moving:
                            await trio.sleep(0.005)
                    told.append(current_loop().name)
                    await trio.sleep_forever()
            told.append(drives.moving)

    async def host() -> None:
        loop = asyncio.get_running_loop()
        ended: asyncio.Future[Any] = loop.create_future()
        trio.lowlevel.start_guest_run(guest, run_sync_soon_threadsafe=loop.call_soon_threadsafe, done_callback=ended.set_result)
        async with simulated_devices({"virtual:host": powerballs(5)}), open_master("virtual:host") as master:
            end = loop.time() + LIMIT
            while not told:
                assert not ended.done(), f"the guest has ended: {ended.result()}"
                assert loop.time() < end, f"not within {LIMIT:g} s: the guest's drive moves"
                assert await master.node(5).read("device_type") == 0x20192
                assert current_loop().name == "asyncio"
                await asyncio.sleep(0.005)
            scope.cancel()
            await asyncio.wait([ended], timeout=LIMIT)
            assert ended.done(), f"not within {LIMIT:g} s: the guest ends, which was cancelled"
            ended.result().unwrap()

    asyncio.run(host())
    assert told == ["trio", []]


HEAD = f"""
from contextlib import asynccontextmanager
import time
import canopen_master
import trio
from canopen_master.simulation import simulated_drives

served = []
really_open = canopen_master.open_master

async def serve():  # as a system task: no scope of the page cancels the drives
    async with simulated_drives([("virtual:cell", 3)]) as drives:
        served.append(drives)
        await trio.sleep_forever()

@asynccontextmanager
async def open_served(locator):
    assert locator == "socketcan:can0"
    trio.lowlevel.spawn_system_task(serve)
    end = time.monotonic() + {LIMIT}
    while not served:
        assert time.monotonic() < end, "not within {LIMIT:g} s: the drive is served"
        await trio.sleep(0.001)
    try:
        async with really_open("virtual:cell") as master:
            yield master
    finally:
        print("left", served[0].moving)

canopen_master.open_master = open_served
"""
TAIL = """
import os
import time
from PySide6.QtCore import QTimer

began, moved = time.monotonic(), []

def look():
    if time.monotonic() > began + 80:
        print("not within 80 s: the drive moves, and the window closes", flush=True)
        os._exit(1)
    if not moved and served and served[0].moving:
        moved.append(True)
        print("moves")
        host.close()

timer = QTimer()
timer.timeout.connect(look)
timer.start(5)
application.exec()
print("ended")
"""


def test_under_qt_the_text_of_the_page() -> None:
    """The window closes while the drive moves. In a process of its own: an application of Qt ends with it."""
    if importlib.util.find_spec("PySide6") is None:
        pytest.skip("PySide6 is not installed: pip install PySide6-Essentials")
    (block,) = re.findall(r"```py\n(import trio\n.*?)application.exec\(\)\n```", PAGE, re.DOTALL)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "QT_QPA_PLATFORM": "offscreen"}
    command = [sys.executable, "-W", "error", "-c", HEAD + block + TAIL]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False, env=environment)
    assert done.returncode == 0, (done.stdout, done.stderr)
    assert done.stdout == "moves\nleft []\nended\n"
