"""Stop goes first: whatever frame is lost or late, the first frame of a stop stops the drive; success is told only if it did."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.abort import AbortOrigin
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.halting import halt_after
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import Command, ControlBit, State
from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Outbox, Outcome, RequestId, Time
from canopen_proto.network import Network
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFinished
from canopen_proto.procedures.steps import Cancelled, Procedure, SdoTransferError, sleep
from canopen_proto.remote_node import FRESH, RemoteNode
from canopen_proto.sdo.events import SdoAborted, SdoUploaded
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.core.bus import Fate
from tests.drives.rig import MILLIDEGREES, Rig
from tests.examples import examples

SPEED: Final = 50_000
ENDLESS: Final = Track(positive_limit=1e9)
HALT: Final = int(Command.ENABLE_OPERATION) | ControlBit.HALT
STOPS: Final[dict[str, tuple[Callable[[Axis], Procedure[None]], int]]] = {
    "quick stop": (drive.quick_stop, Command.QUICK_STOP),
    "disable": (drive.shut_down, Command.DISABLE_VOLTAGE),
    "brake": (drive.engage_brake, Command.SHUTDOWN),
}
FATES: Final = st.lists(st.sampled_from((Fate.DELIVERED, Fate.LOST, Fate.PAUSED, Fate.COPIED)), max_size=16)


def running() -> Rig:
    """A drive that runs at SPEED, without PDOs."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(track=ENDLESS))
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.run(drive.enable(rig.axis))
    rig.run(write(rig.remote, "0x60FF", SPEED))
    rig.bus.run(200 * MILLISECOND)
    return rig


def another_program(rig: Rig) -> tuple[Network, Axis]:
    """One that has just been started: it knows nothing of the drive."""
    network = rig.bus.attach(Network())
    remote = RemoteNode(network.out, 5, rig.node.dictionary)
    network.attach(remote)
    rig.bus.events.clear()  # its requests have the numbers of others
    return network, Axis(remote, MILLIDEGREES)


def words(rig: Rig, since: int = 0) -> list[int]:
    """The controlwords that were sent to the drive."""
    frames = [frame.data for _, frame in rig.bus.sent[since:] if frame.can_id == 0x605]
    return [int.from_bytes(data[4:6], "little") for data in frames if data[:4] == b"\x2b\x40\x60\x00"]


@pytest.mark.thorough(3)
@pytest.mark.parametrize("name", STOPS)
@given(fates=FATES, pause=st.sampled_from((MILLISECOND, 400 * MILLISECOND, 2 * SECOND)))
def test_the_first_frame_of_a_stop_is_one_that_stops(name: str, fates: list[Fate], pause: int) -> None:
    stop, word = STOPS[name]
    rig = running()
    network, axis = another_program(rig)
    sent = len(rig.bus.sent)
    rig.bus._pause, rig.bus._fates = pause, iter(fates)
    began = rig.bus.now
    request = network.run(stop(axis), rig.bus.now)
    ended = rig.outcome(request)
    at, first = rig.bus.sent[sent]
    assert (at, str(first)) == (began, f"605#2B406000{word:02X}000000")
    assert set(words(rig, sent)) <= {word, HALT, Command.QUICK_STOP}  # and no word that moves
    if isinstance(ended, ProcedureFinished):
        assert rig.drive.state is not State.OPERATION_ENABLED


@given(fates=FATES, pause=st.sampled_from((MILLISECOND, 400 * MILLISECOND, 2 * SECOND)), age=st.sampled_from((1, 90, 200, 5000)))
def test_a_halt_asks_no_longer_than_100_ms(fates: list[Fate], pause: int, age: int) -> None:
    """The word of a halt also enables: a drive that somebody else has disabled must not get it. So the drive is asked first."""
    rig = running()
    rig.run(drive.read_statusword(rig.axis))
    rig.bus.run(age * MILLISECOND)
    sent = len(rig.bus.sent)
    rig.bus._pause, rig.bus._fates = pause, iter(fates)
    began = rig.bus.now
    ended = rig.outcome(rig.master.run(drive.halt(rig.axis), began))
    assert words(rig, sent)[0] == HALT
    told = next(time for time, frame in rig.bus.sent[sent:] if frame.data[:4] == b"\x2b\x40\x60\x00")
    assert told - began <= (0 if age * MILLISECOND <= FRESH else FRESH)
    if isinstance(ended, ProcedureFinished):
        rig.drive.refresh(rig.bus.now)
        assert rig.drive._servo.velocity == 0


