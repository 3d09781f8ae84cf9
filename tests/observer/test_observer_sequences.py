"""Several frames in one line: a fastscan, and what a node is told behind its boot-up."""

from __future__ import annotations

from functools import partial

import pytest

from canopen_proto.frame import Frame
from canopen_proto.lss.messages import LssAddress, LssService
from canopen_proto.lss.scan import fastscan, survey
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.observer.observer import Observer
from tests.interop.recorded import load, needs_recordings
from tests.lss.lss_bench import LssBench, random_addresses

scene = partial(LssBench, bare=True)
Lines = list[tuple[Time, Frame]]


def told(lines: Lines) -> tuple[list[str], list[str]]:
    """The summaries, in their order with the frames that stand for themselves; and the frames that are part of a summary."""
    observer = Observer()
    seen, parts = [], []
    for now, frame in lines:
        observation = observer.observe(frame, now)
        seen += [f"{each.service} {each.node_id}: {each.text}" for each in observation.summaries]
        if observation.is_part:
            parts.append(observation.meaning.text)
        else:
            seen.append(observation.meaning.text)
    seen += [f"{each.service} {each.node_id}: {each.text}" for each in observer.unfinished()]
    assert observer.unfinished() == ()
    return seen, parts


def lines(*texts: str, apart: Time = 10 * MILLISECOND) -> Lines:
    return [(number * apart, Frame.parse(text)) for number, text in enumerate(texts)]


def test_a_fastscan_is_one_line() -> None:
    bench = scene([LssAddress(0x360, 0x2, 0x10003, 0xC0FFEE)])
    bench.run(fastscan(bench.tool, bench.pace))
    (summary,), parts = told(bench.bus.sent)
    address = "vendor-ID 0x00000360, product code 0x00000002, revision 0x00010003, serial number 0x00C0FFEE"
    assert summary.startswith(f"LSS 0: fastscan: {address} is selected (133 requests, ")
    assert len(parts) == len(bench.bus.sent) > 133
    assert parts[0] == "fastscan begins: who has no node-ID?", "each frame still has its own words"


def test_each_fastscan_of_a_survey_is_one_line() -> None:
    addresses = random_addresses(3, 3)
    bench = scene(addresses, together=True)
    bench.run(survey(bench.tool, bench.pace))
    seen, parts = told(bench.bus.sent)
    scans = [text for text in seen if "fastscan" in text]
    assert len(scans) == 4
    for address, text in zip(sorted(addresses), scans, strict=False):
        assert f"serial number 0x{address.serial:08X} is selected" in text
    assert "no device without a node-ID answers" in scans[3]
    assert sum(frame.data[:1] == bytes((LssService.FASTSCAN,)) for _, frame in bench.bus.sent) <= len(parts)


@pytest.mark.parametrize("end", [[], ["7E5#0400"], ["7E5#0400000000000000"], ["7E5#5100000000800000"]])
def test_a_fastscan_that_is_given_up(end: list[str]) -> None:
    begin = ["7E5#5100000000800000", "7E4#4F00000000000000", "7E5#51000000001F0000"]
    seen, parts = told(lines(*begin, *end))
    assert seen[0] == "LSS 0: fastscan: given up (2 requests, 20 ms)"
    assert parts[1:3] == ["slave: yes", "fastscan: is the vendor-ID 0x00000000 down to bit 31?"]


def test_a_fastscan_ends_with_a_silence() -> None:
    seen, _ = told([*lines("7E5#5100000000800000"), (3 * SECOND, Frame.parse("705#05"))])
    assert seen == ["LSS 0: fastscan: no device without a node-ID answers (1 request, 0 ms)", "operational"]


READ = ["605#4000100000000000", "585#4300100092010200"]
WRITE = ["605#2B171000E8030000", "585#6017100000000000"]
REFUSED = ["605#2B161001E8030000", "585#8016100111000906"]


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (["000#0105"], "; started 70 ms behind its boot-up"),
        (["000#0100"], "; started 70 ms behind its boot-up"),
        (["705#05"], "; operational 70 ms behind its boot-up"),
        (["705#00"], "; boots again 70 ms behind its boot-up"),
        (["000#8105"], "; reset 70 ms behind its boot-up"),
        ([], ""),
    ],
)
def test_what_a_node_is_told_behind_its_boot_up(end: list[str], words: str) -> None:
    seen, parts = told(lines("705#00", *READ, *WRITE, *REFUSED, *end))
    assert seen[:2] == ["", f"boot-up 5: 1 value read, 1 written, 1 transfer aborted (0x1016:01){words}"]
    assert len(seen) == 2 + len(end)
    assert len(parts) == 6


def test_others_are_no_part_of_a_boot_up() -> None:
    seen, parts = told([*lines("706#00", "705#7F", *READ), (3 * SECOND, Frame.parse("080#")), *lines("705#00", "080#")])
    assert (parts, [text for text in seen if "boot-up" in text]) == ([], [])
    seen, parts = told([*lines("705#00", *READ), *[(4 * SECOND, frame) for _, frame in lines(*READ)]])
    assert seen[1] == "boot-up 5: 1 value read, 0 written, 0 transfers aborted"
    assert len(parts) == 2


@needs_recordings
def test_the_boot_up_of_a_recorded_slave() -> None:
    seen, parts = told([(line.time, line.frame) for line in load("lely-master-boots-lely-slave")])
    assert "boot-up 4: 2 values read, 16 written, 0 transfers aborted; operational 207 ms behind its boot-up" in seen
    assert len(parts) == 36
