"""The boot-up of one node: every letter, every exchange that a recorded master has."""

from __future__ import annotations

from typing import Any

import pytest

from canopen_proto.frame import Frame
from canopen_proto.heartbeat import HeartbeatLost
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, SECOND, LocalProtocolError, Time
from canopen_proto.manager.boot.network_boot import BootReport
from canopen_proto.manager.boot.node_boot import MAX_RESTARTS, boot_node
from canopen_proto.manager.boot.outcome import BootLetter, BootOutcome
from canopen_proto.procedures.runner import ProcedureFinished
from canopen_proto.procedures.steps import Procedure, ProcedureError, sleep
from tests.manager.boot_bench import (
    DATE,
    DEVICE_TYPE,
    HEARTBEAT,
    LOAD,
    PRODUCT,
    PROGRAM,
    PROGRAM_DATE,
    PROGRAM_TIME,
    REVISION,
    SAVE,
    SERIAL,
    SETTING,
    TIME,
    VENDOR,
    Answer,
    BootBench,
    Object,
    entry,
    u32,
)

LISTED, BOOTS, KEEP_ALIVE, CHECKED, UPDATED, RESTORED = 0x01, 0x05, 0x15, 0x25, 0x65, 0x85
ABSENT = 0x0602_0000


def booted(
    answers: dict[Object, Answer] | None = None,
    assignment: int = BOOTS,
    *,
    state: int = 0x7F,
    boot_delay: Time = 12 * MILLISECOND,
    guarded: bool = False,
    **fields: Any,
) -> tuple[BootBench, BootOutcome]:
    """Boot node 6, which gives these answers, whatever a reset does to it."""
    bench = BootBench()
    bench.node.table.update(answers or {})
    bench.node.defaults.update(answers or {})
    bench.node.state, bench.node.boot_delay, bench.node.guarded = state, boot_delay, guarded
    hooks = {name: fields.pop(name) for name in ("until", "update", "configure") if name in fields}
    return bench, bench.run(boot_node(bench.remote, bench.commands, entry(6, assignment, **fields), **hooks))


def beating(node_time: int = 100) -> dict[Object, Answer]:
    return {HEARTBEAT: node_time.to_bytes(2, "little")}