@pytest.mark.parametrize("state", [State.READY_TO_SWITCH_ON, State.SWITCHED_ON])
def test_a_halt_gives_no_power_to_a_drive_that_somebody_has_disabled(state: State) -> None:
    rig = running()
    rig.run(drive.read_statusword(rig.axis))
    network, other = another_program(rig)
    rig.outcome(network.run(drive.change_state(other, state), rig.bus.now))
    rig.bus.run(SECOND)
    sent = len(rig.bus.sent)
    rig.outcome(rig.master.run(drive.halt(rig.axis), rig.bus.now))
    assert HALT not in words(rig, sent)
    assert rig.drive.state is state


def test_a_halt_of_a_drive_of_which_nothing_is_known_and_heard_is_a_quick_stop() -> None:
    rig = running()
    network, axis = another_program(rig)
    sent = len(rig.bus.sent)
    rig.bus._fates = iter([Fate.LOST] * 2)  # the statusword is asked for; nobody hears that
    rig.outcome(network.run(drive.halt(axis), rig.bus.now))
    assert words(rig, sent)[:1] == [Command.QUICK_STOP]
    assert rig.drive.state is not State.OPERATION_ENABLED
    assert rig.node.values[objects.CONTROLWORD] == Command.QUICK_STOP


@pytest.mark.parametrize("name", STOPS)
def test_a_stop_without_an_answer_is_sent_again_and_is_urgent(name: str) -> None:
    stop, word = STOPS[name]
    rig = running()
    network, axis = another_program(rig)
    sent = len(rig.bus.sent)
    rig.bus._fates = iter([Fate.LOST] * 2)
    began = rig.bus.now
    assert isinstance(rig.outcome(network.run(stop(axis), rig.bus.now)), ProcedureFinished)
    times = [time for time, frame in rig.bus.sent[sent:] if frame.data[:6] == bytes((0x2B, 0x40, 0x60, 0, word, 0))]
    assert times[1] - began <= axis.node.sdo.timeout + 2 * MILLISECOND  # it does not wait for the late answer to the first one
    assert rig.drive.state is not State.OPERATION_ENABLED


@pytest.mark.thorough(2)
@pytest.mark.parametrize("name", [*STOPS, "halt"])
@given(fates=FATES)
@example([Fate.DELIVERED, Fate.COPIED, Fate.LOST])
def test_the_answer_to_the_word_before_makes_no_stop_a_success(name: str, fates: list[Fate]) -> None:
    """It comes twice, right where the answer to the stop is due: a stop asks no question, and what the drive shows counts."""
    stop = drive.halt if name == "halt" else STOPS[name][0]
    rig = running()
    rig.bus._pause, rig.bus._fates = MILLISECOND, iter(fates)

    def both() -> Procedure[None]:
        yield from write(rig.remote, objects.CONTROLWORD, int(Command.ENABLE_OPERATION))
        yield from stop(rig.axis)

    if isinstance(rig.outcome(rig.master.run(both(), rig.bus.now)), ProcedureFinished):
        rig.drive.refresh(rig.bus.now)
        assert rig.drive.state is not State.OPERATION_ENABLED if name in STOPS else rig.drive._servo.velocity == 0


def outcomes(rig: Rig, request_id: RequestId) -> list[Any]:
    return [each for each in rig.bus.events if isinstance(each, Outcome) and each.request_id == request_id]


