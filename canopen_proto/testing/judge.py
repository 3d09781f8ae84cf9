"""`Judge`: what an observer says of a bus of a World: each frame in words, and what was wrong.

It reads the trace when it is asked, so a test that asks nothing pays nothing. It knows the dictionaries of the world's devices.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import NamedTuple

from canopen_proto.frame import Frame
from canopen_proto.machine import SECOND, Time
from canopen_proto.observer.finding import BusFinding
from canopen_proto.observer.observer import RULES, Observation, Observer
from canopen_proto.testing.patterns import Names


class Passed(NamedTuple):
    """See this module's text. time: ns. sender: its name; "" for somebody whom nobody knows.

    fate: what a fault did to it, in words; "" if it came as it was sent. only: the one receiver that this is about; 0: all.
    """

    time: Time
    frame: Frame
    sender: str
    fate: str = ""
    only: int = 0

    @property
    def was_heard(self) -> bool:
        """Whether the bus has seen it: it was not lost on its way, and it is no copy that one receiver alone has got."""
        return self.fate != "lost" and not self.only


class Witnessed(NamedTuple):
    """A frame of the trace, and what the observer says of it; None if the bus has not seen it."""

    passed: Passed
    observation: Observation | None

    def __str__(self) -> str:
        passed, seen = self.passed, self.observation
        head = f"{passed.time / SECOND:10.6f} s  {passed.sender or '?':10} {passed.frame!s:22}"
        words = "" if seen is None else f"{seen.meaning.service} {seen.meaning.node_id or ''} {seen.meaning.text}"
        fate = f"  [{passed.fate}]" if passed.fate else ""
        wrong = "" if seen is None else "".join(f"  <-- {found.text}" for found in seen.findings)
        return f"{head} {' '.join(words.split())}{fate}{wrong}"


class Found(NamedTuple):
    """What was wrong. time: ns, of the frame that shows it, or of the end."""

    time: Time
    finding: BusFinding

    def __str__(self) -> str:
        node = f"node {self.finding.node_id}: " if self.finding.node_id else ""
        doubt = "" if self.finding.is_certain else " (not certain)"
        return f"{self.time / SECOND:10.6f} s  {self.finding.rule}: {node}{self.finding.text}{doubt}"


class Judge:
    """See this module's text; it is `bus.observer`. under_way: returns the frames that were sent, and have not come yet."""

    def __init__(
        self, name: str, trace: list[Passed], clock: Callable[[], Time], names: Names, under_way: Callable[[], list[Frame]]
    ) -> None:
        self.name = name
        self.under_way = under_way
        self._trace = trace
        self._clock = clock
        self._names = names
        self._observer: Observer | None = None
        self._witnessed: list[Witnessed] = []
        self._missed: list[Found] = []  # by silence, as far as it was asked; the observer tells each once

    def witnessed(self) -> list[Witnessed]:
        """Return all frames so far, with what is to say of them."""
        if self._observer is None:
            self._observer = Observer(self._names, exact=True)
        for passed in self._trace[len(self._witnessed) :]:
            observation = self._observer.observe(passed.frame, passed.time) if passed.was_heard else None
            self._witnessed.append(Witnessed(passed, observation))
        return self._witnessed

    def forget(self) -> None:
        """Look at all frames again: another device is known now."""
        self._observer = None
        self._witnessed = []
        self._missed = []

    def lines(self) -> list[str]:
        """Return all frames in words."""
        return [str(each) for each in self.witnessed()]

    @property
    def findings(self) -> list[Found]:
        """What was wrong so far, in order."""
        found = [
            Found(each.passed.time, finding)
            for each in self.witnessed()
            if each.observation is not None
            for finding in each.observation.findings
        ]
        assert self._observer is not None
        now = self._clock()
        self._missed += [Found(now, finding) for finding in self._observer.idle(now)[0]]
        return sorted(found + self._missed, key=lambda each: each.time)

    def clean(self, but: str | Collection[str] = ()) -> None:
        """Check that nothing was wrong. but: a rule (canopen_proto.observer.observer.RULES) that may be broken, or several.

        Raises AssertionError, which names what was wrong, and shows the frames before it.
        """
        __tracebackhide__ = True
        but = (but,) if isinstance(but, str) else but
        unknown = [rule for rule in but if rule not in RULES]
        if unknown:
            raise ValueError(f"the observer has no rule {unknown[0]!r}: {', '.join(RULES)}")
        wrong = [found for found in self.findings if found.finding.rule not in but]
        if wrong:
            text = "\n".join(f"  {found}" for found in wrong)
            raise AssertionError(f"What was wrong on {self.name}:\n{text}\n{self.tail(wrong[0].time)}")

    def tail(self, until: Time, count: int = 8) -> str:
        """Return the last frames up to a time, for an error."""
        lines = [f"  {each}" for each in self.witnessed() if each.passed.time <= until][-count:]
        return "\n".join([f"The last frames on {self.name}:", *lines]) if lines else f"No frame was on {self.name}."
