"""Each obstacle, planted into a drive, is named first by the error of whatever the drive does not do, with what to try."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.dictionary import Direction
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.view import view_of
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.network import Network
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoTransferError, StepTimeoutError
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.settings import Shape
from tests.drives.rig import CYCLE, Rig

TENTH = 100 * MILLISECOND
SHORT = AxisSettings(homing_method=35, state_timeout=5 * TENTH, reaction_time=TENTH, halt_time=TENTH)
STO = DriveBit(objects.DIGITAL_INPUTS, 31)


def move(axis: Axis) -> Procedure[None]:
    return drive.move_to(axis, 20_000, timeout=500 * MILLISECOND)


def home(axis: Axis) -> Procedure[None]:
    axis.settings = replace(axis.settings, homing_timeout=500 * MILLISECOND)
    return drive.home(axis)


def csp(axis: Axis) -> Procedure[float]:
    return drive.start_cyclic_position(axis, CYCLE, sends_itself=True)


def ip(axis: Axis) -> Procedure[float]:
    return drive.start_interpolation(axis, CYCLE, sends_itself=True)


def select(axis: Axis) -> Procedure[None]:
    return drive.set_mode(axis, Mode.PROFILE_VELOCITY)


Operation = Callable[[Axis], Procedure[object]]
OPERATIONS: dict[str, Operation] = {"enable": drive.enable, "mode": select, "move": move, "home": home, "csp": csp, "ip": ip}


class Stubborn:
    """A drive that is nothing but a table of numbers: it takes every write, and shows what it likes. node 5.

    refuses: index -> abort code of a write to it. deaf: it answers nothing.
    """

    def __init__(self, shown: dict[Mux, int], settings: AxisSettings = SHORT, refuses: dict[int, int] | None = None) -> None:
        self.shown = {objects.SUPPORTED_DRIVE_MODES: 0xFFFF, objects.POSITION_ACTUAL_VALUE: 0, objects.ERROR_CODE: 0, **shown}
        self.refuses = refuses or {}
        self.follows_mode = True
        self.deaf = False
        self.network = Network()
        self.remote = RemoteNode(self.network.out, 5, Rig(Shape.STANDARD, pdos=False).node.dictionary)
        self.network.attach(self.remote)
        self.axis = Axis(self.remote, settings)
        self.now: Time = SECOND

    def run(self, procedure: Procedure[object]) -> Exception:
        """Return what the procedure raised."""
        request_id = self.network.run(procedure, self.now)
        for _ in range(100_000):
            frames, events = self.network.drain(self.now)
            for event in events:
                if getattr(event, "request_id", None) == request_id:
                    error = getattr(event, "error", None)
                    assert error is not None, "it succeeded"
                    return error  # type: ignore[no-any-return]
            self.now += 200 * MICROSECOND
            for frame in frames:
                answer = self._answer(frame)
                if answer is not None:
                    self.network.receive(answer, self.now)
            if not frames:
                self.now = max(self.now, self.network.next_deadline())
                self.network.handle_timeout(self.now)
        raise AssertionError("it never ends")

    def _answer(self, frame: Frame) -> Frame | None:
        if frame.key != 0x605 or self.deaf:
            return None
        data = frame.data
        index, place = data[1] | data[2] << 8, data[1:4]
        key = mux(index, data[3])
        if data[0] >> 5 == 2:  # upload
            variable = self.remote.dictionary.get(index, data[3])
            if key not in self.shown:
                return Frame(0x585, b"\x80" + place + int(AbortCode.NO_SUCH_OBJECT).to_bytes(4, "little"))
            size = 4 if variable is None else (variable.bit_length or 32) // 8
            content = (self.shown[key] & (1 << 8 * size) - 1).to_bytes(size, "little").ljust(4, b"\0")
            return Frame(0x585, bytes([0x43 | 4 - size << 2]) + place + content)
        if index in self.refuses:
            return Frame(0x585, b"\x80" + place + self.refuses[index].to_bytes(4, "little"))
        value = int.from_bytes(data[4 : 8 - (data[0] >> 2 & 3)], "little")
        self.shown[key] = value
        if key == objects.MODES_OF_OPERATION and self.follows_mode:
            self.shown[objects.MODES_OF_OPERATION_DISPLAY] = value
        return Frame(0x585, b"\x60" + place + bytes(4))


def told(error: BaseException, obstacle: str, remedy: str) -> None:
    """The error is one account: the obstacle comes first, then what the drive showed, then what to try."""
    assert isinstance(error, drive.DriveError), repr(error)
    text = str(error)
    assert error.reason.startswith(obstacle), text
    assert remedy in error.remedy, text
    assert text == f"{error.failed}: {error.reason}; {error.view.describe()}. Try: {error.remedy}"
    assert error.failed.startswith("drive 5 ") or isinstance(error, SdoTransferError)
    assert len(text) < 800  # ten lines of a terminal


ENABLED, READY, DISABLED = 0x0237, 0x0231, 0x0250
NEED_POWER = ("enable", "home", "move", "csp", "ip")
FOLLOW = ("move", "csp", "ip")
MOVE = ("home", *FOLLOW)
SHOWN: dict[str, tuple[dict[Mux, int], AxisSettings, str, str, tuple[str, ...]]] = {
    "remote is 0": (
        {objects.STATUSWORD: 0x0050},
        SHORT,
        "it is under local control (bit 9",
        "at the drive",
        NEED_POWER,
    ),
    "no voltage": (
        {objects.STATUSWORD: 0x0240},
        SHORT,
        "its power stage has no voltage (bit 4",
        "motor supply",
        NEED_POWER,
    ),
    "STO in 60FD": (
        {objects.STATUSWORD: DISABLED, objects.DIGITAL_INPUTS: 1 << 31},
        replace(SHORT, sto_input=STO),
        "safe torque off is active (bit 31 of 0x60FD:00 is 1)",
        "release the emergency stop",
        NEED_POWER,
    ),
    "STO in a bit of the statusword": (
        {objects.STATUSWORD: DISABLED},
        replace(SHORT, sto_input=DriveBit(objects.STATUSWORD, 14, 0)),
        "safe torque off is active (bit 14 of 0x6041:00 is 0)",
        "STO inputs",
        NEED_POWER,
    ),
    "STO in an object of the maker": (
        {objects.STATUSWORD: DISABLED, mux(0x251A): 0x08},
        replace(SHORT, sto_input=DriveBit(mux(0x251A), 4, 0)),
        "safe torque off is active (bit 4 of 0x251A:00 is 0)",
        "STO inputs",
        NEED_POWER,
    ),
    "the brake holds": (
        {objects.STATUSWORD: ENABLED, mux(0x60FE, 1): 1},
        replace(SHORT, brake_bit=DriveBit(mux(0x60FE, 1), 0)),
        "its brake holds it (bit 0 of 0x60FE:01 is 1)",
        "supply of the brake",
        MOVE,
    ),
    "an internal limit": (
        {objects.STATUSWORD: ENABLED | 0x800},
        SHORT,
        "a limit of its own holds it (bit 11)",
        "away",
        FOLLOW,
    ),
    "following error": (
        {objects.STATUSWORD: ENABLED | 0x2000},
        SHORT,
        "its following error is too large (bit 13)",
        "blocked",
        ("move", "csp"),
    ),
    "not homed": ({objects.STATUSWORD: ENABLED}, SHORT, "this master has not homed it", "home it", FOLLOW),
}


@pytest.mark.thorough(3)
@pytest.mark.parametrize(("case", "operation"), [(case, each) for case, row in SHOWN.items() for each in row[4]])
def test_what_the_drive_shows_is_named(case: str, operation: str) -> None:
    shown, settings, obstacle, remedy, _ = SHOWN[case]
    stubborn = Stubborn(dict(shown), settings)
    error = stubborn.run(OPERATIONS[operation](stubborn.axis))
    told(error, obstacle, remedy)
    assert isinstance(error, StepTimeoutError)


def test_a_drive_that_shows_nothing_wrong_gets_no_false_reason() -> None:
    stubborn = Stubborn({objects.STATUSWORD: DISABLED})  # it has voltage, and simply does not obey
    error = stubborn.run(drive.enable(stubborn.axis))
    assert isinstance(error, drive.DriveTimeoutError)
    assert (error.reason, error.remedy) == ("", "more time, if it is only slow")
    assert "statusword 0x0250: switch on disabled, voltage enabled, remote; commanded 0x0006 (shutdown)" in str(error)


def test_a_move_that_takes_longer_than_it_may_gets_no_false_reason() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis.settings = SHORT
    with pytest.raises(drive.DriveTimeoutError, match="did not reach its target position within 0.1 s: statusword") as caught:
        rig.run(drive.move_to(rig.axis, 100_000, timeout=100 * MILLISECOND))
    assert (caught.value.reason, caught.value.remedy) == ("", "more time, if it is only slow")


REFUSED: dict[str, tuple[int, str, str]] = {
    "enable": (0x6040, "writing 0x6040:00", "in this NMT state"),
    "mode": (0x6060, "writing 0x6060:00", "some drives change their mode"),
    "home": (0x6060, "writing 0x6060:00", "some drives change their mode"),
    "move": (0x607A, "writing 0x607A:00", "look at its limits"),
}


@pytest.mark.parametrize("operation", REFUSED)
def test_a_refusal_bears_its_abort_code(operation: str) -> None:
    index, what, remedy = REFUSED[operation]
    stubborn = Stubborn({objects.STATUSWORD: DISABLED if index != 0x607A else ENABLED}, refuses={index: AbortCode.DEVICE_STATE})
    error = stubborn.run(OPERATIONS[operation](stubborn.axis))
    assert isinstance(error, drive.DriveAccessError)
    assert (error.index, error.abort_code, error.origin) == (index, AbortCode.DEVICE_STATE, AbortOrigin.PEER)
    assert f"node 5 refused {what}: abort 0x08000022" in error.failed
    assert remedy in error.remedy
    assert "statusword 0x" in str(error)


def test_a_mode_that_is_not_taken_up_tells_what_0x6060_holds() -> None:
    stubborn = Stubborn({objects.STATUSWORD: ENABLED, objects.MODES_OF_OPERATION_DISPLAY: 1})
    stubborn.follows_mode = False
    error = stubborn.run(select(stubborn.axis))
    assert isinstance(error, drive.ModeUnsupportedError)
    told(
        error,
        "profile velocity (pv) was selected, but it shows profile position (pp)",
        "some drives change their mode only while",
    )


@pytest.mark.parametrize("operation", OPERATIONS)
def test_a_silent_drive(operation: str) -> None:
    stubborn = Stubborn({})
    stubborn.deaf = True
    error = stubborn.run(OPERATIONS[operation](stubborn.axis))
    told(error, "it is silent", "its power, its cable and its node-ID")
    assert isinstance(error, SdoTransferError)


@pytest.mark.parametrize("operation", ["enable", "move", "home", "csp"])
def test_a_fault_bears_its_code_and_the_emergency(operation: str) -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis.settings = SHORT
    rig.node.raise_fault(0x8611, rig.bus.now, lasting=True)
    rig.bus.run(MILLISECOND)
    with pytest.raises(drive.DriveInFaultError) as caught:
        rig.run(OPERATIONS[operation](rig.axis))
    told(caught.value, "0x8611 following error", "reset the fault")
    assert "error code 0x8611" in str(caught.value)
    assert "last EMCY 0x8611" in str(caught.value)


def test_a_fault_that_stays_says_so() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.node.raise_fault(0x4310, rig.bus.now, lasting=True)
    rig.bus.run(MILLISECOND)
    with pytest.raises(drive.DriveInFaultError, match="that a fault reset did not clear: 0x4310") as caught:
        rig.run(drive.reset_fault(rig.axis))
    told(caught.value, "0x4310", "find the cause")


@pytest.mark.parametrize("operation", ["enable", "move", "csp"])
def test_a_stopped_node(operation: str) -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.run(drive.read_statusword(rig.axis))
    rig.bus.run(SECOND)
    rig.nmt.stop(5, rig.bus.now)
    with pytest.raises(drive.DriveError) as caught:
        rig.run(OPERATIONS[operation](rig.axis))
    told(caught.value, "its NMT state is stopped", "start it")


def test_set_points_that_no_pdo_brings() -> None:
    rig = Rig(Shape.STANDARD)
    rig.start_sync()
    rig.nmt.enter_pre_operational(5, rig.bus.now)
    with pytest.raises(drive.DriveError) as caught:
        rig.run(drive.start_interpolation(rig.axis, CYCLE))
    told(caught.value, "RPDOs are sent to a node that is Operational, and this one is PRE_OPERATIONAL", "NMT start")


def test_a_reference_that_is_lost() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis.settings = SHORT
    rig.run(drive.home(rig.axis))
    rig.axis.is_homed = False
    for operation in (move, csp, ip):
        with pytest.raises(drive.ReferenceLostError) as caught:
            rig.run(operation(rig.axis))
        told(caught.value, "it was homed, and then reset or without power", "home it again")


# ---- what another master does ----


class Foreign:
    """Another master on the bus of a Rig."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.network = rig.bus.attach(Network())
        self.remote = RemoteNode(self.network.out, 5, rig.node.dictionary)
        self.network.attach(self.remote)

    def write(self, key: Mux, value: int) -> None:
        self.remote.write(key, value, self.rig.bus.now)
        self.rig.bus.run(5 * MILLISECOND)


