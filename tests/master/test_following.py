"""A joint that does not follow its set-points stops its chain, whatever the reason; the simulated drives know the truth.

The property, over all of CASES: the chain goes on with each joint within its limit, or ChainFaultError with joint and cause comes
within three cycles of the first PDO, or missing PDO, that shows it; then all joints stand within their ramps.
"""

from __future__ import annotations

import functools
import itertools
import math
import re
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace
from functools import partial

import pytest

from canopen_data import load_dictionary
from canopen_master import Chain, ChainFaultError, ChainSettings, ChainState, Host, open_master, simulate
from canopen_proto.drives.axis.axis import SCHUNK_POWERBALL, HomingStyle
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.objects import (
    FOLLOWING_ERROR_WINDOW,
    MODES_OF_OPERATION_DISPLAY,
    PROFILE_DECELERATION,
    QUICK_STOP_DECELERATION,
)
from canopen_proto.drives.cia402.states import State, state_of
from canopen_proto.frame import SDO_CLIENT_TO_SERVER, Frame
from canopen_proto.nmt import NmtState
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from canopen_transports import Transport
from tests.examples import takes_all
from tests.loops import loop
from tests.master.world import BUS, Link, chain_text, drives, position_of, value, virtual_time

DICTIONARY, _ = load_dictionary()
DICTIONARIES = {shape: drive_dictionary(shape) for shape in Shape}
PERIOD = 0.01
SPEED = 0.06  # rad/s, 3.4 degrees/s
LIMIT = 0.01  # rad
RAMP = 1_000  # degrees/s^2
VICTIM, OTHER = 3, 4
COUNTS = 180_000 / math.pi  # in a radian
SOFTWARE_LIMITS = (0x607D_01, 0x607D_02)
STRUCK, WATCHED = 2, 9  # the cycle in which a case happens (both joints move); how many are looked at then
EARLY, LATE = 0.05, 0.93  # of the cycle: behind the PDOs and before what is read, or before the next SYNC


def one_copy(frame: Frame, is_sent: bool) -> int:
    """Nothing happens on a line."""
    return 1


@dataclass
class Scene:
    """Two joints, each on a line of its own, and their master; its line's log is what it could know."""

    arm: Chain
    master_link: Link
    links: dict[int, Link]
    hosts: dict[int, Host]
    stranger: Transport
    objects: dict[int, int]  # of each drive: what was set up
    has_struck: bool = False

    def restore(self) -> None:
        """What the cases changed that `recover` leaves alone."""
        for node_id in self.hosts:
            self.node(node_id).values.store.update(self.objects)

    def node(self, node_id: int) -> DriveNode:
        return drives(self.hosts[node_id])[0]

    def true_position(self, node_id: int) -> float:
        """In radians, as the drive itself has it."""
        axis = next(device.axis for device in self.arm.devices if device.node.node_id == node_id)
        return axis.scale.from_counts(position_of(self.hosts[node_id], self.node(node_id)))


@asynccontextmanager
async def scene(is_standard: bool = False, limit: float | None = LIMIT, window: int = 10_000) -> AsyncIterator[Scene]:
    error: BaseException | None = None
    async with loop.open_nursery() as nursery:
        links, hosts = {}, {}
        for node_id in (VICTIM, OTHER):
            links[node_id] = Link()
            shape = Shape.STANDARD if is_standard else Shape.SCHUNK_POWERBALL
            make = partial(DriveNode, node_id=node_id, settings=DriveSettings(shape=shape), dictionary=DICTIONARIES[shape])
            hosts[node_id] = await nursery.start(simulate, links[node_id], [make])
        try:
            async with AsyncExitStack() as stack:
                master_link, stranger = Link(), Link()
                master = await stack.enter_async_context(
                    open_master(buses={BUS: master_link}, heartbeat_timeout=0.24, dictionary=DICTIONARY)
                )
                objects = {mux: value(drives(hosts[VICTIM])[0], mux) for mux in SOFTWARE_LIMITS}
                objects |= dict.fromkeys((PROFILE_DECELERATION, QUICK_STOP_DECELERATION), RAMP * 1000)
                objects[FOLLOWING_ERROR_WINDOW] = window
                homing = HomingStyle.STANDARD if is_standard else HomingStyle.SCHUNK
                axis = replace(SCHUNK_POWERBALL, homing=homing, following_error_limit=limit)
                settings = ChainSettings(cycle_time=PERIOD, define_pdos=is_standard)
                arm = master.load_chains(text=chain_text(VICTIM, OTHER, bus=BUS), settings=settings, axes=axis)["arm"]
                here = Scene(arm, master_link, links, hosts, stranger, objects)
                here.restore()
                await arm.initialise()
                await arm.enable_interpolated_position()
                yield here
        except BaseException as raised:  # noqa: BLE001 - raised below: not through the nursery, which would make a group of it
            error = raised
        nursery.cancel_scope.cancel()
    if error is not None:
        raise error