@pytest.mark.parametrize("name", [*STOPS, "halt"])
@pytest.mark.parametrize("other", ["segments", "blocks", "no answer"])
def test_no_stop_waits_for_the_end_of_another_transfer(name: str, other: str) -> None:
    stop, word = (drive.halt, HALT) if name == "halt" else STOPS[name]
    rig = running()
    rig.node.values[0x1008_00] = "x" * 1_000_000
    began = rig.bus.now
    rig.bus._fates = iter([Fate.LOST] if other == "no answer" else [])
    patience = 60 * SECOND  # a caller's own
    request_id = rig.remote.sdo.upload(0x1008, 0, began, block=other == "blocks", timeout=patience)
    rig.bus.run(MILLISECOND)
    sent = len(rig.bus.sent)
    assert isinstance(rig.outcome(rig.master.run(stop(rig.axis), rig.bus.now)), ProcedureFinished)
    start = bytes((0x2B, 0x40, 0x60, 0)) + int(word).to_bytes(2, "little")
    first = next(time for time, frame in rig.bus.sent[sent:] if frame.data[:6] == start)
    assert first - began <= 2 * FRESH  # of a halt it may be that the statusword is asked for first, in vain
    (ended,) = outcomes(rig, request_id)
    assert (type(ended), ended.origin) == (SdoAborted, AbortOrigin.CANCELLED)
    assert "given up: a stop of its drive went before it" in str(SdoTransferError(ended, "reading"))


def test_a_stop_lets_a_transfer_of_a_few_frames_come_to_its_end() -> None:
    rig = running()
    rig.node.values[0x1008_00] = "x" * 200
    request_id = rig.remote.sdo.upload(0x1008, 0, rig.bus.now)
    rig.run(drive.quick_stop(rig.axis))
    (ended,) = outcomes(rig, request_id)
    assert (type(ended), len(ended.data)) == (SdoUploaded, 200)


STRANGERS: Final = ("4008100000000000", "6000000000000000", "0001020304050607", "8008100000000405", "A408100002000000")


@pytest.mark.parametrize("name", [*STOPS, "halt"])
@examples(60, least=12)
@given(request=st.sampled_from(STRANGERS), after=st.integers(0, 2000), is_lost=st.booleans())
def test_one_frame_of_another_sdo_client_keeps_no_drive_running(name: str, request: str, after: int, is_lost: bool) -> None:
    """after: us from the stop to that frame. is_lost: the server does not hear the first word, as many do in a transfer."""
    stop = drive.halt if name == "halt" else STOPS[name][0]
    rig = running()
    deliver = rig.bus._deliver
    lost: list[Frame] = []

    def deaf(receiver: Outbox, frame: Frame) -> None:
        if is_lost and not lost and frame.data[:4] == b"\x2b\x40\x60\x00":
            lost.append(frame)
        else:
            deliver(receiver, frame)

    rig.bus._deliver = deaf  # type: ignore[method-assign]
    asked = rig.master.run(stop(rig.axis), rig.bus.now)
    rig.bus.run(after * MICROSECOND)
    rig.bus.send(f"605#{request}")
    rig.outcome(asked)
    rig.bus.run(3 * SECOND)
    rig.drive.refresh(rig.bus.now)
    assert rig.drive.state is not State.OPERATION_ENABLED if name in STOPS else rig.drive._servo.velocity == 0


@pytest.mark.parametrize("name", STOPS)
def test_a_stop_reaches_a_drive_that_hears_nobody_else_in_a_strangers_transfer(name: str) -> None:
    """As in much firmware: during a segmented transfer it hears no initiate request, of whomever. An abort ends that."""
    rig = running()
    deliver = rig.bus._deliver
    is_deaf = False

    def receive(receiver: Outbox, frame: Frame) -> None:
        nonlocal is_deaf
        if frame.can_id == 0x605 and receiver is rig.device.out:
            is_deaf = is_deaf and frame.data[0] != 0x80
            if is_deaf and frame.data[0] in (0x2B, 0x40):
                return
        deliver(receiver, frame)

    rig.bus._deliver = receive  # type: ignore[method-assign]
    rig.bus.send("605#4008100000000000")
    rig.bus.run(MILLISECOND)
    is_deaf = True
    asked = rig.master.run(STOPS[name][0](rig.axis), rig.bus.now)
    for toggle in (0x60, 0x70) * 5:  # it reads on, without a heed to anybody
        rig.bus.run(5 * MILLISECOND)
        rig.bus.send(f"605#{toggle:02X}00000000000000")
    rig.outcome(asked)
    rig.bus.run(3 * SECOND)
    rig.drive.refresh(rig.bus.now)
    assert rig.drive.state is not State.OPERATION_ENABLED


