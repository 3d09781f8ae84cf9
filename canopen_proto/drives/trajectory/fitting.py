"""`smoothed`: the smoothest positions that samples can have meant, when they were written with few decimals.

A position that is written with two decimals is known to half a unit of the last one. At 10 ms from row to row a spline through
such numbers has a jerk of thousands, which is in no motion: it comes from the rounding alone. `smoothed` looks for the positions
within half a unit of each sample whose jerk, squared and summed, is least. The first and the last position stay as they are, and
the path is at rest there, as that of `cubic`.

Only samples of a motion are smoothed: at most SPARSE apart, evenly to a factor of UNEVEN, over MANY units of the last decimal.
Everything else are waypoints, and these are meant as they are. Samples that say more than their rounding hides are left as well:
those of which half the third differences are larger than rounding can make them.

A value that stays for HOLD is a hold, and is meant: its rows stay exactly there, but for SETTLING at its ends, where the motion
that comes to rest is still within its rounding.

It is a quadratic program with a band for each sample, solved by an interior point: a barrier keeps each position inside its band,
and is lowered until it no longer counts. Each step of Newton's method solves a system with seven diagonals, so that the whole
takes a time that grows with the count of samples only. Nothing is random.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final

FEWEST: Final = 8
"""With fewer samples there is nothing to smooth."""
MAX_SMOOTHED: Final = 20_000
"""More samples than this would take minutes."""
SPARSE: Final = 0.05
"""Rows that are further apart than this, in s, are waypoints, and no samples of a motion."""
UNEVEN: Final = 10.0
"""The longest step of samples is at most so many times the shortest one."""
MANY: Final = 50
"""Positions over fewer units of the last decimal than this were chosen one by one."""
HOLD: Final = 0.5
"""A value that stays for so long, in s, is a hold."""
SETTLING: Final = 0.1
"""At the ends of a hold, for so long in s, a motion may still be within its rounding."""
_TOLERANCE: Final = 1e-9
"""A part of a step or unit that does not count in these comparisons: times and positions are sums and differences of floats."""
_NOTHING: Final = 1e-6
"""A roughness of less than this part of the rounding is none: there is nothing to smooth."""
_LOWER: Final = 0.1
"""The barrier of a round, as a part of that of the round before."""
_ENOUGH: Final = 1e-3
"""The barrier is low enough when it counts for less than this part of the jerk."""
_ROUNDS: Final = 40
_STEPS: Final = 30
_NEARLY: Final = 0.95
"""How much of the way to the edge of a band one step may go."""


def is_rounded(steps: Sequence[float], positions: Sequence[float], resolution: float) -> bool:
    """Return whether rounding to multiples of `resolution` may have made most of what is rough in these samples. steps: s between
    the samples. positions: one more than steps."""
    if len(positions) < FEWEST or not resolution > 0.0:
        return False
    enough = 1.0 + _TOLERANCE
    if max(steps) > min(SPARSE, UNEVEN * min(steps)) * enough or (max(positions) - min(positions)) * enough < MANY * resolution:
        return False
    shares = sorted([
        abs(a * p + b * q + c * r + d * s) / (abs(a) + abs(b) + abs(c) + abs(d))
        for (a, b, c, d), p, q, r, s in zip(
            _jerk_rows(steps)[1:-1], positions, positions[1:], positions[2:], positions[3:], strict=False
        )
    ])  # fmt: skip
    half = resolution / 2.0
    return shares[-1] > _NOTHING * half and shares[len(shares) // 2] <= half


def held(steps: Sequence[float], positions: Sequence[float]) -> list[int]:
    """Return the samples that stay as they are: the first, the last, and those of a hold that are not near its ends. steps: s
    between the samples. positions: one more than steps."""
    kept, begin, last = {0, len(positions) - 1}, 0, len(positions) - 1
    times = [0.0, *itertools.accumulate(steps)]
    for i, position in enumerate(positions):
        if i == last or positions[i + 1] != position:
            if (times[i] - times[begin]) * (1.0 + _TOLERANCE) >= HOLD:
                kept.update(k for k in range(begin, i + 1) if min(times[k] - times[begin], times[i] - times[k]) >= SETTLING)
            begin = i + 1
    return sorted(kept)


def smoothed(steps: Sequence[float], positions: Sequence[float], resolution: float) -> list[float]:
    """Return positions with the least jerk, each within half of `resolution` of its sample.

    steps: seconds from sample to sample. Samples that are not `is_rounded`, or more than MAX_SMOOTHED, are returned as they are.
    """
    if len(positions) > MAX_SMOOTHED or not is_rounded(steps, positions, resolution):
        return list(positions)
    problem = _Problem(steps, positions, resolution / 2.0)
    problem.solve()
    return problem.result()


class _Problem:
    """Where each position lies in its band, from -1 to 1 (`_z`), and the rows that give the jerk.

    Row k is the jerk over four positions, in units of what rounding can make of it; at the ends a position is reflected there.
    Each row has four coefficients for positions k - 1 to k + 2 of the samples; those outside are 0.
    """

    def __init__(self, steps: Sequence[float], positions: Sequence[float], half: float) -> None:
        self._half = half
        self._positions = list(positions)
        self._held = held(steps, positions)
        self._rows = _jerk_rows(steps)
        # The jerk of the samples themselves, and what a step of half a unit adds to it, both by the same measure
        scale = max(max(map(abs, row)) for row in self._rows)
        self._rows = [tuple([each / scale for each in row]) for row in self._rows]
        self._rest = [value / half for value in self._jerks(self._positions)]
        self._z = [0.0] * len(positions)
        self._bands = self._hessian()

    def _jerks(self, values: Sequence[float]) -> list[float]:
        last = len(values) - 1
        found = []
        for k, (a, b, c, d) in enumerate(self._rows):
            found.append(a * values[max(k - 1, 0)] + b * values[k] + c * values[k + 1] + d * values[min(k + 2, last)])
        return found

    def _hessian(self) -> list[list[float]]:
        """Return the diagonal and the three above it of the sum of all rows' squares."""
        count = len(self._positions)
        bands = [[0.0] * count for _ in range(4)]
        for k, row in enumerate(self._rows):
            for i, one in enumerate(row):
                for j in range(i, 4):
                    if one and row[j]:
                        bands[j - i][k - 1 + i] += one * row[j]
        for i in self._held:  # its unknown stands alone
            bands[0][i] = 1.0
            for apart in (1, 2, 3):
                bands[apart][i] = 0.0
                if i >= apart:
                    bands[apart][i - apart] = 0.0
        return bands

    def solve(self) -> None:
        """Find the positions."""
        weight = 1.0
        for _ in range(_ROUNDS):
            for _ in range(_STEPS):
                if self._step(weight) < 0.1 * weight:
                    break
            jerks = self._present()
            if weight < _ENOUGH * math.fsum([each * each for each in jerks]) / len(jerks):
                break
            weight *= _LOWER

    def _present(self) -> list[float]:
        return [rest + jerk for rest, jerk in zip(self._rest, self._jerks(self._z), strict=True)]

    def _cost(self, z: Sequence[float], weight: float) -> float:
        jerks = [rest + jerk for rest, jerk in zip(self._rest, self._jerks(z), strict=True)]
        return 0.5 * math.fsum([each * each for each in jerks]) - weight * math.fsum([math.log1p(-each * each) for each in z])

    def _step(self, weight: float) -> float:
        """Take one step of Newton's method; return how much it promised."""
        z, count = self._z, len(self._z)
        gradient = [0.0] * count
        for k, (jerk, (a, b, c, d)) in enumerate(zip(self._present(), self._rows, strict=True)):
            if a:
                gradient[k - 1] += jerk * a
            gradient[k] += jerk * b
            gradient[k + 1] += jerk * c
            if d:
                gradient[k + 2] += jerk * d
        for i in self._held:
            gradient[i] = 0.0
        diagonal = self._bands[0][:]
        for i, each in enumerate(z):
            left = 1.0 - each * each
            gradient[i] += weight * 2.0 * each / left
            diagonal[i] += weight * 2.0 * (1.0 + each * each) / (left * left)
        way = _solve([diagonal, *self._bands[1:]], gradient)
        promised = math.fsum([g * w for g, w in zip(gradient, way, strict=True)])
        share = 1.0
        for each, w in zip(z, way, strict=True):  # the step goes against `way`
            if w and share * abs(w) > (room := _NEARLY * (1.0 + each if w > 0.0 else 1.0 - each)):
                share = room / abs(w)
        cost = self._cost(z, weight)
        for _ in range(_STEPS):
            new = [each - share * w for each, w in zip(z, way, strict=True)]
            if self._cost(new, weight) <= cost - 0.1 * share * promised:
                self._z = new
                return promised
            share /= 2.0
        return 0.0

    def result(self) -> list[float]:
        """Return the positions, none outside its band, also not by a rounding error."""
        return [
            min(max(position + self._half * each, position - self._half), position + self._half)
            for position, each in zip(self._positions, self._z, strict=True)
        ]


