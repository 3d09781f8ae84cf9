"""SDO frame by frame, for the cases that check the frames themselves, or send frames that a client never sends.

`ask` sends one request and awaits its response. `segmented_upload` and `segmented_download` do a whole transfer and check every
bit of every response. CiA 301 v4.2.0, 7.2.4.3."""

from __future__ import annotations

from typing import Final

from canopen_check.bench import ANSWER_TIME, Bench
from canopen_proto.procedures.steps import Procedure
from canopen_proto.sdo.codec import (
    DOWNLOAD_SEGMENT,
    INITIATE_DOWNLOAD,
    INITIATE_UPLOAD,
    LAST,
    RESPONSES,
    SIZE_BIT,
    TOGGLE,
    UPLOAD_SEGMENT,
    SdoFrame,
    announced_size,
    expedited_data,
    number_in,
    segment,
    segment_data,
)
from canopen_proto.verdict import ViolationError, expect, expect_equal

MAX_SEGMENTS: Final = 1 << 12
"""The most segments of one upload: if the server never sends the last one, the case ends."""


def multiplexer(index: int, subindex: int) -> bytes:
    """Return the three bytes of a frame that name an object."""
    return index.to_bytes(2, "little") + bytes((subindex,))


def initiate(command: int, index: int, subindex: int, content: bytes = b"") -> bytes:
    """Return a request that names an object, with up to four bytes after it. command: the command byte."""
    return (bytes((command,)) + multiplexer(index, subindex) + content).ljust(8, b"\x00")


def ask(bench: Bench, request: bytes) -> Procedure[bytes]:
    """Send a request (filled up to eight bytes); return the response, which must have eight."""
    bench.probe.forget(bench.response_key)
    request = request.ljust(8, b"\x00")
    yield from bench.send(bench.request_key, request)
    return (yield from answer(bench, f"the answer to {request.hex(' ')}"))


def answer(bench: Bench, what: str) -> Procedure[bytes]:
    """Return the server's next frame. what: the answer, for the text."""
    heard = yield from bench.next_frame(bench.response_key, ANSWER_TIME, what)
    data = heard.frame.data
    expect_equal(len(data), 8, f"the length of {what} ({heard.frame})")
    return data


def abort_code_in(response: bytes) -> int | None:
    """Return the code of an abort; None if the response is not an abort."""
    return number_in(response) if RESPONSES[response[0]] is SdoFrame.ABORT else None


def expect_response(response: bytes, expected: SdoFrame, what: str, place: tuple[int, int] | None = None) -> None:
    """Check that a request was answered by this frame, and that it names this index and subindex, if any.

    expected: no abort. what: the request, in words.
    """
    code = abort_code_in(response)
    if code is not None:
        raise ViolationError(f"{what} was answered by abort 0x{code:08X}")
    expect(RESPONSES[response[0]] is expected, f"{what} was answered by the command byte 0x{response[0]:02X}")
    if place is not None:
        expect_equal(response[1:4], multiplexer(*place), f"the object that {response.hex(' ')} names")


def initiate_upload(bench: Bench, index: int, subindex: int) -> Procedure[bytes]:
    """Send an initiate upload request; check and return the response."""
    response = yield from ask(bench, initiate(INITIATE_UPLOAD, index, subindex))
    expect_response(response, SdoFrame.UPLOAD, f"the upload of 0x{index:04X}:{subindex:02X}", (index, subindex))
    return response


def segmented_upload(bench: Bench, index: int, subindex: int) -> Procedure[bytes]:
    """Do a whole upload in segments; return the data. Checks toggle, counts and announced size; an expedited answer is a
    ViolationError."""
    response = yield from initiate_upload(bench, index, subindex)
    place = f"0x{index:04X}:{subindex:02X}"
    expect(expedited_data(response) is None, f"{place} came with an expedited transfer")
    announced = announced_size(response)
    content = yield from upload_segments(bench)
    if announced is not None:
        expect_equal(len(content), announced, f"the number of bytes of {place}, against the one announced,")
    return content


def upload_segments(bench: Bench) -> Procedure[bytes]:
    """Receive the segments of an upload that was initiated; return the data."""
    content, toggle = b"", 0
    for _ in range(MAX_SEGMENTS):
        response = yield from ask(bench, bytes((UPLOAD_SEGMENT | toggle,)))
        expect_response(response, SdoFrame.UPLOAD_SEGMENT, "an upload segment request")
        expect_equal(response[0] & TOGGLE, toggle, "the toggle bit of an upload segment")
        content += segment_data(response)
        if response[0] & LAST:
            return content
        toggle ^= TOGGLE
    raise ViolationError(f"no last segment came among {MAX_SEGMENTS}")


def segmented_download(bench: Bench, index: int, subindex: int, content: bytes) -> Procedure[None]:
    """Do a whole download in segments, however short the data. content: the bytes of the value."""
    size = len(content).to_bytes(4, "little")
    response = yield from ask(bench, initiate(INITIATE_DOWNLOAD | SIZE_BIT, index, subindex, size))
    what = f"the segmented download of 0x{index:04X}:{subindex:02X}"
    expect_response(response, SdoFrame.DOWNLOAD, what, (index, subindex))
    toggle = 0
    for offset in range(0, len(content), 7):
        response = yield from ask(bench, segment(DOWNLOAD_SEGMENT | toggle, content, offset))
        expect_response(response, SdoFrame.DOWNLOAD_SEGMENT, "a download segment")
        expect_equal(response[0] & TOGGLE, toggle, "the toggle bit of a segment's confirmation")
        toggle ^= TOGGLE
