"""Curves on a terminal: each character has two by four dots (Unicode 2800 to 28FF, Braille patterns)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

ACROSS: Final = 2
DOWN: Final = 4
_BLANK: Final = 0x2800
_DOTS: Final = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
"""The bit of each dot: by column, from the top."""


def curve(
    points: Iterable[tuple[float, float, float]], width: int, height: int, gap: float = 0.0
) -> tuple[list[str], float, float]:
    """Draw a curve; return its lines, from the top, and the least and the greatest value.

    points: from left to right, each with its place, from 0 (left) to 1 (right), and the least and the greatest value there.
    Places outside are left out. gap: points that are nearer to each other than this are joined; where none is, there is no dot.
    width, height: characters. All lines are blank if there are no points.
    """
    inside = [(place, low, high) for place, low, high in points if 0 <= place <= 1]
    least = min((low for _, low, _ in inside), default=0.0)
    most = max((high for _, _, high in inside), default=0.0)
    cells = [[_BLANK] * width for _ in range(height)]
    columns, rows = width * ACROSS - 1, height * DOWN - 1

    def row_of(value: float) -> int:
        return rows - round((value - least) / (most - least) * rows) if most > least else rows // 2

    def dot(column: int, row: int) -> None:
        cells[row // DOWN][column // ACROSS] |= _DOTS[column % ACROSS][row % DOWN]

    before: tuple[float, int, int] | None = None
    for place, low, high in inside:
        column, top, bottom = round(place * columns), row_of(high), row_of(low)
        for row in range(top, bottom + 1):
            dot(column, row)
        if before is not None and place - before[0] <= gap:
            _, first, level = before
            for between in range(first + 1, column):
                dot(between, level + round((top - level) * (between - first) / (column - first)))
        before = place, column, bottom
    return ["".join(map(chr, line)) for line in cells], least, most
