"""Several clients on one SDO channel (contention.py): never wrong bytes as success, never "confirmed" for what is not there.

The model of the property is fuzz/sdo_clients.py, which runs as many cases as one likes by hand.
"""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given, note
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Event, Outbox, Outcome, Time
from canopen_proto.sdo.access import ObjectStore
from canopen_proto.sdo.client import CONTEST_LIMIT, LATE_GUARD, TIMEOUT, SdoAborted, SdoDownloaded, SdoUploaded
from canopen_proto.sdo.codec import what_was_asked
from canopen_proto.sdo.contention import SPREAD
from canopen_proto.sdo.server import SdoServer
from fuzz.sdo_clients import SERVERS, History, case_of, many, run
from tests.core.bus import take_events
from tests.core.test_sdo_client import Bench
from tests.examples import examples


@pytest.mark.parametrize("kind", SERVERS)
def test_whoever_else_speaks_no_wrong_bytes_and_no_false_word(kind: str) -> None:
    @examples(400)
    @given(source=st.randoms(use_true_random=False))
    def check(source: Random) -> None:
        case = case_of(source, kind)
        note(str(case))
        assert run(case) == []

    check()


def test_the_program_for_many_cases_says_how_they_ended(capsys: pytest.CaptureFixture[str]) -> None:
    assert many(30, "0") == 0
    said = capsys.readouterr().out
    assert "30 cases, 0 false words" in said
    for end in ("SdoUploaded", "SdoDownloaded", "CONTESTED"):
        assert f"{end} " in said


class Forgetful(History):
    """It stores nothing that is written."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | None:
        return None


class Liar(SdoServer):
    """It confirms writes of which the history knows nothing."""

    def __init__(self, out: Outbox, node_id: int, store: ObjectStore) -> None:
        super().__init__(out, node_id, Forgetful())


def test_the_program_shows_a_false_word_with_its_case(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SERVERS, "restarts", Liar)
    assert many(30, "0") == 1
    said = capsys.readouterr().out
    assert "confirmed what was not written" in said
    assert "Case(seed=" in said
    assert "0 false words" not in said


# ---- single cases: what is sent when, and what is said ----


class Shared(Bench):
    """A client of node 12 that hears a stranger's requests too."""

    def other(self, *requests: str) -> None:
        for request in requests:
            self.now += MILLISECOND
            self.client.receive(Frame(0x60C, bytes.fromhex(request)), self.now)

    def wait(self, duration: Time) -> None:
        self.now += duration
        self.client.handle_timeout(self.now)

    def outcomes(self) -> list[Event]:
        return [event for event in take_events(self.out) if isinstance(event, Outcome)]


QUESTION = "60C#4000100000000000"
READ, FOREIGN_READ = "60C#4008100000000000", "40 01 10 00 00 00 00 00"


def test_a_request_waits_until_the_strangers_exchange_is_over() -> None:
    bench = Shared()
    bench.other(FOREIGN_READ)
    bench.client.upload(0x1008, 0, bench.now)
    assert bench.frames() == []
    bench.hear("4F 01 10 00 05 00 00 00")
    assert bench.frames() == [READ]


FOREIGN_WRITE, CONFIRMED = "2B 17 10 00 08 00 00 00", "60 17 10 00 00 00 00 00"
"""A stranger's exchange about the object that we write."""


