"""The table of `canopen watch` as text, at the size of a terminal: no stale value looks like a present one."""

from __future__ import annotations

import pytest
from rich.console import Console, RenderableType

from canopen_cli.live.braille import curve
from canopen_cli.live.watch_polling import Load, load_text
from canopen_cli.live.watch_view import Around, age_text, picture, plain
from canopen_cli.live.watched import FRESH, SLOTS, Watched
from canopen_data import load_dictionary
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.observer.meaning import Meaning, ShownObject, Words

NODE = 5
OTHER = 6
EVIL = "\x1b[2J[bold]x[/]"
ANGLE = Variable(0x2100, 1, "angle", DataType.INTEGER32, Access.RO, unit="deg", factor=0.001)
TEXT = Variable(0x2101, 0, f"text {EVIL}", DataType.VISIBLE_STRING, Access.RO)
DICTIONARY = load_dictionary()[0].with_objects(
    [
        Object.of("angles", [Variable(0x2100, 0, "count", DataType.UNSIGNED8), ANGLE]),
        Object.of(TEXT.name, [TEXT]),
    ]
)
STATUSWORD = DICTIONARY.variable("6041")
MODE = DICTIONARY.variable("6061")
POSITION = DICTIONARY.variable("6064")
AROUND = Around("can0", "SDO: 15 reads a second, 0.8 % of 500k of load", "q end")


def watched(*variables: Variable, span: Time = 0, dictionary: ObjectDictionary = DICTIONARY) -> Watched:
    return Watched(NODE, dictionary, variables, span=span)


def value(variable: Variable, value: Value | None, service: str = "TPDO 1", *, node: int = NODE, held: bool = True) -> Meaning:
    shown = ShownObject(node, variable.index, variable.subindex, variable.name, value, str(value), held)
    return meaning(service, "", (shown,), node)


def meaning(service: str, text: str, objects: tuple[ShownObject, ...] = (), node: int = NODE) -> Meaning:
    return Meaning(service, node, lambda frame: Words(text, objects), Frame(0, b""))


def lines(renderable: RenderableType, width: int = 80) -> list[str]:
    console = Console(width=width, color_system=None)
    with console.capture() as captured:
        console.print(renderable)
    return [line.rstrip() for line in captured.get().rstrip("\n").split("\n")]


def at_80(watch: Watched, now: Time, around: Around = AROUND, height: int = 24, span: float = 0) -> list[str]:
    shown = lines(picture(watch.view(now), around, 80, height, span=span))
    assert len(shown) == height
    assert all(len(line) <= 80 for line in shown)
    return shown


def test_a_statusword_is_shown_as_state_and_bits_in_the_mode_that_it_has() -> None:
    watch = watched(STATUSWORD, POSITION)
    watch.take(value(MODE, 7), 0)  # not shown, and heard all the same
    watch.take(value(STATUSWORD, 0x1637), 0)
    watch.take(value(POSITION, -14000, "SDO"), 50 * MILLISECOND)
    watch.take(value(POSITION, 12000, "SDO"), 100 * MILLISECOND)
    shown = at_80(watch, 200 * MILLISECOND)
    assert shown[0].startswith("node 5 (0x05)  NMT state not known")
    assert shown[0].endswith("can0")
    assert shown[2:6] == [
        "6041:00 statusword            0x1637              0.2 s TPDO 1",
        "        operation enabled  0001 0110 0011 0111",
        "        voltage enabled, remote, target reached, interpolation active",
        "6064:00 position_actual_value  12000 -14000 12000 0.1 s SDO",
    ]
    assert shown[-2:] == [AROUND.how, AROUND.keys]


def test_a_mode_that_is_old_names_no_bits() -> None:
    watch = watched(STATUSWORD)
    watch.take(value(MODE, 7), 0)
    watch.take(value(STATUSWORD, 0x1637), 2 * FRESH)
    assert "interpolation" not in "".join(at_80(watch, 2 * FRESH))


def test_a_value_that_does_not_come_again_is_stale() -> None:
    watch = watched(POSITION)
    watch.take(value(POSITION, 77), 0)
    (row,) = watch.view(FRESH).rows
    assert not row.is_stale
    (row,) = watch.view(FRESH + 1).rows
    assert row.is_stale
    shown = at_80(watch, 12 * SECOND)
    assert shown[2].split() == ["6064:00", "position_actual_value", "77", "77", "77", "12", "s", "TPDO", "1"]
    assert shown[3].strip() == "STALE: nothing has brought it again"
    with_style = Console(width=80, force_terminal=True, color_system="standard")
    with with_style.capture() as captured:
        with_style.print(picture(watch.view(12 * SECOND), AROUND, 80, 24))
    assert "\x1b[2m" in next(each for each in captured.get().split("\n") if " 77" in each)  # dim
    watch.take(value(POSITION, 78), 12 * SECOND)
    assert "STALE" not in "".join(at_80(watch, 12 * SECOND))


def test_a_boot_up_makes_all_values_old_at_once() -> None:
    watch = watched(POSITION, STATUSWORD)
    watch.take(value(POSITION, 77), 0)
    watch.take(meaning("boot-up", "", node=OTHER), 1)
    assert not watch.view(2).rows[0].is_stale
    watch.take(meaning("boot-up", ""), 1)
    assert (watch.boots, watch.pdo_age(POSITION, 2) > SECOND) == (1, True)
    assert at_80(watch, 2)[3].strip() == "STALE: from before its boot-up"
    watch.take(value(POSITION, 77), 3)
    assert not watch.view(3).rows[0].is_stale


