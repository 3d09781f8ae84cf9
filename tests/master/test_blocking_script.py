"""Scripts that end without closing their blocking master, and processes that are forked while they have one."""

from __future__ import annotations

from typing import Any

import pytest

from tests.examples import takes_all
from tests.master.script_ends import HALT, endings, last_controlword

pytestmark = pytest.mark.timeout(900)  # a busy computer takes minutes for these scripts, and all share one process

SCRIPT = """
from canopen_master import ChainSettings

drives = blocking.simulated_devices({BUS: powerballs(12)})
devices = drives.__enter__()
master = blocking.open_master(BUS, sdo_timeout=10)
patient = ChainSettings(max_silent_cycles=500, max_missed_cycles=500)  # how a busy computer stops a move is not asked here
arm = master.load_chains(text="arm joint1 can0 12\\n", settings=patient)["arm"]
arm.initialise()
arm.follow()
far = [arm.positions[0] + 5.0]

over = []

def move_far():
    try:
        arm.move(far)
        over.append("at its target")
    except BaseException as error:
        over.append(f"with {error!r}")
        raise

def moves():
    while not devices.moving:
        if over:
            raise RuntimeError(f"the move ended {over[0]} before a drive was seen to move")
        time.sleep(0.005)

def move():
    threading.Thread(target=move_far, daemon=True).start()
    moves()

sys.stdout.write("moving\\n")
"""

ENDS: dict[str, tuple[Any, ...]] = {
    "last line": ("", 0),
    "exception": ("raise RuntimeError('a mistake')", 1),
    "exit": ("sys.exit(7)", 7),
    "interrupt": ("os.kill(os.getpid(), signal.SIGINT); time.sleep(30)", -2),
    "interrupt of a call": ("press_ctrl_c(1, moves); move_far(); time.sleep(30)", -2),
    "interrupts of a call, without end": ("press_ctrl_c(40, moves); move_far(); time.sleep(30)", -2),
    "interrupts of the script's end": ("press_ctrl_c(40, lambda: time.sleep(0.03))", 0, -2),
    "interrupts of the block's end": ("move(); press_ctrl_c(40, lambda: None); master.close()", -2),
    "thread left": ("move()", 0),
    "fork": (
        """
child = os.fork()
if not child:
    try:
        master.node(12)["statusword"]
    except Exception as error:
        sys.stderr.write(f"{error}\\n")
    master.close()
    with blocking.simulated_devices({"virtual:child": powerballs(3)}), blocking.open_master("virtual:child") as own:
        sys.stderr.write(f"of its own: {own.node(3)['statusword']}\\n")
    os._exit(3)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
master.node(12)["statusword"]
""",
        0,
    ),
}
NAMES = [*ENDS] if takes_all() else [*ENDS][1::2]
"""Every day half of them; test_direct_script.py takes the others."""


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str, str]]:
    return endings(tmp_path_factory.mktemp("scripts"), SCRIPT, {name: ENDS[name][0] for name in NAMES})


@pytest.mark.parametrize("name", NAMES)
def test_a_script_that_ends_anyhow_leaves_its_drive_halted(ended: dict[str, tuple[int, str, str]], name: str) -> None:
    status, output, errors = ended[name]
    assert status in ENDS[name][1:], errors
    assert last_controlword(output) & HALT, output
    assert "a mistake" in errors if name == "exception" else True


def test_a_child_process_is_refused_and_may_open_a_master_of_its_own(ended: dict[str, tuple[int, str, str]]) -> None:
    _, _, errors = ended["fork"]
    assert "forked" in errors
    assert "spawn" in errors
    assert "of its own: " in errors