@pytest.mark.parametrize("given_up", [1, 2])
def test_a_write_that_was_given_up_in_our_queue_is_not_confirmed_by_what_the_server_says_to_a_stranger(given_up: int) -> None:
    """No answer tells whose it is, however often the server says that the object was written: only the answer to a question
    behind ours in our queue shows that it has them all."""
    bench = Shared()
    urgent = [bench.client.download(0x1017, 0, bytes((number, 0)), bench.now, urgent=True) for number in range(given_up)]
    last = bench.client.download(0x1017, 0, b"\7\0", bench.now)
    bench.other(FOREIGN_WRITE)  # before ours on the bus
    bench.hear(CONFIRMED)
    bench.other(FOREIGN_READ)
    bench.hear("4F 01 10 00 05 00 00 00")
    sent = bench.frames()
    assert [frame for frame in sent if frame.startswith("60C#2B")] == [
        f"60C#2B1710000{number}000000" for number in range(given_up)
    ]
    assert sent[-1] == QUESTION
    for _ in range(given_up):
        bench.hear("60 17 10 00 00 00 00 00")  # now ours has come to the server
        assert bench.frames() == []
    bench.hear("43 00 10 00 92 01 02 00")
    bench.wait(2 * SPREAD)  # a stranger's turn
    assert bench.frames() == ["60C#2B17100007000000"]
    ended = bench.outcomes()
    assert [event.request_id for event in ended if isinstance(event, SdoAborted) and event.not_confirmed] == urgent
    assert len(ended) == given_up
    bench.hear("60 17 10 00 00 00 00 00")
    assert bench.outcomes() == [SdoDownloaded(12, last, 0x1017, 0)]


def test_an_urgent_write_goes_out_at_once_and_is_not_confirmed_while_one_that_was_given_up_may_wait_in_our_queue() -> None:
    bench = Shared()
    bench.client.download(0x1017, 0, b"\0\0", bench.now, urgent=True)
    bench.other(FOREIGN_WRITE)  # before ours on the bus
    bench.hear(CONFIRMED)
    bench.other(FOREIGN_READ)  # of another object: an answer that names ours would be ours, if no other were due
    bench.frames(), bench.outcomes()
    second = bench.client.download(0x1017, 0, b"\1\0", bench.now, urgent=True)
    assert bench.frames() == ["60C#8017100000000008", "60C#2B17100001000000"]  # some servers stay in what was left
    bench.hear("60 17 10 00 00 00 00 00")  # to the first
    (aborted,) = bench.outcomes()
    assert isinstance(aborted, SdoAborted)
    assert (aborted.request_id, aborted.origin, aborted.not_confirmed) == (second, AbortOrigin.CONTESTED, True)


def test_a_request_waits_through_the_segments_of_a_stranger() -> None:
    bench = Shared()
    bench.other("40 08 10 00 00 00 00 00")
    bench.hear("41 08 10 00 08 00 00 00")
    bench.client.upload(0x1008, 0, bench.now)
    bench.other("60 00 00 00 00 00 00 00")
    bench.hear("00 31 32 33 34 35 36 37")
    bench.other("70 00 00 00 00 00 00 00")
    assert bench.frames() == []
    bench.hear("1D 38 00 00 00 00 00 00")
    assert bench.frames() == [READ]


@pytest.mark.parametrize(("requests", "quiet"), [(["40 08 10 00 00 00 00 00"], TIMEOUT), (["C6 50 1F 01 00 10 00 00"], SECOND)])
def test_a_stranger_that_falls_silent_is_waited_for_no_longer_than_that(requests: list[str], quiet: Time) -> None:
    bench = Shared()
    bench.other(*requests)
    bench.client.upload(0x1008, 0, bench.now)
    bench.wait(quiet - 1)
    assert bench.frames() == []
    bench.wait(1)
    assert bench.frames() == [READ]


def test_a_stranger_that_never_ends_is_named_after_the_limit() -> None:
    bench = Shared()
    bench.other("C6 50 1F 01 00 00 10 00")
    requests = [bench.client.upload(0x1008, 0, bench.now), bench.client.download(0x1017, 0, b"\0\0", bench.now)]
    begun = bench.now
    while bench.client.busy:
        bench.other("01 00 00 00 00 00 00 00")
        bench.wait(100 * MILLISECOND)
    assert bench.now <= begun + CONTEST_LIMIT + 200 * MILLISECOND
    first, second = bench.outcomes()
    assert isinstance(first, SdoAborted)
    assert isinstance(second, SdoAborted)
    assert [first.request_id, second.request_id] == requests
    assert first.origin is second.origin is AbortOrigin.CONTESTED
    assert not second.not_confirmed  # it was never sent
    assert bench.frames() == []