# ---- what happens ----

Frames = tuple[Frame, ...]


@dataclass
class Case:
    """What happens to the victim in one cycle. cause: what the ChainFaultError says; "" where the chain has to go on."""

    name: str
    frames: Frames | Callable[[int], Frames] = ()  # that a stranger sends; by where the victim is
    can_id: int = 0  # of the frame that is lost or doubled
    is_sent: bool = False  # by the victim
    copies: int = 1
    count: int = 1  # so many of them
    cause: str = ""
    may_go_on: bool = False  # with each joint within its limit: it depends on the drive
    refused_by_schunk: bool = False  # which goes on
    settles: int = 4  # within so many cycles and its ramp; the command to halt needs two

    def __str__(self) -> str:
        return self.name

    def expected(self, is_standard: bool) -> str:
        """What matches the reason of the ChainFaultError, or "" for a chain that went on."""
        cause = "" if self.refused_by_schunk and not is_standard else self.cause
        return f"({cause})?" if self.may_go_on else cause


FOR_EVER = 1_000_000


def sdo_write(index: int, subindex: int, value: int, size: int) -> Frame:
    data = value.to_bytes(4, "little", signed=value < 0)
    return Frame(0x600 + VICTIM, bytes((0x23 | (4 - size) << 2, index & 0xFF, index >> 8, subindex)) + data)


def software_limits(position: int) -> Frames:
    return sdo_write(0x607D, 2, position + 100, 4), sdo_write(0x607D, 1, position - 100, 4)


def csp_at_its_place(position: int) -> Frames:
    """Another mode that nothing but 0x6061 shows: bit 12 and the position go on as before."""
    return sdo_write(0x607A, 0, position, 4), sdo_write(0x6060, 0, 8, 1)


def nmt(command: int) -> Frame:
    return Frame(0x000, bytes((command, VICTIM)))


SILENT = "is silent: no PDO with its statusword for 30 ms, behind 3 SYNCs"
FOLLOWS = "(no longer follows its set-points: bit 12|is [0-9.]+ off its path).*"
LEFT = "left operation enabled by itself.*"
MODE = "changed its mode of operation: 0x6061 shows .*"
NMT_STATE = f"left NMT state Operational.*|{SILENT}"
KINDS = {
    "TPDO": (0x180 + VICTIM, True),
    "SDO request": (0x600 + VICTIM, False),
    "SDO answer": (0x580 + VICTIM, True),
    "heartbeat": (0x700 + VICTIM, True),
}
CASES = [
    *(
        Case(f"{kind} {what}", (), can_id, is_sent, copies)
        for kind, (can_id, is_sent) in KINDS.items()
        for what, copies in (("lost", 0), ("doubled", 2))
    ),
    Case("SYNC lost", (), 0x080, copies=0, cause=FOLLOWS, may_go_on=True),
    Case("SYNC doubled", (), 0x080, copies=2, cause=FOLLOWS),
    Case("RPDO lost", (), 0x200 + VICTIM, copies=0, cause=FOLLOWS),
    Case("RPDO doubled", (), 0x200 + VICTIM, copies=2),
    Case("TPDOs lost", (), 0x180 + VICTIM, True, 0, FOR_EVER, SILENT),
    Case("RPDOs lost", (), 0x200 + VICTIM, False, 0, FOR_EVER, FOLLOWS),
    Case("node gone", (), -1, True, 0, FOR_EVER, SILENT),
    Case("foreign SYNC", (Frame(0x080),), cause=FOLLOWS, may_go_on=True),
    Case("foreign SYNCs", (Frame(0x080),) * 3, cause=FOLLOWS, may_go_on=True),
    Case("NMT stop", (nmt(2),), cause=NMT_STATE),
    Case("NMT pre-operational", (nmt(128),), cause=NMT_STATE),
    Case("NMT reset node", (nmt(129),), cause="was reset.*"),
    Case("NMT reset communication", (nmt(130),), cause="was reset.*"),
    Case("NMT stop of all", (Frame(0x000, b"\x02\x00"),), cause=NMT_STATE),
    *(
        Case(f"controlword 0x{word:04X}", (sdo_write(0x6040, 0, word, 2),), cause=cause)
        for word, cause in (
            *((word, LEFT) for word in (0x0000, 0x0002)),
            *((word, f"{LEFT}|{FOLLOWS}") for word in (0x0006, 0x0007)),  # from which our next controlword may lead back at once
            *((word, FOLLOWS) for word in (0x000F, 0x010F, 0x011F)),
        )
    ),
    *(
        Case(f"mode {mode}", (sdo_write(0x6060, 0, mode, 1),), cause=f"{MODE}|{FOLLOWS}", refused_by_schunk=mode == 3, settles=8)
        for mode in (0, 1, 3, 6)
    ),
    Case("mode 8", csp_at_its_place, cause=MODE, refused_by_schunk=True),
    Case("software limits", software_limits, cause="is held by a limit.*"),
    Case("foreign RPDO", (Frame(0x200 + VICTIM, bytes.fromhex("1F0000000000FFFF")),), cause=FOLLOWS, settles=8),
    Case("foreign RPDO that disables", (Frame(0x200 + VICTIM, bytes(8)),), cause=LEFT),
]


