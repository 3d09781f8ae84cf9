"""The bit rate that the kernel tells of an interface: its answer by rtnetlink, byte by byte."""

from __future__ import annotations

import struct
import sys

import pytest

if sys.platform != "linux":
    pytest.skip("SocketCAN is part of Linux", allow_module_level=True)

from canopen_transports.socketcan.bit_rate import bitrate_in, bitrate_of


def attribute(kind: int, data: bytes) -> bytes:
    return (struct.pack("=HH", 4 + len(data), kind) + data).ljust(4 + (len(data) + 3 & ~3), b"\0")


def answer(*parts: bytes, kind: int = 16) -> bytes:
    body = struct.pack("=BxHiII", 0, 280, 7, 0x41, 0) + b"".join(parts)  # ARPHRD_CAN; up, running
    return struct.pack("=IHHII", 16 + len(body), kind, 0, 1, 0) + body


def link_info(*data: bytes) -> bytes:
    return attribute(0x8000 | 18, attribute(1, b"can\0") + attribute(0x8000 | 2, b"".join(data)))


TIMING = struct.pack("=8I", 500_000, 875, 125, 6, 7, 2, 1, 5)
"""struct can_bittiming: bit rate, sample point, tq, segments, sjw, brp."""


def test_the_bit_rate_lies_three_attributes_deep() -> None:
    name, state = attribute(3, b"can0\0"), attribute(4, struct.pack("=I", 0))
    assert bitrate_in(answer(name, link_info(state, attribute(1, TIMING)), attribute(13, b"x"))) == 500_000


@pytest.mark.parametrize(
    "told",
    [
        b"",
        answer(),
        answer(attribute(3, b"vcan0\0"), attribute(18, attribute(1, b"vcan\0"))),  # without bit timing
        answer(link_info(attribute(1, bytes(32)))),  # not set yet
        answer(link_info(attribute(1, TIMING[:2]))),
        answer(b"\1\0\0\0"),  # shorter than its own head
        answer(link_info(attribute(1, TIMING)), kind=2),  # NLMSG_ERROR
    ],
)
def test_without_a_bit_rate_there_is_none(told: bytes) -> None:
    assert bitrate_in(told) is None


def test_the_kernel_answers() -> None:
    """The loopback is no CAN interface, but the question is the same."""
    assert bitrate_of("lo") is None
    assert bitrate_of("nothing0") is None