def test_each_wait_for_a_stranger_has_its_own_limit_however_long_ago_the_one_before_was() -> None:
    bench = Shared()
    for _ in range(3):  # a drive is polled, while somebody looks at it every two seconds
        bench.other(FOREIGN_READ)
        request = bench.client.upload(0x6041, 0, bench.now)
        assert bench.frames() == []
        bench.hear("4F 01 10 00 05 00 00 00")
        assert bench.frames() == ["60C#4041600000000000"]
        bench.hear("4B 41 60 00 37 02 00 00")
        assert bench.outcomes() == [SdoUploaded(12, request, 0x6041, 0, b"\x37\x02")]
        bench.wait(2 * SECOND)


STATUSWORD, STATUS = "60C#4041600000000000", "4B 41 60 00 37 02 00 00"


def test_an_urgent_read_that_was_disturbed_by_a_reader_is_made_again_behind_it_and_holds_no_stop() -> None:
    bench = Shared()
    request = bench.client.upload(0x6041, 0, bench.now, urgent=True)
    bench.other("40 41 60 00 00 00 00 00")  # the same object: whose answer is it?
    assert bench.frames().count(STATUSWORD) == 2
    bench.hear(STATUS, STATUS)
    assert bench.outcomes() == []
    bench.client.download(0x6040, 0, b"\x02\0", bench.now, urgent=True)
    frames = bench.frames()
    assert "60C#2B40600002000000" in frames, "a stop goes out at once"
    bench.hear(STATUS, "60 40 60 00 00 00 00 00")
    bench.outcomes()
    for _ in range(100):
        if bench.client.busy:
            bench.wait(20 * MILLISECOND)
            bench.hear(*(STATUS for frame in bench.frames() if frame == STATUSWORD))
    assert bench.outcomes() == [SdoUploaded(12, request, 0x6041, 0, b"\x37\x02")]


def test_urgent_reads_that_went_well_leave_the_next_one_its_whole_limit() -> None:
    bench = Shared()
    for _ in range(3):  # a motion only reads, and all of it is urgent
        request = bench.client.upload(0x6041, 0, bench.now, urgent=True)
        bench.hear("41 41 60 00 08 00 00 00")
        bench.other(FOREIGN_READ)
        bench.hear("4F 01 10 00 05 00 00 00", STATUS)
        while bench.client.busy:
            bench.wait(20 * MILLISECOND)
            bench.hear(*(STATUS for frame in bench.frames() if frame == STATUSWORD))
        assert bench.outcomes() == [SdoUploaded(12, request, 0x6041, 0, b"\x37\x02")]
        bench.frames()
        bench.wait(2 * SECOND)


def test_a_wait_that_was_cancelled_does_not_shorten_the_next_one() -> None:
    bench = Shared()
    bench.other(FOREIGN_READ)
    bench.client.cancel(bench.client.upload(0x6041, 0, bench.now), bench.now)
    bench.outcomes()
    bench.hear("4F 01 10 00 05 00 00 00")
    bench.wait(CONTEST_LIMIT)
    bench.other(FOREIGN_READ)
    bench.client.upload(0x6041, 0, bench.now)
    assert bench.outcomes() == []
    bench.hear("4F 01 10 00 05 00 00 00")
    assert bench.frames() == ["60C#4041600000000000"]


def test_an_urgent_request_does_not_wait() -> None:
    bench = Shared()
    bench.other("C6 50 1F 01 00 00 10 00", "01 00 00 00 00 00 00 00")
    request = bench.client.download(0x6040, 0, b"\x07\x01", bench.now, urgent=True)
    assert bench.frames() == ["60C#2B40600007010000"]
    bench.hear("60 40 60 00 00 00 00 00")  # or a frame that looks like it
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.request_id, end.origin, end.not_confirmed) == (request, AbortOrigin.CONTESTED, True)


def in_a_strangers_segments() -> Shared:
    """A stop went out in the middle of a stranger's read, and the server has only gone on with that."""
    bench = Shared()
    bench.other("40 08 10 00 00 00 00 00")
    bench.hear("41 08 10 00 08 00 00 00")
    bench.other("60 00 00 00 00 00 00 00")
    bench.client.download(0x6040, 0, b"\x02\0", bench.now, urgent=True)
    assert bench.frames() == ["60C#2B40600002000000"]
    bench.hear("00 31 32 33 34 35 36 37")
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)
    assert bench.frames() == []
    return bench


