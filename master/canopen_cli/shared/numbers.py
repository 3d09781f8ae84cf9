"""Numbers as people type and read them: values below 0 among the arguments of a command, names of units, positions."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from itertools import islice
from typing import Any, Final

import click

_BELOW_0: Final = re.compile(r"-(0[xX][0-9A-Fa-f]+|([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|inf)")
_ALSO: Final = {
    **dict.fromkeys(("deg", "degrees", "\u00b0"), "degree"),
    **dict.fromkeys(("rad", "radians"), "radian"),
    **dict.fromkeys(("turns", "rev", "revolution", "revolutions"), "turn"),
    **dict.fromkeys(("mm", "millimetres", "millimeter", "millimeters"), "millimetre"),
    **dict.fromkeys(("count", "inc", "increments"), "counts"),
    **dict.fromkeys(("nm", "n\u00b7m"), "newton-metre"),
}
"""What people call the units, besides the names of ours."""


def position_text(position: float, counts_per_unit: float) -> str:
    """Return a position with as many decimals as it takes to tell two counts of the drive apart."""
    return f"{round(position, max(0, math.ceil(math.log10(abs(counts_per_unit))))):.10g}"


class NumberCommand(click.Command):
    """A command that takes numbers below 0 as arguments: `-5` is one there, as if it stood behind `--`, and no option."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        options = (each for each in self.get_params(ctx) if isinstance(each, click.Option))
        values = {name: each.nargs for each in options if not (each.is_flag or each.count) for name in each.opts}
        front, behind, words = list[str](), list[str](), iter(args)
        for word in words:
            if word == "--":
                behind.extend(words)
            elif word in values:
                front += [word, *islice(words, values[word])]
            elif _BELOW_0.fullmatch(word) or (behind and not word.startswith("-")):
                behind.append(word)  # with all arguments that follow, which keep their order
            else:
                front.append(word)
        return super().parse_args(ctx, [*front, *(["--", *behind] if behind else [])])


class UnitName(click.Choice[str]):
    """The name of a unit, also as people abbreviate it: deg, mm."""

    def __init__(self, names: Iterable[str]) -> None:
        super().__init__([str(name) for name in names])

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        named = _ALSO.get(str(value).lower())
        return super().convert(named if named in self.choices else value, param, ctx)
