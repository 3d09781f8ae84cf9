"""Our master's side of a drive leads a minimal drive on the `LocalNode` of canopen 2.4.1: states, pp, pv, homing, faults."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import SECOND
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.runner import ProcedureFailed
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from tests.interop.driver import Driver
from tests.interop.peer import new_channel, peer_dictionary, peer_network
from tests.interop.peer_drive import PeerDrive
from tests.simulation import cia402_oracle as cia402

NODE = 5
HAS = (
    0x1000,
    0x1001,
    0x1017,
    0x1018,
    0x603F,
    0x6040,
    0x6041,
    0x6060,
    0x6061,
    0x6064,
    0x606C,
    0x607A,
    0x6081,
    0x6098,
    0x60FF,
    0x6502,
)
SETTINGS = AxisSettings(homing_method=35, state_timeout=20 * SECOND, homing_timeout=20 * SECOND, reaction_time=SECOND // 10)


class Rig:
    """The axis, and the drive that it leads."""

    def __init__(self, driver: Driver, axis: Axis, peer: PeerDrive) -> None:
        self.driver = driver
        self.axis = axis
        self.drive = peer

    def run(self, procedure: Procedure[object]) -> None:
        self.driver.run(procedure)

    def error_of(self, procedure: Procedure[object]) -> BaseException:
        outcome = self.driver.outcome(lambda now: self.driver.network.run(procedure, now))
        assert isinstance(outcome, ProcedureFailed), outcome
        return outcome.error


@pytest.fixture
def rig() -> Iterator[Rig]:
    channel = new_channel()
    driver = Driver(channel)
    whole = drive_dictionary()
    dictionary = ObjectDictionary([whole.objects[index] for index in HAS])
    with peer_network(channel) as peer:
        node = peer.create_node(NODE, peer_dictionary(dictionary, NODE))
        node.sdo.RESPONSE_TIMEOUT = 20
        remote = driver.add(lambda out: RemoteNode(out, NODE, dictionary, sdo_timeout=5 * SECOND))
        with driver:
            yield Rig(driver, Axis(remote, SETTINGS), PeerDrive(node))


@pytest.mark.parametrize("target", [cia402.READY, cia402.SWITCHED_ON, cia402.ENABLED])
def test_up_and_down(rig: Rig, target: str) -> None:
    rig.run(drive.change_state(rig.axis, State(target)))
    assert rig.drive.state == rig.axis.state == target
    rig.run(drive.shut_down(rig.axis))
    assert rig.drive.state == rig.axis.state == cia402.DISABLED


def test_a_quick_stop(rig: Rig) -> None:
    rig.run(drive.enable(rig.axis))
    rig.run(drive.quick_stop(rig.axis))
    assert rig.drive.state == rig.axis.state == cia402.QUICK_STOP
    rig.run(drive.enable(rig.axis))
    assert rig.drive.state == cia402.ENABLED


def test_moves_by_the_handshake_of_profile_position(rig: Rig) -> None:
    rig.run(drive.move_to(rig.axis, 1000, timeout=20 * SECOND))
    assert (rig.drive.position, rig.drive.state, rig.drive.mode) == (1000, cia402.ENABLED, 1)
    rig.run(drive.move_to(rig.axis, -200, timeout=20 * SECOND, relative=True))
    assert rig.drive.position == 800
    edges = [now & ~before & 0x10 for before, now in zip([0, *rig.drive.words], rig.drive.words, strict=False)]
    assert edges.count(0x10) == 2
    assert not rig.drive.words[-1] & 0x10


def test_homes(rig: Rig) -> None:
    rig.run(drive.home(rig.axis))
    assert rig.axis.is_homed
    assert rig.drive.homed
    assert (rig.drive.values[0x6098], rig.drive.position) == (35, 0)


def test_a_homing_that_fails(rig: Rig) -> None:
    rig.drive.fails_homing = True
    error = rig.error_of(drive.home(rig.axis))
    assert isinstance(error, drive.HomingError)
    assert "homing error" in str(error)
    assert not rig.axis.is_homed
    assert rig.drive.word & 0x0100  # halted


def test_runs_at_a_velocity_and_halts(rig: Rig) -> None:
    rig.run(drive.set_mode(rig.axis, 3))
    rig.run(write(rig.axis.node, "0x60FF", 30))
    rig.run(drive.enable(rig.axis))
    rig.run(drive.wait_for_statusword(rig.axis, lambda word: word & 0x1400 == 0x0400, 20 * SECOND, "its speed", mode=3))
    assert rig.drive.velocity == 30
    rig.run(drive.halt(rig.axis))
    assert (rig.drive.velocity, rig.drive.state) == (0, cia402.ENABLED)


def test_a_fault_is_told_and_reset_by_an_edge(rig: Rig) -> None:
    rig.run(drive.enable(rig.axis))
    rig.drive.fail(0x2310)
    error = rig.error_of(drive.move_to(rig.axis, 10, timeout=20 * SECOND))
    assert isinstance(error, drive.DriveInFaultError)
    assert "0x2310" in str(error)
    rig.drive.word = 0x80  # another master has left the bit set
    rig.run(drive.reset_fault(rig.axis))
    assert rig.drive.state == rig.axis.state == cia402.DISABLED
    rig.run(drive.move_to(rig.axis, 10, timeout=20 * SECOND))
    assert rig.drive.position == 10


def test_a_mode_that_it_does_not_have_or_does_not_take(rig: Rig) -> None:
    assert isinstance(rig.error_of(drive.set_mode(rig.axis, 8)), drive.ModeUnsupportedError)
    rig.drive.ignores_modes = True
    rig.axis.settings = AxisSettings(state_timeout=SECOND // 20)
    error = rig.error_of(drive.set_mode(rig.axis, 1))
    assert isinstance(error, drive.ModeUnsupportedError)
    assert "0x6061" in str(error)