def test_the_second_stop_first_ends_a_strangers_transfer_in_which_a_server_may_be_deaf() -> None:
    bench = in_a_strangers_segments()
    bench.wait(SPREAD)
    bench.client.download(0x6040, 0, b"\x02\0", bench.now, urgent=True)
    assert bench.frames() == ["60C#8040600000000008", "60C#2B40600002000000"]


def test_no_other_request_ends_a_strangers_transfer() -> None:
    bench = in_a_strangers_segments()
    bench.client.upload(0x6041, 0, bench.now, urgent=True)
    assert bench.frames() == ["60C#4041600000000000"]
    bench = in_a_strangers_segments()
    bench.wait(SECOND)
    assert bench.frames() == []
    bench.client.download(0x6040, 0, b"\x02\0", bench.now)
    assert bench.frames() == ["60C#2B40600002000000"]


def test_an_expedited_answer_names_its_object_so_another_read_does_no_harm() -> None:
    bench = Shared()
    request = bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other(FOREIGN_READ)
    bench.hear("4F 01 10 00 05 00 00 00", "60 40 60 00 00 00 00 00")
    assert bench.outcomes() == [SdoDownloaded(12, request, 0x6040, 0)]


READS_IT, VALUE, OURS = "40 40 60 00 00 00 00 00", "4B 40 60 00 0F 00 00 00", "60 40 60 00 00 00 00 00"
"""A stranger reads the object that we write; its answer, and ours."""


@pytest.mark.parametrize("answers", [(VALUE, OURS), (OURS, VALUE), (VALUE, VALUE, OURS)])
@pytest.mark.parametrize("begins", ["we", "we, beside another read", "the stranger"])
def test_a_stranger_that_reads_what_we_write_takes_nothing_from_our_confirmation(begins: str, answers: tuple[str, ...]) -> None:
    """The server says 0x60 to writes alone. A value is no answer to a write."""
    bench = Shared()
    if begins.startswith("we"):
        request = bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
        bench.other(*([FOREIGN_READ] if "beside" in begins else []), READS_IT)
    else:
        bench.other(READS_IT)
        request = bench.client.download(0x6040, 0, b"\x0f\0", bench.now, urgent=True)
    for answer in answers:
        bench.hear(answer)
        assert bool(bench.outcomes() == [SdoDownloaded(12, request, 0x6040, 0)]) == (answer == OURS)
    assert bench.frames() == ["60C#2B4060000F000000"]


def test_a_refusal_that_may_be_the_strangers_leaves_our_write_not_confirmed_and_our_answer_confirms_no_later_one() -> None:
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other(READS_IT)
    bench.hear("80 40 60 00 01 00 01 06")  # it cannot be read
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)
    second = bench.client.download(0x6040, 0, b"\x07\0", bench.now, urgent=True)
    bench.other(FOREIGN_READ)
    bench.hear(OURS)  # to the first one
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.request_id, end.origin, end.not_confirmed) == (second, AbortOrigin.CONTESTED, True)


def test_an_answer_to_a_write_of_ours_that_ended_long_ago_confirms_none_while_a_stranger_has_gone_on_since() -> None:
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other("A4 01 10 00 02 00 00 00")
    for _ in range(8):
        bench.wait(100 * MILLISECOND)
        bench.other(FOREIGN_READ)
    bench.outcomes()
    bench.client.download(0x6040, 0, b"\x07\0", bench.now, urgent=True)
    bench.hear(OURS)
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)


def test_a_stranger_that_reads_what_we_write_and_then_writes_it_has_perhaps_our_confirmation() -> None:
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other(READS_IT, "2B 40 60 00 06 00 00 00")
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)


def test_a_value_in_segments_of_the_object_that_we_write_ends_the_write_in_doubt() -> None:
    """Some servers hear no request of others in such a transfer."""
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other(READS_IT)
    bench.hear("41 40 60 00 08 00 00 00")
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)


