"""Chapter 2, continued: SDO block transfer (CiA 301 v4.2.0, 7.2.4.3.8 to 7.2.4.3.16).

A transfer is made frame by frame, with a check of every bit of every response. A server need not support block transfer; the
cases do not apply then.
"""

from __future__ import annotations

from binascii import crc_hqx
from functools import partial
from typing import Final

from canopen_check.bench import Bench
from canopen_check.case import Case
from canopen_check.expectations import expect_refusal
from canopen_check.raw_sdo import MAX_SEGMENTS, abort_code_in, answer, ask, expect_response, initiate
from canopen_check.sdo_cases import ANY_TIME, HEARTBEAT, TIME_SIZE, holds, long_object
from canopen_proto.abort import AbortCode
from canopen_proto.indices import DEVICE_TYPE, GUARD_TIME
from canopen_proto.procedures.steps import Procedure
from canopen_proto.sdo.block import ACKNOWLEDGE, END_FRAME, MAX_BLOCK_SIZE, SEGMENT_SIZE
from canopen_proto.sdo.codec import (
    ABORT,
    ACKNOWLEDGEMENT,
    BLOCK_DOWNLOAD,
    BLOCK_SIZE_BIT,
    BLOCK_UPLOAD,
    CRC_BIT,
    END,
    END_RESPONSE,
    FINAL,
    RESPONSES,
    SEQUENCE,
    START_UPLOAD,
    SdoFrame,
    announced_size,
    unused_at_end,
)
from canopen_proto.verdict import ViolationError, does_not_apply, expect, expect_equal

BAD_BLOCK_SIZE: Final = (AbortCode.INVALID_COMMAND, AbortCode.INVALID_BLOCK_SIZE, AbortCode.GENERAL_ERROR)
BAD_SEQUENCE: Final = (AbortCode.INVALID_COMMAND, AbortCode.INVALID_SEQUENCE_NUMBER, AbortCode.GENERAL_ERROR)


# ---- frame by frame ----


def _expect_initiated(response: bytes, expected: SdoFrame, index: int, subindex: int) -> None:
    if abort_code_in(response) == AbortCode.INVALID_COMMAND:
        does_not_apply("the device does not support block transfer")
    expect_response(response, expected, f"the block transfer of 0x{index:04X}:{subindex:02X}", (index, subindex))


def initiate_block_upload(bench: Bench, index: int, subindex: int, *, crc: bool, block_size: int) -> Procedure[bytes]:
    """Send an initiate block upload request; return the answer, whatever it is. crc: whether one is asked for. block_size:
    segments in a sub-block, 1 to 127."""
    command = BLOCK_UPLOAD | (CRC_BIT if crc else 0)
    return (yield from ask(bench, initiate(command, index, subindex, bytes((block_size,)))))


def begin_block_upload(bench: Bench, index: int, subindex: int, *, crc: bool) -> Procedure[bytes]:
    """Send an initiate block upload request; check and return the answer. The upload can be started then. crc: whether one is
    asked for."""
    response = yield from initiate_block_upload(bench, index, subindex, crc=crc, block_size=MAX_BLOCK_SIZE)
    _expect_initiated(response, SdoFrame.BLOCK_UPLOAD, index, subindex)
    return response


def receive_sub_block(bench: Bench) -> Procedure[tuple[bytes, int, bool]]:
    """Receive a sub-block; return the data of its segments, their number, and whether the last segment is among them."""
    content = b""
    for sequence in range(1, MAX_BLOCK_SIZE + 1):
        segment = yield from answer(bench, f"segment {sequence} of a block")
        if segment[0] == ABORT:  # no segment has the number 0
            raise ViolationError(f"segment {sequence} did not come, but abort 0x{abort_code_in(segment):08X}")
        expect_equal(segment[0] & SEQUENCE, sequence, "the sequence number of a segment")
        content += segment[1:]
        if segment[0] & FINAL:
            return content, sequence, True
    return content, MAX_BLOCK_SIZE, False


