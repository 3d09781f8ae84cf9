"""Assertions that explain: what a bus of a World has seen, and in which order.

    bus.saw(sdo_write(5, "controlword", 0x0F)).within(100 * MILLISECOND).then(tpdo(5))
    bus.never(sdo_abort(5))

An assertion looks back: let the world run first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sized
from typing import Final

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import mux
from canopen_proto.sdo.codec import RESPONSES, SdoFrame
from canopen_proto.testing.judge import Judge, Witnessed
from canopen_proto.testing.patterns import Names, Pattern, as_pattern
from canopen_proto.testing.times import nanoseconds

_NEAR: Final = 5
"""Frames that are shown because they are near to what was looked for."""
_SERVICES: Final = {"tpdo": "TPDO", "rpdo": "RPDO", "sync": "SYNC", "nmt": "NMT", "emcy": "EMCY"} | dict.fromkeys(
    ("sdo request", "sdo answer", "sdo write", "sdo read", "sdo abort"), "SDO"
)
"""The services of the observer, by those of patterns."""


class SeenFrame:
    """A frame that was seen; made by `WorldBus.saw`. time: ns. frame: itself. text: in words."""

    def __init__(self, pattern: Pattern, place: int, judge: Judge, names: Names, since: Time) -> None:
        self._pattern = pattern
        self._place = place
        self._judge = judge
        self._names = names
        self._since = since

    @property
    def _witnessed(self) -> Witnessed:
        return self._judge.witnessed()[self._place]

    @property
    def time(self) -> Time:
        """When it was on the bus, ns."""
        return self._witnessed.passed.time

    @property
    def frame(self) -> Frame:
        """The frame."""
        return self._witnessed.passed.frame

    @property
    def text(self) -> str:
        """The frame in words, with its time and its sender."""
        return str(self._witnessed)

    def within(self, limit: Time | float) -> SeenFrame:
        """Check that it came not later than so many ns behind the time from which was looked (`after`, `mark`, the start), or
        behind the frame before it (`then`). Raises AssertionError."""
        __tracebackhide__ = True
        limit = nanoseconds(limit, "within")
        took = self.time - self._since
        if took > limit:
            behind = f"{_time_text(took)} behind {self._since / SECOND:.6f} s, not within {_time_text(limit)}"
            raise AssertionError(f"{self._pattern} came {behind}.\n{self._judge.tail(self.time)}")
        return self

    def times(self, count: int) -> SeenFrame:
        """Check that such frames came so many times, no more and no less. Raises AssertionError."""
        __tracebackhide__ = True
        if not isinstance(count, int) or count < 1:
            raise LocalProtocolError(f"times takes a number from 1 on, not {count!r}; for none: bus.never(...)")
        found = list(_all(self._pattern, self._judge, self._names, self._since))
        if len(found) != count:
            lines = "\n".join(f"  {self._judge.witnessed()[place]}" for place in found[-_NEAR:])
            raise AssertionError(
                f"{self._pattern} came {'once' if len(found) == 1 else f'{len(found)} times'}, not {count}:\n{lines}"
            )
        return self

    def then(self, pattern: Pattern | Frame | str) -> SeenFrame:
        """Return the first frame behind this one that fits another pattern. Raises AssertionError if there is none."""
        __tracebackhide__ = True
        return find(as_pattern(pattern), self._judge, self._names, self.time, self._place + 1, f" behind {self._pattern}")


def find(pattern: Pattern, judge: Judge, names: Names, since: Time, first: int = 0, behind: str = "") -> SeenFrame:
    """Return the first frame that fits. Raises AssertionError, which says what came instead."""
    __tracebackhide__ = True
    pattern.check(names)
    place = next(_all(pattern, judge, names, since, first), None)
    if place is not None:
        return SeenFrame(pattern, place, judge, names, since)
    looked = [each for each in judge.witnessed()[first:] if each.passed.time >= since]
    near = _nearest(pattern, looked, names)
    told = [f"{judge.name} never saw {pattern}{behind} (looked at {_count(looked)} from {since / SECOND:.6f} s on)."]
    if near:
        told += ["What came nearest:", *(f"  {each}" for each in near)]
    before = [judge.witnessed()[each] for each in _all(pattern, judge, names, 0)]
    if before:
        told += ["It came before that:", *(f"  {each}" for each in before[-_NEAR:])]
    lost = [each for each in looked if not each.passed.was_heard and pattern.fits(each.passed.frame, names)]
    if lost:
        told += ["It was sent, but a fault took it:", *(f"  {each}" for each in lost[:_NEAR])]
    if any(pattern.fits(frame, names) for frame in judge.under_way()):
        told.append("It was sent just now, and is on its way: let time pass before you look.")
    raise AssertionError("\n".join([*told, judge.tail(looked[-1].passed.time if looked else since)]))


def check_never(pattern: Pattern, judge: Judge, names: Names, since: Time) -> None:
    """Check that no frame fits. Raises AssertionError."""
    __tracebackhide__ = True
    pattern.check(names)
    place = next(_all(pattern, judge, names, since), None)
    if place is not None:
        witnessed = judge.witnessed()[place]
        raise AssertionError(f"{judge.name} saw {pattern}:\n  {witnessed}\n{judge.tail(witnessed.passed.time)}")


def _all(pattern: Pattern, judge: Judge, names: Names, since: Time, first: int = 0) -> Iterator[int]:
    """The places of the frames that fit. A value that was written in segments or blocks fits with the frame that confirms it."""
    value = _value(pattern, names)
    for place, each in enumerate(judge.witnessed()[first:], start=first):
        if each.passed.time < since or not each.passed.was_heard:
            continue
        fits = pattern.fits(each.passed.frame, names)
        settled = None if each.observation is None else each.observation.settled
        if not fits and value is not None and settled is not None and not settled.is_read:
            is_of_many = RESPONSES[each.passed.frame.data[0]] is not SdoFrame.DOWNLOAD  # else the request was the whole of it
            fits = is_of_many and (settled.node_id, settled.place, settled.data) == value
        if fits:
            yield place


def _value(pattern: Pattern, names: Names) -> tuple[int, int, bytes] | None:
    """The node, object and bytes of a write, if it is one of a certain value."""
    data = pattern.data(names) if pattern.service == "sdo write" else None
    return None if data is None else (pattern.node_id, pattern.variable(names).mux, data)


def _nearest(pattern: Pattern, looked: Iterable[Witnessed], names: Names) -> list[Witnessed]:
    """The last frames that are most like what was looked for: of its object, else of its service and node."""
    service = _SERVICES.get(pattern.service, pattern.service)
    same, of_object = [], []
    for each in looked:
        meaning = None if each.observation is None else each.observation.meaning
        if meaning is None or not meaning.service.startswith(service) or pattern.node_id not in (0, meaning.node_id):
            continue
        same.append(each)
        if pattern.key is not None and any(
            mux(shown.index, shown.subindex) == pattern.variable(names).mux for shown in meaning.objects
        ):
            of_object.append(each)
    return (of_object or same)[-_NEAR:]


def _count(frames: Sized) -> str:
    return f"{len(frames)} frame{'' if len(frames) == 1 else 's'}"


def _time_text(time: Time) -> str:
    return f"{time / SECOND:g} s" if time >= SECOND else f"{time / MILLISECOND:g} ms"