def _jerk_rows(steps: Sequence[float]) -> list[tuple[float, ...]]:
    """Return the coefficients of the jerk around each step: a third difference over the three steps, for uneven ones too."""
    rows: list[tuple[float, ...]] = []
    last = len(steps) - 1
    for k, h in enumerate(steps):
        before, after = steps[k - 1] if k else h, steps[k + 1] if k < last else h
        times = (-before, 0.0, h, h + after)
        row = []
        for i in range(4):
            divisor = 1.0
            for j in range(4):
                if i != j:
                    divisor *= times[i] - times[j]
            row.append(6.0 / divisor * math.sqrt(h))
        a, b, c, d = row
        if not k:  # at rest: the position before is that after it
            a, c = 0.0, c + a
        if k == last:
            b, d = b + d, 0.0
        rows.append((a, b, c, d))
    return rows


def _solve(bands: list[list[float]], right: list[float]) -> list[float]:
    """Solve a symmetric system with seven diagonals; its first and last unknown are 0."""
    main, first, second, third = bands
    count = len(main)
    pivots = [1.0] * count
    one, two, three = [0.0] * count, [0.0] * count, [0.0] * count  # factors of the three rows below each pivot
    rests = [0.0] * count
    for i in range(1, count - 1):
        pivot, below1, below2, below3, rest = main[i], first[i], second[i], third[i] if i < count - 3 else 0.0, right[i]
        for back in (1, 2, 3):
            k = i - back
            if k < 1:
                break
            factors = (one[k], two[k], three[k])
            factor = factors[back - 1]
            if not factor:
                continue
            carried = factor * pivots[k]
            pivot -= carried * factor
            if back < 3:
                below1 -= carried * factors[back]
            if back < 2:
                below2 -= carried * factors[back + 1]
            rest -= factor * rests[k]
        pivots[i], rests[i] = pivot, rest
        one[i], two[i], three[i] = below1 / pivot, below2 / pivot, below3 / pivot
    found = [0.0] * count
    for i in range(count - 2, 0, -1):
        value = rests[i] / pivots[i]
        if i + 1 < count - 1:
            value -= one[i] * found[i + 1]
        if i + 2 < count - 1:
            value -= two[i] * found[i + 2]
        if i + 3 < count - 1:
            value -= three[i] * found[i + 3]
        found[i] = value
    return found