@pytest.mark.parametrize("foreign", ["2B 40 60 00 06 00 00 00", "80 40 60 00 00 00 04 05"])
def test_a_write_is_not_confirmed_if_the_answer_may_be_the_strangers(foreign: str) -> None:
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other(foreign)
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)
    assert "0x6040:00" in end.others_doing
    bench.hear("60 40 60 00 00 00 00 00")
    assert bench.outcomes() == []


def test_a_read_in_segments_is_made_again_once_the_stranger_is_done() -> None:
    bench = Shared()
    request = bench.client.upload(0x1008, 0, bench.now)
    bench.hear("41 08 10 00 08 00 00 00")
    bench.frames()
    bench.other(FOREIGN_READ)
    assert bench.frames() == []
    bench.hear("4F 01 10 00 05 00 00 00")
    assert bench.frames() == ["60C#8008100000000008", READ]  # some servers stay in the transfer that was left
    bench.hear("41 08 10 00 08 00 00 00", "00 31 32 33 34 35 36 37", "1D 38 00 00 00 00 00 00")
    assert bench.outcomes() == [SdoUploaded(12, request, 0x1008, 0, b"12345678")]


def test_the_servers_abort_because_of_a_stranger_is_no_refusal() -> None:
    bench = Shared()
    request = bench.client.upload(0x1008, 0, bench.now)
    bench.other(FOREIGN_READ)
    bench.hear("80 08 10 00 01 00 04 05")
    assert bench.frames() == [READ]
    assert bench.outcomes() == []
    bench.wait(TIMEOUT + SPREAD)
    assert bench.frames() == ["60C#8008100000000008", READ]
    bench.hear("80 08 10 00 00 00 02 06")
    (end,) = bench.outcomes()
    assert end == SdoAborted(12, request, 0x1008, 0, AbortCode.NO_SUCH_OBJECT, AbortOrigin.PEER)


def test_a_write_in_segments_is_broken_off_at_once_before_both_mix() -> None:
    bench = Shared()
    bench.client.download(0x2000, 0, bytes(20), bench.now)
    bench.hear("60 00 20 00 00 00 00 00")
    bench.frames()
    bench.other("00 01 02 03 04 05 06 07")
    assert bench.frames() == ["60C#8000200000000008"]
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert end.not_confirmed
    assert end.others_doing == "sent a segment of a write"


@pytest.mark.parametrize(
    ("request_data", "words"),
    [
        ("2F 60 60 00 01 00 00 00", "wrote 0x6060:00"),
        ("21 60 60 00 01 00 00 00", "began to write 0x6060:00"),
        (FOREIGN_READ, "asked for 0x1001:00"),
        ("70 00 00 00 00 00 00 00", "asked for a segment of a read"),
        ("80 01 10 00 00 00 04 05", "aborted the transfer of 0x1001:00 with 0x05040000"),
        ("A4 01 10 00 7F 00 00 00", "began a block read of 0x1001:00"),
        ("C6 50 1F 01 00 10 00 00", "began a block write of 0x1F50:01"),
        ("A2 7F 7F 00 00 00 00 00", "sent a frame of a block transfer (command 0xA2)"),
    ],
)
def test_what_the_stranger_did_is_said_in_words(request_data: str, words: str) -> None:
    assert what_was_asked(bytes.fromhex(request_data)) == words


def test_an_urgent_write_is_not_confirmed_by_the_late_answer_to_the_write_before() -> None:
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other("A4 01 10 00 02 00 00 00")
    bench.hear("C6 01 10 00 04 00 00 00")
    bench.other("80 01 10 00 00 00 04 05")
    bench.wait(SPREAD)
    bench.outcomes()
    bench.client.download(0x6040, 0, b"\x07\0", bench.now, urgent=True)
    bench.hear("60 40 60 00 00 00 00 00")
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)