def rig_in_motion() -> tuple[Rig, Foreign]:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis.settings = replace(SHORT, homing_method=17)
    return rig, Foreign(rig)


def raised_by(rig: Rig, procedure: Procedure[object], do: Callable[[], None]) -> BaseException:
    """Run a procedure, and do something 120 ms after it began; return what it raised."""
    request_id = rig.master.run(procedure, rig.bus.now)
    rig.bus.run(120 * MILLISECOND)
    do()
    ended = rig.outcome(request_id)
    error: BaseException = getattr(ended, "error")  # noqa: B009 - it must have failed
    return error


def test_a_halt_by_another_master() -> None:
    rig, foreign = rig_in_motion()
    error = raised_by(rig, drive.move_to(rig.axis, 2_000_000, timeout=SECOND), lambda: foreign.write(objects.CONTROLWORD, 0x010F))
    told(error, "another master commanded 0x010F (enable operation, halt) ", "end the other master")
    assert error.reason.endswith("ms ago by SDO")  # type: ignore[attr-defined]


@pytest.mark.parametrize("operation", ["move", "home"])
def test_a_shutdown_by_another_master(operation: str) -> None:
    rig, foreign = rig_in_motion()
    error = raised_by(rig, OPERATIONS[operation](rig.axis), lambda: foreign.write(objects.CONTROLWORD, 0x0006))
    assert isinstance(error, drive.StateLostError)
    told(error, "another master commanded 0x0006 (shutdown) ", "end the other master")


