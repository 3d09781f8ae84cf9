"""The standard's homing methods (6098h) as a table: where each one begins, and which edge or index pulse is home.

The standard draws each method as a picture of a track with its switches. Every picture follows one rule:

    1  off its switch, the axis goes in the direction `start` until the switch is active; if a method `turns`, and the home switch
       lies behind the axis, it turns round at the limit switch
    2  on its switch, it leaves the switch at the side `edge`: -1 the negative end of the switch, +1 its positive end
    3  home is that edge, passed in the direction `last`; with an index pulse, the first pulse behind it in that direction

                      start  edge  last    without, with index pulse
    negative limit      -     +     +         17, 1
    positive limit      +     -     -         18, 2
    home switch         +     -     -  +      19, 3   20, 4       a home switch that is active up to the positive end of the track
    home switch         -     +     +  -      21, 5   22, 6       ... to the negative end
    home switch         +     -     -  +      23, 7   24, 8       a home switch in the middle; turns at the positive limit switch
    home switch         +     +     -  +      25, 9   26, 10
    home switch         -     +     +  -      27, 11  28, 12      turns at the negative limit switch
    home switch         -     -     +  -      29, 13  30, 14

33 and 34 take the next index pulse in negative and positive direction; 35 and 37 the present position (35 is the older number).
36, homing by a touch probe, is in few drives: it has a name here and no picture. Numbers below 0 are the manufacturer's.

Makers agree on the pictures. They differ in words: "positive home switch" is the switch of methods 3 and 4 in the standard, of 5
and 6 at Bonfiglioli; many say left and right for negative and positive.

Source: IEC 61800-7-201 (CiA 402-2), homing mode, compared with the tables of Bonfiglioli, Brooks and Moog.
"""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple


class HomingSwitch(Enum):
    """A switch by which a drive homes, or a hard stop at an end of the axis, which it feels by its torque."""

    NEGATIVE_LIMIT = "negative limit switch"
    POSITIVE_LIMIT = "positive limit switch"
    HOME = "home switch"
    NEGATIVE_STOP = "negative hard stop"
    POSITIVE_STOP = "positive hard stop"


class HomingMethod(NamedTuple):
    """The picture of one method; see this module's text. start, edge, last: +1 or -1.

    switch: None if the method uses none; edge is 0 then. start and last are 0 if nothing moves. has_index: whether home is an
    index pulse. turns: whether the axis turns round at the limit switch in the direction `start`.
    """

    switch: HomingSwitch | None
    start: int
    edge: int
    last: int
    has_index: bool = False
    turns: bool = False


_LOWER, _UPPER = HomingSwitch.NEGATIVE_LIMIT, HomingSwitch.POSITIVE_LIMIT
_HOME: Final = HomingSwitch.HOME

_WITHOUT_INDEX: Final = {
    17: HomingMethod(_LOWER, -1, +1, +1),
    18: HomingMethod(_UPPER, +1, -1, -1),
    19: HomingMethod(_HOME, +1, -1, -1),
    20: HomingMethod(_HOME, +1, -1, +1),
    21: HomingMethod(_HOME, -1, +1, +1),
    22: HomingMethod(_HOME, -1, +1, -1),
    23: HomingMethod(_HOME, +1, -1, -1, turns=True),
    24: HomingMethod(_HOME, +1, -1, +1, turns=True),
    25: HomingMethod(_HOME, +1, +1, -1, turns=True),
    26: HomingMethod(_HOME, +1, +1, +1, turns=True),
    27: HomingMethod(_HOME, -1, +1, +1, turns=True),
    28: HomingMethod(_HOME, -1, +1, -1, turns=True),
    29: HomingMethod(_HOME, -1, -1, +1, turns=True),
    30: HomingMethod(_HOME, -1, -1, -1, turns=True),
}
_HERE: Final = HomingMethod(None, 0, 0, 0)
_INDEX_METHODS: Final = 16
"""A method with index pulse is this many below the same method without."""

HOMING_METHODS: Final[dict[int, HomingMethod]] = {
    **{number - _INDEX_METHODS: method._replace(has_index=True) for number, method in _WITHOUT_INDEX.items()},
    **_WITHOUT_INDEX,
    33: HomingMethod(None, -1, 0, -1, has_index=True),
    34: HomingMethod(None, +1, 0, +1, has_index=True),
    35: _HERE,
    37: _HERE,
}
"""The number of a method -> its picture. Without 36."""

MAXON_HOMING: Final[dict[int, HomingMethod]] = {
    -1: HomingMethod(HomingSwitch.POSITIVE_STOP, +1, +1, -1, has_index=True),
    -2: HomingMethod(HomingSwitch.NEGATIVE_STOP, -1, -1, +1, has_index=True),
    -3: HomingMethod(HomingSwitch.POSITIVE_STOP, +1, +1, +1),
    -4: HomingMethod(HomingSwitch.NEGATIVE_STOP, -1, -1, -1),
}
"""The methods of maxon's EPOS drives (the numbers and names are those of its EPOS Command Library, FindHome): onto a hard stop,
until the current is above a threshold; with index pulse, back to the first one (that direction from memory). Other makers use the
same numbers for something else."""

HOMING_BY_PROBE: Final = 36

NO_HOMING: Final = 0
"""The value of 6098h, and of an empty place in 60E3h, that is no method."""

_DIRECTIONS: Final = {-1: "negative", +1: "positive"}


def homing_method_name(number: int) -> str:
    """Return a homing method and its name: "method 17: negative limit switch; begins in negative direction". number: of the
    method (0x6098)."""
    return f"method {number}: {homing_name(number)}"


def homing_name(number: int) -> str:
    """Return a homing method in a few words: "home switch, negative end in positive direction, with index pulse; begins in
    positive direction". Any integer has a name. number: of the method (0x6098)."""
    if number == NO_HOMING:
        return "no homing"
    if number < 0:
        return "the manufacturer's"
    if number == HOMING_BY_PROBE:
        return "touch probe"
    method = HOMING_METHODS.get(number)
    if method is None:
        return "reserved"
    if not method.last:
        return "the present position; nothing moves"
    direction = _DIRECTIONS[method.start]
    if method.switch is None:
        return f"the next index pulse in {direction} direction"
    side = f", {_DIRECTIONS[method.edge]} end in {_DIRECTIONS[method.last]} direction" if method.switch is _HOME else ""
    index = ", with index pulse" if method.has_index else ""
    turns = f", turns at the {direction} limit switch" if method.turns else ""
    return f"{method.switch.value}{side}{index}; begins in {direction} direction{turns}"


def describe_homing(number: int) -> str:
    """Return, in one sentence, where a method goes and what is home; for methods without a picture, the name. number: of the
    method (0x6098)."""
    method = HOMING_METHODS.get(number)
    if method is None or not method.last:
        return homing_name(number)
    start, last = _DIRECTIONS[method.start], _DIRECTIONS[method.last]
    if method.switch is None:
        return f"goes in {start} direction; home is the next index pulse"
    switch = method.switch.value
    way = f"goes in {start} direction"
    if method.edge != method.start:
        way += f", from the {switch} in {_DIRECTIONS[method.edge]} direction"
    if method.turns:
        way += f", and turns round at the {start} limit switch"
    edge = f"the {_DIRECTIONS[method.edge]} end of the {switch}, in {last} direction"
    return f"{way}; home is {'the first index pulse behind ' if method.has_index else ''}{edge}"