async def strike(case: Case, here: Scene) -> None:
    struck = 0

    def copies(frame: Frame, is_sent: bool) -> int:
        nonlocal struck
        if struck < case.count and (case.can_id == -1 or (frame.can_id, is_sent) == (case.can_id, case.is_sent)):
            struck += 1
            here.has_struck = True
            return case.copies
        return 1

    here.has_struck = not case.can_id
    here.links[VICTIM].copies = copies if case.can_id else one_copy
    frames = case.frames if isinstance(case.frames, tuple) else case.frames(position_of(here.hosts[VICTIM], here.node(VICTIM)))
    for frame in frames:
        await here.stranger.send(frame)
        await loop.sleep(0.001)


# ---- what is seen ----


def shown_at(here: Scene, since: float) -> float | None:
    """When the master's line first showed that the victim does not follow."""
    shown = [*shown_by_words(here, since), *shown_by_silence(here, since)]
    set_points: deque[int] = deque(maxlen=6)
    for time, is_sent, frame in here.master_link.log:
        data = frame.data
        if (frame.can_id, is_sent) == (0x200 + VICTIM, True):
            set_points.append(int.from_bytes(data[4:], "little", signed=True))
        elif (frame.can_id, is_sent) == (0x180 + VICTIM, False) and time >= since:
            position = int.from_bytes(data[4:], "little", signed=True)
            if max(min(set_points) - position, position - max(set_points)) > LIMIT * COUNTS:
                shown.append(time)
    return min(shown, default=None)


def shown_by_words(here: Scene, since: float) -> Iterator[float]:
    """By its state, bit 12, or bit 11 twice; by 0x6061; by a boot-up or an NMT state."""
    limited = 0
    for time, is_sent, frame in here.master_link.log:
        if is_sent or time < since:
            continue
        data, word = frame.data, int.from_bytes(frame.data[:2], "little")
        match frame.can_id - VICTIM:
            case 0x180:
                limited = limited + 1 if word & 1 << 11 else 0
                is_shown = state_of(word) is not State.OPERATION_ENABLED or not word & 1 << 12 or limited == 2
            case 0x580:
                is_shown = data[:4] == b"\x4f\x61\x60\x00" and data[4] != Mode.INTERPOLATED_POSITION
            case 0x700:
                is_shown = data[0] != NmtState.OPERATIONAL
            case _:
                is_shown = False
        if is_shown:
            yield time