def test_a_shutdown_by_the_rpdo_of_another_master() -> None:
    rig, _ = rig_in_motion()
    rig.run(use_device_pdo(rig.remote, Direction.RPDO, 1))
    error = raised_by(rig, drive.home(rig.axis), lambda: rig.bus.send("205#0600"))
    assert isinstance(error, drive.StateLostError)
    told(error, "another master commanded 0x0006 (shutdown) ", "end the other master")
    assert error.reason.endswith(" ms ago by RPDO 0x205")


def test_the_rpdo_of_another_master_that_only_the_file_knows() -> None:
    rig, _ = rig_in_motion()  # we send no RPDO ourselves
    error = raised_by(rig, drive.home(rig.axis), lambda: rig.bus.send("205#0600"))
    told(error, "another master commanded 0x0006 (shutdown) ", "end the other master")


def test_a_pdo_without_a_command_is_nobodys_fault() -> None:
    """Another device may send the drive a PDO that has nothing to do with commands."""
    rig, _ = rig_in_motion()
    rig.run(drive.select_motionless_mode(rig.axis))
    rig.run(drive.enable(rig.axis))
    carries = Mapping([MappedEntry.of(rig.node.dictionary.variable(objects.TARGET_POSITION))])
    rig.remote.add_rpdo(2, 0x305, carries, 255)  # type: ignore[arg-type]
    rig.bus.send("305#06000000")
    rig.run(drive.read_statusword(rig.axis))
    assert view_of(rig.axis).foreign is None


