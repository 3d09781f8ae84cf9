"""Chapters 9 and 10 of the conformance test: the NMT states, and the transitions between them (CiA 301 v4.2.0, 7.3.2).

The heartbeat shows the state, or guarding if a device has no heartbeat (`Bench.supervise`).

By CiA 301 a device is Pre-operational after its boot-up. Bit 2 of 0x1F80 (CiA 302-2) lets a device start by itself, and
certified ones do. So a device that is Operational after its boot-up gets a remark, and fails a strict test unless it has that
object.
"""

from __future__ import annotations

from functools import partial
from typing import Final

from canopen_check.bench import ANSWER_TIME, REACTION_TIME, Bench
from canopen_check.case import Case
from canopen_check.dictionary_cases import (
    FIRST_OF_MAKER,
    change_settings,
    expect_defaults,
    expect_put_back,
    with_default,
)
from canopen_check.pdo_cases import EVENT_TIME, LEADS_TO
from canopen_check.pdo_tools import PROFILE_EVENTS, Pdo, destroy, has, key_of, length_of, mapped_variable, set_up, usable
from canopen_check.raw_sdo import initiate
from canopen_proto.dictionary import Direction
from canopen_proto.explained import counted
from canopen_proto.frame import MAX_NODE_ID, NMT
from canopen_proto.indices import COB_ID_SYNC, DEVICE_TYPE, NMT_STARTUP
from canopen_proto.machine import SECOND
from canopen_proto.nmt import ALL_NODES, NmtCommand, NmtState
from canopen_proto.pdo.settings import EVENT_TIMER
from canopen_proto.procedures.steps import Procedure
from canopen_proto.sdo.codec import INITIATE_UPLOAD
from canopen_proto.verdict import NotApplicable, expect, expect_equal

EACH_SYNC: Final = 1

_RESETS: Final = (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)


def expect_sdo(bench: Bench, lives: bool) -> Procedure[None]:
    """Check that the device answers SDO requests, or, if `lives` is False, that it does not."""
    bench.probe.forget(bench.response_key)
    yield from bench.send(bench.request_key, initiate(INITIATE_UPLOAD, DEVICE_TYPE, 0))
    if lives:
        yield from bench.next_frame(bench.response_key, ANSWER_TIME, "the answer to an SDO request")
    yield from bench.expect_silence(bench.response_key, REACTION_TIME, "more than is due to an SDO request")


def timed_tpdo(bench: Bench) -> Procedure[Pdo | None]:
    """Set up a TPDO that is sent by its event timer, if the device has one that can; return it."""
    for pdo in _those_of(bench, Direction.TPDO):
        if has(bench, pdo, EVENT_TIMER) and (yield from set_up(bench, pdo, PROFILE_EVENTS, event_time=EVENT_TIME)):
            return pdo
    return None


def immediate_rpdo(bench: Bench) -> Procedure[Pdo | None]:
    """Set up an RPDO that takes effect at once and whose first object can be read back, if the device has one; return it."""
    for pdo in _those_of(bench, Direction.RPDO):
        variable = mapped_variable(bench, pdo)
        if (
            variable is not None
            and variable.size
            and variable.access.readable
            and (yield from set_up(bench, pdo, PROFILE_EVENTS))
        ):
            return pdo
    return None


def _those_of(bench: Bench, direction: Direction) -> list[Pdo]:
    """Return the usable PDOs, perhaps none: the case applies without them too."""
    try:
        return usable(bench, direction)
    except NotApplicable:
        return []


def expect_tpdo(bench: Bench, pdo: Pdo | None, lives: bool, why: str = "") -> Procedure[None]:
    """Check that a TPDO comes by its event timer, or, if `lives` is False, that it does not. why: for the text."""
    if pdo is not None:
        heard = yield from bench.frames_within(key_of(bench, pdo), 1 * SECOND)
        expect(bool(heard) is lives, f"{pdo} came {counted(len(heard), 'time')} {why}".rstrip())