TABLE: list[tuple[str, dict[Object, Answer], int, dict[str, Any], Object | None, int | None]] = [
    # letter, what the node answers, 0x1F81, what else; the object of the outcome, its abort code
    ("0", {}, BOOTS, {}, None, None),
    ("A", {}, 0, {}, None, None),
    ("B", {DEVICE_TYPE: None}, BOOTS, {}, DEVICE_TYPE, 0x0504_0000),
    ("B", {DEVICE_TYPE: ABSENT}, BOOTS, {}, DEVICE_TYPE, ABSENT),
    ("C", {DEVICE_TYPE: u32(0x10192)}, BOOTS, {}, DEVICE_TYPE, None),
    ("D", {VENDOR: u32(0x63)}, BOOTS, {}, VENDOR, None),
    ("D", {VENDOR: None}, BOOTS, {}, VENDOR, 0x0504_0000),
    ("M", {PRODUCT: u32(0x1235)}, BOOTS, {}, PRODUCT, None),
    ("M", {PRODUCT: ABSENT}, BOOTS, {}, PRODUCT, ABSENT),
    ("N", {REVISION: u32(0x10003)}, BOOTS, {}, REVISION, None),
    ("N", {REVISION: ABSENT}, BOOTS, {}, REVISION, ABSENT),
    ("O", {SERIAL: u32(0x63)}, BOOTS, {}, SERIAL, None),
    ("O", {SERIAL: ABSENT}, BOOTS, {}, SERIAL, ABSENT),
    ("E", {}, KEEP_ALIVE, {}, None, None),
    ("F", {}, KEEP_ALIVE, {"consumer_time": 0}, None, None),
    ("B", {}, KEEP_ALIVE, {"consumer_time": 0, "guarded": True, "boot_delay": NEVER}, None, None),
    ("G", {}, CHECKED, {}, None, None),
    ("G", {}, CHECKED, {"software": 0}, None, None),
    ("G", {PROGRAM: ABSENT}, CHECKED, {"software": 2}, PROGRAM, ABSENT),
    ("G", {PROGRAM: None}, CHECKED, {"software": 2}, PROGRAM, 0x0504_0000),
    ("H", {PROGRAM: u32(1)}, CHECKED, {"software": 2}, PROGRAM, None),
    ("H", {}, UPDATED | 0x10, {"software": 2, "consumer_time": 0, "guarded": True}, PROGRAM, None),
    ("G", {}, CHECKED, {"software_date": (9, 8)}, PROGRAM_DATE, ABSENT),
    ("H", {PROGRAM_DATE: u32(9), PROGRAM_TIME: u32(7)}, CHECKED, {"software_date": (9, 8)}, PROGRAM_TIME, None),
    ("H", {PROGRAM_DATE: u32(8), PROGRAM_TIME: u32(8)}, CHECKED, {"software_date": (9, 8)}, PROGRAM_DATE, None),
    ("0", {PROGRAM_DATE: u32(9), PROGRAM_TIME: u32(8)}, CHECKED, {"software_date": (9, 8)}, None, None),
    ("0", {PROGRAM: u32(2), PROGRAM_DATE: u32(1)}, CHECKED, {"software": 2, "software_date": (9, 8)}, None, None),
    ("I", {PROGRAM: u32(1)}, UPDATED, {"software": 2}, PROGRAM, None),
    ("J", {SETTING: 0x0609_0030}, BOOTS, {}, SETTING, 0x0609_0030),
    ("J", {SETTING: None}, BOOTS, {}, SETTING, 0x0504_0000),
    ("J", {LOAD: ABSENT}, RESTORED, {"restore_subindex": 1}, LOAD, ABSENT),
    ("J", {}, RESTORED, {"restore_subindex": 1, "boot_delay": NEVER}, LOAD, None),
    ("J", {SAVE: 0x0800_0020}, BOOTS, {"save": True}, SAVE, 0x0800_0020),
    ("J", {DATE: None}, BOOTS, {"date": (9, 9)}, DATE, 0x0504_0000),
    ("0", {TIME: ABSENT}, BOOTS, {"date": (9, 9)}, None, None),
    ("K", {}, BOOTS, {"configuration": ()}, HEARTBEAT, None),
    ("K", {}, 0x0064_0305, {"configuration": (), "consumer_time": 0}, None, None),
    ("0", {}, 0x0064_0305, {"configuration": (), "consumer_time": 0, "guarded": True}, None, None),
    ("0", {PROGRAM: u32(2)}, CHECKED, {"software": 2}, None, None),
    ("0", {}, LISTED, {"configuration": (), "consumer_time": 0}, None, None),
]  # fmt: skip


@pytest.mark.parametrize(("letter", "answers", "assignment", "fields", "place", "abort"), TABLE)
def test_every_letter(
    letter: str, answers: dict[Object, Answer], assignment: int, fields: dict[str, Any], place: Object | None, abort: int | None
) -> None:
    bench, outcome = booted(answers, assignment, **fields)
    assert (outcome.letter, outcome.object, outcome.abort_code) == (letter, place, abort)
    assert outcome.is_failure == (letter not in "0L")
    assert str(outcome).startswith(f"node 6: {outcome.meaning}")
    assert abort is None or ("has another" in outcome.meaning) == (letter in "HI"), "it was not read"
    assert abort in (None, 0x0504_0000) or outcome.meaning != "does not answer"
    assert f"({letter}, " in str(outcome)
    assert not any(command.startswith("000#01") for command in bench.commands_sent())
    assert outcome.elapsed <= 10 * SECOND


def test_every_letter_is_in_the_table() -> None:
    assert {row[0] for row in TABLE} | {"L"} == set(BootLetter)