def test_what_is_not_its_value_is_not_taken() -> None:
    watch = watched(POSITION)
    for each in (
        value(POSITION, 1, node=OTHER),
        value(POSITION, None, "SDO"),
        value(POSITION, 1, "SDO", held=False),  # a write that was not confirmed
        value(STATUSWORD, 1),
    ):
        assert watch.take(each, 0) == []
    assert at_80(watch, 0)[2].split() == ["6064:00", "position_actual_value", "-"]
    (sample,) = watch.take(value(POSITION, 1, "RPDO 1", held=False), 0)  # what a master sends it
    assert (sample.value, sample.source, sample.is_change) == (1, "RPDO 1", True)
    (sample,) = watch.take(value(POSITION, 1), 1)
    assert not sample.is_change


def test_what_is_known_of_the_node_stands_in_its_head() -> None:
    watch = watched(POSITION)
    assert "never heard" in at_80(watch, 0)[0]
    watch.take(meaning("heartbeat", "operational"), 0)
    watch.take(meaning("EMCY", f"0x8130 {EVIL}"), SECOND)
    shown = at_80(watch, 2 * SECOND)
    assert "operational  last heard 1.0 s ago" in shown[0]
    assert shown[-3] == "last EMCY, 1.0 s ago: 0x8130 \\x1b[2J[bold]x[/]"
    assert "NMT state not known" in at_80(watch, 9 * SECOND)[0]


def test_units_and_foreign_texts() -> None:
    watch = watched(ANGLE, TEXT)
    watch.take(value(ANGLE, 12345), 0)
    watch.take(value(TEXT, f"a{EVIL}", "SDO"), 0)
    shown = at_80(watch, 0)
    assert shown[2].split() == ["2100:01", "angle", "12.345", "deg", "12.345", "12.345", "0.0", "s", "TPDO", "1"]
    assert "\\x1b[2J[bold]x[/]" in shown[3].replace("\\\\", "\\")


def test_why_there_is_no_value() -> None:
    watch = watched(POSITION)
    watch.refused(POSITION, "refused: object does not exist in the object dictionary")
    assert at_80(watch, 0)[3].strip() == "refused: object does not exist in the object dictionary"
    watch.take(value(POSITION, 1), 0)
    watch.refused(POSITION, "the node does not answer SDO requests")
    assert at_80(watch, 0)[3].strip() == "the node does not answer SDO requests"
    assert at_80(watch, 9 * SECOND)[3].strip() == "STALE: the node does not answer SDO requests"


@pytest.mark.parametrize("height", [6, 10, 24])
def test_what_does_not_fit_is_counted(height: int) -> None:
    many = [Variable(0x2200, number, f"v{number}", DataType.INTEGER16) for number in range(40)]
    watch = watched(*many)
    for each in many:
        watch.take(value(each, 1), 0)
    shown = at_80(watch, 0, height=height)
    rows = sum(line.startswith("2200:") for line in shown)
    assert f"... {40 - rows} objects more: the terminal is too low" in shown
    assert 0 < rows == height - 5
    assert sum(line.startswith("2200:") for line in lines(plain(watch.view(0), AROUND, 80))) == 40


def test_a_picture_that_is_held_says_so() -> None:
    watch = watched(POSITION)
    assert at_80(watch, 0, AROUND._replace(paused=12.3))[0].endswith("PAUSED 12 s AGO")


def test_curves() -> None:
    watch = watched(POSITION, STATUSWORD, span=30 * SECOND)
    for number in range(300):
        watch.take(value(POSITION, number * number), number * 100 * MILLISECOND)
    (row, _) = watch.view(30 * SECOND).rows
    assert len(row.curve) <= SLOTS
    shown = at_80(watch, 30 * SECOND, span=30)
    assert shown[4] == "position_actual_value, the last 30 s"
    assert shown[5].split()[0] == str(299 * 299)
    assert shown[12].split()[0] == "0"
    with_dots = [sum(ord(sign) > 0x2800 for sign in line) for line in shown[5:13]]
    assert with_dots == sorted(with_dots)  # a parabola: steep at its end


def test_a_curve_has_gaps_where_nothing_came() -> None:
    drawn, least, most = curve([(0.0, 1, 1), (0.4, 2, 2), (1.0, 3, 3)], 10, 1, gap=0.5)
    assert (least, most) == (1, 3)
    assert drawn[0].replace("\u2800", " ") == "⣀⡠⠤⠒⠂    ⠈"
    drawn, least, most = curve([(0.5, 7, 7)], 4, 1)
    assert (least, most) == (7, 7)
    assert curve([], 4, 2) == (["\u2800" * 4] * 2, 0.0, 0.0)
    assert curve([(0.2, -1, 5), (1.2, 9, 9)], 4, 2)[1:] == (-1, 5)


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.04, "0.0 s"), (9.94, "9.9 s"), (9.96, "10 s"), (119, "119 s"), (120, "2 min"), (7200, "2 h")]
)
def test_ages(seconds: float, text: str) -> None:
    assert age_text(round(seconds * SECOND)) == text


def test_the_load_of_the_last_second() -> None:
    load = Load()
    frame = Frame(0x605, bytes.fromhex("4041600000000000"))
    assert load_text(load.last_second(0), 500_000) == "SDO: no reads"
    for number in range(20):
        load.add(frame, number * 50 * MILLISECOND)
    frames, bits = load.last_second(SECOND)
    assert (frames, bits > 20 * 100) == (20, True)
    assert load_text((20, 2500), 500_000) == "SDO: 10 reads a second, 0.5 % of 500k of load"
    assert load_text((20, 2500), None) == "SDO: 10 reads a second, 2.5 kbit/s of load"
    assert load.last_second(3 * SECOND) == (0, 0)
