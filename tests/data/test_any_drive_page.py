"""docs/any-drive.md: its table says what the plan for each drive file is."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_data.descriptions import load_description
from canopen_proto.dictionary import Direction
from canopen_proto.drives.axis.motion_plan import MODES, MotionPlan, NoMotionPlanError, plan_motion
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, short_name
from canopen_proto.machine import MILLISECOND
from canopen_proto.multiplexer import index_of, mapped
from canopen_proto.pdo.settings import PdoSettings
from tests import vendor_files
from tests.drives.test_motion_plan import assert_writable

PAGE = Path(__file__).parents[2] / "docs" / "any-drive.md"
NODE = 3
DRIVES = (
    "schunk-powerball-lwa4p.dcf",
    "inovance-e35.eds",
    "ros2-cia402-slave.eds",
    "maxon-epos2.eds",
    "faulhaber-605.3150.70-B.eds",
    "faulhaber-605.3150.51-V.eds",
    "cia-402.eds",
)


def plan_of(name: str, wish: Mode | None = None) -> MotionPlan:
    dictionary = load_description(vendor_files.path_of(name)).dictionary
    return plan_motion(dictionary, NODE, 10 * MILLISECOND, wish=wish)


def pdo_text(plan: MotionPlan, pdo: PdoSettings) -> str:
    places = (f"{index:04X}:{subindex:02X}".removesuffix(":00") for index, subindex, _ in map(mapped, pdo.entries))
    kind = "" if pdo.transmission_type == 1 else " (event)"
    return f"{'**' if pdo in plan.written else ''}{pdo.number}{'**' if pdo in plan.written else ''}{kind}: {', '.join(places)}"


def row_of(name: str) -> str:
    """The table's row: the file, the mode, its PDOs, and what goes by SDO beside the cycle."""
    plan = plan_of(name)
    pdos = {
        direction: "; ".join(pdo_text(plan, pdo) for pdo in plan.pdos if pdo.direction is direction) or "-"
        for direction in Direction
    }
    keys = dict.fromkeys(key for key in (*plan.commands_by_sdo, *plan.watched_by_sdo) if key != objects.MODES_OF_OPERATION)
    by_sdo = ", ".join(f"{index_of(key):04X}" for key in keys) or "-"
    return f"| `{name}` | {short_name(plan.mode)} | {pdos[Direction.RPDO]} | {pdos[Direction.TPDO]} | {by_sdo} |"


@pytest.mark.parametrize("name", DRIVES)
def test_the_table_says_what_the_plan_is(name: str) -> None:
    assert row_of(name) in PAGE.read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize("wish", [None, *MODES])
@pytest.mark.parametrize("name", DRIVES)
def test_every_write_of_a_plan_is_one_that_the_device_takes(name: str, wish: Mode | None) -> None:
    try:
        plan = plan_of(name, wish)
    except NoMotionPlanError as refused:
        assert wish in (Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.INTERPOLATED_POSITION)
        assert refused.obstacles[0].reason
    else:
        assert_writable(plan)
        assert all(pdo.direction is Direction.TPDO or pdo.entries for pdo in plan.pdos)
        assert len({pdo.cob_id & 0x7FF for pdo in plan.pdos}) == len(plan.pdos)
