"""The table of homing methods: complete, in words, and its symmetries."""

from __future__ import annotations

import pytest

from canopen_proto.drives.cia402.homing_methods import HOMING_METHODS, HomingSwitch, describe_homing, homing_method_name


def test_every_method_of_the_standard_has_a_picture_but_36() -> None:
    assert sorted(HOMING_METHODS) == [*range(1, 15), *range(17, 31), 33, 34, 35, 37]


@pytest.mark.parametrize(("one", "mirrored"), [(1, 2), (3, 5), (4, 6), (7, 11), (8, 12), (9, 13), (10, 14), (33, 34)])
def test_the_pictures_come_in_mirrored_pairs(one: int, mirrored: int) -> None:
    """As the standard draws them: the second of a pair is the first with the ends of the track exchanged."""
    for shift in (0, 16) if one < 33 else (0,):
        left, right = HOMING_METHODS[one + shift], HOMING_METHODS[mirrored + shift]
        assert (left.start, left.edge, left.last) == (-right.start, -right.edge, -right.last)
        assert (left.has_index, left.turns) == (right.has_index, right.turns)
        ends = {HomingSwitch.NEGATIVE_LIMIT: HomingSwitch.POSITIVE_LIMIT}
        assert right.switch is (ends.get(left.switch, left.switch) if left.switch is not None else None)


TURNS = ", turns at the positive limit switch"


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (-3, "method -3: the manufacturer's"),
        (0, "method 0: no homing"),
        (1, "method 1: negative limit switch, with index pulse; begins in negative direction"),
        (15, "method 15: reserved"),
        (19, "method 19: home switch, negative end in negative direction; begins in positive direction"),
        (26, "method 26: home switch, positive end in positive direction; begins in positive direction" + TURNS),
        (34, "method 34: the next index pulse in positive direction"),
        (35, "method 35: the present position; nothing moves"),
        (36, "method 36: touch probe"),
        (99, "method 99: reserved"),
    ],
)
def test_every_number_has_a_name(number: int, words: str) -> None:
    assert homing_method_name(number) == words


def test_a_method_in_a_sentence() -> None:
    assert describe_homing(7) == (
        "goes in positive direction, from the home switch in negative direction, and turns round at the positive limit switch; "
        "home is the first index pulse behind the negative end of the home switch, in negative direction"
    )
    assert describe_homing(26) == (
        "goes in positive direction, and turns round at the positive limit switch; "
        "home is the positive end of the home switch, in positive direction"
    )
    assert describe_homing(33) == "goes in negative direction; home is the next index pulse"
    assert describe_homing(37) == "the present position; nothing moves"
    assert describe_homing(-1) == "the manufacturer's"