def test_a_node_that_is_operational_is_left_running() -> None:
    bench = BootBench()
    bench.node.table.update(beating())
    bench.node.boot(bench.bus.now)
    bench.node.state = 5
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry(assignment=KEEP_ALIVE)))
    assert (outcome.letter, outcome.is_failure) == ("L", False)
    assert bench.node.writes == []
    assert bench.commands_sent() == []
    assert bench.remote.heartbeat.timeout == 500 * MILLISECOND


# ---- exchanges: those of a recorded master with a scripted node 6 ----

IDENTITY_READ = [
    "606#4000100000000000", "586#4300100091010100",
    "606#4018100100000000", "586#4318100160030000",
    "606#4018100200000000", "586#4318100234120000",
    "606#4018100300000000", "586#4318100302000100",
    "606#4018100400000000", "586#431810044D000000",
]  # fmt: skip
CONFIGURED = ["606#2B171000C8000000", "586#6017100000000000", "606#2B02200034120000", "586#6002200000000000"]


def test_the_exchange_of_a_good_boot_up() -> None:
    bench, outcome = booted()
    assert outcome.letter == "0"
    assert bench.bus.trace() == [*IDENTITY_READ, *CONFIGURED, "706#7F"]
    assert outcome.elapsed == 200 * MILLISECOND + 12 * 100 * MICROSECOND, "its heartbeat time, and the frames before and after"


@pytest.mark.parametrize(
    ("answers", "assignment", "fields", "trace"),
    [
        ({SETTING: 0x0609_0030}, BOOTS, {}, [*IDENTITY_READ, *CONFIGURED[:3], "586#8002200030000906"]),
        ({VENDOR: u32(0x63)}, BOOTS, {}, [*IDENTITY_READ[:3], "586#4318100163000000"]),
        (
            {},
            RESTORED,
            {"restore_subindex": 1},
            [*IDENTITY_READ, "606#231110016C6F6164", "586#6011100100000000", "000#8106", "706#00", *CONFIGURED, "706#7F"],
        ),
        (
            {},
            RESTORED,
            {"restore_subindex": 2},
            [*IDENTITY_READ, "606#231110026C6F6164", "586#6011100200000000", "000#8206", "706#00", *CONFIGURED, "706#7F"],
        ),
        ({}, CHECKED, {"software": 0x12345678}, [*IDENTITY_READ, "606#40561F0100000000", "586#43561F0101000000"]),
        (
            {},
            BOOTS,
            {"save": True, "configuration": (), "consumer_time": 0},
            [*IDENTITY_READ, "606#2310100173617665", "586#6010100100000000", "606#4017100000000000", "586#4B17100000000000"],
        ),
    ],
)
def test_exchanges(answers: dict[Object, Answer], assignment: int, fields: dict[str, Any], trace: list[str]) -> None:
    assert booted(answers, assignment, **fields)[0].bus.trace() == trace


def test_a_node_that_is_away_is_asked_four_times() -> None:
    bench, outcome = booted({DEVICE_TYPE: None})
    assert bench.bus.trace() == ["606#4000100000000000", "606#8000100000000405"] * 4
    assert outcome.elapsed == 400 * MILLISECOND


def test_only_what_is_expected_is_read() -> None:
    bench, outcome = booted({VENDOR: u32(9)}, vendor=None, device_type=None, revision=None, serial=None)
    assert outcome.letter == "0"
    assert bench.bus.trace()[:4] == [*IDENTITY_READ[:2], *IDENTITY_READ[4:6]]


# ---- time ----


@pytest.mark.parametrize("until", [50 * MILLISECOND, 400 * MILLISECOND, SECOND, 2345 * MILLISECOND, 5 * SECOND])
def test_a_silent_node_has_until_its_deadline_exactly(until: Time) -> None:
    bench = BootBench()
    bench.node.switch_off()
    begun = bench.bus.now
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry(), until=begun + until))
    assert (outcome.letter, outcome.elapsed) == ("B", until)
    assert bench.bus.now == begun + until