def test_another_mode_by_another_master() -> None:
    rig, foreign = rig_in_motion()
    error = raised_by(rig, move(rig.axis), lambda: foreign.write(objects.MODES_OF_OPERATION, Mode.PROFILE_VELOCITY))
    assert isinstance(error, drive.ModeLostError)
    told(error, "another master selected profile velocity (pv) ", "0x6060")


def test_an_rpdo_that_does_not_reach_the_drive() -> None:
    """It has another CAN-ID there, so that no controlword comes."""
    rig = Rig(Shape.STANDARD, pdos=False)
    entries = Mapping([MappedEntry.of(rig.node.dictionary.variable(objects.CONTROLWORD))])
    rig.remote.add_rpdo(1, 0x3A5, entries, 255)  # type: ignore[arg-type]
    rig.remote.enable_rpdo(1, rig.bus.now)
    with pytest.raises(drive.DriveTimeoutError) as caught:
        rig.run(drive.enable(rig.axis))
    told(caught.value, "its RPDO 1, which carries the controlword, does not reach it: its controlword is 0x0000", "mapping")


@pytest.mark.parametrize(("halts", "word"), [(True, "0x010F"), (False, "0x000F")])
def test_a_drive_that_has_left_operational_unheard(halts: bool, word: str) -> None:
    """As one whose master's heartbeat came too late: it takes no RPDO, and still has what came by SDO."""
    rig = Rig(Shape.SCHUNK_POWERBALL)
    if halts:
        rig.run(drive.enable(rig.axis))
    rig.start_sync()
    rig.bus.send("000#8005")
    with pytest.raises(drive.DriveTimeoutError) as caught:
        rig.run(drive.start_interpolation(rig.axis, CYCLE))
    told(
        caught.value, f"its RPDO 1, which carries the controlword, does not reach it: its controlword is {word}", "start it (NMT)"
    )


