"""Chapter 5 of the conformance test: emergency (CiA 301 v4.2.0, 7.2.7, 7.5.2.2, 7.5.2.4, 7.5.2.17).

Only one error can be caused by the bus alone: an RPDO that is too short. It is not processed, and EMCY 0x8210 reports it."""

from __future__ import annotations

from typing import Final

from canopen_check.bench import ANSWER_TIME, REACTION_TIME, Bench
from canopen_check.case import Case
from canopen_check.emergencies import code_of, errors_heard, next_error
from canopen_check.expectations import expect_refusal
from canopen_check.pdo_cases import PROFILE_EVENTS
from canopen_check.pdo_tools import key_of, length_of, set_up, usable
from canopen_check.sdo_cases import ERROR_HISTORY
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import Direction
from canopen_proto.explained import counted
from canopen_proto.frame import COB_ID_INVALID, EMCY
from canopen_proto.indices import COB_ID_EMERGENCY, ERROR_REGISTER
from canopen_proto.nmt import NmtCommand
from canopen_proto.pdo.consumer import EMCY_PDO_NOT_PROCESSED
from canopen_proto.procedures.steps import Procedure
from canopen_proto.verdict import expect, expect_equal

GENERIC_ERROR: Final = 0x01

NO_DATA: Final = (AbortCode.NO_DATA, AbortCode.NO_SUCH_SUBINDEX, AbortCode.CANNOT_TRANSFER, AbortCode.GENERAL_ERROR)


def cob_id(bench: Bench) -> Procedure[None]:
    """5.1: the COB-ID is as described, and, if valid, that of the predefined connection set by default."""
    yield from bench.expect_default(COB_ID_EMERGENCY, 0, "after a reset")
    seen = yield from bench.number(COB_ID_EMERGENCY)
    if not seen & COB_ID_INVALID:
        expect_equal(seen, EMCY + bench.node_id, "0x1014:00, by the predefined connection set,")


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
    """Send an RPDO that is a byte too short to an Operational device; return its emergency message."""
    bench.check_emergency()
    pdo = usable(bench, Direction.RPDO)[0]
    yield from set_up(bench, pdo, PROFILE_EVENTS)
    yield from bench.command(NmtCommand.START)
    bench.probe.forget(bench.emcy_key)
    yield from bench.send(key_of(bench, pdo), bytes(length_of(bench, pdo) - 1))
    return (yield from next_error(bench, ANSWER_TIME, f"an emergency message about {pdo}, which was too short,")).frame.data


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


def history_of_error(bench: Bench) -> Procedure[None]:
    """5.6: the newest entry of the history has the code of the message; the history can be cleared."""
    message = yield from force_error(bench)
    entry = yield from bench.number(ERROR_HISTORY, 1)
    expect_equal(entry & 0xFFFF, code_of(message), "the error code in 0x1003:01")
    yield from bench.write(ERROR_HISTORY, 0, 0)
    yield from bench.expect_number(ERROR_HISTORY, 0, 0, "after clearing")


CASES: Final = (
    Case("5.1", "Emergency 01", "Check the COB-ID in 0x1014:00", cob_id, (COB_ID_EMERGENCY,)),
    Case("5.2", "Emergency 02", "Read 0x1001:00", no_error, (ERROR_REGISTER,)),
    Case("5.3", "Emergency 03", "Read 0x1003:01", empty_history, (ERROR_HISTORY,)),
    Case("5.4", "Emergency 04", "Force an emergency message", emergency, (COB_ID_EMERGENCY,)),
    Case("5.5", "Emergency 05", "Read 0x1001:00 while there is an error", register_of_error, (COB_ID_EMERGENCY, ERROR_REGISTER)),
    Case("5.6", "Emergency 06", "Compare 0x1003:01 with the message", history_of_error, (COB_ID_EMERGENCY, ERROR_HISTORY)),
)