def block_upload(bench: Bench, index: int, subindex: int, *, crc: bool, repeats: bool = False) -> Procedure[tuple[bytes, bool]]:
    """Do a whole block upload; return the data, and whether a CRC protected them. Numbers, size and CRC are checked. repeats: act
    as if the first sub-block had been lost, and expect it again (7.2.4.3.14)."""
    response = yield from begin_block_upload(bench, index, subindex, crc=crc)
    with_crc = crc and bool(response[0] & CRC_BIT)
    request, content, is_last = bytes((START_UPLOAD,)), b"", False
    while not is_last:
        yield from bench.send(bench.request_key, request.ljust(8, b"\x00"))
        data, count, is_last = yield from receive_sub_block(bench)
        if repeats:
            repeats = False
            yield from bench.send(bench.request_key, ACKNOWLEDGE.pack(ACKNOWLEDGEMENT, 0, MAX_BLOCK_SIZE).ljust(8, b"\x00"))
            again, _, _ = yield from receive_sub_block(bench)
            expect_equal(again, data, "the first sub-block, of which no segment was acknowledged, sent again,")
        content += data
        request = ACKNOWLEDGE.pack(ACKNOWLEDGEMENT, count, MAX_BLOCK_SIZE)
        expect(len(content) < MAX_SEGMENTS * SEGMENT_SIZE, f"no last segment came among {MAX_SEGMENTS}")
    end = yield from ask(bench, request)
    expect(RESPONSES[end[0]] is SdoFrame.BLOCK_END, f"the end of a block upload is 0x{end[0]:02X}")
    content = content[: len(content) - unused_at_end(end)]
    announced = announced_size(response)
    if announced is not None:
        expect_equal(len(content), announced, f"the number of bytes of 0x{index:04X}:{subindex:02X}, against the one announced,")
    if with_crc:
        expect_equal(int.from_bytes(end[1:3], "little"), crc_hqx(content, 0), "the CRC")
    yield from bench.send(bench.request_key, bytes((END_RESPONSE,)).ljust(8, b"\x00"))
    return content, with_crc


def block_download(bench: Bench, index: int, subindex: int, content: bytes, *, crc: bool) -> Procedure[bool]:
    """Do a whole block download of one segment (1 to 7 bytes); return whether a CRC protected it. crc:
    whether one is offered."""
    command = BLOCK_DOWNLOAD | BLOCK_SIZE_BIT | (CRC_BIT if crc else 0)
    response = yield from ask(bench, initiate(command, index, subindex, len(content).to_bytes(4, "little")))
    _expect_initiated(response, SdoFrame.BLOCK_DOWNLOAD, index, subindex)
    expect(1 <= response[4] <= MAX_BLOCK_SIZE, f"the block size that the device asks for is {response[4]}")
    with_crc = crc and bool(response[0] & CRC_BIT)
    acknowledgement = yield from ask(bench, bytes((FINAL | 1,)) + content)
    expect_response(acknowledgement, SdoFrame.BLOCK_ACKNOWLEDGEMENT, "a sub-block")
    expect_equal(acknowledgement[1], 1, "the number of acknowledged segments")
    unused = SEGMENT_SIZE - len(content)
    end = yield from ask(bench, END_FRAME.pack(END | unused << 2, crc_hqx(content, 0) if with_crc else 0))
    expect_response(end, SdoFrame.BLOCK_END_RESPONSE, "the end of a block download")
    return with_crc


# ---- the cases ----


def _remark(asked: bool, with_crc: bool) -> str:
    return "the device has no CRC" if asked and not with_crc else ""


def read_device_type(bench: Bench) -> Procedure[None]:
    """2.19: four bytes in one segment."""
    content, _ = yield from block_upload(bench, DEVICE_TYPE, 0, crc=False)
    expect_equal(len(content), 4, "the number of bytes of 0x1000:00")
    holds(bench, bench.variable(DEVICE_TYPE), content, "by block transfer")