def test_nor_by_the_late_answer_to_a_write_that_timed_out_though_the_strangers_exchange_is_over() -> None:
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.wait(TIMEOUT)
    bench.other(FOREIGN_READ)
    bench.hear("4F 01 10 00 05 00 00 00")
    bench.outcomes()
    bench.client.download(0x6040, 0, b"\x07\0", bench.now, urgent=True)
    bench.hear("60 40 60 00 00 00 00 00")
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)


@pytest.mark.parametrize("before", ["read", "write"])
def test_nor_is_it_refused_by_the_late_refusal_of_the_request_before(before: str) -> None:
    """The server may take the urgent write all the same: "refused" would be a false word."""
    bench = Shared()
    if before == "read":
        bench.client.upload(0x6040, 0, bench.now)
    else:
        bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.wait(TIMEOUT)
    bench.outcomes()
    urgent = bench.client.download(0x6040, 0, b"\x07\0", bench.now, urgent=True)
    bench.hear("80 40 60 00 01 00 01 06")
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.request_id, end.origin, end.not_confirmed) == (urgent, AbortOrigin.PEER, True)
    second = bench.client.download(0x6040, 0, b"\x06\0", bench.now)
    bench.wait(LATE_GUARD)
    bench.hear("43 00 10 00 92 01 02 00")  # the answer to the question before it: nothing else is due
    bench.hear("80 40 60 00 02 00 01 06")  # this is its own refusal
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.request_id, end.not_confirmed) == (second, False)


def test_a_write_waits_for_the_late_confirmation_of_each_of_two_urgent_ones_that_timed_out() -> None:
    bench = Shared()
    bench.client.late_guard = 4 * TIMEOUT
    for data in (b"\0\0", b"\1\0"):
        bench.client.download(0x1017, 0, data, bench.now, urgent=True)
        bench.wait(TIMEOUT)
    last = bench.client.download(0x1017, 0, b"\2\0", bench.now)
    bench.frames(), bench.outcomes()
    bench.hear("60 17 10 00 00 00 00 00")
    assert bench.frames() == []
    bench.hear("60 17 10 00 00 00 00 00")
    assert bench.frames() == ["60C#2B17100002000000"]
    bench.hear("60 17 10 00 00 00 00 00")
    assert bench.outcomes() == [SdoDownloaded(12, last, 0x1017, 0)]


def test_a_late_answer_to_a_read_does_not_show_that_the_server_has_our_write_of_that_object() -> None:
    bench = Shared()
    bench.client.download(0x1017, 0, b"\0\0", bench.now, urgent=True)
    bench.other("80 17 10 00 00 00 04 05")  # before ours on the bus
    bench.client.download(0x1008, 0, b"\1", bench.now, urgent=True)
    bench.other(FOREIGN_READ)
    bench.hear("C6 08 10 00 04 00 00 00")  # to a read in blocks that was given up before
    bench.hear("4F 01 10 00 05 00 00 00")
    bench.frames()
    bench.client.download(0x1017, 0, b"\7\0", bench.now)
    bench.wait(2 * SPREAD)
    assert bench.frames() == [QUESTION]  # the first write may stand in our queue yet


def test_an_acknowledgement_of_the_segment_before_is_not_the_last_one() -> None:
    bench = Shared()
    bench.other("21 00 20 00 08 00 00 00", "00 01 02 03 04 05 06 07", "1D 08 00 00 00 00 00 00")
    bench.hear("60 00 20 00 00 00 00 00", "20 00 00 00 00 00 00 00")
    bench.client.upload(0x1008, 0, bench.now)
    assert bench.frames() == []
    bench.hear("30 00 00 00 00 00 00 00")
    assert bench.frames() == [READ]


def test_a_read_does_not_go_on_in_segments_that_may_be_another_clients() -> None:
    bench = Shared()
    bench.client.upload(0x1008, 0, bench.now)
    bench.other("40 09 10 00 00 00 00 00")
    bench.hear("41 08 10 00 08 00 00 00", "41 09 10 00 08 00 00 00")
    assert bench.frames() == [READ]
    bench.wait(TIMEOUT + SPREAD)
    assert bench.frames() == ["60C#8008100000000008", READ]


