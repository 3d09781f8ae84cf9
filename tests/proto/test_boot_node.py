"""The boot-up of one node: every letter, every exchange that a recorded master has."""

from __future__ import annotations

from typing import Any

import pytest

from canopen_proto.boot.node_boot import boot_node
from canopen_proto.boot.outcome import BootLetter, BootOutcome
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Time
from tests.proto.boot_bench import (
    DATE,
    DEVICE_TYPE,
    HEARTBEAT,
    LOAD,
    PRODUCT,
    PROGRAM,
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
    ("I", {PROGRAM: u32(1)}, UPDATED, {"software": 2}, PROGRAM, None),
    ("J", {SETTING: 0x0609_0030}, BOOTS, {}, SETTING, 0x0609_0030),
    ("J", {SETTING: None}, BOOTS, {}, SETTING, 0x0504_0000),
    ("J", {LOAD: ABSENT}, RESTORED, {"restore_subindex": 1}, LOAD, ABSENT),
    ("J", {}, RESTORED, {"restore_subindex": 1, "boot_delay": NEVER}, LOAD, None),
    ("J", {SAVE: 0x0800_0020}, BOOTS, {"save": True}, SAVE, 0x0800_0020),
    ("J", {DATE: None}, BOOTS, {"date": (9, 9)}, DATE, 0x0504_0000),
    ("J", {TIME: 0x0601_0002}, BOOTS, {"date": (9, 9)}, TIME, 0x0601_0002),
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
    assert f"node 6: {letter}, {outcome.letter.meaning}" in str(outcome)
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
