"""The conversions of ros_canopen, such as "rint(rad2deg(pos)*1000)", read as arithmetic: `value = factor * variable + offset`.

Nothing is evaluated as code. Known are numbers, `pi`, one variable, + - * / and parentheses, `rad2deg`, `deg2rad`, and `rint`
around the whole: rounding to counts, which every set-point undergoes. Whatever is not such a line (`norm`, `smooth`, a variable
twice in a product) is refused with the reason. Numbers are fractions and powers of pi, so nothing is rounded.

Source: muparser expressions, as ros_canopen's canopen_motor_node has them.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Final

from canopen_master.ros_configurations.yaml_text import number_of

MAX_LENGTH: Final = 500
MAX_DEPTH: Final = 30
FEWEST_DIGITS: Final = 3
"""Of a number that may be rounded: 0.001 is a thousandth, and 0.0175 may be a degree in radians."""
_TOKEN: Final = re.compile(r"\s*((?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?|[A-Za-z_]\w*|[-+*/(),])")


class NotLinearError(ValueError):
    """An expression is no straight line of one variable, or none at all. The text is the reason."""


@dataclass(frozen=True, slots=True)
class Exact:
    """The number fraction * pi ** power. 0 has the power 0."""

    fraction: Fraction
    power: int = 0

    def __mul__(self, other: Exact) -> Exact:
        return _exact(self.fraction * other.fraction, self.power + other.power)

    def __truediv__(self, other: Exact) -> Exact:
        if not other.fraction:
            raise NotLinearError("it divides by 0")
        return _exact(self.fraction / other.fraction, self.power - other.power)

    def __add__(self, other: Exact) -> Exact:
        if not self.fraction or not other.fraction:
            return other if not self.fraction else self
        if self.power != other.power:
            raise NotLinearError("it adds numbers with pi and without")
        return _exact(self.fraction + other.fraction, self.power)

    def __float__(self) -> float:
        """Return the nearest float; infinity beyond the largest one."""
        try:
            return float(self.fraction) * math.pi**self.power
        except OverflowError:
            return math.inf


def _exact(fraction: Fraction, power: int) -> Exact:
    return Exact(fraction, power if fraction else 0)


ZERO: Final = Exact(Fraction(0))
ONE: Final = Exact(Fraction(1))
DEGREES_PER_RADIAN: Final = Exact(Fraction(180), -1)


@dataclass(frozen=True, slots=True)
class Line:
    """factor * variable + offset. variable: "" if there is none.

    rounding, offset_rounding: by how much of itself the factor, or the offset, may differ from what its author rounded it from.
    """

    factor: Exact
    offset: Exact
    variable: str = ""
    rounding: Fraction = field(default=Fraction(0), compare=False)
    offset_rounding: Fraction = field(default=Fraction(0), compare=False)


def rounding_of(text: str) -> Fraction:
    """Return half of the last digit of a decimal number, relative to it; 0 for fewer than FEWEST_DIGITS digits: it is exact."""
    digits, _, _ = text.strip().lstrip("+-").lower().partition("e")
    significant = digits.replace(".", "").replace("_", "").lstrip("0")
    return Fraction(1, 2 * int(significant)) if significant.isdecimal() and len(significant) >= FEWEST_DIGITS else Fraction(0)


def read_expression(text: str) -> Line:
    """Return the line that an expression is. Raises NotLinearError with the reason."""
    if len(text) > MAX_LENGTH:
        raise NotLinearError(f"it has more than {MAX_LENGTH} characters")
    rounded = re.fullmatch(r"\s*rint\s*\((.*)\)\s*", text, re.DOTALL)
    if rounded is not None and _closes_at_the_end(rounded[1]):
        text = rounded[1]
    parser = _Parser(text)
    rounding = parser.rounding()
    return replace(parser.whole(), rounding=rounding, offset_rounding=rounding)


def _closes_at_the_end(inside: str) -> bool:
    """Return whether each parenthesis inside is closed inside: "a)*(b" is not."""
    depth = 0
    for character in inside:
        depth += {"(": 1, ")": -1}.get(character, 0)
        if depth < 0:
            return False
    return depth == 0


class _Parser:
    """A sum of products of factors."""

    def __init__(self, text: str) -> None:
        self._tokens: list[str] = []
        place = 0
        while text[place:].strip():
            found = _TOKEN.match(text, place)
            if found is None:
                raise NotLinearError(f"{text[place:].strip()[0]!r} is not known in it")
            self._tokens.append(found[1])
            place = found.end()
        self._depth = 0

    def rounding(self) -> Fraction:
        """Return that of all decimal fractions together, and of a whole number that is the only one: several are exact."""
        numbers = [token for token in self._tokens if token[0] in "0123456789."]
        return sum((rounding_of(each) for each in numbers if len(numbers) == 1 or "." in each), Fraction(0))

    def whole(self) -> Line:
        line = self._sum()
        if self._tokens:
            raise NotLinearError(f"{self._tokens[0]!r} is out of place in it")
        return line

    def _next(self, *wanted: str) -> str:
        """Take the next token if it is wanted; "" if not."""
        return self._tokens.pop(0) if self._tokens and self._tokens[0] in wanted else ""

    def _sum(self) -> Line:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise NotLinearError(f"it is nested deeper than {MAX_DEPTH} levels")
        line = self._product()
        while sign := self._next("+", "-"):
            other = self._product()
            line = _added(line, other if sign == "+" else _scaled(other, Exact(Fraction(-1))))
        self._depth -= 1
        return line

    def _product(self) -> Line:
        line = self._factor()
        while sign := self._next("*", "/"):
            other = self._factor()
            if other.variable and (line.variable or sign == "/"):
                raise NotLinearError("it multiplies or divides by its variable")
            if other.variable:
                line, other = other, line
            line = _scaled(line, other.offset if sign == "*" else ONE / other.offset)
        return line

    def _factor(self) -> Line:
        sign = 1
        while given := self._next("-", "+"):
            sign = -sign if given == "-" else sign
        return _scaled(self._unsigned(), Exact(Fraction(sign)))

    def _unsigned(self) -> Line:
        if not self._tokens:
            raise NotLinearError("it ends too early")
        token = self._tokens.pop(0)
        if token == "(":
            return self._closed()
        if (number := number_of(token)) is not None:
            return Line(ZERO, Exact(Fraction(token) if token.isdigit() else number))
        if not re.match("[A-Za-z_]", token):
            raise NotLinearError(f"{token!r} is out of place in it")
        if self._next("("):
            if token not in _FUNCTIONS:
                raise NotLinearError(f"the function {token!r} is no plain factor")
            return _scaled(self._closed(), _FUNCTIONS[token])
        return Line(ZERO, Exact(Fraction(1), 1)) if token in ("pi", "_pi") else Line(ONE, ZERO, token)

    def _closed(self) -> Line:
        line = self._sum()
        if not self._next(")"):
            raise NotLinearError("a parenthesis is not closed, or a function has several arguments")
        return line


_FUNCTIONS: Final = {"rad2deg": DEGREES_PER_RADIAN, "deg2rad": ONE / DEGREES_PER_RADIAN}


def _scaled(line: Line, factor: Exact) -> Line:
    return Line(line.factor * factor, line.offset * factor, line.variable)


def _added(one: Line, other: Line) -> Line:
    if one.variable and other.variable and one.variable != other.variable:
        raise NotLinearError(f"it has two variables, {one.variable} and {other.variable}")
    return Line(one.factor + other.factor, one.offset + other.offset, one.variable or other.variable)