def test_what_agrees_with_us_or_is_long_ago_is_no_reason() -> None:
    rig, foreign = rig_in_motion()
    rig.run(drive.select_motionless_mode(rig.axis))
    rig.run(drive.enable(rig.axis))
    foreign.write(objects.CONTROLWORD, rig.axis.controlword)
    assert view_of(rig.axis).foreign is None
    foreign.write(objects.CONTROLWORD, 0x010F)
    rig.run(drive.read_statusword(rig.axis))
    assert str(view_of(rig.axis).foreign).startswith("another master commanded 0x010F")
    rig.bus.run(6 * SECOND)
    rig.run(drive.read_statusword(rig.axis))
    assert view_of(rig.axis).foreign is None
    foreign.write(objects.CONTROLWORD, 0x010F)
    rig.run(drive.command(rig.axis, 0x0007))  # ours came later, and counts
    assert view_of(rig.axis).foreign is None


def test_only_commands_of_others_are_listened_to() -> None:
    """No frame of another kind, and none of our own, reaches the machine that listens."""
    rig, foreign = rig_in_motion()
    assert set(rig.remote.foreign_writes.can_ids()) == {0x605, 0x205, 0x305, 0x405, 0x505}
    rig.run(drive.enable(rig.axis))
    foreign.remote.read(objects.STATUSWORD, rig.bus.now)
    foreign.write(objects.TARGET_POSITION, 7)
    for key in (objects.CONTROLWORD, objects.MODES_OF_OPERATION):
        assert rig.remote.foreign_writes.last(key) is None
    assert not set(RemoteNode(Network().out, 5, rig.node.dictionary).foreign_writes.can_ids())


def test_a_bit_that_no_object_has_is_refused() -> None:
    for bit in (DriveBit(objects.DIGITAL_INPUTS, 64), DriveBit(objects.DIGITAL_INPUTS, 0, 2)):
        with pytest.raises(LocalProtocolError, match="sto_input: bit"):
            AxisSettings(sto_input=bit)
    with pytest.raises(LocalProtocolError, match="brake_bit"):
        AxisSettings(brake_bit=DriveBit(objects.DIGITAL_INPUTS, -1))


PROCEDURES = {
    name: member
    for name, member in ((name, getattr(drive, name)) for name in dir(drive))  # vars() lacks what nobody has asked for yet
    if inspect.isfunction(member) and next(iter(inspect.signature(member).parameters), "") == "axis"
}
OF_ERRORS = {"fault_of", "halt_after"}
"""They make errors, and clean up behind them."""


@pytest.mark.parametrize("name", sorted(PROCEDURES.keys() - OF_ERRORS))
def test_every_procedure_of_a_drive_gives_an_account_of_what_it_is_refused(name: str) -> None:
    assert hasattr(PROCEDURES[name], "__wrapped__"), f"drive.{name} is not @as_drive_errors"


def test_every_error_of_a_drive_is_one_account() -> None:
    errors = [
        each
        for each in (getattr(drive, name) for name in dir(drive))
        if isinstance(each, type) and issubclass(each, ProcedureError)
    ]
    assert len(errors) >= 10
    assert all(issubclass(each, drive.DriveError) for each in errors)
