"""The conformance cases on a bus in virtual time, against a sound device and against devices with a planted fault.

A `Fault` says how the device differs from what its dictionary promises: frames that it sends come out altered, frames that it
hears come in altered (candump text, by regular expression), it is described by another dictionary, or it is another kind of
node."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeAlias, TypeVar

from canopen_check.bench import Bench
from canopen_check.case import Case
from canopen_check.catalogue import BY_NUMBER
from canopen_data.description import DeviceDescription
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.frame import KEY_REMOTE, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MICROSECOND, MILLISECOND, Event, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.procedures.steps import Procedure
from canopen_proto.sdo.events import ObjectAccessPending
from canopen_proto.testing import World
from canopen_proto.verdict import Result, Verdict
from tests.core.full_device import NODE_ID, full_device

T = TypeVar("T")

Alteration: TypeAlias = tuple[str, "str | Callable[[re.Match[str]], str] | None"]
"""A pattern that a whole frame has to match, and what comes in its place: several frames stand apart by blanks, None is none."""
MakeNode: TypeAlias = Callable[[Outbox, int, ObjectDictionary], LocalNode]


@dataclass(frozen=True)
class Fault:
    """What is wrong with a device. sent, heard: alterations, the first that matches counts.

    strict: only a strict test calls it a failure.
    """

    what: str
    sent: Sequence[Alteration] = ()
    heard: Sequence[Alteration] = ()
    dictionary: ObjectDictionary | None = None
    node: MakeNode = LocalNode
    strict: bool = False


FRAME = 100 * MICROSECOND
EVERYTHING = (*range(0x800), *(key | KEY_REMOTE for key in range(0x800)))


class Wire(Network):
    """A network whose frames are altered on their way to the bus and from it."""

    def __init__(self, fault: Fault) -> None:
        super().__init__()
        self.fault = fault

    def can_ids(self) -> tuple[int, ...]:
        return EVERYTHING if self.fault.heard else super().can_ids()  # what comes in may be altered into what it wants

    def receive(self, frame: Frame, now: Time, timestamp: int | None = None) -> None:
        for each in altered(frame, self.fault.heard):
            super().receive(each, now, timestamp)

    def drain(self, now: Time) -> tuple[list[Frame], list[Event]]:
        frames, events = super().drain(now)
        return [each for frame in frames for each in altered(frame, self.fault.sent)], events


def altered(frame: Frame, alterations: Sequence[Alteration]) -> list[Frame]:
    """What becomes of a frame."""
    if not alterations:
        return [frame]
    text = str(frame)
    for pattern, replacement in alterations:
        match = re.fullmatch(pattern, text)
        if match is not None:
            if replacement is None:
                return []
            result = match.expand(replacement) if isinstance(replacement, str) else replacement(match)
            return [Frame.parse(each) for each in result.split()]
    return [frame]


class Site:
    """A bench and a device on a bus. truth: the dictionary that the bench goes by; the device's own, unless the fault has one.
    description: the device's file, of which the truth is then."""

    def __init__(
        self,
        fault: Fault | None = None,
        truth: ObjectDictionary | None = None,
        *,
        description: DeviceDescription | None = None,
        stimulus: bool = True,
        strict: bool = False,
        master: Network | None = None,
    ) -> None:
        self.world = World(transmission=(FRAME, FRAME))
        fault = fault or Fault("none")
        truth = truth or (full_device() if description is None else description.dictionary)
        self.tester = self.world.master(network=master)
        self.network = Wire(fault)
        self.node = fault.node(self.network.out, NODE_ID, fault.dictionary or truth)
        self.network.attach(self.node)
        self.device = self.world.host(self.network, on_event=self.serve)
        change = self.change if stimulus else None
        self.bench = Bench(self.tester.runs, NODE_ID, truth, description=description, stimulus=change, strict=strict)
        self.node.boot(self.world.now)
        self.world.advance(MILLISECOND)

    def serve(self, report: Event) -> None:
        """The device's host: it stores at once."""
        if isinstance(report, ObjectAccessPending):
            self.node.complete(report.access_id, None, self.world.now)

    def change(self, variable: Variable, now: Time) -> bool:
        """The device's process changes a value."""
        value = self.node.values.store[variable.mux]
        assert isinstance(value, int)
        self.node.set_value(variable.index, variable.subindex, value ^ 1, now)
        return True

    def frames(self) -> list[str]:
        """The frames so far, as candump writes them."""
        return [str(each.frame) for each in self.world.bus().trace]

    def run(self, case: Case) -> Verdict:
        """The verdict of a case."""
        return self.result_of(case.run)

    def result_of(self, procedure: Callable[[Bench], Procedure[T]]) -> T:
        """What a procedure on this bench comes to."""
        return self.tester.run(procedure(self.bench))


def verdict_of(
    number: str,
    fault: Fault | None = None,
    truth: ObjectDictionary | None = None,
    *,
    stimulus: bool = True,
    strict: bool = False,
) -> Verdict:
    """How a case ends on a device that was just switched on."""
    return Site(fault, truth, stimulus=stimulus, strict=strict).run(BY_NUMBER[number])


@cache
def sound_verdict(number: str, *, strict: bool) -> Verdict:
    """How a case ends on the sound device."""
    return verdict_of(number, strict=strict)


def check_caught(number: str, fault: Fault, truth: ObjectDictionary | None = None, said: str = "") -> None:
    """The case passes without the fault and fails with it, for the reason that is meant.

    What a strict test alone calls a failure, another one passes over, or remarks.
    """
    sound = verdict_of(number, None, truth, strict=fault.strict) if truth else sound_verdict(number, strict=fault.strict)
    assert sound.result is Result.PASSED
    verdict = verdict_of(number, fault, truth, strict=fault.strict)
    assert verdict.result is Result.FAILED, verdict
    assert any(re.search(said, failure) for failure in verdict.failures), verdict
    if fault.strict:
        assert verdict_of(number, fault, truth).result is not Result.FAILED


def refused(code: int) -> str:
    """An answer with another abort code in place of the one in a pattern's first group, the frame up to it."""
    return r"\g<1>" + code.to_bytes(4, "little").hex().upper()
