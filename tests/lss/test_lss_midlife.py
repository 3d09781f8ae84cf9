"""A device's three pairs of node-ID and bit rate, whatever a master, the host and NMT do to them in mid-life.

The oracle is a table of CiA 305 (see `canopen_proto.lss.slave`): each service changes one of the three pairs, and only so.
"""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.lss.messages import UNCONFIGURED, LssAddress, LssConfiguration, LssState
from canopen_proto.lss.slave import (
    STORE_TIMEOUT,
    LssBitRateSwitched,
    LssResetNeeded,
    LssSilenceBegan,
    LssSilenceEnded,
    LssSlave,
    LssStoreRequested,
)
from canopen_proto.machine import MILLISECOND, NEVER, Event, Outbox
from canopen_proto.nmt import NmtCommand
from tests.core.bus import take_events, take_frames
from tests.examples import examples

BIT_RATES = {0: 1000, 2: 500, 4: 125}
ABSENT_BIT_RATE = 6

STEPS = st.one_of(
    st.tuples(st.just("node-ID"), st.sampled_from([1, 33, 127, UNCONFIGURED, 0, 128, 200])),
    st.tuples(st.just("bit rate"), st.sampled_from([*BIT_RATES, ABSENT_BIT_RATE])),
    st.tuples(st.just("store"), st.sampled_from(["stored", "failed", "late", "reset meanwhile"])),
    st.tuples(st.just("activate"), st.sampled_from([0, 1, 50])),
    st.tuples(st.just("switch"), st.sampled_from([0, 1])),
    st.tuples(st.just("reset"), st.sampled_from([NmtCommand.RESET_COMMUNICATION, NmtCommand.RESET_NODE])),
)


class Scene:
    """The device, and what the standard has it hold."""

    def __init__(self, node_id: int, bit_rate: int) -> None:
        self.now = 0
        self.device = LssSlave(
            Outbox(), LssAddress(1, 2, 3, 4), LssConfiguration(node_id, bit_rate), bit_rates=BIT_RATES.values()
        )
        self.persistent = self.pending = self.active = (node_id, bit_rate)
        self.is_configuring = False

    def take(self, kind: type[Event]) -> list[Event]:
        return [event for event in take_events(self.device.out) if isinstance(event, kind)]

    def ask(self, *request: int) -> list[bytes]:
        self.device.receive(Frame(0x7E5, bytes(request).ljust(8, b"\0")), self.now)
        return [bytes.fromhex(text.partition("#")[2]) for text in take_frames(self.device.out)]

    def answers(self, error: int, service: int) -> list[bytes]:
        return [bytes((service, error)).ljust(8, b"\0")] if self.is_configuring else []

    def wake(self) -> None:
        self.now = self.device.deadline
        self.device.handle_timeout(self.now)

    def step(self, what: str, choice: object) -> None:
        match what, choice:
            case "node-ID", int(number):
                is_fine = 1 <= number <= 127 or number == UNCONFIGURED
                assert self.ask(0x11, number) == self.answers(0 if is_fine else 1, 0x11)
                if self.is_configuring and is_fine:
                    self.pending = (number, self.pending[1])
            case "bit rate", int(index):
                assert self.ask(0x13, 0, index) == self.answers(int(index not in BIT_RATES), 0x13)
                if self.is_configuring and index in BIT_RATES:
                    self.pending = (self.pending[0], BIT_RATES[index])
            case "store", how:
                self.store(how)
            case "activate", int(delay):
                self.activate(delay)
            case "switch", int(mode):
                assert self.ask(0x04, mode) == []
                leaves = self.is_configuring and not mode and self.active[0] == UNCONFIGURED != self.pending[0]
                assert len(self.take(LssResetNeeded)) == leaves
                self.is_configuring = bool(mode)
            case "reset", NmtCommand() as command:
                self.reset(command)

    def reset(self, command: NmtCommand) -> None:
        self.device.reset(command, self.now)
        if command is NmtCommand.RESET_NODE:
            self.pending = self.persistent
        self.active = (self.pending[0], self.active[1])
        self.is_configuring = False

    def store(self, how: object) -> None:
        assert self.ask(0x17) == []
        assert len(self.take(LssStoreRequested)) == self.is_configuring
        if not self.is_configuring:
            return
        assert self.ask(0x11, 99) == [], "it stores, and serves nothing"
        if how == "reset meanwhile":
            self.reset(NmtCommand.RESET_COMMUNICATION)
            self.device.complete_store(0, self.now)
            return
        if how == "late":
            self.now += STORE_TIMEOUT
            self.device.handle_timeout(self.now)
        else:
            self.device.complete_store(0 if how == "stored" else 2, self.now)
        (answer,) = (text.partition("#")[2] for text in take_frames(self.device.out))
        assert answer == ("1700" if how == "stored" else "1702").ljust(16, "0")
        if how == "stored":
            self.persistent = self.pending
        self.device.complete_store(0, self.now)  # once more, and too late

    def activate(self, delay: int) -> None:
        assert self.ask(0x15, delay, 0) == []
        began = self.take(LssSilenceBegan)
        assert len(began) == self.is_configuring
        if not began:
            return
        begun, new = self.now, self.pending[1]
        assert self.device.active.bit_rate == self.active[1]
        assert self.ask(0x11, 99) == []
        self.wake()
        assert self.now == begun + delay * MILLISECOND
        assert self.take(LssBitRateSwitched) == [LssBitRateSwitched(self.device.node_id, new)]
        self.active = (self.active[0], new)
        assert self.ask(0x11, 99) == []
        self.wake()
        assert self.now == begun + 2 * delay * MILLISECOND
        assert len(self.take(LssSilenceEnded)) == 1


@examples(500)
@given(
    st.sampled_from([5, UNCONFIGURED]),
    st.sampled_from([*BIT_RATES.values()]),
    st.lists(STEPS, max_size=25),
)
def test_each_service_changes_its_own_pair_and_no_other(node_id: int, bit_rate: int, steps: list[tuple[str, object]]) -> None:
    scene = Scene(node_id, bit_rate)
    for what, choice in [("switch", 1), *steps]:
        scene.step(what, choice)
        device = scene.device
        shown = (device.persistent, device.pending, device.active)
        assert shown == (scene.persistent, scene.pending, scene.active), (what, choice)
        assert (device.state is LssState.CONFIGURATION) == scene.is_configuring
        assert (device.is_silent, device.is_storing, device.deadline) == (False, False, NEVER)
        device.out.events.clear()
        assert device.out.frames == []
