"""How many planted faults the observer finds, by rule, and what it finds where nothing is wrong.

    python -m fuzz.recall                  # recordings that our own stack makes: the figures of docs/live.md; some seconds
    python -m fuzz.recall --places 40      # more places in each recording
    python -m fuzz.recall --recorded       # the recordings of other stacks (tests/interop/recorded.py says where); a minute

The faults are those of tests/interop/faults.py. A fault is found if its rule is told at it, `certain` if it is told as certain.
Its twin is the like of it without a fault. A false word is a finding in a recording or a twin where nothing is wrong.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from random import Random

from canopen_proto.frame import SYNC
from canopen_proto.observer.observer import RULES
from tests.interop.faults import CHANGES, KNOWN, SCENES, Found, Session, found_in
from tests.interop.recorded import FOLDER, Line, load
from tests.observer.observer_sessions import CLEAN, clean

PLACES = 4
"""In each recording, of each fault."""
MADE = (*range(4), *range(4, CLEAN, 7))
"""The recordings of our own stack: machines, and transfers of all kinds."""


@dataclass
class Recall:
    """planted, found, certain: how often, by rule. frames: where nothing is wrong. false: the rules told there."""

    planted: Counter[str] = field(default_factory=Counter)
    found: Counter[str] = field(default_factory=Counter)
    certain: Counter[str] = field(default_factory=Counter)
    recordings: int = 0
    twins: int = 0
    frames: int = 0
    false: list[str] = field(default_factory=list)

    def add(self, name: str, session: Session, places: int) -> None:
        """Plant each fault in a recording. places: how often, where it fits."""
        random, known = Random(name), found_in(session)
        self.recordings += 1
        self.frames += len(session)
        false = Counter(each.rule for each in known)
        false.subtract(KNOWN.get(name, ()))
        self.false += false.elements()
        for change in CHANGES:
            fitting = change.places(session)
            for at in random.sample(fitting, min(places, len(fitting))):
                self._take(change.rule, change.found(session, at, known))
        has_sync = any(line.frame.can_id == SYNC for line in session)
        for scene in SCENES:
            if has_sync and scene.has_sync:
                continue  # two producers
            for _ in range(places):
                found = scene.found(session, scene.begin_in(session, random), known)
                if scene.is_faulty:
                    self._take(scene.rule, found)
                else:
                    self.twins += 1
                    self.frames += len(scene.frames)
                    self.false += [each.rule for each in found]

    def _take(self, rule: str, found: list[Found]) -> None:
        self.planted[rule] += 1
        self.found[rule] += any(each.rule == rule for each in found)
        self.certain[rule] += any(each.rule == rule and each.is_certain for each in found)

    def lines(self) -> Iterator[str]:
        """The table, as it stands in docs/live.md."""
        yield "| rule | planted | found | certain |"
        yield "|---|---|---|---|"
        for rule in RULES:
            planted = self.planted[rule]
            yield f"| `{rule}` | {planted} | {_share(self.found[rule], planted)} | {_share(self.certain[rule], planted)} |"
        yield ""
        yield (
            f"{self.recordings} recordings and {self.twins} twins without a fault, {self.frames} frames: "
            f"{len(self.false)} false words."
        )


def _share(count: int, planted: int) -> str:
    return f"{count * 1000 // planted / 10:g} %" if planted else "-"


def of_made(places: int = PLACES, numbers: Iterable[int] = MADE) -> Recall:
    """The recall in recordings that our own stack makes: each run has the same."""
    recall = Recall()
    for number in numbers:
        recall.add(f"made {number}", [Line(at, frame) for at, frame in clean(number)], places)
    return recall


def of_recorded(places: int = PLACES) -> Recall:
    """The recall in the recordings of other stacks."""
    recall = Recall()
    for path in sorted(FOLDER.glob("*.log")):
        recall.add(path.stem, load(path.stem), places)
    return recall


def main() -> None:
    parser = argparse.ArgumentParser(description="How many planted faults the observer finds.")
    parser.add_argument("--places", type=int, default=PLACES, help="in each recording, of each fault")
    parser.add_argument("--recorded", action="store_true", help="the recordings of other stacks, not those of our own one")
    given = parser.parse_args()
    recall = (of_recorded if given.recorded else of_made)(given.places)
    print("\n".join(recall.lines()))
    for rule, count in sorted(Counter(recall.false).items()):
        print(f"false: {count} x {rule}")


if __name__ == "__main__":
    main()
