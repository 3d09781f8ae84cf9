"""A node beside what the master knows of it: read, never written."""

from __future__ import annotations

from canopen_proto.manager.boot.comparison import Compared, NodeComparison, compare_node
from tests.manager.boot_bench import DEVICE_TYPE, HEARTBEAT, PROGRAM, SERIAL, SETTING, Answer, BootBench, Object, entry, u32

ABSENT, WRITE_ONLY = 0x0602_0000, 0x0601_0001
TPDO_COB_ID = (0x1800, 1)


def compared(answers: dict[Object, Answer], *, settings: bool = True, **fields: object) -> NodeComparison:
    """Compare node 6, which gives these answers. Nothing but reads may be sent."""
    bench = BootBench()
    bench.node.table.update(answers)
    result = bench.run(compare_node(bench.remote, entry(**fields), settings=settings))  # type: ignore[arg-type]
    frames = [frame for _, frame in bench.bus.sent if frame.can_id < 0x580 or frame.can_id == 0x606]
    assert frames
    assert all(frame.can_id == 0x606 and frame.data[0] in (0x40, 0x80) for frame in frames)  # uploads, and their time-outs
    assert bench.node.writes == []
    return result


RIGHT: dict[Object, Answer] = {HEARTBEAT: b"\xc8\x00", SETTING: b"\x34\x12"}


def test_a_node_as_it_should_be() -> None:
    result = compared(RIGHT, software=1)
    assert result.is_right
    assert [(each.index, each.subindex) for each in result.objects] == [
        DEVICE_TYPE, (0x1018, 1), (0x1018, 2), (0x1018, 3), SERIAL, PROGRAM, HEARTBEAT, SETTING,
    ]  # fmt: skip
    assert [each.is_setting for each in result.objects] == [False] * 6 + [True] * 2
    assert len(compared(RIGHT, settings=False).objects) == 5


def test_each_difference_is_told() -> None:
    answers = {SERIAL: u32(9), PROGRAM: ABSENT, HEARTBEAT: WRITE_ONLY, SETTING: b"\x34\x13"}
    result = compared(answers, software=1)
    assert not result.is_right
    assert result.wrong == (
        Compared(*SERIAL, u32(0x4D), u32(9)),
        Compared(*PROGRAM, u32(1), None, ABSENT),
        Compared(*HEARTBEAT, b"\xc8\x00", None, WRITE_ONLY, True),
        Compared(*SETTING, b"\x34\x12", b"\x34\x13", None, True),
    )


def test_what_is_not_expected_is_never_wrong() -> None:
    result = compared({**RIGHT, SERIAL: ABSENT}, serial=None)
    assert result.is_right
    assert result.objects[4] == Compared(*SERIAL, None, None, ABSENT)


def test_a_silent_node_is_asked_for_nothing_else() -> None:
    assert compared({DEVICE_TYPE: None}) == NodeComparison(6, False)
    late = compared({**RIGHT, SETTING: None})
    assert (late.answers, late.is_right, late.wrong[0].abort_code) == (True, False, 0x0504_0000)


def test_the_last_of_several_writes_counts_and_commands_are_not_read() -> None:
    writes = ((*SETTING, b"\0\0"), (*SETTING, b"\x34\x12"), (0x1010, 1, b"save"))
    assert compared(RIGHT, configuration=writes).objects[-1] == Compared(*SETTING, b"\x34\x12", b"\x34\x12", None, True)


def test_a_pdo_that_does_not_exist_has_any_can_id() -> None:
    def is_right(expected: int, found: int) -> bool:
        return Compared(*TPDO_COB_ID, u32(expected), u32(found)).is_right

    assert is_right(0x8000_0186, 0xC000_0000)
    assert is_right(0x0000_0186, 0x4000_0186)
    assert not is_right(0x8000_0186, 0x186)
    assert not is_right(0x186, 0x187)
    assert not Compared(0x2000, 1, u32(0x186), u32(0x4000_0186)).is_right
