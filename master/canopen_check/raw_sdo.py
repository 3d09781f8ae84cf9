"""SDO frame by frame, for the cases that check the frames themselves, or send frames that a client never sends.

`ask` sends one request and awaits its response. `segmented_upload` and `segmented_download` do a whole transfer and check every
bit of every response. CiA 301 v4.2.0, 7.2.4.3."""

from __future__ import annotations

from typing import Final

from canopen_check.bench import ANSWER_TIME, Bench
from canopen_check.expectations import Violation, expect, expect_equal
from canopen_proto.procedures.steps import Procedure
from canopen_proto.sdo.codec import (
    ABORT,
    DOWNLOAD_SEGMENT,
    DOWNLOAD_SEGMENT_RESPONSE,
    EXPEDITED_BIT,
    INITIATE_DOWNLOAD,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    INITIATE_UPLOAD_RESPONSE,
    LAST,
    SIZE_BIT,
    SPECIFIER,
    TOGGLE,
    UPLOAD_SEGMENT,
    segment,
)

MAX_SEGMENTS: Final = 1 << 12
"""The most segments of one upload: if the server never sends the last one, the case ends."""


def multiplexer(index: int, subindex: int) -> bytes:
    """Return the three bytes of a frame that name an object."""
    return index.to_bytes(2, "little") + bytes((subindex,))


def initiate(command: int, index: int, subindex: int, content: bytes = b"") -> bytes:
    """Return a request that names an object, with up to four bytes after it."""
    return (bytes((command,)) + multiplexer(index, subindex) + content).ljust(8, b"\x00")


def ask(bench: Bench, request: bytes) -> Procedure[bytes]:
    """Send a request (filled up to eight bytes); return the response, which must have eight."""
    bench.probe.forget(bench.response_key)
    request = request.ljust(8, b"\x00")
    yield from bench.send(bench.request_key, request)
    return (yield from answer(bench, f"the answer to {request.hex(' ')}"))


def answer(bench: Bench, what: str) -> Procedure[bytes]:
    """Return the server's next frame."""
    heard = yield from bench.next_frame(bench.response_key, ANSWER_TIME, what)
    data = heard.frame.data
    expect_equal(len(data), 8, f"the length of {what} ({heard.frame})")
    return data


def abort_code_in(response: bytes) -> int | None:
    """Return the code of an abort; None if the response is not an abort."""
    return int.from_bytes(response[4:], "little") if response[0] & SPECIFIER == ABORT else None


def expect_command(response: bytes, specifier: int, what: str) -> None:
    """Check that a response has this server command specifier."""
    code = abort_code_in(response)
    if code is not None and specifier != ABORT:
        raise Violation(f"{what} was answered by abort 0x{code:08X}")
    expect(response[0] & SPECIFIER == specifier, f"{what} was answered by the command byte 0x{response[0]:02X}")


def expect_multiplexer(response: bytes, index: int, subindex: int) -> None:
    """Check that a response names this object."""
    expect_equal(response[1:4], multiplexer(index, subindex), f"the object that {response.hex(' ')} names")


def initiate_upload(bench: Bench, index: int, subindex: int) -> Procedure[bytes]:
    """Send an initiate upload request; check and return the response."""
    response = yield from ask(bench, initiate(INITIATE_UPLOAD, index, subindex))
    expect_command(response, INITIATE_UPLOAD_RESPONSE, f"the upload of 0x{index:04X}:{subindex:02X}")
    expect_multiplexer(response, index, subindex)
    return response


def expedited_content(response: bytes) -> bytes | None:
    """Return the data of an expedited upload response; None if it begins a segmented transfer."""
    command = response[0]
    if not command & EXPEDITED_BIT:
        return None
    unused = command >> 2 & 3 if command & SIZE_BIT else 0
    return response[4 : 8 - unused]


def segmented_upload(bench: Bench, index: int, subindex: int) -> Procedure[bytes]:
    """Do a whole upload in segments; return the data. Checks toggle, counts and announced size; an expedited answer is a
    Violation."""
    response = yield from initiate_upload(bench, index, subindex)
    place = f"0x{index:04X}:{subindex:02X}"
    expect(expedited_content(response) is None, f"{place} came with an expedited transfer")
    announced = int.from_bytes(response[4:], "little") if response[0] & SIZE_BIT else None
    content = yield from upload_segments(bench)
    if announced is not None:
        expect_equal(len(content), announced, f"the number of bytes of {place}, against the one announced,")
    return content


def upload_segments(bench: Bench) -> Procedure[bytes]:
    """Receive the segments of an upload that was initiated; return the data."""
    content, toggle = b"", 0
    for _ in range(MAX_SEGMENTS):
        response = yield from ask(bench, bytes((UPLOAD_SEGMENT | toggle,)))
        expect_command(response, 0, "an upload segment request")
        expect_equal(response[0] & TOGGLE, toggle, "the toggle bit of an upload segment")
        content += response[1 : 8 - (response[0] >> 1 & 7)]
        if response[0] & LAST:
            return content
        toggle ^= TOGGLE
    raise Violation(f"no last segment came among {MAX_SEGMENTS}")


def segmented_download(bench: Bench, index: int, subindex: int, content: bytes) -> Procedure[None]:
    """Do a whole download in segments, however short the data."""
    size = len(content).to_bytes(4, "little")
    response = yield from ask(bench, initiate(INITIATE_DOWNLOAD | SIZE_BIT, index, subindex, size))
    expect_command(response, INITIATE_DOWNLOAD_RESPONSE, f"the segmented download of 0x{index:04X}:{subindex:02X}")
    expect_multiplexer(response, index, subindex)
    toggle = 0
    for offset in range(0, len(content), 7):
        response = yield from ask(bench, segment(DOWNLOAD_SEGMENT | toggle, content, offset))
        expect_command(response, DOWNLOAD_SEGMENT_RESPONSE, "a download segment")
        expect_equal(response[0] & TOGGLE, toggle, "the toggle bit of a segment's confirmation")
        toggle ^= TOGGLE
