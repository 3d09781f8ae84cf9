"""A minimal drive of CiA 402 on the `LocalNode` of canopen 2.4.1: state machine, pp, pv, hm, halt. None of it is our code.

It has no clock: each read of its statusword is one step of its motion. So it is as fast as its master asks, and never too fast.
"""

from __future__ import annotations

from typing import Any

import canopen

from tests.simulation import cia402_oracle as cia402

STEPS = 4
"""From the start of a motion to its end."""
MODES = 1 << 0 | 1 << 2 | 1 << 5


class PeerDrive:
    """The drive behind a node. fails_homing: a homing ends with an error. ignores_modes: it takes no mode."""

    def __init__(self, node: canopen.LocalNode) -> None:
        self.state = cia402.DISABLED
        self.word = 0
        self.words: list[int] = []
        self.mode = 0
        self.error = 0
        self.position = 100
        self.velocity = 0
        self.target = 100
        self.steps = 0
        self.acknowledged = self.homed = self.homes = False
        self.fails_homing = self.ignores_modes = self.has_lasting_fault = False
        self.values: dict[int, int] = {}
        node.add_write_callback(self._written)
        node.add_read_callback(self._read)

    def fail(self, code: int) -> None:
        self.error, self.state, self.velocity = code, cia402.FAULT, 0

    def _written(self, *, index: int, subindex: int, od: Any, data: bytes) -> None:
        value = int.from_bytes(data, "little", signed=index in (0x6060, 0x607A, 0x60FF))
        self.values[index] = value
        if index == 0x6040:
            self._control(value)
        elif index == 0x6060 and not self.ignores_modes:
            self.mode = value

    def _control(self, word: int) -> None:
        before, self.word = self.word, word
        self.words.append(word)
        if not (self.state == cia402.FAULT and self.has_lasting_fault):
            self.state, _ = cia402.walk(self.state, word, before)
        if self.state != cia402.FAULT:
            self.error = 0
        if self.state != cia402.ENABLED:
            self.velocity = self.steps = 0
            return
        rises = word & ~before & 0x10
        if self.mode == 1:
            if rises:
                self.target = self.values[0x607A] + (self.position if word & 0x40 else 0)
                self.steps, self.acknowledged = STEPS, True
            elif not word & 0x10:
                self.acknowledged = False
        elif self.mode == 6 and rises:
            self.steps, self.homes, self.homed = STEPS, True, False

    def _step(self) -> None:
        if self.state != cia402.ENABLED or self.word & 0x100:
            self.velocity = 0
            return
        if self.mode == 3:
            self.velocity = self.values.get(0x60FF, 0)
            self.position += self.velocity
        elif self.steps:
            self.steps -= 1
            if self.mode == 1:
                self.position += (self.target - self.position) // (self.steps + 1)
            elif not self.steps and not self.fails_homing:
                self.position, self.homed = 0, True

    def _statusword(self) -> int:
        """x in the pattern: 0, but for remote and voltage."""
        word = int(cia402.STATUSWORDS[self.state].replace("x", "0"), 2) | 0x0210
        if self.state == cia402.DISABLED or self.state == cia402.FAULT:
            word &= ~0x10
        if self.state == cia402.QUICK_STOP:
            return word
        if self.mode == 6:
            if self.homes and not self.steps:
                return word | (0x1400 if self.homed else 0x2400)
            return word | (0 if self.steps else 0x0400)
        stands = self.velocity == 0 and (self.steps == 0 or bool(self.word & 0x100))
        if self.mode == 3:
            reached = stands if self.word & 0x100 else self.velocity == self.values.get(0x60FF, 0)
            return word | reached << 10 | stands << 12
        return word | stands << 10 | self.acknowledged << 12

    def _read(self, *, index: int, subindex: int, od: Any) -> int | None:
        if index == 0x6041:
            self._step()
            return self._statusword()
        shown = {0x6061: self.mode, 0x603F: self.error, 0x6064: self.position, 0x606C: self.velocity, 0x6502: MODES}
        return shown.get(index)