def read_long(crc: bool, bench: Bench) -> Procedure[str]:
    """2.22 and 2.23: blocks bring the object's value, each time; if the test is strict, also after a lost sub-block. crc: whether
    one is asked for."""
    variable = long_object(bench)
    for repeats in (False, bench.strict):
        content, with_crc = yield from block_upload(bench, variable.index, variable.subindex, crc=crc, repeats=repeats)
        expect_equal(content, (yield from bench.read(variable.index, variable.subindex)), f"{variable.label}, by block transfer,")
    return _remark(crc, with_crc) or variable.label


def write_time(index: int, crc: bool, bench: Bench) -> Procedure[str]:
    """2.20, 2.21, 2.24, 2.25: two bytes in one segment. crc: whether one is offered."""
    bench.check_writable(index)
    written = bench.encode(index, 0, ANY_TIME)
    expect_equal(len(written), TIME_SIZE, f"the number of bytes of 0x{index:04X}:00, by the dictionary,")
    with_crc = yield from block_download(bench, index, 0, written, crc=crc)
    expect_equal((yield from bench.read(index)), written, f"0x{index:04X}:00, read back,")
    return _remark(crc, with_crc)


def wrong_block_size(bench: Bench) -> Procedure[None]:
    """2.26: a sub-block has at most 127 segments. More are refused at once, or when the upload is started; so is the size 0, if
    the test is strict."""
    variable = long_object(bench)
    for size in (128, 0) if bench.strict else (128,):
        response = yield from initiate_block_upload(bench, variable.index, variable.subindex, crc=False, block_size=size)
        if abort_code_in(response) is None:
            expect_response(response, SdoFrame.BLOCK_UPLOAD, f"a block upload with the block size {size}")
            response = yield from ask(bench, bytes((START_UPLOAD,)))
        expect_refusal(abort_code_in(response), BAD_BLOCK_SIZE, f"the block size {size}")


def wrong_sequence_number(bench: Bench) -> Procedure[None]:
    """2.27: there is no segment 128 to acknowledge."""
    variable = long_object(bench)
    yield from begin_block_upload(bench, variable.index, variable.subindex, crc=False)
    yield from bench.send(bench.request_key, bytes((START_UPLOAD,)).ljust(8, b"\x00"))
    yield from receive_sub_block(bench)
    response = yield from ask(bench, ACKNOWLEDGE.pack(ACKNOWLEDGEMENT, 128, MAX_BLOCK_SIZE))
    expect_refusal(abort_code_in(response), BAD_SEQUENCE, "the acknowledgement of segment 128")


_GUARD: Final = "Write 0x100C:00 with a block transfer {}, if there is guarding"
_BEAT: Final = "Write 0x1017:00 with a block transfer {}, if there is a heartbeat"
_PLAIN, _SAFE = "without CRC", "and CRC"

CASES: Final = (
    Case("2.19", "SDO 19", "Read 0x1000:00 with a block transfer without CRC", read_device_type, (DEVICE_TYPE,)),
    Case("2.20", "SDO 20", _GUARD.format(_PLAIN), partial(write_time, GUARD_TIME, False), (GUARD_TIME,)),
    Case("2.21", "SDO 21", _BEAT.format(_PLAIN), partial(write_time, HEARTBEAT, False), (HEARTBEAT,)),
    Case("2.22", "SDO 22", "Read a segmented object with a block transfer", partial(read_long, False)),
    Case("2.23", "SDO 23", "Read an object with a block transfer and CRC", partial(read_long, True)),
    Case("2.24", "SDO 24", _GUARD.format(_SAFE), partial(write_time, GUARD_TIME, True), (GUARD_TIME,)),
    Case("2.25", "SDO 25", _BEAT.format(_SAFE), partial(write_time, HEARTBEAT, True), (HEARTBEAT,)),
    Case("2.26", "SDO 26", "Perform a block read with a wrong block size (128)", wrong_block_size),
    Case("2.27", "SDO 27", "Perform a block read with a wrong sequence number (128)", wrong_sequence_number),
)
