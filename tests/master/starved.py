"""A `PatientClock` on a busy computer: this process stands still again and again, for up to seconds. Nothing really sleeps."""

from __future__ import annotations

import math
import random

from canopen_master.participant.patient_clock import PatientClock


class StarvedClock(PatientClock):
    """The processor is taken away at any look at the clock, and wake-ups come late. share: of looks. longest: seconds."""

    def __init__(self, seed: int = 0, share: float = 0.01, longest: float = 3.0) -> None:
        super().__init__(self._now)
        self._random, self._share, self._longest = random.Random(seed), share, longest
        self.real = 1000.0

    def _now(self) -> float:
        self.real += 10e-6
        if self._random.random() < self._share:
            self.real += self._random.uniform(0.0, self._longest)
        return self.real

    def deadline_to_sleep_time(self, deadline: float) -> float:
        """Sleep: until the deadline, by the real time."""
        sleep = super().deadline_to_sleep_time(deadline)
        if sleep == math.inf:  # only another thread, or a file, can wake the loop
            return 0.001
        self.real += max(0.0, sleep)
        return 0.0
