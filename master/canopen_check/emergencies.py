"""Emergency messages of a device under test (CiA 301 v4.2.0, 7.2.7).

"Error reset" (code 0) reports no error, and is skipped.
"""

from __future__ import annotations

from canopen_check.bench import Bench
from canopen_check.probe import FrameHeard
from canopen_proto.machine import Time
from canopen_proto.procedures.steps import Procedure, current_time
from canopen_proto.verdict import ViolationError, expect_equal


def code_of(message: bytes) -> int:
    """Return the error code of a message."""
    return int.from_bytes(message[:2], "little")


def errors_heard(bench: Bench) -> list[FrameHeard]:
    """Return the messages about errors that came and were not taken yet."""
    return [each for each in bench.probe.take_all(bench.emcy_key) if code_of(each.frame.data)]


def next_error(bench: Bench, timeout: Time, what: str) -> Procedure[FrameHeard]:
    """Return the next message about an error. Raises NotInTimeError, which names `what`.

    timeout: ns. The inhibit time of emergency messages comes on top: the one before may have been sent just now.
    """
    end = (yield from current_time()) + timeout + bench.emergency_inhibit_time
    while True:
        left = max(end - (yield from current_time()), 0)
        heard = yield from bench.next_frame(bench.emcy_key, left, what)
        expect_equal(len(heard.frame.data), 8, f"the length of the emergency message ({heard.frame})")
        if code_of(heard.frame.data):
            return heard
        end += bench.emergency_inhibit_time


def expect_no_error(bench: Bench, duration: Time, what: str) -> Procedure[None]:
    """Check that no message about an error comes within `duration` ns. what: for the text."""
    bench.probe.listen_also(bench.emcy_key)
    yield from bench.sleep(duration)
    for each in errors_heard(bench):
        raise ViolationError(f"{what}: {each.frame} came")