def expect_rpdo(bench: Bench, pdo: Pdo | None, lives: bool, why: str = "", state: NmtState | None = None) -> Procedure[None]:
    """Send an RPDO with another value for its first object; check that it takes effect, or (lives is False) does not. why: for
    the text. state: to which the device is led for the PDO, from Pre-operational and back; None: it has SDO where it is."""
    variable = None if pdo is None else mapped_variable(bench, pdo)
    if pdo is not None and variable is not None:
        before = yield from bench.read(variable.index, variable.subindex)
        expect_equal(len(before), variable.size, f"the number of bytes of {variable.label}")
        changed = bytes((before[0] ^ 1,)) + before[1:]
        if state is not None:
            yield from bench.command(LEADS_TO[state])
        yield from bench.send(key_of(bench, pdo), changed.ljust(length_of(bench, pdo), b"\x00"))
        yield from bench.sleep(REACTION_TIME)
        if state is not None:
            yield from bench.command(NmtCommand.ENTER_PRE_OPERATIONAL)
        after = yield from bench.read(variable.index, variable.subindex)
        expect((after != before) is lives, f"{pdo} was {'not ' if lives else ''}processed {why}".rstrip())
        if lives:
            same = f"{variable.label} is {after.hex(' ')} after {pdo} with {changed.hex(' ')}"
            bench.notes.beyond(after == changed, same)


def expect_held_rpdo(bench: Bench, pdo: Pdo | None) -> Procedure[None]:
    """Check that an RPDO of type 1, if it can have that type, takes effect at the next SYNC (7.2.2.3), and not before."""
    variable = None if pdo is None else mapped_variable(bench, pdo)
    if pdo is None or variable is None or not bench.dictionary.has_index(COB_ID_SYNC):
        return
    yield from bench.silence_sync()
    yield from bench.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    is_held = yield from set_up(bench, pdo, EACH_SYNC)
    yield from bench.command(NmtCommand.START)
    if not is_held:
        return
    yield from expect_rpdo(bench, pdo, False, "before SYNC")
    before = yield from bench.read(variable.index, variable.subindex)
    yield from bench.sync()
    expect((yield from bench.read(variable.index, variable.subindex)) != before, f"{pdo} was not processed at SYNC")


def expect_booted(bench: Bench, when: str) -> Procedure[None]:
    """Check that the device is Pre-operational after its boot-up; if it has started by itself, command Pre-operational. when: for
    the text."""
    state = yield from bench.state()
    if state is NmtState.OPERATIONAL:
        itself = f"{when}, the device is OPERATIONAL: it starts by itself"
        if bench.dictionary.has_index(NMT_STARTUP):
            bench.notes.remark(f"{itself}, as 0x{NMT_STARTUP:04X} may tell it")
        else:
            bench.notes.beyond(False, itself)
        yield from bench.command(NmtCommand.ENTER_PRE_OPERATIONAL)
        yield from bench.expect_state(NmtState.PRE_OPERATIONAL, "commanded")
    else:
        expect(state is NmtState.PRE_OPERATIONAL, f"{when}, the device is {state.name}, not PRE_OPERATIONAL")


def expect_other_nodes_business(bench: Bench, state: NmtState) -> Procedure[None]:
    """Check that commands for other nodes, and a command that does not exist, change nothing. Others: the next, the one before,
    and the device's own number with bit 7, which no node has."""
    own = bench.node_id
    for other in (own % MAX_NODE_ID + 1, (own - 2) % MAX_NODE_ID + 1, own | 0x80):
        bench.probe.forget(bench.error_control_key)
        for command in (*LEADS_TO.values(), *_RESETS):
            yield from bench.send(NMT, bytes((command, other)))
        yield from bench.sleep(REACTION_TIME)
        is_reset = any(heard.frame.data == b"\x00" for heard in bench.probe.take_all(bench.error_control_key))
        expect(not is_reset, f"a reset of node {other} has reset the device: it obeys commands that are not for it")
        yield from bench.expect_state(state, f"after commands for node {other}, which are not for it")
    yield from bench.send(NMT, bytes((0x03, own)))
    yield from bench.sleep(REACTION_TIME)
    yield from bench.expect_state(state, "after commands that are not for it")


def boot_up(bench: Bench) -> Procedure[str]:
    """9.1: after a reset one boot-up frame comes, and the writable communication parameters have their defaults; if the test is
    strict, all objects have."""
    before = yield from change_settings(bench)
    yield from bench.reset()
    more = [heard for heard in bench.probe.take_all(bench.error_control_key) if heard.frame.data == b"\x00"]
    expect(not more, "more than one boot-up frame came")
    yield from expect_put_back(bench, before)
    found = (each for each in with_default(bench) if bench.strict or (each.index < FIRST_OF_MAKER and each.access.writable))
    return (yield from expect_defaults(bench, found))


def pre_operational(bench: Bench) -> Procedure[None]:
    """9.2: after boot-up the device is Pre-operational: it has SDO, but no PDO."""
    yield from bench.restart()
    yield from bench.supervise()
    yield from expect_booted(bench, "after boot-up")
    tpdo, rpdo = (yield from timed_tpdo(bench)), (yield from immediate_rpdo(bench))
    yield from expect_sdo(bench, True)
    yield from expect_tpdo(bench, tpdo, False)
    yield from expect_rpdo(bench, rpdo, False)
    yield from expect_other_nodes_business(bench, NmtState.PRE_OPERATIONAL)