@pytest.mark.parametrize("late", [150 * MILLISECOND, 700 * MILLISECOND, 1500 * MILLISECOND])
def test_a_node_that_comes_before_its_deadline_is_booted_at_once(late: Time) -> None:
    bench = BootBench()
    bench.node.switch_off()
    bench.node._boots_at = bench.bus.now + late
    bench.node._rearm()
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry(), until=bench.bus.now + 5 * SECOND))
    assert outcome.letter == "0"
    assert outcome.elapsed < late + 203 * MILLISECOND


@pytest.mark.parametrize("delay", [60 * MILLISECOND, 101 * MILLISECOND, 150 * MILLISECOND, 199 * MILLISECOND])
def test_late_answers_are_for_what_was_asked(delay: Time) -> None:
    """An answer to the first read that comes while the vendor-ID is asked for is not taken for the vendor-ID."""
    bench = BootBench()
    bench.node.answer_delay = delay
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry(configuration=(), consumer_time=0)))
    assert outcome.letter == "0", outcome


# ---- the configuration ----


@pytest.mark.parametrize(
    ("date", "time", "skipped"), [(9, 8, True), (9, 7, False), (8, 8, False), (0, 0, False), (None, 8, False), (9, None, False)]
)
def test_a_configuration_that_the_node_has_is_not_written(date: int | None, time: int | None, skipped: bool) -> None:
    answers: dict[Object, Answer] = {
        DATE: ABSENT if date is None else u32(date), TIME: ABSENT if time is None else u32(time), HEARTBEAT: b"\x64\0",
    }  # fmt: skip
    bench = BootBench()
    bench.node.table.update(answers)
    bench.node.boot(bench.bus.now)
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry(date=(9, 8))))
    assert outcome.letter == "0", outcome
    written = [place for place, _ in bench.node.writes]
    assert written == ([] if skipped else [HEARTBEAT, SETTING, DATE, TIME] if None not in (date, time) else [HEARTBEAT, SETTING])


def test_the_date_is_written_last() -> None:
    bench, outcome = booted(date=(9, 8), save=True)
    assert outcome.letter == "0"
    assert [place for place, _ in bench.node.writes] == [HEARTBEAT, SETTING, DATE, TIME, SAVE]
    assert bench.node.table[DATE] == u32(9)
    assert bench.node.table[TIME] == u32(8)


def test_a_configuration_that_writes_the_date_itself_is_written_as_it_is() -> None:
    bench, _ = booted(date=(9, 8), configuration=((*DATE, u32(9)), (*TIME, u32(8))), consumer_time=0)
    assert [place for place, _ in bench.node.writes] == [DATE, TIME]


def test_a_node_may_take_its_time_to_store() -> None:
    bench = BootBench()

    def on_write(place: Object, data: bytes) -> None:
        bench.node.answer_delay = 5 * SECOND if place == SAVE else 0

    bench.node.on_write = on_write
    assert bench.run(boot_node(bench.remote, bench.commands, entry(save=True))).letter == "0"


def test_a_node_that_does_not_answer_guarding_is_not_asked_any_more() -> None:
    bench, outcome = booted({}, 0x0064_0305, configuration=(), consumer_time=0)
    assert outcome.letter == "K"
    bench.bus.sent.clear()
    bench.bus.run(SECOND)
    assert bench.bus.trace() == []


# ---- boot-ups in the middle ----

STEPS = [*(frame for frame in (*IDENTITY_READ, *CONFIGURED) if frame.startswith("606"))]


@pytest.mark.parametrize("request_number", range(len(STEPS)))
@pytest.mark.parametrize("times", [1, MAX_RESTARTS, MAX_RESTARTS + 1])
def test_a_node_that_boots_in_the_middle_is_booted_from_the_beginning(request_number: int, times: int) -> None:
    bench = BootBench()
    left = times
    hear = bench.node.receive

    def receive(frame: Any, now: Time) -> None:
        nonlocal left
        hear(frame, now)
        if left and str(frame) == STEPS[request_number]:
            left -= 1
            bench.node.writes.clear()
            bench.node._obey(0x81, now)
            bench.node._rearm()

    bench.node.receive = receive  # type: ignore[method-assign]
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry()))
    if times <= MAX_RESTARTS:
        assert outcome.letter == "0"
        assert [place for place, _ in bench.node.writes] == [HEARTBEAT, SETTING], "all of it, after the last boot-up"
    else:
        assert outcome.letter == "BBBBJJK"[request_number], "it boots in the step after that request"
        assert "4 times in the middle" in outcome.remark


