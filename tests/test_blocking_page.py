"""docs/blocking.md: each example runs as it stands there, with simulated devices in place of those on can0."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from canopen_data.descriptions import load_description
from canopen_master import DeviceModel, PatientClock, powerballs
from canopen_master.blocking import loop_thread, simulated_devices
from tests.master.direct_world import near_home

PAGE = (Path(__file__).parents[1] / "docs" / "blocking.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
TOLD = (
    "0x20192",
    "131474",
    r"status 0x0\nstatus 0x0\nstatus 0x0",
    "the call was not done within 0.5 s, and was taken back\nit stands",
    "interrupted, and it stands",
    r"\w+\n5",
    r"\w+, error register 0",
    r"\[10\] nobody is left\nTrue",
    r"\[0\.1, 0\.2\] \[3, 4\]",
)
"""What each example prints."""


def test_all_examples_are_known() -> None:
    assert len(BLOCKS) == len(TOLD)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("number", range(len(TOLD)))
def test_example(number: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(loop_thread, "make_clock", PatientClock)
    drive = DeviceModel(load_description("sample_drive.eds").dictionary, 5)
    code = BLOCKS[number].replace("socketcan:can0", "virtual:page").replace("drive.eds", "sample_drive.eds")
    with simulated_devices({"virtual:page": [*near_home(3), drive, *powerballs(255)]}):
        exec(compile(code, f"example {number}", "exec"), {"__name__": "__main__"})
    shown = "\n".join(line for line in capsys.readouterr().out.splitlines() if not line.startswith("EmcyReceived"))
    if number == 2:  # the two threads print in any order
        assert re.search("^type 0x20192$", shown, re.MULTILINE), shown
        shown = shown.replace("type 0x20192\n", "").replace("\ntype 0x20192", "")
    assert re.fullmatch(TOLD[number], shown.strip()), shown