@pytest.mark.parametrize("name", STOPS)
def test_a_stop_without_an_answer_is_sent_again_to_a_drive_that_has_just_shown_its_state(name: str) -> None:
    rig = running()
    rig.run(drive.read_statusword(rig.axis))
    deliver = rig.bus._deliver
    lost: list[Frame] = []

    def receive(receiver: Outbox, frame: Frame) -> None:
        if not lost and frame.data[:4] == b"\x2b\x40\x60\x00":
            lost.append(frame)
        else:
            deliver(receiver, frame)

    rig.bus._deliver = receive  # type: ignore[method-assign]
    asked = rig.master.run(STOPS[name][0](rig.axis), rig.bus.now)
    assert isinstance(rig.outcome(asked), ProcedureFinished)
    assert lost
    assert rig.drive.state is not State.OPERATION_ENABLED


@pytest.mark.thorough(3)
@pytest.mark.parametrize("name", STOPS)
def test_another_client_of_long_ago_makes_no_stop_doubtful(name: str) -> None:
    """A stranger once read an object; much later the answer to the first word is lost."""
    stop, _ = STOPS[name]
    rig = running()
    rig.bus.send("605#4008100000000000")
    rig.bus.run(60 * SECOND)
    rig.bus._fates = iter([Fate.DELIVERED, Fate.LOST])
    for _ in range(2):
        assert isinstance(rig.outcome(rig.master.run(stop(rig.axis), rig.bus.now)), ProcedureFinished)
        rig.bus.run(5 * SECOND)
    assert rig.drive.state is not State.OPERATION_ENABLED


@pytest.mark.parametrize("before", [State.SWITCHED_ON, State.QUICK_STOP_ACTIVE])
@given(
    reaction=st.integers(0, 2_400).map(lambda ms: ms * MILLISECOND),
    after=st.integers(0, 3_200).map(lambda ms: ms * MILLISECOND),
    is_known=st.booleans(),
    is_clean_up=st.booleans(),
)
@example(1_300 * MILLISECOND, 50 * MILLISECOND, True, False)
@example(1_300 * MILLISECOND, 50 * MILLISECOND, True, True)
@example(2_400 * MILLISECOND, 50 * MILLISECOND, False, False)
@examples(10)
def test_behind_a_command_to_enable_that_may_still_act_a_halt_leaves_one_that_stops(
    before: State, reaction: Time, after: Time, is_known: bool, is_clean_up: bool
) -> None:
    """is_known: whether the master has seen how late the drive acts. is_clean_up: the halt is that of a cancelled motion."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(track=ENDLESS, reaction=reaction))
    rig.node.values.store[objects.QUICK_STOP_OPTION_CODE] = 6
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.run(drive.enable(rig.axis))
    rig.run(write(rig.remote, "0x60FF", SPEED))
    rig.run(drive.quick_stop(rig.axis) if before is State.QUICK_STOP_ACTIVE else drive.change_state(rig.axis, before))
    rig.bus.run(5 * SECOND)
    if not is_known:
        rig.master, rig.axis = another_program(rig)
    sent = len(rig.bus.sent)
    enables = drive.enable(rig.axis)
    request = rig.master.run(halted_when_cancelled(rig.axis, enables) if is_clean_up else enables, rig.bus.now)
    rig.bus.run_until(lambda: bool(words(rig, sent)), SECOND)
    rig.bus.run(after)
    rig.master.cancel(request, rig.bus.now)
    ended = rig.outcome(request)
    is_halted = isinstance(ended, ProcedureCancelled) and ended.clean_up_error is None
    if not is_clean_up:
        is_halted = isinstance(rig.outcome(rig.master.run(drive.halt(rig.axis), rig.bus.now)), ProcedureFinished)
    assert is_halted
    assert words(rig, sent)[-1] in (HALT, Command.SWITCH_ON, Command.QUICK_STOP)
    rig.bus.run(reaction + SECOND)
    rig.drive.refresh(rig.bus.now)
    assert rig.drive._servo.velocity == 0


def halted_when_cancelled(axis: Axis, motion: Procedure[None]) -> Procedure[None]:
    try:
        yield from motion
        yield from sleep(60 * SECOND)
    except Cancelled as cancelled:
        yield from halt_after(axis, cancelled)
        raise
