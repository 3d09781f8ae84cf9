"""Waits end when the reason is there: each procedure that waits for a drive, each cause, by PDO and by SDO.

The drive acts late enough for the procedure to be caught waiting. Then something happens to it that nobody of us commanded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest

from canopen_proto.dictionary import Direction
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.runner import ProcedureFailed
from canopen_proto.procedures.steps import Procedure, ProcedureError
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import CYCLE, Rig

REACTION = 100 * MILLISECOND
HEARTBEAT = 50 * MILLISECOND
AT_ONCE = 200 * MILLISECOND
"""The mode is read every 100 ms where no PDO carries it; a heartbeat is lost after 100 ms."""


@dataclass(frozen=True)
class Waiting:
    """A procedure, and what comes before it. wait: ns from its start until it waits for the drive."""

    run: Callable[[Rig], Procedure[object]]
    prepare: Callable[[Rig], None] = lambda rig: None
    mode: int | None = None
    is_enabled: bool = True
    wait: int = REACTION // 2


def enabled_in(mode: int) -> Callable[[Rig], None]:
    def prepare(rig: Rig) -> None:
        rig.run(drive.set_mode(rig.axis, mode))
        rig.run(drive.enable(rig.axis))

    return prepare


def homing(rig: Rig) -> None:
    rig.axis.settings = replace(rig.axis.settings, homing_method=17)
    enabled_in(Mode.HOMING)(rig)


def running(rig: Rig) -> None:
    rig.node.values.store[objects.PROFILE_DECELERATION] = 2_000
    enabled_in(Mode.PROFILE_VELOCITY)(rig)
    rig.run(write(rig.remote, "0x60FF", 10_000))
    rig.bus.run(300 * MILLISECOND)


def halted_in_csp(rig: Rig) -> None:
    """Bit 12 falls while it is halted, and rises when a command without bit 8 has taken effect."""
    enabled_in(Mode.CYCLIC_SYNCHRONOUS_POSITION)(rig)
    rig.run(drive.halt(rig.axis))
    rig.bus.run(300 * MILLISECOND)


WAITS = {
    "home": Waiting(lambda rig: drive.home(rig.axis), homing, Mode.HOMING, wait=SECOND // 2),
    "move_to": Waiting(
        lambda rig: drive.move_to(rig.axis, 3.0, timeout=60 * SECOND),
        enabled_in(1),
        Mode.PROFILE_POSITION,
        wait=SECOND,
    ),
    "start_interpolation": Waiting(
        lambda rig: drive.start_interpolation(rig.axis, CYCLE, sends_itself=True), enabled_in(7), Mode.INTERPOLATED_POSITION
    ),
    "start_cyclic_position": Waiting(
        lambda rig: drive.start_cyclic_position(rig.axis, CYCLE, sends_itself=True),
        halted_in_csp,
        Mode.CYCLIC_SYNCHRONOUS_POSITION,
    ),
    "change_state": Waiting(lambda rig: drive.enable(rig.axis), is_enabled=False, wait=2 * REACTION + REACTION // 2),
    "set_mode": Waiting(lambda rig: drive.set_mode(rig.axis, Mode.HOMING), enabled_in(1)),
    "quick_stop": Waiting(lambda rig: drive.quick_stop(rig.axis), enabled_in(1)),
    "halt": Waiting(lambda rig: drive.halt(rig.axis), running),
}


def command_by_somebody(word: int) -> Callable[[Rig], None]:
    """The drive obeys another master at once."""

    def happen(rig: Rig) -> None:
        now = rig.bus.now
        store = rig.node.values.store
        store[objects.CONTROLWORD] = word
        rig.drive._late.clear()  # type: ignore[attr-defined]
        rig.drive._obey(now, objects.CONTROLWORD, word)  # type: ignore[attr-defined]
        rig.bus.pump()

    return happen


def mode_by_somebody(rig: Rig) -> None:
    rig.node.values.store[objects.MODES_OF_OPERATION] = Mode.PROFILE_VELOCITY
    rig.drive._obey(rig.bus.now, objects.MODES_OF_OPERATION, Mode.PROFILE_VELOCITY)  # type: ignore[attr-defined]


CAUSES: dict[str, tuple[Callable[[Rig], None], type[ProcedureError]]] = {
    "quick stop": (command_by_somebody(0x02), drive.StateLostError),
    "disable": (command_by_somebody(0x00), drive.StateLostError),
    "fault": (lambda rig: rig.node.raise_fault(0x2310, rig.bus.now), drive.DriveInFaultError),
    "heartbeat lost": (lambda rig: rig.bus.detach(rig.device), drive.DriveLostError),
    "boot-up": (lambda rig: rig.bus.send("705#00"), drive.DriveLostError),
    "mode change": (mode_by_somebody, drive.ModeLostError),
}
REACHED = {
    ("quick_stop", "quick stop"), ("quick_stop", "disable"), ("halt", "quick stop"), ("halt", "disable"), ("halt", "fault"),
}  # fmt: skip
"""What is waited for is there then, and is no failure."""
NO_MATTER = {("change_state", "mode change"), ("set_mode", "mode change"), ("quick_stop", "mode change"), ("halt", "mode change")}
"""The mode is nothing that these need; set_mode goes on waiting for its own."""
CASES = [(name, cause) for name in WAITS for cause in CAUSES if (name, cause) not in NO_MATTER]


@pytest.mark.thorough(8)
@pytest.mark.parametrize("by_pdo", [False, True])
@pytest.mark.parametrize(("name", "cause"), CASES)
def test_a_wait_ends_as_soon_as_its_reason_is_there(name: str, cause: str, by_pdo: bool) -> None:
    waiting = WAITS[name]
    rig = rig_of(by_pdo)
    waiting.prepare(rig)
    request = rig.master.run(waiting.run(rig), rig.bus.now)
    rig.bus.run(waiting.wait)
    assert rig.master.runner.busy, "it does not wait any more"
    happen, kind = CAUSES[cause]
    at = rig.bus.now
    happen(rig)
    if (name, cause) in REACHED:
        rig.outcome(request)
        rig.drive.refresh(rig.bus.now)
        assert rig.drive.state is not State.OPERATION_ENABLED
        return
    error = error_of(rig, request)
    assert isinstance(error, kind), f"{type(error).__name__}: {error}"
    assert rig.bus.now - at <= AT_ONCE + allowed_for_clean_up(cause)


def allowed_for_clean_up(cause: str) -> int:
    """A move is halted after its end. That takes an SDO time-out of a node that is gone, and one or two more to ask it whether it
    has power; its ramp of a drive that moves; one that was started a moment ago is watched for `reaction_time`.
    """
    return {"heartbeat lost": 2 * SECOND, "boot-up": 1100 * MILLISECOND, "mode change": 5 * SECOND}.get(cause, 600 * MILLISECOND)


def error_of(rig: Rig, request: int) -> BaseException | None:
    ended = rig.outcome(request)  # type: ignore[arg-type]
    return ended.error if isinstance(ended, ProcedureFailed) else None


def rig_of(by_pdo: bool) -> Rig:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(reaction=REACTION))
    rig.run(write(rig.remote, "0x1017", HEARTBEAT // MILLISECOND))
    rig.remote.heartbeat.set_timeout(2 * HEARTBEAT, rig.bus.now)
    if by_pdo:
        rig.run(use_device_pdo(rig.remote, Direction.RPDO, 1))
        for number in (1, 2):
            rig.run(use_device_pdo(rig.remote, Direction.TPDO, number))
        rig.remote.enable_rpdo(1, rig.bus.now)
    return rig


@pytest.mark.thorough(6)
@pytest.mark.parametrize("by_pdo", [False, True])
@pytest.mark.parametrize("name", WAITS)
def test_without_a_cause_it_waits_to_its_end(name: str, by_pdo: bool) -> None:
    waiting = WAITS[name]
    rig = rig_of(by_pdo)
    waiting.prepare(rig)
    rig.run(waiting.run(rig))


@pytest.mark.thorough(2)
@pytest.mark.parametrize("beyond", [-4.0, 4.0])
def test_a_move_beyond_a_software_limit_is_told_with_the_limit(beyond: float) -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.run(drive.home(rig.axis))
    rig.node.values.store[objects.MIN_SOFTWARE_POSITION_LIMIT] = -90_000
    rig.node.values.store[objects.MAX_SOFTWARE_POSITION_LIMIT] = 90_000
    limit = r"0x607D:02 is 1.5708 \(90000 counts\)" if beyond > 0 else r"0x607D:01 is -1.5708 \(-90000 counts\)"
    with pytest.raises(drive.LimitReachedError, match=f"not at its target .*{limit}"):
        rig.run(drive.move_to(rig.axis, beyond, timeout=60 * SECOND))
    rig.run(drive.move_to(rig.axis, beyond / 4, timeout=60 * SECOND))
    with pytest.raises(drive.LimitReachedError, match=limit):
        rig.run(drive.move_to(rig.axis, beyond, timeout=60 * SECOND, relative=True))


@pytest.mark.thorough(3)
@pytest.mark.parametrize("reaction", [0, 100 * MILLISECOND, 900 * MILLISECOND])
def test_a_move_of_a_late_drive_ends_at_its_target(reaction: int) -> None:
    """It shows "target reached" of the move before until it has taken the next one."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(reaction=reaction))
    for target in (0.2, -0.1, -0.1):
        rig.run(drive.move_to(rig.axis, target, timeout=60 * SECOND))
        rig.drive.refresh(rig.bus.now)
        assert rig.drive._servo.position == pytest.approx(rig.axis.scale.to_counts(target), abs=11)
    rig.run(drive.move_to(rig.axis, 0.3, timeout=60 * SECOND, relative=True))
    rig.drive.refresh(rig.bus.now)
    assert rig.drive._servo.position == pytest.approx(rig.axis.scale.to_counts(0.2), abs=11)


def test_another_master_that_disables_a_drive_is_not_fought() -> None:
    """Enabling goes up; a drive that goes down meanwhile is somebody else's."""
    rig = rig_of(False)
    request = rig.master.run(drive.enable(rig.axis), rig.bus.now)
    rig.bus.run(2 * REACTION + REACTION // 2)
    command_by_somebody(0x00)(rig)
    error = error_of(rig, request)
    assert isinstance(error, drive.StateLostError)
    rig.bus.run(2 * SECOND)
    assert rig.drive.state is State.SWITCH_ON_DISABLED
