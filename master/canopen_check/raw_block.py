"""SDO block transfer frame by frame, with a check of every bit of every response (CiA 301 v4.2.0, 7.2.4.3.8 to 7.2.4.3.16).

A server need not support block transfer; the case does not apply then.
"""

from __future__ import annotations

from binascii import crc_hqx

from canopen_check.bench import Bench
from canopen_check.raw_sdo import MAX_SEGMENTS, abort_code_in, answer, ask, expect_response, initiate
from canopen_proto.abort import AbortCode
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


def block_upload(bench: Bench, index: int, subindex: int, *, crc: bool) -> Procedure[tuple[bytes, bool]]:
    """Do a whole block upload; return the data, and whether a CRC protected them. Numbers, size and CRC are checked."""
    response = yield from begin_block_upload(bench, index, subindex, crc=crc)
    with_crc = crc and bool(response[0] & CRC_BIT)
    request, content, is_last = bytes((START_UPLOAD,)), b"", False
    while not is_last:
        yield from bench.send(bench.request_key, request.ljust(8, b"\x00"))
        data, count, is_last = yield from receive_sub_block(bench)
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
