"""Chapter 2, continued: SDO block transfer (CiA 301 v4.2.0, 7.2.4.3.8 to 7.2.4.3.16)."""

from __future__ import annotations

from functools import partial
from typing import Final

from canopen_check.bench import Bench
from canopen_check.case import Case
from canopen_check.expectations import expect_refusal
from canopen_check.raw_block import (
    begin_block_upload,
    block_download,
    block_upload,
    initiate_block_upload,
    receive_sub_block,
)
from canopen_check.raw_sdo import abort_code_in, ask
from canopen_check.sdo_cases import ANY_TIME, DEVICE_TYPE, TIME_SIZE, holds, long_object
from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.procedures.steps import Procedure
from canopen_proto.sdo.block import ACKNOWLEDGE, MAX_BLOCK_SIZE
from canopen_proto.sdo.codec import ACKNOWLEDGEMENT, START_UPLOAD
from canopen_proto.verdict import expect_equal

BAD_BLOCK_SIZE: Final = (AbortCode.INVALID_COMMAND, AbortCode.INVALID_BLOCK_SIZE, AbortCode.GENERAL_ERROR)
BAD_SEQUENCE: Final = (AbortCode.INVALID_COMMAND, AbortCode.INVALID_SEQUENCE_NUMBER, AbortCode.GENERAL_ERROR)

GUARD_TIME: Final = indices.GUARD_TIME
HEARTBEAT: Final = indices.PRODUCER_HEARTBEAT_TIME


def _remark(asked: bool, with_crc: bool) -> str:
    return "the device has no CRC" if asked and not with_crc else ""


def read_device_type(bench: Bench) -> Procedure[None]:
    """2.19: four bytes in one segment."""
    content, _ = yield from block_upload(bench, DEVICE_TYPE, 0, crc=False)
    expect_equal(len(content), 4, "the number of bytes of 0x1000:00")
    holds(bench, bench.variable(DEVICE_TYPE), content, "by block transfer")


def read_long(crc: bool, bench: Bench) -> Procedure[str]:
    """2.22 and 2.23: blocks bring the object's value, each time. crc: whether one is asked for."""
    variable = long_object(bench)
    for _ in range(2):
        content, with_crc = yield from block_upload(bench, variable.index, variable.subindex, crc=crc)
        expect_equal(content, (yield from bench.read(variable.index, variable.subindex)), f"{variable.label}, by block transfer,")
    return _remark(crc, with_crc) or variable.label


def write_time(index: int, crc: bool, bench: Bench) -> Procedure[str]:
    """2.20, 2.21, 2.24, 2.25: two bytes in one segment. crc: whether one is offered."""
    written = bench.encode(index, 0, ANY_TIME)
    expect_equal(len(written), TIME_SIZE, f"the number of bytes of 0x{index:04X}:00, by the dictionary,")
    with_crc = yield from block_download(bench, index, 0, written, crc=crc)
    expect_equal((yield from bench.read(index)), written, f"0x{index:04X}:00, read back,")
    return _remark(crc, with_crc)


def wrong_block_size(bench: Bench) -> Procedure[None]:
    """2.26: a sub-block has at most 127 segments. More are refused at once, or when the upload is started."""
    variable = long_object(bench)
    response = yield from initiate_block_upload(bench, variable.index, variable.subindex, crc=False, block_size=128)
    if abort_code_in(response) is None:
        response = yield from ask(bench, bytes((START_UPLOAD,)))
    expect_refusal(abort_code_in(response), BAD_BLOCK_SIZE, "the block size 128")


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