def shown_by_silence(here: Scene, since: float) -> Iterator[float]:
    """By the first of three PDOs that are missing in a row."""
    log = here.master_link.log
    heard = {round(time / PERIOD) for time, is_sent, frame in log if frame.can_id == 0x180 + VICTIM}
    syncs = [time for time, is_sent, frame in log if is_sent and frame.can_id == 0x080 and time >= since]
    missing = [time for time in syncs[:-1] if round(time / PERIOD) not in heard]
    yield from (a for a, b, c in zip(missing, missing[1:], missing[2:], strict=False) if c - a < 2.5 * PERIOD)


async def run(case: Case, here: Scene, phase: float) -> str:
    """The property; the reason of the ChainFaultError, or "" where the chain went on."""
    arm, struck_at = here.arm, -1.0
    here.master_link.log.clear()
    start = arm.desired_positions
    off_since: float | None = None
    for number in range(STRUCK + WATCHED):
        if number == STRUCK:
            await loop.sleep(phase * PERIOD)
            struck_at = loop.current_time()
            await strike(case, here)
        for _ in range(2):
            await loop.sleep(PERIOD / 2)
            if arm.state is not ChainState.FOLLOWING:
                break
            truth = [here.true_position(node_id) for node_id in (VICTIM, OTHER)]
            off = max(abs(a - b) for a, b in zip(truth, arm.desired_positions, strict=True))
            off_since = None if off <= LIMIT + 5 * SPEED * PERIOD else off_since or loop.current_time()
            assert off_since is None or loop.current_time() - off_since < 4 * PERIOD, f"a joint is {off:.4f} rad off, unseen"
        if arm.state is not ChainState.FOLLOWING:
            break
        arm.set_positions([position + SPEED * PERIOD * (number + 1) for position in start])
    failed_at, first = loop.current_time(), shown_at(here, struck_at)
    assert here.has_struck
    if arm.state is ChainState.FOLLOWING:
        assert first is None, "not seen, though it was shown"
        return ""
    assert first is not None, "stopped, though nothing was shown"
    assert failed_at - first <= 3.6 * PERIOD, f"seen {failed_at - first:.4f} s after it was shown"
    with pytest.raises(ChainFaultError) as caught:
        arm.set_positions([0.0, 0.0])
    if case.name not in ("NMT stop of all", "foreign SYNC", "foreign SYNCs"):
        assert caught.value.node_id == VICTIM
    assert caught.value.joint in str(caught.value)
    await loop.sleep(max(0.0, failed_at + math.degrees(SPEED) / RAMP + case.settles * PERIOD - loop.current_time()))
    stood = [here.true_position(node_id) for node_id in (VICTIM, OTHER)]
    await loop.sleep(PERIOD)
    assert [here.true_position(node_id) for node_id in (VICTIM, OTHER)] == pytest.approx(stood, abs=2e-5)
    return caught.value.reason


def cases_at(phase: float, is_standard: bool) -> list[Case]:
    """Whenever in a cycle a frame is to be lost or doubled, it is the next one of its kind: one phase says all.

    Every day the late phase gets each sixth of its cases, other ones with each kind of drive; and each second case of the early
    phase comes with one kind alone.
    """
    if phase == EARLY:
        return CASES[:: 1 if takes_all() or not is_standard else 2]
    return [case for case in CASES if case.frames][0 if takes_all() else 3 * is_standard :: 1 if takes_all() else 6]


@functools.cache
def outcomes(is_standard: bool, phase: float) -> dict[str, str | Exception]:
    """What each case ended with: all of them happen to one arm, which recovers in between. A failure takes another arm."""
    ended: dict[str, str | Exception] = {}
    cases = cases_at(phase, is_standard)

    @virtual_time
    async def play() -> None:
        async with scene(is_standard) as here:
            for case in cases[len(ended) :]:
                try:
                    ended[case.name] = await run(case, here, phase)
                except Exception as failed:  # noqa: BLE001 - raised by the test of that case
                    ended[case.name] = failed
                    return
                finally:
                    here.links[VICTIM].copies = one_copy
                here.restore()
                if here.arm.state is ChainState.FAULT:
                    await here.arm.recover()
                elif case.name in ("SDO request lost", "SDO answer lost"):  # what is read beside the cycle waits for its time-out
                    await here.arm.enable_interpolated_position()

    while len(ended) < len(cases):
        play()
    return ended


