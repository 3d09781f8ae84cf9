"""Chapter 2 of the conformance test: SDO (CiA 301 v4.2.0, 7.2.4).

Expedited and segmented transfers, and requests that a server has to refuse, with the right abort codes. block_cases.py has the
block transfers.

0x08000000 (general error) is right wherever a server need not say more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final

from canopen_check.bench import REACTION_TIME, Bench
from canopen_check.case import Case, for_each
from canopen_check.expectations import expect_refusal, expect_taken, some
from canopen_check.raw_sdo import (
    abort_code_in,
    ask,
    initiate,
    initiate_upload,
    segmented_download,
    segmented_upload,
    upload_segments,
)
from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, range_of
from canopen_proto.dictionary import Object, Variable
from canopen_proto.explained import counted
from canopen_proto.frame import MAX_NODE_ID, SDO_CLIENT_TO_SERVER, RoutingKey
from canopen_proto.indices import DEVICE_TYPE, GUARD_TIME, INHIBIT_TIME_EMERGENCY, RESTORE_DEFAULT_PARAMETERS, STORE_PARAMETERS
from canopen_proto.pdo.settings import EVENT_TIMER, place_of
from canopen_proto.procedures.steps import Procedure
from canopen_proto.sdo.codec import (
    ABORT,
    DOWNLOAD_SEGMENT,
    INITIATE_DOWNLOAD,
    INITIATE_UPLOAD,
    SIZE_BIT,
    TOGGLE,
    UPLOAD_SEGMENT,
    expedited_data,
    segment,
)
from canopen_proto.verdict import ViolationError, does_not_apply, expect, expect_equal

READ_ONLY: Final = (AbortCode.UNSUPPORTED_ACCESS, AbortCode.READ_ONLY, AbortCode.GENERAL_ERROR)
WRITE_ONLY: Final = (AbortCode.UNSUPPORTED_ACCESS, AbortCode.WRITE_ONLY, AbortCode.GENERAL_ERROR)
NO_SUBINDEX: Final = (AbortCode.NO_SUCH_SUBINDEX, AbortCode.GENERAL_ERROR)
NO_OBJECT: Final = (AbortCode.NO_SUCH_OBJECT, AbortCode.GENERAL_ERROR)
BAD_COMMAND: Final = (AbortCode.INVALID_COMMAND, AbortCode.GENERAL_ERROR)
TOO_LONG: Final = (AbortCode.LENGTH_MISMATCH, AbortCode.LENGTH_TOO_HIGH, AbortCode.GENERAL_ERROR)
TOO_SHORT: Final = (AbortCode.LENGTH_MISMATCH, AbortCode.LENGTH_TOO_LOW, AbortCode.GENERAL_ERROR)
TOO_HIGH: Final = (AbortCode.INVALID_VALUE, AbortCode.VALUE_TOO_HIGH, AbortCode.GENERAL_ERROR)
TOO_LOW: Final = (AbortCode.INVALID_VALUE, AbortCode.VALUE_TOO_LOW, AbortCode.GENERAL_ERROR)
NO_CAN_ID: Final = (AbortCode.INVALID_VALUE, AbortCode.VALUE_TOO_HIGH, AbortCode.VALUE_TOO_LOW, AbortCode.GENERAL_ERROR)
NOT_NOW: Final = (AbortCode.UNSUPPORTED_ACCESS, AbortCode.READ_ONLY, AbortCode.DEVICE_STATE, AbortCode.GENERAL_ERROR)
BAD_TOGGLE: Final = (AbortCode.TOGGLE_NOT_ALTERNATED, AbortCode.GENERAL_ERROR)

SDO_SERVER: Final = indices.SDO_SERVER_PARAMETER
ERROR_HISTORY: Final = indices.PREDEFINED_ERROR_FIELD
HEARTBEAT: Final = indices.PRODUCER_HEARTBEAT_TIME
SYNC_OVERFLOW: Final = indices.SYNCHRONOUS_COUNTER_OVERFLOW_VALUE

STRUCTURE: Final = 0xFF
"""The subindex that holds data type and object type."""

NEVER_WRITTEN: Final = (ERROR_HISTORY, STORE_PARAMETERS, RESTORE_DEFAULT_PARAMETERS)
"""Objects that act when they are written, and do not hold the value."""

ANY_TIME: Final = 0x0155
"""A number of ms (0.3 s) or of 100 us that any object for a time takes, and the next number too."""
TIME_SIZE: Final = 2
"""The number of bytes of such an object."""
NO_TRIAL: Final = "no communication object can be changed for a trial"


def settings(bench: Bench) -> Iterator[Variable]:
    """Return the objects of the communication area that keep a written value."""
    for variable in bench.dictionary:
        access = variable.access
        if (
            variable.index in indices.COMMUNICATION_AREA
            and variable.index not in NEVER_WRITTEN
            and access.readable
            and access.writable
        ):
            yield variable


def takes_any_time(variable: Variable) -> bool:
    """Return whether a setting takes ANY_TIME at any moment."""
    low, high = variable.low_limit or 0, variable.high_limit
    if variable.size != TIME_SIZE or low > ANY_TIME or (high is not None and high <= ANY_TIME):
        return False
    place = place_of(variable.index)
    is_event_timer = place is not None and not place.is_mapping and variable.subindex == EVENT_TIMER
    return is_event_timer or variable.index in (GUARD_TIME, INHIBIT_TIME_EMERGENCY, HEARTBEAT)


def long_object(bench: Bench) -> Variable:
    """Return a readable object of more than four bytes, best a constant one; without any, the case does not apply."""
    found = [each for each in bench.dictionary if each.access.readable and _length(bench, each) > 4]
    return min(some(found, "no object has more than four bytes"), key=lambda each: (each.access.writable, each.mux))


def _length(bench: Bench, variable: Variable) -> int:
    return len(bench.content_of(variable) or b"") if variable.size is None else variable.size


def holds(bench: Bench, variable: Variable, content: bytes, how: str) -> None:
    """Check that the device sent the value that an object holds if it was never written. content: what it sent. how: for the
    text, as in "in segments"."""
    expected = bench.content_of(variable)
    if expected is not None:
        expect_equal(content, expected, f"{variable.label}, read {how},")


def read_expedited(bench: Bench) -> Procedure[None]:
    """2.1: the device type comes in one frame, with its four bytes and its own multiplexer."""
    content = expedited_data((yield from initiate_upload(bench, DEVICE_TYPE, 0)))
    if content is None:
        raise ViolationError("0x1000:00 came with a segmented transfer")
    expect_equal(len(content), 4, "the number of bytes of 0x1000:00")
    holds(bench, bench.variable(DEVICE_TYPE), content, "expedited")


def read_and_write(bench: Bench) -> Procedure[str]:
    """2.2: a setting of the communication area takes another value, and its old one again.

    One setting that is a time is tried, best that of the heartbeat. If the test is strict, all settings are tried; those that are
    not times with their own value.
    """
    found = list(settings(bench))
    times = [variable for variable in found if takes_any_time(variable)]
    chosen = found if bench.strict else sorted(times, key=lambda variable: variable.index != HEARTBEAT)[:1]

    def look(variable: Variable) -> Procedure[None]:
        place = variable.index, variable.subindex
        before = yield from bench.read(*place)
        if variable.size is not None:
            expect_equal(len(before), variable.size, f"the number of bytes of {variable.label}")
        if not takes_any_time(variable):
            yield from expect_own_value(bench, variable, before)
            return
        for written in (ANY_TIME.to_bytes(len(before), "little"), before):
            expect_taken((yield from bench.refusal_of_write(*place, written)), f"{variable.label} = {written.hex(' ')}")
            expect_equal((yield from bench.read(*place)), written, f"{variable.label}, read back,")

    return (yield from for_each(bench, some(chosen, NO_TRIAL), look))


def expect_own_value(bench: Bench, variable: Variable, content: bytes) -> Procedure[None]:
    """Check that an object takes its own value. content: the bytes of that value.

    Three kinds may refuse: an enabled mapping, any parameter of a valid PDO, and 0x1019 while 0x1006 is not 0. They cannot change
    then, and the standard does not say whether the same value is a change.
    """
    refusal = yield from bench.refusal_of_write(variable.index, variable.subindex, content)
    is_tied = place_of(variable.index) is not None or variable.index == SYNC_OVERFLOW
    if not (is_tied and refusal in (*NOT_NOW, AbortCode.INVALID_VALUE)):
        expect_taken(refusal, f"writing its own value to {variable.label}")


def write_device_type(bench: Bench) -> Procedure[None]:
    """2.3: the device type cannot be written."""
    code = yield from bench.refusal_of_write(DEVICE_TYPE, 0, bytes(4))
    expect_refusal(code, READ_ONLY, "writing 0x1000:00")


def read_write_only(bench: Bench) -> Procedure[None]:
    """2.4 and 4.4: a write-only object cannot be read."""
    found = some([variable for variable in bench.dictionary if not variable.access.readable], "no object is write-only")

    def look(variable: Variable) -> Procedure[None]:
        code = yield from bench.refusal_of_read(variable.index, variable.subindex)
        expect_refusal(code, WRITE_ONLY, f"reading {variable.label}")

    yield from for_each(bench, found, look)


def read_missing_subindex(bench: Bench) -> Procedure[None]:
    """2.5: a subindex that does not exist cannot be read; if the test is strict, none behind the last one of any object."""
    expect_refusal((yield from bench.refusal_of_read(DEVICE_TYPE, 1)), NO_SUBINDEX, "reading 0x1000:01")

    def look(described: Object) -> Procedure[None]:
        beyond = max(each for each in described.variables if each != STRUCTURE) + 1
        if beyond < STRUCTURE:
            refusal = yield from bench.refusal_of_read(described.index, beyond)
            expect_refusal(refusal, NO_SUBINDEX, f"reading 0x{described.index:04X}:{beyond:02X}")

    if bench.strict:
        yield from for_each(bench, bench.dictionary.objects.values(), look)


def read_missing_object(bench: Bench) -> Procedure[None]:
    """2.6: an object that does not exist cannot be read."""
    if bench.dictionary.has_index(0x1004):
        does_not_apply("the device has an object 0x1004")
    expect_refusal((yield from bench.refusal_of_read(0x1004, 0)), NO_OBJECT, "reading 0x1004:00")


def wrong_command_specifier(bench: Bench) -> Procedure[None]:
    """2.7: the client command specifier 7, which has no meaning, is refused."""
    response = yield from ask(bench, initiate(0xE0, DEVICE_TYPE, 0))
    expect_refusal(abort_code_in(response), BAD_COMMAND, "the command specifier 7")


def _setting_of(bench: Bench, *types: DataType) -> Variable:
    found = [variable for variable in settings(bench) if variable.data_type in types]
    return some(found, "no object of the communication area that can be written has the type")[0]


def write_too_long(bench: Bench) -> Procedure[None]:
    """2.8: four bytes are too many for an object of one or two."""
    yield from _write_other_length(bench, 4, TOO_LONG, _setting_of(bench, DataType.UNSIGNED16, DataType.UNSIGNED8), (1, 2))


def write_too_short(bench: Bench) -> Procedure[None]:
    """2.9: one byte is too few for an object of two or four."""
    yield from _write_other_length(bench, 1, TOO_SHORT, _setting_of(bench, DataType.UNSIGNED16, DataType.UNSIGNED32), (2, 4))


def _write_other_length(
    bench: Bench, length: int, valid: Sequence[AbortCode], setting: Variable, sizes: Sequence[int]
) -> Procedure[None]:
    """Write so many bytes to a setting; if the test is strict, to each object from 0x2000 on that has one of these sizes too."""

    def look(variable: Variable) -> Procedure[None]:
        code = yield from bench.refusal_of_write(variable.index, variable.subindex, bytes(length))
        expect_refusal(code, valid, f"writing {counted(length, 'byte')} to {variable.label}")

    others = [each for each in bench.dictionary if each.index not in indices.COMMUNICATION_AREA and each.access.writable]
    more = [each for each in others if each.size in sizes] if bench.strict else []
    yield from for_each(bench, [setting, *more], look)


def limited(bench: Bench) -> list[tuple[Variable, int | None, int | None]]:
    """Return the objects with limits of their own, each with the next value below and the next one above them. None: the type has
    no such value."""
    found = []
    for variable in bench.dictionary:
        span = range_of(variable.data_type)
        if variable.access.writable and variable.index not in NEVER_WRITTEN and span is not None:
            least, most = span
            low, high = variable.low_limit, variable.high_limit
            below = int(low) - 1 if low is not None and least < low <= most else None
            above = int(high) + 1 if high is not None and least <= high < most else None
            if below is not None or above is not None:
                found.append((variable, below, above))
    return found


def write_too_high(bench: Bench) -> Procedure[None]:
    """2.10: a value above an object's limit is refused; so is a number of errors other than 0 in 0x1003:00, as CiA's tool tries.
    7.5.2.4"""
    yield from bench.silence_sync()  # the object may be 0x1019
    tried = [(variable, above) for variable, _, above in limited(bench) if above is not None][:1]
    errors = bench.dictionary.get(ERROR_HISTORY)
    if errors is not None and errors.access.writable:
        tried.append((errors, 0xFF))
    for variable, above in some(tried, "no object has a high limit of its own"):
        code = yield from bench.refusal_of_write(variable.index, variable.subindex, variable.encode(above))
        expect_refusal(code, TOO_HIGH, f"writing {above} to {variable.label}")


def write_too_low(bench: Bench) -> Procedure[None]:
    """2.11: a value below an object's limit is refused."""
    yield from bench.silence_sync()
    for variable, below, _ in limited(bench):
        if below is not None:
            code = yield from bench.refusal_of_write(variable.index, variable.subindex, variable.encode(below))
            expect_refusal(code, TOO_LOW, f"writing {below} to {variable.label}")
            return
    does_not_apply("no object has a low limit of its own")


