"""Why a drive does not move: each obstacle alone, and the order of several."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.reasons import Reason, look_at, outer_reason, reasons
from canopen_proto.drives.axis.view import DriveView, view_of
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State, state_of
from canopen_proto.machine import SECOND
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.steps import SdoTransferError, StepTimeoutError
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.core.object_answers import run_against
from tests.drives.rig import Rig

MOVES = DriveView(0x1637, 0x001F, Mode.INTERPOLATED_POSITION, Mode.INTERPOLATED_POSITION, 0x43, 0, 0, 0, NmtState.OPERATIONAL)
CASES: dict[str, tuple[DriveView, tuple[str, ...]]] = {
    "it would move": (MOVES, ()),
    "it tells only its statusword": (DriveView(0x0637), ()),
    "stopped": (replace(MOVES, nmt_state=NmtState.STOPPED), ("its NMT state is stopped",)),
    "in fault": (
        replace(MOVES, statusword=0x0208, error_code=0x8611),
        ("it is in fault: 0x8611 following error",),
    ),
    "in fault, without a code": (replace(MOVES, statusword=0x0208, error_code=None), ("it is in fault",)),
    "a fault reaction": (replace(MOVES, statusword=0x021F), ("it brakes because of a fault",)),
    "no pattern": (replace(MOVES, statusword=0x0225), ("its statusword 0x0225 fits no state",)),
    "local control": (replace(MOVES, statusword=0x1437), ("it is under local control (bit 9",)),
    "quick stop": (replace(MOVES, statusword=0x0217), ("a quick stop is active",)),
    "not enabled": (replace(MOVES, statusword=0x0250), ("it is not enabled: switch on disabled",)),
    "no voltage": (
        replace(MOVES, statusword=0x0240, controlword=0x0006),
        ("its power stage has no voltage (bit 4", "it is not enabled: switch on disabled"),
    ),
    "no voltage is asked for": (
        replace(MOVES, statusword=0x0240, controlword=0x0000),
        ("it is not enabled: switch on disabled",),
    ),
    "no voltage further on": (
        replace(MOVES, statusword=0x0221, controlword=0x0007),
        ("its power stage has no voltage (bit 4", "it is not enabled: ready to switch on"),
    ),
    "a drive that is only ready needs none yet": (
        replace(MOVES, statusword=0x0221, controlword=0x0006),
        ("it is not enabled: ready to switch on",),
    ),
    "not ready": (replace(MOVES, statusword=0x0210), ("it is not ready to switch on",)),
    "halt": (replace(MOVES, controlword=0x011F), ("its controlword commands a halt (bit 8)",)),
    "a controlword that does not show what came by PDO": (replace(MOVES, controlword=0, commanded=0x001F), ()),
    "another controlword": (
        replace(MOVES, statusword=0x0231, controlword=0x0006, commanded=0x0007),
        ("it is not enabled", "its controlword is 0x0006 (shutdown), not the 0x0007 (switch on) that it was sent"),
    ),
    "a halt that we did not send": (
        replace(MOVES, controlword=0x011F, commanded=0x001F),
        ("its controlword commands a halt (bit 8): its controlword is 0x011F",),
    ),
    "a mode that we did not send": (
        replace(MOVES, wanted_mode=Mode.PROFILE_POSITION, selected_mode=Mode.INTERPOLATED_POSITION),
        ("0x6060 holds profile position (pp), not interpolated position (ip) as it was sent",),
    ),
    "no mode": (replace(MOVES, mode=0, wanted_mode=0), ("no mode of operation is selected",)),
    "another mode": (
        replace(MOVES, wanted_mode=Mode.PROFILE_POSITION),
        ("profile position (pp) was selected, but it shows interpolated position (ip)",),
    ),
    "a mode that it lacks": (
        replace(MOVES, wanted_mode=Mode.CYCLIC_SYNCHRONOUS_POSITION, mode=0),
        ("it does not have the mode that was selected, cyclic synchronous position (csp) (0x6502)",),
    ),
    "a maker's mode has no bit": (replace(MOVES, wanted_mode=-3, mode=-3), ()),
    "csp that does not follow": (
        replace(MOVES, statusword=0x0637, mode=Mode.CYCLIC_SYNCHRONOUS_POSITION, wanted_mode=8, supported_modes=0x80),
        ("it does not follow its set-points (bit 12",),
    ),
    "an internal limit": (replace(MOVES, statusword=0x1E37), ("a limit of its own holds it (bit 11)",)),
    "a following error": (
        replace(MOVES, statusword=0x2637, mode=Mode.PROFILE_POSITION, wanted_mode=1),
        ("its following error is too large (bit 13)",),
    ),
    "bit 13 means nothing in ip": (replace(MOVES, statusword=0x3637), ()),
    "both limit switches": (
        replace(MOVES, inputs=0b1011),
        ("it stands on its negative limit switch", "it stands on its positive limit switch"),
    ),
    "a fault hides what would come after it": (
        replace(MOVES, statusword=0x0208, inputs=1, controlword=0x0100),
        ("it is in fault",),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_each_obstacle(case: str) -> None:
    view, starts = CASES[case]
    found = reasons(view)
    assert len(found) == len(starts), found
    for reason, start in zip(found, starts, strict=True):
        assert reason.what.startswith(start)
        assert reason.remedy


words = st.integers(0, 0xFFFF)


@given(words | st.just(0x1637), st.none() | words, st.none() | st.integers(-128, 127), st.none() | st.integers(-128, 127))
def test_a_drive_that_is_not_enabled_or_is_halted_never_goes_without_a_reason(
    statusword: int, controlword: int | None, mode: int | None, wanted: int | None
) -> None:
    found = reasons(DriveView(statusword, controlword, mode, wanted))
    is_halted = controlword is not None and bool(controlword & 0x0100)
    has_its_mode = mode != 0 and (mode is None or wanted is None or mode == wanted)
    if state_of(statusword) is not State.OPERATION_ENABLED or is_halted or not has_its_mode:
        assert found
    assert all(isinstance(each, Reason) for each in found)
    assert len({each.what for each in found}) == len(found)


def test_the_order_is_that_of_removal() -> None:
    view = replace(MOVES, statusword=0x0840, controlword=0x0106, mode=0, wanted_mode=0, nmt_state=NmtState.STOPPED, inputs=1)
    order = ["NMT state", "local control", "no voltage", "not enabled", "halt", "no mode", "limit switch", "limit of its own"]
    found = [each.what for each in reasons(view)]
    places = [next(place for place, what in enumerate(found) if word in what) for word in order]
    assert all(earlier < later for earlier, later in itertools.pairwise(places))


def test_what_does_not_come_in_time_names_the_obstacle() -> None:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(reaction=10 * SECOND))
    with pytest.raises(StepTimeoutError, match=r"within 3 s: its power stage has no voltage .*\. Try: look at the motor supply"):
        rig.run(drive.enable(rig.axis))
    rig = Rig(Shape.STANDARD, pdos=False)
    assert outer_reason(view_of(rig.axis)) is None  # nothing was heard yet
    rig.run(drive.select_motionless_mode(rig.axis))
    rig.run(drive.enable(rig.axis))
    assert outer_reason(view_of(rig.axis)) is None


def test_it_is_read_from_the_drive() -> None:
    told = {(0x6041, 0): 0x0250, (0x6060, 0): 0xFFFF_FFFD, (0x6061, 0): 6, (0x6064, 0): -5, (0x603F, 0): 0}
    view = run_against(told, look_at)
    assert view == DriveView(0x0250, None, 6, -3, None, 0, -5, None, None)
    assert run_against({}, look_at) is None
    assert isinstance(run_against(told, look_at, abort=None), SdoTransferError)