@pytest.mark.parametrize("assignment", [BOOTS, KEEP_ALIVE])
def test_a_boot_up_behind_the_last_heartbeat(assignment: int) -> None:
    bench = BootBench()
    request_id = bench.master.run(boot_node(bench.remote, bench.commands, entry(assignment=assignment)), bench.bus.now)
    for _ in range(2 if assignment == KEEP_ALIVE else 1):
        bench.bus.run(10 * MILLISECOND)
        bench.master.receive(Frame.parse("706#05"), bench.bus.now)
    bench.master.receive(Frame.parse("706#00"), bench.bus.now)
    bench.bus.run(10 * MILLISECOND)
    assert not bench.bus.take_events(ProcedureFinished)
    assert bench.bus.trace().count("606#4000100000000000") == 2
    bench.master.cancel(request_id, bench.bus.now)


# ---- kept alive ----


def test_a_node_that_is_kept_alive_and_not_operational_is_reset() -> None:
    bench = BootBench()
    bench.node.table.update(beating())
    bench.node.defaults.update(beating())
    bench.node.boot(bench.bus.now)
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry(assignment=KEEP_ALIVE)))
    assert outcome.letter == "0"
    assert bench.commands_sent() == ["000#8206"]
    assert len(bench.node.writes) == 2


# ---- hooks ----


class Works:
    """A host's own work on a node."""

    def __init__(self, bench: BootBench, software: int, *, boots: bool = False, fails: type[Exception] | None = None) -> None:
        self.bench, self.software, self.boots, self.fails = bench, software, boots, fails
        self.calls = 0

    def __call__(self, node: Any, told: Any) -> Procedure[None]:
        self.calls += 1
        assert (node.node_id, told.node_id) == (6, 6)
        yield from sleep(3 * SECOND)
        if self.fails is not None:
            raise self.fails("the flash memory is worn out")
        self.bench.node.table[PROGRAM] = u32(self.software)
        if self.boots:
            self.bench.node.boot(self.bench.bus.now)
            yield from sleep(MILLISECOND)


@pytest.mark.parametrize("boots", [False, True])
@pytest.mark.parametrize(("installed", "letter"), [(2, "0"), (3, "I")])
def test_another_program_is_replaced(installed: int, letter: str, boots: bool) -> None:
    bench = BootBench()
    update = Works(bench, installed, boots=boots)
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry(assignment=UPDATED, software=2), update=update))
    assert (outcome.letter, update.calls) == (letter, 1)
    assert bench.bus.trace().count("606#4000100000000000") == 2
    if letter == "I":
        assert (outcome.object, outcome.expected, outcome.found) == (PROGRAM, 2, 3)


@pytest.mark.parametrize("error", [ProcedureError, LocalProtocolError])
def test_an_update_that_fails(error: type[Exception]) -> None:
    bench = BootBench()
    update = Works(bench, 2, fails=error)
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry(assignment=UPDATED, software=2), update=update))
    assert (outcome.letter, outcome.remark) == ("I", "the flash memory is worn out")


@pytest.mark.parametrize(("fails", "letter"), [(None, "0"), (ProcedureError, "J"), (LocalProtocolError, "J")])
def test_a_configuration_of_the_host(fails: type[Exception] | None, letter: str) -> None:
    bench = BootBench()
    configure = Works(bench, 2, fails=fails)
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry(), configure=configure))
    assert (outcome.letter, configure.calls, len(bench.node.writes)) == (letter, 1, 2)


# ---- a crowd ----


