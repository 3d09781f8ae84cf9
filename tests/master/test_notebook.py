"""A notebook: the cells of docs/asyncio.md in a kernel of Jupyter, its interrupt button, and its end while a drive moves."""

from __future__ import annotations

import importlib
import importlib.util
import os
import queue
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.master.moving_for_ever import SERVE_AND_WORK

PAGE = (Path(__file__).parents[2] / "docs" / "asyncio.md").read_text(encoding="utf-8")
MISSING = [name for name in ("nbclient", "ipykernel") if importlib.util.find_spec(name) is None]
LIMIT = 100.0
"""Seconds for a cell, on a busy computer."""

pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason="no notebook can be run here: pip install nbclient ipykernel"),
    pytest.mark.filterwarnings("default"),  # of jupyter_client's own
]


@pytest.fixture
def in_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """What kernels are to find: our packages. Nothing of the user's own settings."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")


def test_the_cells_of_the_page(in_kernels: None, tmp_path: Path) -> None:
    """Each `# cell` of the page's block is one, on a bus with a simulated drive."""
    nbformat, nbclient = importlib.import_module("nbformat"), importlib.import_module("nbclient")
    (block,) = re.findall(r"```py\n(# cell.*?)```", PAGE, re.DOTALL)
    page = [cell.strip() for cell in re.split(r"^# cell[^\n]*\n", block, flags=re.MULTILINE) if cell]
    assert len(page) == 5
    devices = 'simulated_devices({"virtual:cell": powerballs(5)})'
    begin = f"""
import contextlib
from canopen_master import blocking, powerballs
from canopen_master.simulation import simulated_devices
line = contextlib.AsyncExitStack()
served = await line.enter_async_context({devices})
"""
    cells = [
        begin,
        *(cell.replace("socketcan:can0", "virtual:cell") for cell in page[:4]),
        f"await line.aclose()\ndevices = blocking.{devices}\ndevices.__enter__()\nNone",
        page[4].replace("socketcan:can0", "virtual:cell"),
        "master.node(5)['producer_heartbeat_time']",
        "master.close()\ndevices.__exit__(None, None, None)",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    nbclient.NotebookClient(notebook, timeout=LIMIT, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    told = [[each["text"] if "text" in each else each["data"]["text/plain"] for each in cell.outputs] for cell in notebook.cells]
    name = "'Simulated Schunk Powerball joint'"
    assert told == [[], ["0x20192\n"], [], [name], [], [], [name], ["0"], []]


SERVED = f"""{SERVE_AND_WORK}
import atexit

def last():
    with open("last", "w") as file:
        file.write(str(drives.moving))

atexit.register(last)
served = asyncio.get_running_loop().create_future()
serving = asyncio.create_task(serve(served))
drives = await served
"""
MOVES = """
await until(lambda: drives.moving, "the drive moves")
print("moves", flush=True)
"""


class Kernel:
    """A kernel, and cells that are run in it."""

    def __init__(self, folder: Path) -> None:
        start = importlib.import_module("jupyter_client.manager").start_new_kernel
        self.manager, self.client = start(kernel_name="python3", cwd=str(folder))

    def run(self, cell: str, on_text: Callable[[], object] = lambda: None) -> tuple[str, str]:
        """What it has printed, and the name of its error. on_text: called when it prints."""
        number = self.client.execute(cell)
        text = error = ""
        while True:
            try:
                message: dict[str, Any] = self.client.get_iopub_msg(timeout=LIMIT)
            except queue.Empty:
                pytest.fail(f"within {LIMIT:g} s the kernel said nothing of the end of this cell: {cell}\nIt has printed: {text}")
            content = message["content"]
            if message["parent_header"].get("msg_id") != number:
                continue
            if message["msg_type"] == "stream" and content["name"] == "stdout":
                text += content["text"]
                on_text()
            elif message["msg_type"] == "error":
                error = content["ename"]
            elif message["msg_type"] == "status" and content["execution_state"] == "idle":
                return text, error


@pytest.fixture
def kernel(in_kernels: None, tmp_path: Path) -> Iterator[Kernel]:
    kernel = Kernel(tmp_path)
    yield kernel
    kernel.client.stop_channels()
    if kernel.manager.is_alive():
        kernel.manager.shutdown_kernel(now=True)


def test_its_interrupt_button_and_the_end_of_the_kernel(kernel: Kernel, tmp_path: Path) -> None:
    """The button cancels the cell. A task that an earlier cell began goes on, until the kernel ends."""
    assert kernel.run(SERVED) == ("", "")
    moving = "moving = asyncio.ensure_future(work())\n" + MOVES + "await moving"
    assert kernel.run(moving, on_text=kernel.manager.interrupt_kernel) == ("moves\n", "CancelledError")
    assert kernel.run("print(moving.cancelled(), drives.moving)") == ("True []\n", "")
    assert kernel.run("task = asyncio.create_task(work())" + MOVES) == ("moves\n", "")
    waiting = MOVES + "await asyncio.sleep(1000)"
    assert kernel.run(waiting, on_text=kernel.manager.interrupt_kernel) == ("moves\n", "CancelledError")
    assert kernel.run(MOVES + "print(task.done())") == ("moves\nFalse\n", "")
    kernel.manager.shutdown_kernel()
    assert (tmp_path / "last").read_text() == "[]"
