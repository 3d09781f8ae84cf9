"""Chapter 5 of the conformance test: emergency (CiA 301 v4.2.0, 7.2.7, 7.5.2.2, 7.5.2.4, 7.5.2.17).

Only one error can be caused by the bus alone: an RPDO that is too short. It is not processed, and EMCY 0x8210 reports it."""

from __future__ import annotations

from typing import Final

from canopen_check.bench import ANSWER_TIME, REACTION_TIME, Bench
from canopen_check.case import Case
from canopen_check.emergencies import code_of, errors_heard, next_error
from canopen_check.expectations import expect_refusal, expect_taken
from canopen_check.heartbeat_cases import EMCY_CONNECTION_LOST, lose_a_node
from canopen_check.pdo_tools import first_set_up, key_of, length_of, mapped_variable, usable
from canopen_check.sdo_cases import ERROR_HISTORY, NO_CAN_ID, NOT_NOW
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import Direction
from canopen_proto.explained import counted
from canopen_proto.frame import COB_ID_INVALID, EMCY
from canopen_proto.indices import COB_ID_EMERGENCY, ERROR_REGISTER
from canopen_proto.nmt import NmtCommand
from canopen_proto.pdo.consumer import EMCY_PDO_NOT_PROCESSED
from canopen_proto.procedures.steps import Procedure
from canopen_proto.verdict import expect, expect_equal

OTHER_CAN_ID: Final = 0x1FF
"""Not of the predefined connection set."""

GENERIC_ERROR: Final = 0x01

NO_DATA: Final = (AbortCode.NO_DATA, AbortCode.NO_SUCH_SUBINDEX, AbortCode.CANNOT_TRANSFER, AbortCode.GENERAL_ERROR)


def cob_id(bench: Bench) -> Procedure[None]:
    """5.1: the COB-ID is as described, and, if valid, that of the predefined connection set by default. If the test is strict,
    its CAN-ID cannot change while it is valid (7.5.2.17)."""
    yield from bench.expect_default(COB_ID_EMERGENCY, 0, "after a reset")
    seen = yield from bench.number(COB_ID_EMERGENCY)
    if not seen & COB_ID_INVALID:
        expect_equal(seen, EMCY + bench.node_id, "0x1014:00, by the predefined connection set,")
        if bench.strict:
            refusal = yield from bench.refusal_of_write(COB_ID_EMERGENCY, 0, OTHER_CAN_ID)
            expect_refusal(refusal, (*NOT_NOW, *NO_CAN_ID), "a new CAN-ID in 0x1014:00, which is valid,")


def no_error(bench: Bench) -> Procedure[None]:
    """5.2: a device without an error has an empty error register. CiA's tool does not check that the device has no error."""
    register = yield from bench.number(ERROR_REGISTER)
    bench.notes.beyond(register == 0, f"0x1001:00 is 0x{register:02X}: the device has an error")


def empty_history(bench: Bench) -> Procedure[str]:
    """5.3: an empty error history has no entry to read. A history that survived the reset has some."""
    count = yield from bench.number(ERROR_HISTORY)
    if count == 0:
        expect_refusal((yield from bench.refusal_of_read(ERROR_HISTORY, 1)), NO_DATA, "reading 0x1003:01 of an empty history")
    else:
        yield from bench.read(ERROR_HISTORY, 1)
    return counted(count, "error")


def force_error(bench: Bench) -> Procedure[bytes]:
    """Send an RPDO that is a byte too short to an Operational device; return its emergency message. It must not be processed."""
    bench.check_emergency()
    pdo = yield from first_set_up(bench, usable(bench, Direction.RPDO))
    yield from bench.command(NmtCommand.START)
    bench.probe.forget(bench.emcy_key)
    variable = mapped_variable(bench, pdo)
    is_shown = variable is not None and variable.access.readable
    before = (yield from bench.read(variable.index, variable.subindex)) if variable is not None and is_shown else b""
    data = bytes(byte ^ 1 for byte in before).ljust(length_of(bench, pdo), b"\x00")[: length_of(bench, pdo) - 1]
    yield from bench.send(key_of(bench, pdo), data)
    heard = yield from next_error(bench, ANSWER_TIME, f"an emergency message about {pdo}, which was too short,")
    if variable is not None and is_shown:
        after = yield from bench.read(variable.index, variable.subindex)
        bench.notes.beyond(after == before, f"{pdo} was processed though it was too short: {variable.label} is {after.hex(' ')}")
    return heard.frame.data


def emergency(bench: Bench) -> Procedure[str]:
    """5.4: an error makes one emergency message, with its code and the error register."""
    message = yield from force_error(bench)
    expect_equal(code_of(message), EMCY_PDO_NOT_PROCESSED, "the error code")
    generic = message[2] & GENERIC_ERROR != 0
    bench.notes.beyond(generic, f"the error register in {message.hex(' ')} lacks the generic error")
    yield from bench.sleep(REACTION_TIME)
    expect(not errors_heard(bench), "a second emergency message came for one error")
    return message.hex(" ")


def register_of_error(bench: Bench) -> Procedure[None]:
    """5.5: the error register equals that of the message as long as the error lasts. The device decides how long that is."""
    message = yield from force_error(bench)
    bench.notes.beyond(message[2] != 0, f"the error register in {message.hex(' ')} is empty")
    register = yield from bench.number(ERROR_REGISTER)
    bench.notes.beyond(register == message[2], f"0x1001:00 is 0x{register:02X} after the emergency message {message.hex(' ')}")
    yield from bench.reset()
    register = yield from bench.number(ERROR_REGISTER)
    bench.notes.beyond(register == 0, f"0x1001:00 is 0x{register:02X} after the reset behind the error")


def history_of_error(bench: Bench) -> Procedure[None]:
    """5.6: the newest entry of the history has the code of the message; the history can be cleared. If the test is strict, a
    newer error, a lost heartbeat, takes the first place."""
    message = yield from force_error(bench)
    entry = yield from bench.number(ERROR_HISTORY, 1)
    expect_equal(entry & 0xFFFF, code_of(message), "the error code in 0x1003:01")
    if bench.strict and bench.dictionary.get(ERROR_HISTORY, 2) is not None and (yield from lose_a_node(bench)):
        for subindex, code in ((1, EMCY_CONNECTION_LOST), (2, code_of(message))):
            entry = yield from bench.number(ERROR_HISTORY, subindex)
            expect_equal(entry & 0xFFFF, code, f"after another error the error code in 0x1003:{subindex:02X}")
    expect_taken((yield from bench.refusal_of_write(ERROR_HISTORY, 0, 0)), "clearing 0x1003:00")  # rw in every device: 7.5.2.4
    yield from bench.expect_number(ERROR_HISTORY, 0, 0, "after clearing")


CASES: Final = (
    Case("5.1", "Emergency 01", "Check the COB-ID in 0x1014:00", cob_id, (COB_ID_EMERGENCY,)),
    Case("5.2", "Emergency 02", "Read 0x1001:00", no_error, (ERROR_REGISTER,)),
    Case("5.3", "Emergency 03", "Read 0x1003:01", empty_history, (ERROR_HISTORY,)),
    Case("5.4", "Emergency 04", "Force an emergency message", emergency, (COB_ID_EMERGENCY,)),
    Case("5.5", "Emergency 05", "Read 0x1001:00 while there is an error", register_of_error, (COB_ID_EMERGENCY, ERROR_REGISTER)),
    Case("5.6", "Emergency 06", "Compare 0x1003:01 with the message", history_of_error, (COB_ID_EMERGENCY, ERROR_HISTORY)),
)