def default_channel(bench: Bench) -> Procedure[None]:
    """2.12: the first SDO server has the CAN-IDs of the predefined connection set; if the test is strict, requests to the node
    before and to the next one are not answered."""
    yield from bench.expect_number(SDO_SERVER, 1, bench.request_key, "client to server")
    yield from bench.expect_number(SDO_SERVER, 2, bench.response_key, "server to client")
    for other in (bench.node_id % MAX_NODE_ID + 1, (bench.node_id - 2) % MAX_NODE_ID + 1) if bench.strict else ():
        bench.probe.forget(bench.response_key)
        yield from bench.send(RoutingKey(SDO_CLIENT_TO_SERVER + other), initiate(INITIATE_UPLOAD, DEVICE_TYPE, 0))
        yield from bench.expect_silence(bench.response_key, REACTION_TIME, f"a request to node {other} was answered")


def read_device_type_segmented(bench: Bench) -> Procedure[str]:
    """2.13: the server chooses the kind of an upload. Segments must bring the four bytes. An expedited transfer is over at once
    (if the test is strict, a segment request after it must be refused)."""
    response = yield from initiate_upload(bench, DEVICE_TYPE, 0)
    content = expedited_data(response)
    if content is None:
        content = yield from upload_segments(bench)
        how = "in segments"
    else:
        if bench.strict:
            refusal = abort_code_in((yield from ask(bench, bytes((UPLOAD_SEGMENT,)))))
            expect_refusal(refusal, BAD_COMMAND, "a segment request behind an expedited upload")
        how = "expedited"
    expect_equal(len(content), 4, f"the number of bytes of 0x1000:00, read {how},")
    holds(bench, bench.variable(DEVICE_TYPE), content, how)
    return how