@pytest.mark.parametrize(
    ("is_standard", "phase", "case"),
    [
        pytest.param(is_standard, phase, case, id=f"{phase}-{case}-{'standard' if is_standard else 'schunk'}")
        for is_standard, phase in itertools.product((False, True), (EARLY, LATE))
        for case in cases_at(phase, is_standard)
    ],
)
def test_a_joint_that_does_not_follow_stops_its_chain(case: Case, is_standard: bool, phase: float) -> None:
    reason = outcomes(is_standard, phase)[case.name]
    if isinstance(reason, Exception):
        raise reason
    assert re.fullmatch(case.expected(is_standard), reason), reason


@pytest.mark.parametrize(
    ("limit", "source"),
    [(0.02, "the settings (following_error_limit)"), (None, "0x6065 of the drive")],
)
@virtual_time
async def test_a_joint_that_is_held_is_told_with_the_limit_and_where_it_comes_from(limit: float | None, source: str) -> None:
    async with scene(limit=limit, window=1_500) as here:
        arm, node, host = here.arm, here.node(VICTIM), here.hosts[VICTIM]
        start = arm.desired_positions
        node.block(True, host.now())
        held_at = here.true_position(VICTIM)
        with pytest.raises(ChainFaultError, match=r"is [0-9.]+ off its path: it is at .*; the limit is [0-9.]+, by") as caught:
            async for cycle in arm.cycles():
                arm.set_positions([position + SPEED * cycle.time for position in start])
        assert caught.value.node_id == VICTIM
        assert caught.value.reason.endswith(f"by {source}")
        expected = 1_500 / 180_000 * math.pi if limit is None else limit
        assert abs(arm.desired_positions[0] - held_at) <= expected + 6 * SPEED * PERIOD


@virtual_time
async def test_a_joint_that_answers_no_sdo_blinds_nobody_for_another() -> None:
    """A mode that shows in nothing but 0x6061 is seen when the joint was asked: a cycle for each joint, and the answer."""
    async with scene() as here:
        here.links[OTHER].copies = lambda frame, is_sent: 0 if frame.can_id == 0x580 + OTHER else 1
        await loop.sleep(0.1)
        here.node(VICTIM).values.store[MODES_OF_OPERATION_DISPLAY] = 1
        await loop.sleep(3 * PERIOD)
        with pytest.raises(ChainFaultError, match="changed its mode of operation: 0x6061 shows profile position") as caught:
            here.arm.set_positions([0.0, 0.0])
        assert caught.value.node_id == VICTIM
        here.links[OTHER].copies = lambda frame, is_sent: 1


@virtual_time
async def test_another_sync_is_named() -> None:
    async with scene() as here:
        start = here.arm.desired_positions
        with pytest.raises(ChainFaultError, match="cause: somebody else commands this bus: a SYNC [0-9]+ ms ago"):
            async for cycle in here.arm.cycles():
                here.arm.set_positions([position + SPEED * cycle.time for position in start])
                if cycle.number % 10 == 9:
                    await here.stranger.send(Frame(0x080))


@virtual_time
async def test_the_command_of_another_master_is_named() -> None:
    async with scene() as here:
        key = SDO_CLIENT_TO_SERVER + VICTIM
        await here.stranger.send(Frame(key, bytes.fromhex("2b40600006000000")))  # shutdown
        await loop.sleep(3 * PERIOD)
        with pytest.raises(ChainFaultError) as caught:
            here.arm.set_positions([0.0, 0.0])
        assert caught.value.cause.startswith("another master commanded 0x0006 (shutdown) ")
        assert "by SDO; somebody else commands this bus: an SDO request to it" in caught.value.cause


@virtual_time
async def test_a_joint_that_no_longer_answers_guarding_is_lost_though_nothing_is_followed() -> None:
    async with scene() as here:
        await here.arm.halt()
        joint = here.arm.devices[0]
        await joint.node.write("producer_heartbeat_time", 0)
        joint.node.start_guarding(0.05)
        await loop.sleep(1)
        here.links[VICTIM].copies = lambda frame, is_sent: 0
        await loop.sleep(0.3)
        assert here.arm.state is ChainState.FAULT
        with pytest.raises(ChainFaultError, match="was lost: no answer to node guarding for 0.15 s"):
            here.arm.hold()
        here.links[VICTIM].copies = one_copy
