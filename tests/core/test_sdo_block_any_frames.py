"""Any frames and any commands at any times, into a client and a server in the middle of block transfers."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, LocalProtocolError, Outcome
from canopen_proto.sdo.server import ObjectAccessPending
from tests.core.block_bench import Bench, ClientBench, ServerBench, segments
from tests.core.block_pair import pattern
from tests.core.machines import held_data
from tests.examples import examples

MUX = st.sampled_from(["002000", "012000", "000000", "081000"])
INITIATES = st.builds(
    lambda command, mux, rest: f"{command:02X}{mux}{rest}",
    st.sampled_from([0xA0, 0xA4, 0xC0, 0xC2, 0xC4, 0xC6, 0x20, 0x21, 0x23, 0x40, 0x41, 0x43, 0x60, 0x80]),
    MUX,
    st.sampled_from(["04", "7F", "01", "00", "0D000000", "80", "7FFF", "FFFFFFFF"]),
)
SIZES = st.sampled_from([0, 1, 3, 4, 127, 255])
ACKNOWLEDGEMENTS = st.builds(
    lambda sequence, size: f"A2{sequence:02X}{size:02X}", st.sampled_from([0, 1, 2, 3, 4, 127, 128]), SIZES
)
SEGMENTS = st.builds(
    lambda sequence, final: f"{sequence | final << 7:02X}01020304050607", st.integers(0, 6) | st.integers(0, 127), st.booleans()
)
ENDS = st.sampled_from(["A1", "A3", "C1", "C5", "DD", "C90000", "00", "10", "60", "70"])
RUNS = st.integers(1, 5).map(lambda count: " ".join(segments(pattern(7 * count), final=False)))
ANY = st.binary(min_size=1, max_size=8).map(bytes.hex)
STEPS = st.lists(
    st.one_of(
        INITIATES,
        ACKNOWLEDGEMENTS,
        SEGMENTS,
        ENDS,
        RUNS,
        ANY,
        st.tuples(st.just("time"), st.sampled_from([1, MILLISECOND, 100 * MILLISECOND, 300 * MILLISECOND, 6 * SECOND])),
        st.tuples(st.just("act"), st.integers(0, 99)),
    ),
    max_size=50,
)
LARGEST = 60
HELD = LARGEST + 127 * 7 + 7


def play(bench: Bench, step: str | tuple[str, int]) -> list[Event]:
    if isinstance(step, tuple):
        if step[0] == "time":
            end = bench.now + step[1]
            for _ in range(400):  # at most a sub-block, a frame a turn, and what follows
                if bench.machine.deadline > end:
                    break
                bench.now = max(bench.now, bench.machine.deadline)
                bench.machine.handle_timeout(bench.now)
            assert bench.machine.deadline > end
            bench.now = end
    else:
        bench.tell(*step.split())
    bench.said()
    transfer = bench.machine._transfer
    assert held_data(transfer) <= HELD
    assert len(getattr(transfer, "_content", b"")) <= 1 << 17
    assert transfer is None or bench.machine.deadline < NEVER
    return bench.events()


@examples(300)
@given(steps=STEPS, crc=st.booleans(), block_size=st.integers(1, 127), max_burst=st.integers(1, 127))
def test_a_client(steps: list[str | tuple[str, int]], crc: bool, block_size: int, max_burst: int) -> None:
    bench = ClientBench(max_upload=LARGEST, max_queue=3, crc=crc, block_size=block_size, max_burst=max_burst)
    client = bench.client
    unanswered: set[int] = set()
    for step in steps:
        if isinstance(step, tuple) and step[0] == "act":
            more, what = divmod(step[1], 7)
            try:
                match what:
                    case 0:
                        unanswered.add(client.upload(0x2000, 0, bench.now, block=(True, "auto", False)[more % 3]))
                    case 1:
                        unanswered.add(client.download(0x2000, 0, pattern(more * 9), bench.now, block=(True, "auto")[more % 2]))
                    case 2:
                        unanswered.add(client.upload_stream(0x2000, 0, bench.now))
                    case 3:
                        unanswered.add(client.download_stream(0x2000, 0, bench.now, size=None if more % 2 else more))
                    case 4:
                        for request_id in unanswered:
                            client.feed(request_id, bytes(more), bench.now, last=more % 5 == 0)
                    case 5:
                        for request_id in unanswered:
                            client.proceed(request_id, bench.now)
                    case _:
                        for request_id in sorted(unanswered)[:1]:
                            client.cancel(request_id, bench.now)
            except LocalProtocolError:
                pass
        for report in play(bench, step):
            if isinstance(report, Outcome):
                unanswered.remove(report.request_id)
    for _ in range(30):
        for report in play(bench, ("time", 6 * SECOND)):
            if isinstance(report, Outcome):
                unanswered.remove(report.request_id)
    assert not unanswered
    assert not client.busy


@examples(300)
@given(steps=STEPS, crc=st.booleans(), block_size=st.integers(1, 127), max_burst=st.integers(1, 127))
def test_a_server(steps: list[str | tuple[str, int]], crc: bool, block_size: int, max_burst: int) -> None:
    bench = ServerBench(pattern(50), max_download=LARGEST, crc=crc, block_size=block_size, max_burst=max_burst)
    pending: list[ObjectAccessPending] = []
    for step in steps:
        if isinstance(step, tuple) and step[0] == "act":
            more = step[1]
            if more % 9 == 0:
                bench.server.disable()
                bench.server.enable()
            for access in pending[-2:]:
                given = None if access.data is not None else pattern(more)
                answer = AbortCode.LOCAL_CONTROL if more % 7 == 0 else given
                bench.server.complete(access.access_id, answer, bench.now, more=more % 3 > 0, size=None if more % 2 else more)
            pending.clear()
        pending += [report for report in play(bench, step) if isinstance(report, ObjectAccessPending)]
    for _ in range(5):
        play(bench, ("time", 6 * SECOND))
    assert not bench.server.busy
    assert bench.server.deadline == NEVER
