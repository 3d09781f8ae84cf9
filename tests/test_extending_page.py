"""docs/extending.md: its fragments for a master and a device, in a world with a drive."""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path
from typing import Any

import pytest

from canopen_data import load_dictionary, read
from canopen_data.descriptions import load_description
from canopen_master import AxisSettings, open_master
from canopen_proto import SECOND, Frame, LocalNode, Outbox
from canopen_proto.drives import Axis
from canopen_proto.drives import axis as drive
from canopen_proto.pdo import define_pdo
from canopen_proto.procedures import Cancelled, Procedure, read_int
from canopen_testing import ProgramWorld
from tests.docs_build import DOCS

PAGE = (DOCS / "extending.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def block(begin: str) -> str:
    (found,) = (each for each in BLOCKS if each.startswith(begin))
    return str(found)


async def run(code: str, scope: dict[str, Any]) -> None:
    waits = eval(compile(code, "extending.md", "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT), scope)
    if inspect.iscoroutine(waits):
        await waits


def test_a_device_needs_no_bus(capsys: pytest.CaptureFixture[str]) -> None:
    scope = {"LocalNode": LocalNode, "Outbox": Outbox, "Frame": Frame, "dictionary": load_description("sample_io.eds").dictionary}
    exec(block("node = LocalNode(Outbox(), 5, dictionary)"), scope)
    shown = capsys.readouterr().out
    assert "705#00" in shown
    assert "585#43001000" in shown


def test_a_procedure_of_ones_own(canopen_world: ProgramWorld) -> None:
    canopen_world.drive(5)
    scope: dict[str, Any] = {"drive": drive, "Axis": Axis, "Procedure": Procedure, "SECOND": SECOND, "read_int": read_int}
    scope["Cancelled"] = Cancelled

    async def main() -> None:
        async with open_master("socketcan:can0") as master:
            device = master.device(master.node(5), settings=AxisSettings(counts_per_unit=1000))
            await run(block("def calibrate"), {**scope, "master": master, "device": device})
            assert abs(await master.run(drive.read_position(device.axis)) - 0.1) < 0.01

    canopen_world.run(main)


def test_a_pdo_of_ones_own_data_file(canopen_world: ProgramWorld, tmp_path: Path) -> None:
    (line,) = re.findall(r"^my_fast_tPDO .*$", PAGE, re.MULTILINE)
    (tmp_path / "PDOs.csv").write_text(read("PDOs.csv").text + f"\n{line}\n", encoding="utf-8")
    dictionary, _ = load_dictionary(tmp_path)
    canopen_world.drive(5)

    async def main() -> None:
        async with open_master("socketcan:can0", dictionary=dictionary) as master:
            node = master.node(5)
            await master.nmt_enter_pre_operational()
            await run(block("await master.run(define_pdo"), {"master": master, "node": node, "define_pdo": define_pdo})
            assert await node.read_bytes(0x1A01, 1) == (0x6064_0020).to_bytes(4, "little")

    canopen_world.run(main)