def write_time(index: int, bench: Bench) -> Procedure[None]:
    """2.14, 2.15: two bytes in one segment. If the test is strict, a first segment with the toggle bit set is refused before."""
    bench.check_writable(index)
    written = bench.encode(index, 0, ANY_TIME)
    if bench.strict:
        yield from ask(bench, initiate(INITIATE_DOWNLOAD | SIZE_BIT, index, 0, len(written).to_bytes(4, "little")))
        response = yield from ask(bench, segment(DOWNLOAD_SEGMENT | TOGGLE, written, 0))
        expect_refusal(abort_code_in(response), BAD_TOGGLE, "a download segment with a wrong toggle bit")
    yield from segmented_download(bench, index, 0, written)
    expect_equal((yield from bench.read(index)), written, f"0x{index:04X}:00, read back,")


def read_segmented(bench: Bench) -> Procedure[str]:
    """2.16: an object of more than four bytes comes in segments, as many bytes as announced."""
    variable = long_object(bench)
    content = yield from segmented_upload(bench, variable.index, variable.subindex)
    expect(len(content) > 4, f"{variable.label} came in segments with {counted(len(content), 'byte')}")
    if variable.size is not None:
        expect_equal(len(content), variable.size, f"the number of bytes of {variable.label}")
    return f"{variable.label}: {counted(len(content), 'byte')}"


