"""Scripts that end without closing their connection: a real process each, and its drive must be halted before it is gone."""

from __future__ import annotations

from typing import Any

import pytest

from tests.examples import takes_all
from tests.master.script_ends import HALT, endings, last_controlword

pytestmark = pytest.mark.timeout(900)  # a busy computer takes minutes for these scripts, and all share one process

SCRIPT = """
drives = canopen.simulated([12], bus=BUS)
drives.__enter__()
assert canopen.open_connection(BUS, sdo_timeout=10), canopen.last_error()
canopen.init_nmt()
assert canopen.init_device(12)
assert canopen.set_sync_interval(12, 250)
assert canopen.enable_ip_mode(12)
for step in range(5):
    canopen.send_pos(12, 3000 + 100 * step)
    canopen.send_sync(10)
homes.clear()
sys.stdout.write("moving\\n")  # print() writes the line and its end apart: the other thread's lines would come between
"""


ENDS: dict[str, tuple[Any, ...]] = {
    "last line": ("", 0),
    "exception": ("raise RuntimeError('a mistake')", 1),
    "exit": ("sys.exit(7)", 7),
    "interrupt": ("os.kill(os.getpid(), signal.SIGINT); time.sleep(30)", -2),
    "interrupt of a call": ("press_ctrl_c(1, homes.wait); canopen.homing(12); time.sleep(30)", -2),
    "interrupts of a call, without end": ("press_ctrl_c(40, homes.wait); canopen.homing(12); time.sleep(30)", -2),
    "interrupts of the script's end": ("press_ctrl_c(40, lambda: time.sleep(0.03))", 0, -2),
    "terminated": (
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(143)); os.kill(os.getpid(), signal.SIGTERM); time.sleep(30)",
        143,
    ),
    "thread left": ("threading.Thread(target=canopen.homing, args=(12,)).start(); homes.wait()", 0),
}
NAMES = [*ENDS] if takes_all() else [*ENDS][::2]
"""Every day half of them; test_blocking_script.py takes the others."""


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str, str]]:
    return endings(tmp_path_factory.mktemp("scripts"), SCRIPT, {name: ENDS[name][0] for name in NAMES})


@pytest.mark.parametrize("name", NAMES)
def test_a_script_that_ends_anyhow_leaves_its_drive_halted(ended: dict[str, tuple[int, str, str]], name: str) -> None:
    status, output, errors = ended[name]
    assert status in ENDS[name][1:], errors
    assert last_controlword(output) & HALT, output
    assert "a mistake" in errors if name == "exception" else True
