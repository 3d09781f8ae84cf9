"""SDO transfers overheard: nothing is found in clean ones, whatever they are; each fault that is planted is found."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.observer.finding import BusFinding
from canopen_proto.observer.observer import Observer
from canopen_proto.sdo.codec import TOGGLE
from tests.core.block_pair import BlockPair, pattern
from tests.core.bus import Bus
from tests.examples import examples

Session = list[tuple[Time, Frame]]
REQUEST, ANSWER = 0x60C, 0x58C


def findings(session: Session) -> list[BusFinding]:
    observer = Observer()
    return [finding for now, frame in session for finding in observer.observe(frame, now).findings]


def rules(session: Session) -> list[str]:
    return [finding.rule for finding in findings(session)]


def transfer(
    size: int, *, up: bool, block: bool, crc: bool = True, block_size: int = 127, loss: float = 0.0, seed: int = 0
) -> Session:
    """A transfer of our client and our server, as a recording has it."""
    content = pattern(size)
    pair = BlockPair(
        Bus(seed, loss=loss), content, client={"crc": crc, "block_size": block_size}, server={"block_size": block_size}
    )
    if up:
        pair.upload(block)
    else:
        pair.download(content, block)
    pair.bus.settle()
    return pair.bus.sent


def frames(*texts: str, apart: Time = MILLISECOND) -> Session:
    """Frames in candump's notation, some time apart."""
    return [(number * apart, Frame.parse(text)) for number, text in enumerate(texts)]


def with_data(session: Session, number: int, data: bytes) -> Session:
    """The same recording; one frame has other data."""
    now, frame = session[number]
    return [*session[:number], (now, Frame(frame.can_id, data)), *session[number + 1 :]]


SIZES = st.integers(1, 2000)
BLOCK_SIZES = st.integers(2, 127)


@given(SIZES, st.booleans(), st.booleans(), st.booleans(), BLOCK_SIZES)
@examples(60)
def test_nothing_is_found_in_a_clean_transfer(size: int, up: bool, block: bool, crc: bool, block_size: int) -> None:
    session = transfer(size, up=up, block=block, crc=crc, block_size=block_size)
    assert findings(session) == []
    assert findings([*session, *[(now + SECOND * 9, frame) for now, frame in session]]) == []


@given(SIZES, st.booleans(), st.booleans(), BLOCK_SIZES, st.sampled_from([0.0, 0.0, 0.02]), st.integers(0, 99))
@examples(60)
def test_a_transfer_is_put_together(size: int, up: bool, block: bool, block_size: int, loss: float, seed: int) -> None:
    """With losses the observer has heard what the receiver has not: a block that is sent again counts once."""
    observer = Observer()
    session = transfer(size, up=up, block=block, block_size=block_size, loss=loss if block else 0.0, seed=seed)
    shown = [shown for now, frame in session for shown in observer.observe(frame, now).meaning.objects]
    held = [each.value for each in shown if each.is_held]
    was_aborted = any(frame.data[:1] == b"\x80" for _, frame in session)
    assert {(each.node_id, each.index, each.subindex) for each in shown} == {(12, 0x2000, 0)}
    assert held == [pattern(size)] or was_aborted


@given(SIZES, st.booleans(), BLOCK_SIZES, st.integers(0, 99))
@examples(60)
def test_nothing_is_found_in_a_block_transfer_that_repairs_losses(size: int, up: bool, block_size: int, seed: int) -> None:
    """The recording has what was sent, and not what the receiver has heard: it takes part only by its acknowledgements."""
    found = findings(transfer(size, up=up, block=True, block_size=block_size, loss=0.02, seed=seed))
    assert {finding.rule for finding in found} <= {"missing", "copied"}  # a frame that came behind an abort
    assert not any("CRC" in finding.text for finding in found)


@pytest.mark.parametrize("up", [False, True])
@given(size=st.integers(15, 300), place=st.integers(0, 10**6))
@examples(40)
def test_a_toggle_bit_that_does_not_alternate_is_found(up: bool, size: int, place: int) -> None:
    session = transfer(size, up=up, block=False)
    segments = range(2, len(session))
    number = segments[place % len(segments)]
    frame = session[number][1]
    planted = with_data(session, number, bytes([frame.data[0] ^ TOGGLE]) + frame.data[1:])
    assert rules(planted)[0] == "toggle"


