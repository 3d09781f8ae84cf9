"""`BaseNode402` of canopen 2.4.1 enables, homes and drives our simulated drive, in every mode that it has.

In real time, on a machine that may be busy: nothing depends on when something comes. 0x1006 gives SYNC a minute.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import pytest
from canopen.profiles.p402 import BaseNode402, OperationMode

from canopen_proto.drives.cia402.states import State
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from tests.interop.device_rig import NODE, Rig
from tests.interop.driver import Driver
from tests.interop.peer import new_channel, peer_network

PERIOD = 5  # ms, of SYNC
SYNC_PERIOD = 20_000_000  # us, of 0x1006
SHORT = Track(negative_limit=-2_000, positive_limit=9_000, home_switch=(1_000, 2_000), index_offset=500, index_distance=2_500)


class PatientNode402(BaseNode402):
    """With time enough for a machine under load."""

    TIMEOUT_RESET_FAULT = 0.5  # it always passes, by a fault of theirs
    TIMEOUT_SWITCH_OP_MODE = 20
    TIMEOUT_SWITCH_STATE_FINAL = 20
    TIMEOUT_SWITCH_STATE_SINGLE = 20
    TIMEOUT_CHECK_TPDO = 20


@contextmanager
def drive_on(track: Track) -> Iterator[Rig]:
    channel = new_channel()
    driver = Driver(channel)
    with peer_network(channel) as peer, driver:
        rig = Rig(driver, peer, lambda out: DriveNode(out, NODE, DriveSettings(position=0, track=track)), PatientNode402)
        for number in (1, 2):  # statusword, mode: by SYNC, since the peer knows only what a TPDO has told it
            pdo = rig.remote.tpdo[number]
            pdo.read()
            pdo.trans_type = 1
            pdo.save()
        rig.remote.sdo[0x1006].raw = SYNC_PERIOD
        rig.remote.setup_402_state_machine()
        rig.start()
        peer.sync.start(PERIOD / 1000)
        yield rig


@pytest.fixture
def drive() -> Iterator[Rig]:
    with drive_on(SHORT) as rig:
        yield rig


def drive_of(rig: Rig) -> DriveNode:
    assert isinstance(rig.device, DriveNode)
    return rig.device


def test_the_peer_enables_and_disables_our_drive(drive: Rig) -> None:
    remote = drive.remote
    for state, ours in [
        ("READY TO SWITCH ON", State.READY_TO_SWITCH_ON),
        ("SWITCHED ON", State.SWITCHED_ON),
        ("OPERATION ENABLED", State.OPERATION_ENABLED),
        ("SWITCH ON DISABLED", State.SWITCH_ON_DISABLED),
        ("OPERATION ENABLED", State.OPERATION_ENABLED),
    ]:
        remote.state = state
        assert drive_of(drive).drive.state is ours
        assert remote.state == state


POSITIVE_HOME = replace(SHORT, home_switch=(2_000, math.inf))
NEGATIVE_HOME = replace(SHORT, home_switch=(-math.inf, 2_000))


@pytest.mark.thorough(5)
@pytest.mark.parametrize(
    ("track", "methods"),
    [
        (SHORT, (1, 2, *range(7, 15), 17, 18, *range(23, 31), 33, 34, 35, 37)),
        (POSITIVE_HOME, (3, 4, 19, 20)),
        (NEGATIVE_HOME, (5, 6, 21, 22)),
    ],
)
def test_the_peer_homes_our_drive_by_each_method(track: Track, methods: tuple[int, ...]) -> None:
    with drive_on(track) as rig:
        remote = rig.remote
        for speed in (1, 2):
            remote.sdo[0x6099][speed].raw = 100_000
        remote.sdo[0x609A].raw = 10_000_000
        for method in methods:
            remote.op_mode = "PROFILED POSITION"
            remote.sdo[0x6098].raw = method
            remote.sdo[0x607C].raw = 100 + method
            assert any(remote.homing(timeout=20) for _ in range(3)), method  # it may take an older statusword for the answer
            assert remote.is_homed(), method
            rig.wait(partial(is_near, rig, 100 + method))


def is_near(rig: Rig, position: int) -> bool:
    return bool(abs(rig.remote.sdo[0x6064].raw - position) <= 10)


def shows(rig: Rig, index: int, value: int, sub: int = 0) -> bool:
    found = rig.remote.sdo[index]
    return bool((found[sub] if sub else found).raw == value)


def profile_position(rig: Rig) -> None:
    sdo = rig.remote.sdo
    start = sdo[0x6064].raw
    for word, target, end in ((0x1F, 500, 500), (0x3F, 300, 300), (0x5F, 100, 400)):  # waits, changes at once, is relative
        sdo[0x607A].raw = target if word == 0x5F else start + target
        rig.remote.controlword = word
        rig.wait(lambda: bool(sdo[0x6041].raw & 0x1000))  # set-point acknowledged
        rig.remote.controlword = word & ~0x10
        rig.wait(lambda: sdo[0x6041].raw & 0x1400 == 0x0400)  # ready for the next, target reached
        rig.wait(partial(is_near, rig, start + end))


def velocity(rig: Rig) -> None:
    sdo = rig.remote.sdo
    rig.remote.controlword = 0x7F
    for speed in (50, -50, 0):
        sdo[0x6042].raw = speed
        rig.wait(partial(shows, rig, 0x6044, speed))


def profile_velocity(rig: Rig) -> None:
    sdo = rig.remote.sdo
    for speed in (50, -50):
        sdo[0x60FF].raw = speed
        rig.wait(partial(shows, rig, 0x606C, speed))
        rig.wait(lambda: sdo[0x6041].raw & 0x1400 == 0x0400)
    rig.remote.controlword = 0x010F
    rig.wait(lambda: sdo[0x6041].raw & 0x1400 == 0x1400)  # it stands
    assert sdo[0x606C].raw == 0


def pushes(rig: Rig, torque: int) -> bool:
    return bool(rig.remote.sdo[0x6074].raw * torque > 0)


def torque(rig: Rig) -> None:
    sdo = rig.remote.sdo
    sdo[0x607F].raw = 50
    for target in (60, -60):
        sdo[0x6071].raw = target
        rig.wait(partial(pushes, rig, target))


def interpolated_position(rig: Rig) -> None:
    """The buffer is filled before, and each SYNC is sent when the axis is at the set-point before: none comes too early.

    It moves slowly, since it passes each set-point by the way that it needs to brake.
    """
    sdo, sync = rig.remote.sdo, rig.peer.sync
    start = sdo[0x6064].raw
    sdo[0x60C2][1].raw = 100  # ms
    sdo[0x60C4][6].raw = 1
    steps = (20, 40, 60, 80)
    for step in steps:
        sdo[0x60C1][1].raw = start + step
    rig.stop_sync()
    rig.remote.controlword = 0x1F
    rig.wait(lambda: bool(sdo[0x6041].raw & 0x1000))
    for number, step in enumerate(steps, 1):
        sync.transmit()
        rig.wait(partial(shows, rig, 0x60C4, len(steps) - number, 2))
        rig.wait(partial(is_near, rig, start + step))
    assert sdo[0x6041].raw & 0x1000
    sync.start(PERIOD / 1000)


def cyclic_position(rig: Rig) -> None:
    sdo = rig.remote.sdo
    rig.wait(lambda: bool(sdo[0x6041].raw & 0x1000))
    target = sdo[0x6064].raw
    for _ in range(5):
        target += 20
        sdo[0x607A].raw = target
        rig.wait(partial(is_near, rig, target))


def cyclic_velocity(rig: Rig) -> None:
    sdo = rig.remote.sdo
    for speed in (50, -50, 0):
        sdo[0x60FF].raw = speed
        rig.wait(partial(shows, rig, 0x606C, speed))


MOTIONS: dict[str, tuple[Callable[[Rig], None], dict[int, int]]] = {
    "PROFILED POSITION": (profile_position, {}),
    "VELOCITY": (velocity, {}),
    "PROFILED VELOCITY": (profile_velocity, {0x60FF: 0}),
    "PROFILED TORQUE": (torque, {0x6071: 0}),
    "INTERPOLATED POSITION": (interpolated_position, {}),
    "CYCLIC SYNCHRONOUS POSITION": (cyclic_position, {0x607A: 0}),
    "CYCLIC SYNCHRONOUS VELOCITY": (cyclic_velocity, {0x60FF: 0}),
    "CYCLIC SYNCHRONOUS TORQUE": (torque, {0x6071: 0}),
}
"""Mode -> how it moves, and what is written before it is enabled."""


def test_each_mode_that_the_peer_knows_is_driven() -> None:
    assert {*MOTIONS, "HOMING", "NO MODE"} == {*OperationMode.NAME2CODE}


@pytest.mark.thorough(4)
@pytest.mark.parametrize("mode", MOTIONS)
def test_the_peer_drives_our_drive_in_each_mode(drive: Rig, mode: str) -> None:
    move, before = MOTIONS[mode]
    remote = drive.remote
    for index, value in before.items():
        remote.sdo[index].raw = value
    remote.op_mode = mode
    assert remote.op_mode == mode
    assert drive_of(drive).drive.mode == OperationMode.NAME2CODE[mode]
    remote.state = "OPERATION ENABLED"
    move(drive)
    remote.state = "SWITCH ON DISABLED"
    assert drive_of(drive).drive.state is State.SWITCH_ON_DISABLED


def test_a_fault_of_our_drive_reaches_the_peer_and_is_reset(drive: Rig) -> None:
    remote, node = drive.remote, drive_of(drive)
    remote.state = "OPERATION ENABLED"
    drive.driver.do(lambda now: node.raise_fault(0x7320, now))
    drive.wait(lambda: remote.state == "FAULT")
    drive.wait(lambda: [error.code for error in remote.emcy.active] == [0x7320])
    assert remote.is_faulted()
    assert remote.sdo[0x603F].raw == 0x7320
    remote.reset_from_fault()
    assert remote.state == "OPERATION ENABLED"
    drive.wait(lambda: not remote.emcy.active)
