"""`canopen lss` that is interrupted, or sees devices that do not keep to the rules: what it says is what the devices have."""

from __future__ import annotations

import signal

import pytest
import trio

from canopen_cli.lss import rate
from canopen_cli.shared.problem import ExitCode
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.frame import frame_for_key
from canopen_proto.lss import bit_rate
from canopen_proto.lss.messages import FROM_MASTER, UNCONFIGURED, LssAddress, LssConfiguration, LssState
from canopen_proto.lss.scan import LssTool, Survey
from canopen_proto.lss.slave import LssSlave
from canopen_proto.machine import Time
from canopen_proto.procedures.steps import Procedure, current_time
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.servo import DriveSettings
from canopen_transports import TransportError
from canopen_transports.errors import BUS_LOST
from tests.builds import replaces_what_is_compiled
from tests.cli.cli_support import Alarm, Run, only_drive

DEMO = ("-b", "demo")
RATE = ("lss", "set-bitrate", "250k", "--present", "500k", "--yes", "--window", "10ms", *DEMO)
AFTER_THE_SWITCH = 3
"""The session in which the devices are looked for at their new bit rate: each has the bus, and its devices, anew."""
ADDRESS = "0x0:0xE5:0x10000:0x1"


def alone(monkeypatch: pytest.MonkeyPatch, alarm: Alarm) -> list[DriveNode]:
    return only_drive(monkeypatch, alarm, lambda out, node_id: DriveNode(out, node_id, DriveSettings()))


@pytest.mark.parametrize("at", [0.05, 0.25, 0.45, 0.65, 0.85])
def test_ctrl_c_leaves_no_device_selected(run: Run, alarm: Alarm, monkeypatch: pytest.MonkeyPatch, at: float) -> None:
    drives = alone(monkeypatch, alarm)
    alarm.set((at, signal.SIGINT))
    assert run("lss", "inquire", "only", *DEMO).status == ExitCode.INTERRUPTED
    assert drives[-1].lss.state is LssState.WAITING


@pytest.mark.parametrize("at", [0.3, 0.5, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3])
def test_ctrl_c_while_a_node_id_is_set_says_whether_the_device_may_have_it(
    run: Run, alarm: Alarm, monkeypatch: pytest.MonkeyPatch, at: float
) -> None:
    drives = alone(monkeypatch, alarm)
    alarm.set((at, signal.SIGINT))
    outcome = run("lss", "set-id", "5", "20", "--yes", *DEMO)
    assert outcome.status == ExitCode.INTERRUPTED, outcome.err
    slave = drives[-1].lss
    assert slave.state is LssState.WAITING
    assert slave.pending.node_id == slave.persistent.node_id
    assert ("nothing was written" in outcome.err) != (f"canopen lss inquire {ADDRESS}" in outcome.err), outcome.err
    if "nothing was written" in outcome.err:
        assert (slave.active.node_id, slave.persistent.node_id) == (5, 5)


def interrupt(alarm: Alarm, simulations: list[SimulatedDevices], session: int, seconds: float) -> None:
    """Send Ctrl-C so long after the bus was opened for the time `session`."""

    async def ring(simulation: SimulatedDevices) -> None:
        if len(simulations) == session:
            await trio.sleep(seconds)
            signal.raise_signal(signal.SIGINT)

    alarm.task = ring


@pytest.mark.parametrize(
    ("session", "at", "told"),
    [
        (1, 2.0, "nothing was switched"),
        (2, 0.05, "nothing was switched"),
        (2, 0.3, "nothing was switched"),
        (2, 1.2, "the devices may be at 250 kbit/s already, and our interface perhaps is not; nothing was stored"),
        (2, 2.2, "the devices were switched to 250 kbit/s, and our interface too; nothing was stored"),
        (3, 0.1, "the devices were switched to 250 kbit/s, and our interface too; nothing was stored"),
        (3, 0.5, "perhaps not all have stored it"),
    ],
)
def test_ctrl_c_says_which_bit_rate_the_devices_have(
    run: Run, alarm: Alarm, simulations: list[SimulatedDevices], session: int, at: float, told: str
) -> None:
    interrupt(alarm, simulations, session, at)
    outcome = run(*RATE)
    assert (outcome.status, told in outcome.err) == (ExitCode.INTERRUPTED, True), outcome.err
    slaves = [node.lss for node in simulations[-1].drives.values()]
    assert {slave.state for slave in slaves} == {LssState.CONFIGURATION if slaves[0].is_silent else LssState.WAITING}
    if told == "nothing was switched":
        assert {slave.pending for slave in slaves} <= {
            slave.pending._replace(bit_rate=each) for each in (0, 500) for slave in slaves
        }