def wrong_toggle(bench: Bench) -> Procedure[None]:
    """2.17: a request for the first segment with the toggle bit set is refused."""
    variable = long_object(bench)
    yield from initiate_upload(bench, variable.index, variable.subindex)
    response = yield from ask(bench, bytes((UPLOAD_SEGMENT | TOGGLE,)))
    expect_refusal(abort_code_in(response), BAD_TOGGLE, "a segment request with a wrong toggle bit")


def read_segmented_content(bench: Bench) -> Procedure[str]:
    """2.18: segments bring the object's value, each time, and also after a transfer that was left half-way.

    An initiate in mid-transfer begins a new transfer, or is refused with an abort. If the test is strict, a transfer is left by
    an abort too, to which no server answers (7.2.4.3.17).
    """
    variable = long_object(bench)
    place = variable.index, variable.subindex
    first = yield from segmented_upload(bench, *place)
    yield from ask(bench, initiate(INITIATE_UPLOAD, *place))  # and leave it there
    refusal = abort_code_in((yield from ask(bench, initiate(INITIATE_UPLOAD, *place))))
    if refusal is not None:
        expect_refusal(refusal, BAD_COMMAND, "another initiate upload in mid-transfer")
    else:
        expect_equal((yield from upload_segments(bench)), first, f"{variable.label}, begun again in mid-transfer,")
    if bench.strict:
        yield from ask(bench, initiate(INITIATE_UPLOAD, *place))
        yield from bench.send(bench.request_key, initiate(ABORT, *place, AbortCode.GENERAL_ERROR.to_bytes(4, "little")))
        yield from bench.expect_silence(bench.response_key, REACTION_TIME, "an abort was answered")
    expect_equal((yield from segmented_upload(bench, *place)), first, f"{variable.label}, read again,")
    holds(bench, variable, first, "in segments")
    return f"{variable.label}: {counted(len(first), 'byte')}"