@pytest.mark.parametrize("size", [7, 8, 14, 15, 22, 300])
def test_a_wrong_toggle_bit_of_the_answer_to_the_last_segment_of_a_download_is_found(size: int) -> None:
    """The size was judged before, when that segment came. With one segment there is no answer before of which it is a copy."""
    session = transfer(size, up=False, block=False)
    last = session[-1][1].data
    (found,) = findings(with_data(session, len(session) - 1, bytes([last[0] ^ TOGGLE]) + last[1:]))
    assert (found.rule, found.is_certain) == ("toggle", size <= 7)


@pytest.mark.parametrize(("up", "number", "is_certain"), [(False, 4, True), (False, 5, False), (True, 4, False), (True, 5, True)])
def test_a_wrong_toggle_bit_that_a_late_copy_would_have_is_likely_only(up: bool, number: int, is_certain: bool) -> None:
    """A frame without data is then the same as the one before of its side."""
    session = transfer(100, up=up, block=False)
    data = session[number][1].data
    (found,) = findings(with_data(session, number, bytes([data[0] ^ TOGGLE]) + data[1:]))
    assert (found.rule, found.is_certain) == ("toggle", is_certain)


@pytest.mark.parametrize("up", [False, True])
@given(size=st.integers(8, 1500), place=st.integers(0, 10**6), bit=st.integers(0, 55), block_size=BLOCK_SIZES)
@examples(60)
def test_a_flipped_bit_in_a_block_is_found(up: bool, size: int, place: int, bit: int, block_size: int) -> None:
    session = transfer(size, up=up, block=True, block_size=block_size)
    sender = ANSWER if up else REQUEST
    numbers = [each for each, (_, frame) in enumerate(session) if frame.can_id == sender]
    # Behind the initiate frames, and before the end; an upload's sender has one frame more at the beginning than a download's
    segments = numbers[1:-1]
    count = -(-size // 7)
    assert len(segments) == count
    at = place % size
    data = bytearray(session[segments[at // 7]][1].data)
    data[1 + at % 7] ^= 1 << bit % 8
    assert rules(with_data(session, segments[at // 7], bytes(data))) == ["crc"]
    without = transfer(size, up=up, block=True, block_size=block_size, crc=False)
    assert rules(with_data(without, segments[at // 7], bytes(data))) == []


@pytest.mark.parametrize("block", [False, True])
@pytest.mark.parametrize("up", [False, True])
def test_a_size_that_was_announced_wrongly_is_found(up: bool, block: bool) -> None:
    session = transfer(100, up=up, block=block)
    number = 1 if up else 0
    data = session[number][1].data
    planted = with_data(session, number, data[:4] + (99).to_bytes(4, "little"))
    (found,) = findings(planted)
    assert (found.rule, found.text) == ("size", "2000:00 was announced with 99 bytes, and has 100")


@pytest.mark.parametrize(
    ("texts", "rule", "words"),
    [
        (["60C#4041600000000000", "58C#4B41600037020000", "58C#4B41600037060000"], "missing", "whose request is not there"),
        (["60C#4041600000000000", "58C#4B41600037020000", "58C#4B41600037020000"], "copied", "answer is there twice"),
        (["60C#4041600000000000", "60C#4041600000000000", "58C#4B41600037020000"], "copied", "request is there twice"),
        (["60C#4041600000000000", "58C#4B42600037020000"], "missing", "for 6042:00; the request was for 6041:00"),
        (["60C#4041600000000000", "58C#6041600000000000"], "missing", "of another kind"),
        (
            ["60C#4041600000000000", "60C#4064600000000000", "58C#4B41600037020000", "58C#4364600000000000"],
            "missing",
            "another SDO client uses this channel, or an answer is missing",
        ),
        (["60C#2B4060000600", "58C#6040600000000000", "58C#8040600000000008"], "missing", "aborts a transfer whose request"),
        (["60C#2B4060000600", "58C#6040600000000000", "60C#0000000000000000"], "missing", "outside of such a transfer"),
        (["60C#2B40"], "sdo", "too short for its command"),
        (["60C#2B4060000600", "58C#60"], "sdo", "an SDO answer is too short"),
        (["60C#E000000000000000"], "sdo", "the command 0xE0, which does not exist"),
        (["60C#4000200000000000", "58C#4100200014000000", "58C#0041424344454647"], "missing", "a segment's answer"),
        (
            ["60C#C200200007000000", "58C#A40020007F000000", "60C#81AABBCCDDEEFF00", "58C#A2807F0000000000"],
            "sdo",
            "128 segments acknowledged",
        ),
        (["60C#A00020007F000000", "58C#C200200007000000", "60C#A200000000000000"], "missing", "a part of a block"),
    ],
)
def test_what_does_not_fit(texts: list[str], rule: str, words: str) -> None:
    found = findings(frames("60C#4041600000000000", "58C#4B41600037020000", *texts))
    assert [finding.rule for finding in found] == [rule]
    assert words in found[0].text
    assert found[0].node_id == 12
    assert found[0].is_certain == (rule == "sdo")


def test_two_requests_may_have_two_answers() -> None:
    both = ["60C#4041600000000000", "60C#4041600000000000", "58C#4B41600037020000", "58C#4B41600037020000"]
    assert findings(frames(*both, apart=SECOND // 50)) == []
    assert rules(frames(*both)) == ["copied"]


def test_another_client_is_told_once_it_has_shown_itself_three_times() -> None:
    both = frames("60C#4041600000000000", "60C#4064600000000000", "58C#4B41600037020000", "58C#4364600000000000")
    session = [(at + number * 2 * SECOND, frame) for number in range(3) for at, frame in both]
    assert rules(session) == ["missing", "missing", "two masters"]


def test_another_client_in_the_middle_of_a_transfer() -> None:
    session = transfer(100, up=True, block=False)
    at = session[5][0]
    strange = [(at, Frame.parse(text)) for text in ("60C#4000100000000000", "58C#4300100091010F00")]
    (found,) = findings([*session[:6], *strange, *session[6:]])
    assert (found.rule, found.is_certain) == ("two masters", True)
    assert "another SDO client uses this channel" in found.text


def test_two_nodes_that_answer_are_told_once_they_have_done_so_three_times() -> None:
    """The second answer comes sooner than one to a request that is missing could."""
    texts = ("60C#4041600000000000", "58C#4B41600037020000", "58C#4B41600037060000")
    session = [
        (number * 2 * SECOND + after, Frame.parse(text))
        for number in range(3)
        for after, text in zip((0, MILLISECOND, MILLISECOND + MILLISECOND // 10), texts, strict=True)
    ]
    assert rules(session) == ["missing", "missing", "double id"]


TYPE = ("60C#4000100000000000", "58C#4300100092010200")
OTHER_TYPE = "58C#4300100000000000"


def test_a_device_type_that_has_two_values_is_of_two_devices() -> None:
    """A scan goes on to the next object when the first answer is there, and the second device answers meanwhile."""
    (found,) = [each for each in findings(frames(*TYPE, "60C#4018100100000000", OTHER_TYPE)) if each.rule == "double id"]
    assert found.is_certain
    assert found.text == "two devices answer as node 12: 1000:00 is 0x00020192 and 0x00000000"
    (found,) = [each for each in findings(frames(*TYPE, TYPE[0], OTHER_TYPE, apart=SECOND)) if each.rule == "double id"]
    assert not found.is_certain, "the recording may lack a boot-up"
    assert rules(frames(*TYPE, *TYPE, *TYPE)) == []
    assert rules(frames(*TYPE, "70C#00", TYPE[0], OTHER_TYPE)) == ["boot-up"], "it has another program now"
    identity = ("60C#4018100400000000", "58C#4318100401000000")
    written = ("60C#2318100402000000", "58C#6018100400000000")
    assert rules(frames(*identity, *written, identity[0], "58C#4318100402000000")) == []


def test_a_request_that_is_given_up_is_no_fault() -> None:
    assert findings(frames("60C#4041600000000000", "60C#4064600000000000", "58C#4364600000000000", apart=SECOND)) == []


def test_a_recording_that_begins_in_the_middle_is_no_fault() -> None:
    for block in (False, True):
        for up in (False, True):
            session = transfer(100, up=up, block=block)
            for begin in range(1, len(session)):
                later = [(now + SECOND, frame) for now, frame in transfer(9, up=True, block=False)]
                assert findings(session[begin:] + later) == []


def test_segments_that_the_recording_lacks_are_no_fault() -> None:
    for up in (False, True):
        session = transfer(100, up=up, block=True)
        segments = [number for number, (_, frame) in enumerate(session) if frame.can_id == (ANSWER if up else REQUEST)][1:-1]
        for number in segments[:-1]:  # without the last one it cannot be known where the sub-block ends
            assert rules(session[:number] + session[number + 1 :]) == ["missing"]


@pytest.mark.parametrize("up", [False, True])
def test_an_acknowledgement_that_comes_once_more_is_no_fault(up: bool) -> None:
    session = transfer(100, up=up, block=True, block_size=5)
    numbers = [number for number, (_, frame) in enumerate(session) if frame.data[:1] == b"\xa2"]
    assert len(numbers) == 3
    for number in numbers:  # behind the last one the end is due
        again = [(at + 100_000, frame) for at, frame in session[number:]]
        assert rules(session[: number + 1] + again) == ["copied"]


@pytest.mark.parametrize("up", [False, True])
def test_a_sub_block_that_the_recording_lacks_is_no_fault(up: bool) -> None:
    """Its acknowledgement looks like the one before, said once more: only the CRC tells."""
    session = transfer(100, up=up, block=True, block_size=5)
    first, second, _ = [number for number, (_, frame) in enumerate(session) if frame.data[:1] == b"\xa2"]
    lacking = session[: first + 1] + session[second:]
    assert set(rules(lacking)) <= {"missing", "copied"}
    observer = Observer()
    shown = [shown for now, frame in lacking for shown in observer.observe(frame, now).meaning.objects]
    assert not any(each.is_held for each in shown)


def test_an_abort_in_the_middle_of_a_block_ends_the_transfer() -> None:
    for up in (False, True):
        session = transfer(100, up=up, block=True)
        abort = Frame.parse("60C#8000200000000405") if not up else Frame.parse("58C#8000200000000405")
        assert findings([*session[:5], (session[5][0], abort), *transfer(20, up=up, block=False)]) == []


def test_a_server_may_answer_a_block_upload_in_segments() -> None:
    session = frames("60C#A40020007F150000", "58C#4100200008000000", "60C#6000000000000000", "58C#0041424344454647")
    session += frames("60C#7000000000000000", "58C#1D48000000000000")
    assert findings(session) == []


def test_the_objects_of_the_standard_have_names_and_types_without_a_file() -> None:
    session = frames("60C#40561F0100000000", "58C#43561F0178563412", "60C#2F511F0103000000", "58C#60511F0100000000")
    observer = Observer()
    shown = [observer.observe(frame, now).meaning.objects[0] for now, frame in session]
    assert [each.name for each in shown] == ["program_software_identification:program_1"] * 2 + ["program_control:program_1"] * 2
    assert (shown[1].value, shown[2].value) == (0x12345678, 3)


def test_the_answer_to_a_request_that_is_too_short_is_not_told_again() -> None:
    session = frames("60C#4018100100000000", "58C#4318100101000000", "60C#4018", "58C#4318100201000000", "60C#4018100300000000")
    assert rules(session) == ["sdo"]


@pytest.mark.parametrize(("after", "told"), [(10, ["missing"]), (1500, ["missing", "size"])])
def test_a_size_right_behind_a_gap_is_no_fault_of_the_node(after: int, told: list[str]) -> None:
    gap = frames("60C#4018100100000000", "58C#4318100201000000")
    odd = frames("60C#2100200005000000", "58C#6000200000000000", "60C#0761626364000000")
    assert rules([*gap, *((at + after * MILLISECOND, frame) for at, frame in odd)]) == told
