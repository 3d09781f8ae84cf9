"""An asyncio loop that is left while a master moves a drive: Python ends, nobody closes the loop, and the drive stands."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.master.moving_for_ever import SERVE_AND_WORK

SCRIPT = f"""{SERVE_AND_WORK}
import atexit, os, sys, threading

way = sys.argv[1]
parent = os.getpid()

async def main():
    global drives, tasks
    served = asyncio.get_running_loop().create_future()
    tasks = [asyncio.create_task(serve(served))]
    await until(lambda: served.done(), "the drive is served")
    drives = served.result()
    tasks.append(asyncio.create_task(work()))
    await until(lambda: drives.moving, "the drive moves")

def last():  # registered before the first master is opened: it is called after what a master has registered
    print("parent" if os.getpid() == parent else "child", "at the end", drives.moving, flush=True)

atexit.register(last)
loop = asyncio.new_event_loop()
if way == "daemon":
    threading.Thread(target=loop.run_forever, daemon=True).start()
    asyncio.run_coroutine_threadsafe(main(), loop).result()
else:
    loop.run_until_complete(main())
if way == "stopped again":  # as Jupyter's kernel, whose loop is told to stop some time later
    loop.call_soon(loop.stop)
    loop.call_later(0.05, loop.stop)
if way == "fork" and not os.fork():
    sys.exit()
if way == "fork":
    os.wait()
print("moving", drives.moving, flush=True)
"""


@pytest.mark.thorough(2)
@pytest.mark.parametrize("way", ["stopped", "stopped again", "daemon", "fork"])
def test_the_drive_stands_at_the_end_of_python(way: str) -> None:
    if way == "fork" and not hasattr(os, "fork"):
        pytest.skip("this system copies no processes")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", SCRIPT, way], capture_output=True, text=True, timeout=100, env=environment)
    assert done.returncode == 0, done.stderr
    assert "the event loop ends, and the master has not been left: its drives are halted now" in done.stderr
    told = done.stdout.splitlines()
    if way == "fork":  # a child leaves its parent's master alone
        assert told.pop(0) == "child at the end [3]"
    assert told == ["moving [3]", "parent at the end []"]