def test_a_bit_rate_that_another_master_keeps_from_being_switched_is_taken_back(
    run: Run, simulations: list[SimulatedDevices], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the other one stores it, unseen, with the next node-ID that it gives."""

    def activate(tool: LssTool, delay: Time) -> Procedure[None]:
        now = yield from current_time()
        assert {node.lss.pending.bit_rate for node in simulations[-1].drives.values()} == {250}
        tool.master.receive(frame_for_key(FROM_MASTER, bytes(8)), now)
        return (yield from bit_rate.activate(tool, delay))

    monkeypatch.setattr(rate, "activate", activate)
    outcome = run(*RATE)
    assert "another LSS master is at work on this bus: it sent 7E5#0000000000000000" in outcome.err
    slaves = [node.lss for node in simulations[-1].drives.values()]
    assert {slave.pending.bit_rate for slave in slaves} == {500}
    assert {slave.state for slave in slaves} == {LssState.WAITING}


def test_a_bit_rate_is_not_changed_while_a_device_may_hide_others(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def survey(*arguments: object) -> Procedure[Survey]:
        yield from ()
        return Survey(again=LssAddress(0x360, 2, 3, 4))

    monkeypatch.setattr(rate, "survey", survey)
    outcome = run(*RATE)
    assert (outcome.status, "0x360:0x2:0x3:0x4 takes part in the fastscan though it is selected" in outcome.err) == (
        ExitCode.NO_ANSWER,
        True,
    ), outcome.err


@replaces_what_is_compiled
def test_nodes_that_take_part_in_a_fastscan_are_no_twins_of_themselves(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lely's slaves do so though they have a node-ID."""

    def takes_part(slave: LssSlave, *question: int) -> None:
        pairs = slave.active, slave.pending
        slave.active = slave.pending = LssConfiguration(UNCONFIGURED)
        fastscan(slave, *question)
        slave.active, slave.pending = pairs

    fastscan = LssSlave._fastscan
    monkeypatch.setattr(LssSlave, "_fastscan", takes_part)
    outcome = run(*RATE)
    assert "6 devices at 250 kbit/s" in outcome.err, outcome.err


def test_devices_that_missed_the_switch_are_left_with_no_bit_rate_that_a_later_store_would_keep(
    run: Run, simulations: list[SimulatedDevices], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(*arguments: object) -> Procedure[list[LssAddress]]:
        absent = yield from look(*arguments)
        return arguments[2][:1] if len(simulations) == AFTER_THE_SWITCH else absent

    look = rate.missing
    monkeypatch.setattr(rate, "missing", missing)
    outcome = run(*RATE, "--delay", "100ms")
    assert (outcome.status, "1 device missing at 250 kbit/s: back to 500" in outcome.err) == (ExitCode.PARTIAL, True), outcome.err
    assert "back at 500 kbit/s, all are there" in outcome.err
    assert {node.lss.pending.bit_rate for node in simulations[-1].drives.values()} == {500}


def test_a_bus_that_cannot_be_opened_at_the_new_bit_rate_hides_not_that_the_devices_have_it(
    run: Run, simulations: list[SimulatedDevices], monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(*arguments: object) -> object:
        if len(simulations) == AFTER_THE_SWITCH - 1:
            raise TransportError(BUS_LOST, "demo", "the adapter does not know 250 kbit/s")
        return open_lss(*arguments)

    open_lss = rate.open_lss
    monkeypatch.setattr(rate, "open_lss", opened)
    outcome = run(*RATE, "--delay", "100ms")
    assert "the adapter does not know 250 kbit/s" in outcome.err
    assert "the devices were switched to 250 kbit/s" in outcome.err
    assert "nothing was stored: power off and on brings 500 kbit/s back" in outcome.err
