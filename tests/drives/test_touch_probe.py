"""Touch probes, digital inputs and outputs, the brake and a second encoder: the master against the simulated drive."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from canopen_proto.dictionary.model import Object
from canopen_proto.drives.axis import (
    DigitalInputsChanged,
    Input,
    ProbeLatched,
    ProbeReading,
    ProbeSource,
    arm_probe,
    disarm_probe,
    enable,
    engage_brake,
    move_to,
    quick_stop,
    read_encoder,
    read_inputs,
    read_probe,
    set_outputs,
    shut_down,
    touch_probe,
    wait_for_probe,
    watch_inputs,
    watch_probe,
)
from canopen_proto.drives.axis.axis import Axis, AxisSettings
from canopen_proto.drives.axis.failures import DriveError
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.multiplexer import Mux
from canopen_proto.procedures.objects import read_int
from canopen_proto.procedures.steps import Procedure, ProcedureError, StepTimeoutError
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.drives.rig import Rig

TRACK = Track(
    home_switch=(20_000, 21_000),
    index_offset=100,
    index_distance=1_000,
    probes=((2_000.0, 3_000.0), (-5_000.0, -4_000.0)),
)
DEGREES = AxisSettings(counts_per_unit=1_000)


def rig_with(settings: AxisSettings = DEGREES, *, mechanics: Mechanics | None = None) -> Rig:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=0, track=TRACK, mechanics=mechanics))
    rig.axis.settings = settings
    return rig


def go(rig: Rig, *positions: float) -> None:
    for position in positions:
        rig.run(move_to(rig.axis, position, timeout=20 * SECOND))


def test_a_probe_latches_where_its_edge_is() -> None:
    rig = rig_with(AxisSettings(counts_per_unit=1_000, direction=-1, offset=500))  # position = (500 - counts) / 1000
    rig.run(arm_probe(rig.axis, positive=True, negative=True))
    assert rig.run(read_probe(rig.axis)) == ProbeReading(None, None)
    go(rig, -4.5)
    assert rig.run(read_probe(rig.axis)) == ProbeReading(-1.5, -2.5)
    assert rig.run(wait_for_probe(rig.axis, timeout=SECOND)) == ProbeReading(-1.5, -2.5)
    rig.run(arm_probe(rig.axis))  # anew: what was latched is forgotten
    assert rig.run(read_probe(rig.axis)) == ProbeReading(None, None)


def test_the_probes_do_not_disturb_each_other() -> None:
    rig = rig_with()
    rig.run(arm_probe(rig.axis, 1, source=ProbeSource.INDEX))
    rig.run(arm_probe(rig.axis, 2, negative=True))
    go(rig, -6)
    assert rig.run(read_probe(rig.axis, 2)) == ProbeReading(-4.0, -5.0)
    assert rig.run(read_probe(rig.axis, 1)).positive == pytest.approx(-0.9)
    rig.run(disarm_probe(rig.axis, 2))
    assert rig.run(read_probe(rig.axis, 2)) == ProbeReading(None, None)
    assert rig.run(read_probe(rig.axis, 1)).positive == pytest.approx(-0.9)


def test_each_edge_is_reported_once() -> None:
    rig = rig_with()
    rig.run(arm_probe(rig.axis, each=True, negative=True))
    watching = rig.master.run(watch_probe(rig.axis), rig.bus.now)
    go(rig, 5, 0, 5)
    rig.master.cancel(watching, rig.bus.now)
    told = [event for event in rig.bus.events if isinstance(event, ProbeLatched)]
    assert [(event.is_positive, event.position) for event in told] == [
        (True, 2.0), (False, 3.0), (True, 3.0), (False, 2.0), (True, 2.0), (False, 3.0),
    ]  # fmt: skip
    assert {event.missed for event in told} == {0}


def test_edges_that_are_passed_over_are_counted() -> None:
    rig = rig_with()
    rig.run(arm_probe(rig.axis, each=True, source=ProbeSource.INDEX))
    go(rig, 0.5)
    watching = rig.master.run(watch_probe(rig.axis, interval=10 * SECOND), rig.bus.now)
    go(rig, 8.5)
    rig.bus.run(11 * SECOND)
    rig.master.cancel(watching, rig.bus.now)
    (event,) = [event for event in rig.bus.events if isinstance(event, ProbeLatched)]
    assert (event.position, event.missed) == (8.1, 7)


@pytest.mark.parametrize(
    "arm", [lambda axis: arm_probe(axis, 3), lambda axis: arm_probe(axis, 0), lambda axis: arm_probe(axis, positive=False)]
)
def test_what_no_probe_can_do(arm: Callable[[Axis], Procedure[None]]) -> None:
    rig = rig_with()
    with pytest.raises(LocalProtocolError):
        rig.run(arm(rig.axis))


def test_a_source_that_the_drive_lacks_and_an_edge_that_does_not_come() -> None:
    rig = rig_with()
    with pytest.raises(ProcedureError, match="0x60B8"):
        rig.run(arm_probe(rig.axis, source=ProbeSource.SELECTED))
    rig.run(arm_probe(rig.axis))
    with pytest.raises(StepTimeoutError, match=r"latched nothing by touch probe 1 within 1 s.*Try: look at the probe's input"):
        rig.run(wait_for_probe(rig.axis, timeout=SECOND))


def test_a_drive_that_does_not_enable_its_probe(monkeypatch: pytest.MonkeyPatch) -> None:
    def shows_nothing(node: RemoteNode, key: Mux) -> Procedure[int]:
        value = yield from read_int(node, key)
        return 0 if key == objects.TOUCH_PROBE_STATUS else value

    monkeypatch.setattr(touch_probe, "read_int", shows_nothing)
    rig = rig_with()
    with pytest.raises(StepTimeoutError, match=r"did not show touch probe 1 as enabled \(0x60B9\)"):
        rig.run(arm_probe(rig.axis))


# ---- digital inputs, second encoder ----


def test_inputs_are_read_and_their_changes_told() -> None:
    rig = rig_with()
    assert rig.run(read_inputs(rig.axis)) == Input(0)
    watching = rig.master.run(watch_inputs(rig.axis), rig.bus.now)
    go(rig, 20.5, 0)
    rig.master.cancel(watching, rig.bus.now)
    told = [event for event in rig.bus.events if isinstance(event, DigitalInputsChanged)]
    probe = Input(1 << 16)
    home = Input.HOME
    assert [event.inputs for event in told] == [probe, Input(0), home, Input(0), probe, Input(0)]
    assert [event.changed for event in told] == [probe, probe, home, home, probe, probe]


def test_the_second_encoder_is_read() -> None:
    rig = rig_with()
    go(rig, 1)
    assert rig.run(read_encoder(rig.axis)) == pytest.approx(1_000, abs=11)
    with pytest.raises(ProcedureError, match="no 0x60E4:02"):
        rig.run(read_encoder(rig.axis, 2))


# ---- outputs and the brake ----

VERTICAL = Mechanics(load=5.0)


def brake_holds(rig: Rig) -> bool:
    return rig.drive._servo.holds_brake


def test_outputs_are_set_alone_and_before_their_mask() -> None:
    rig = rig_with()
    store = rig.node.values.store
    store[objects.DIGITAL_OUTPUTS], store[objects.DIGITAL_OUTPUT_MASK] = 1 << 20 | 1 << 16, 1 << 20
    rig.run(set_outputs(rig.axis, {16: False, 17: True}))
    assert store[objects.DIGITAL_OUTPUTS] == 1 << 20 | 1 << 17
    assert store[objects.DIGITAL_OUTPUT_MASK] == 1 << 20 | 1 << 17 | 1 << 16
    written = [frame.data[1:4] for _, frame in rig.bus.sent if frame.can_id == 0x605 and frame.data[0] == 0x23]
    assert written == [b"\xfe\x60\x01", b"\xfe\x60\x02"]
    with pytest.raises(LocalProtocolError, match="no output 32"):
        rig.run(set_outputs(rig.axis, {32: True}))


def test_the_brake_of_a_drive_without_power_is_not_opened_by_mistake() -> None:
    rig = rig_with(mechanics=VERTICAL)
    for _ in range(2):
        with pytest.raises(
            DriveError, match=r"was not told to open its brake: it has no power .*; nothing was sent.*cannot_fall=True"
        ):
            rig.run(set_outputs(rig.axis, {0: False, 16: True}))
        rig.bus.run(SECOND)
        assert rig.node.values.store[objects.DIGITAL_OUTPUTS] == 0
        assert rig.drive._servo.position == 0
        rig.run(engage_brake(rig.axis))  # ready to switch on: no power either
    rig.run(set_outputs(rig.axis, {0: True}))  # closing is always allowed
    assert brake_holds(rig)


def test_a_brake_that_is_opened_on_purpose_lets_the_axis_fall() -> None:
    """So the guard is worth something."""
    rig = rig_with(mechanics=VERTICAL)
    rig.run(set_outputs(rig.axis, {0: False}, cannot_fall=True))
    rig.bus.run(500 * MILLISECOND)
    assert rig.drive._servo.position < -1_000


@pytest.mark.parametrize("leave", [shut_down, engage_brake, quick_stop])
def test_the_drive_gets_its_brake_back_before_it_loses_its_power(leave: Callable[[Axis], Procedure[None]]) -> None:
    rig = rig_with(mechanics=VERTICAL)
    rig.run(enable(rig.axis))
    rig.run(set_outputs(rig.axis, {0: False}))
    assert rig.node.values.store[objects.DIGITAL_OUTPUT_MASK] == 1
    place = rig.drive._servo.position
    rig.run(leave(rig.axis))
    rig.bus.run(SECOND)
    assert rig.drive.state is not State.OPERATION_ENABLED
    assert rig.node.values.store[objects.DIGITAL_OUTPUT_MASK] == 0
    assert brake_holds(rig)
    assert rig.drive._servo.position == pytest.approx(place, abs=50)
    assert not rig.axis.has_opened_brake


def test_a_drive_without_a_mask_is_told_to_hold() -> None:
    rig = rig_with()
    count, outputs = (rig.remote.dictionary.variable(Mux(objects.DIGITAL_OUTPUTS + place)) for place in (-1, 0))
    rig.remote.dictionary = rig.remote.dictionary.with_objects([Object.of("digital_outputs", [count, outputs])])
    rig.run(enable(rig.axis))
    rig.run(set_outputs(rig.axis, {0: False, 16: True}))
    assert rig.node.values.store[objects.DIGITAL_OUTPUTS] == 1 << 16
    rig.run(shut_down(rig.axis))
    assert rig.node.values.store[objects.DIGITAL_OUTPUTS] == 1 << 16 | 1