def operational(bench: Bench) -> Procedure[None]:
    """9.3: in Operational the device has all services. If the test is strict, a synchronous RPDO waits for SYNC, and a PDO that
    is made not valid lives no longer."""
    yield from bench.supervise()
    tpdo, rpdo = (yield from timed_tpdo(bench)), (yield from immediate_rpdo(bench))
    yield from bench.command(NmtCommand.START)
    yield from bench.expect_state(NmtState.OPERATIONAL, "started")
    yield from expect_sdo(bench, True)
    yield from expect_tpdo(bench, tpdo, True)
    yield from expect_rpdo(bench, rpdo, True)
    if bench.strict:
        yield from bench.command(NmtCommand.ENTER_PRE_OPERATIONAL)
        for pdo in (tpdo, rpdo):
            if pdo is not None:
                yield from destroy(bench, pdo)
        yield from bench.command(NmtCommand.START)
        yield from expect_tpdo(bench, tpdo, False, "though it is not valid")
        yield from expect_rpdo(bench, rpdo, False, "though it is not valid")
        yield from expect_held_rpdo(bench, rpdo)
    yield from expect_other_nodes_business(bench, NmtState.OPERATIONAL)


def stopped(bench: Bench) -> Procedure[None]:
    """9.4: in Stopped the device has only NMT and error control; in Pre-operational its settings are there again. If the test is
    strict, an RPDO in Stopped does nothing."""
    yield from bench.supervise()
    tpdo, rpdo = (yield from timed_tpdo(bench)), (yield from immediate_rpdo(bench))
    for _ in range(2):
        yield from bench.command(NmtCommand.STOP)
        bench.probe.forget(bench.emcy_key)
        yield from bench.expect_state(NmtState.STOPPED, "stopped")
        yield from expect_sdo(bench, False)
        yield from expect_tpdo(bench, tpdo, False)
        yield from expect_other_nodes_business(bench, NmtState.STOPPED)
        for heard in bench.probe.take_all(bench.emcy_key):
            bench.notes.beyond(False, f"the emergency message {heard.frame} came in Stopped")
        yield from bench.command(NmtCommand.ENTER_PRE_OPERATIONAL)
        yield from bench.expect_state(NmtState.PRE_OPERATIONAL, "from Stopped")
        yield from expect_sdo(bench, True)
        if bench.strict:
            yield from expect_rpdo(bench, rpdo, False, "in Stopped", state=NmtState.STOPPED)


def resets(bench: Bench) -> Procedure[None]:
    """10.1: reset node and reset communication, from each state, to this node and to all."""
    for command in _RESETS:
        for state, way in LEADS_TO.items():
            for target in (bench.node_id, ALL_NODES):
                yield from bench.supervise()
                yield from bench.command(way)
                bench.probe.forget(bench.error_control_key)
                yield from bench.send(NMT, bytes((command, target)))
                yield from bench.await_boot_up()
                yield from bench.supervise()
                yield from expect_booted(bench, f"after {command.name} from {state.name}")


def transition(target: NmtState, bench: Bench) -> Procedure[None]:
    """10.2 to 10.4: the command for `target` leads there from each state, whether it is sent to this node or to all."""
    command = LEADS_TO[target]
    yield from bench.supervise()
    for state, way in LEADS_TO.items():
        for addressed in (bench.node_id, ALL_NODES):
            yield from bench.command(way)
            yield from bench.expect_state(state, f"after {way.name}")
            yield from bench.command(command, addressed)
            yield from bench.expect_state(target, f"after {command.name} from {state.name}, sent to {addressed},")


CASES: Final = (
    Case("9.1", "State 01", "Boot-up: the parameters have their default values", boot_up),
    Case("9.2", "State 02", "Pre-operational", pre_operational, (DEVICE_TYPE,)),
    Case("9.3", "State 03", "Operational", operational, (DEVICE_TYPE,)),
    Case("9.4", "State 04", "Stopped", stopped, (DEVICE_TYPE,)),
    Case("10.1", "Transition 01", "Reset node and reset communication", resets),
    Case("10.2", "Transition 02", "Enter pre-operational", partial(transition, NmtState.PRE_OPERATIONAL)),
    Case("10.3", "Transition 03", "Start remote node", partial(transition, NmtState.OPERATIONAL)),
    Case("10.4", "Transition 04", "Stop remote node", partial(transition, NmtState.STOPPED)),
)