def test_a_node_whose_queue_others_have_filled_does_not_end_the_start_of_the_network() -> None:
    bench = BootBench((5, 6))

    def configure(node: Any, told: Any) -> Procedure[None]:
        """Others ask node 6 for as much as its queue holds, and one more request is under way."""
        for _ in range(node.sdo.max_queue + 1 if node.node_id == 6 else 0):
            node.sdo.upload(*SETTING, bench.bus.now)
        yield from sleep(0)

    boot = bench.network_boot(1, entry(5, save=True), entry(6, save=True), configure=configure)
    report: BootReport = bench.run(boot.start())
    assert (report.outcomes[5].letter, report.outcomes[6].letter, report.running) == ("0", "J", (5,))
    assert "256 requests are waiting already" in report.outcomes[6].remark


# ---- what is left behind ----


@pytest.mark.parametrize("answers", [{}, {DEVICE_TYPE: None}, {SETTING: None}, {SAVE: None}, {LOAD: None}])
@pytest.mark.parametrize("cancelled", [False, True])
def test_the_sdo_client_has_its_times_again(answers: dict[Object, Answer], cancelled: bool) -> None:
    bench = BootBench()
    bench.node.table.update(answers)
    sdo = bench.remote.sdo
    before = sdo.timeout, sdo.late_guard
    boot = boot_node(bench.remote, bench.commands, entry(assignment=RESTORED, restore_subindex=1, save=True))
    request_id = bench.master.run(boot, bench.bus.now)
    if cancelled:
        bench.bus.run(50 * MILLISECOND)
        bench.master.cancel(request_id, bench.bus.now)
    bench.bus.run(60 * SECOND)
    assert (sdo.timeout, sdo.late_guard) == before
    assert not bench.master.runner.busy


def test_a_node_is_not_watched_while_it_boots() -> None:
    """It may be silent for longer than its consumer time, in a long write or a reset."""
    bench = BootBench()
    bench.node.table.update(beating())
    bench.node.boot(bench.bus.now)
    bench.remote.heartbeat.set_timeout(150 * MILLISECOND, bench.bus.now)
    bench.bus.run(110 * MILLISECOND)
    bench.node.boot_delay = SECOND
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry(assignment=RESTORED, restore_subindex=1)))
    assert outcome.letter == "0"
    assert bench.bus.take_events(HeartbeatLost) == []
    assert bench.remote.heartbeat.timeout == 500 * MILLISECOND
    bench.node.switch_off()
    bench.bus.run(SECOND)
    assert len(bench.bus.take_events(HeartbeatLost)) == 1


# ---- in words ----


@pytest.mark.parametrize(
    ("answers", "text"),
    [
        ({}, "node 6: booted and checked (0, 0.201 s)"),
        (
            {DEVICE_TYPE: u32(0x10192)},
            "node 6: has another device type: 0x1000:00 is 0x00010192, expected 0x00010191 (C, 0.0002 s)",
        ),
        (
            {SERIAL: ABSENT},
            (
                "node 6: does not tell its serial number: 0x1018:04, expected 0x0000004D; abort 0x06020000, "
                "object does not exist in the object dictionary (O, 0.001 s)"
            ),
        ),
        (
            {DEVICE_TYPE: ABSENT},
            (
                "node 6: refuses to tell its device type: 0x1000:00; abort 0x06020000, "
                "object does not exist in the object dictionary (B, 0.0002 s)"
            ),
        ),
        (
            {DEVICE_TYPE: None},
            "node 6: does not answer: 0x1000:00; abort 0x05040000, SDO protocol timed out; no answer (B, 0.4 s)",
        ),
    ],
)
def test_an_outcome_in_words(answers: dict[Object, Answer], text: str) -> None:
    assert str(booted(answers)[1]) == text


def test_a_long_answer_is_no_number() -> None:
    bench = BootBench()
    answers = iter(["586#4100100014000000", "586#0000000000000000", "586#1000000000000000", "586#0300000000000000"])
    bench.node._serve = lambda request, now: bench.node.out.frames.append(Frame.parse(next(answers)))  # type: ignore[method-assign]
    outcome = bench.run(boot_node(bench.remote, bench.commands, entry()))
    assert (outcome.letter, outcome.found) == ("C", "20 bytes")