def test_two_answers_about_one_object_are_both_waited_for() -> None:
    """Ours was ended by a stranger's abort; then it writes the same object. The first answer must not free the way."""
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other("80 01 10 00 00 00 04 05", "2B 40 60 00 06 00 00 00")
    bench.outcomes()
    bench.frames()
    bench.client.download(0x6040, 0, b"\x07\0", bench.now)
    bench.hear("60 40 60 00 00 00 00 00")
    assert bench.frames() == []
    bench.hear("60 40 60 00 00 00 00 00")
    assert bench.outcomes() == []
    bench.wait(TIMEOUT + SPREAD)
    assert bench.frames() == ["60C#2B40600007000000"]


def test_a_client_that_asks_without_a_pause_does_not_keep_us_out() -> None:
    """Both have asked for one object; after that each answer of the other's is followed by its next request."""
    bench = Shared()
    bench.client.upload(0x1000, 0, bench.now)
    bench.other("40 00 10 00 00 00 00 00")
    bench.frames()
    bench.hear("43 00 10 00 92 01 02 00", "43 00 10 00 92 01 02 00")
    bench.other(FOREIGN_READ)
    bench.hear("4F 01 10 00 05 00 00 00")
    assert bench.frames() == ["60C#8000100000000008", "60C#4000100000000000"]


@pytest.mark.parametrize("urgent", [False, True])
@examples(100, least=20)
@given(data=st.data())
def test_what_was_lost_is_no_reason_to_doubt_for_ever(urgent: bool, data: st.DataObject) -> None:
    """Whatever a stranger once did and whatever was lost: a write that is alone again, and is answered, is confirmed."""
    bench = Shared()
    name = "40 60 00"
    frames = ["40 08 10 00", "40 40 60 00", "2B 40 60 00", "21 40 60 00", "80 40 60 00", "60 00 00 00", "C6 40 60 00"]
    pauses = st.sampled_from([0, SPREAD, TIMEOUT, SECOND, 3600 * SECOND])
    bench.other(data.draw(st.sampled_from(frames)) + " 00 00 00 00")
    for step in data.draw(st.lists(st.sampled_from(["stranger", "write", "answer", "refusal"]), max_size=6)):
        bench.wait(data.draw(pauses))
        if step == "stranger":
            bench.other(data.draw(st.sampled_from(frames)) + " 00 00 00 00")
        elif step == "write":
            bench.client.download(0x6040, 0, b"\x0f\0", bench.now, urgent=data.draw(st.booleans()))
        else:
            bench.hear(f"{'60' if step == 'answer' else '80'} {name} 00 00 04 05")
    while bench.client.busy:  # nobody answers any more
        bench.wait(max(0, bench.client.deadline - bench.now))
    bench.wait(max(CONTEST_LIMIT, LATE_GUARD + SPREAD))
    bench.outcomes()
    bench.frames()
    for number in range(2):
        bench.client.download(0x6040, 0, b"\x02\0", bench.now, urgent=urgent)
        if number and not urgent:
            assert bench.frames() == ["60C#4000100000000000"]  # two writes of one object: a question comes between
            bench.hear("43 00 10 00 92 01 02 00")
        assert bench.frames() == ["60C#2B40600002000000"]
        bench.hear(f"60 {name} 00 00 00 00")
        (end,) = bench.outcomes()
        assert isinstance(end, SdoDownloaded)
        bench.wait(SPREAD)


@pytest.mark.parametrize(("size", "block", "answer"), [(100, True, "A4"), (100, False, "60"), (0, False, "60")])
def test_a_contested_write_of_more_than_one_frame_leaves_no_server_in_it(size: int, block: bool, answer: str) -> None:
    """It went out beside a stranger's request, so that its answer is in doubt: the server may have begun it."""
    bench = Shared()
    bench.other(FOREIGN_READ)
    bench.client.download(0x1F50, 1, bytes(size), bench.now, urgent=True, block=block)
    bench.frames()
    bench.hear(f"{answer} 50 1F 01 7F 00 00 00")
    assert bench.frames() == ["60C#80501F0100000008"]
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)