CASES: Final = (
    Case("2.1", "SDO 01", "Read 0x1000:00 with an expedited transfer", read_expedited, (DEVICE_TYPE,)),
    Case("2.2", "SDO 02", "Read and write the entries of 0x1000 to 0x1FFF that can be written", read_and_write),
    Case("2.3", "SDO 03", "Try to write to 0x1000:00", write_device_type, (DEVICE_TYPE,)),
    Case("2.4", "SDO 04", "Try to read a write-only object", read_write_only),
    Case("2.5", "SDO 05", "Try to read the non-existing subindex 0x1000:01", read_missing_subindex, (DEVICE_TYPE,)),
    Case("2.6", "SDO 06", "Try to read the non-existing object 0x1004:00", read_missing_object),
    Case("2.7", "SDO 07", "Read with a wrong command specifier", wrong_command_specifier),
    Case("2.8", "SDO 08", "Write an UNSIGNED32 to an object of 16 or 8 bits", write_too_long),
    Case("2.9", "SDO 09", "Write an UNSIGNED8 to an object of 16 or 32 bits", write_too_short),
    Case("2.10", "SDO 10", "Try to write too high a value", write_too_high),
    Case("2.11", "SDO 11", "Try to write too low a value", write_too_low),
    Case("2.12", "SDO 12", "Compare 0x1200:01 and 0x1200:02 with the predefined values", default_channel, (SDO_SERVER,)),
    Case("2.13", "SDO 13", "Read 0x1000:00 with a segmented transfer", read_device_type_segmented, (DEVICE_TYPE,)),
    Case("2.14", "SDO 14", "Write 0x100C:00 segmented, if guarding is supported", partial(write_time, GUARD_TIME), (GUARD_TIME,)),
    Case("2.15", "SDO 15", "Write 0x1017:00 segmented, if heartbeat is supported", partial(write_time, HEARTBEAT), (HEARTBEAT,)),
    Case("2.16", "SDO 16", "Check the segmented read of an object of more than 4 bytes", read_segmented),
    Case("2.17", "SDO 17", "Read an object segmented with a wrong toggle bit", wrong_toggle),
    Case("2.18", "SDO 18", "Read an object segmented", read_segmented_content),
)
