"""Another bit rate for a whole bus: nobody is left behind, and there is a way back."""

from __future__ import annotations

import pytest

from canopen_proto.frame import Frame
from canopen_proto.lss.bit_rate import Refusal, activate, missing, prepare, store_all, take_back
from canopen_proto.lss.messages import LssAddress, LssService
from canopen_proto.lss.slave import LssSlave
from canopen_proto.machine import MILLISECOND, LocalProtocolError, Outbox
from tests.lss.lss_bench import LssBench

ADDRESSES = [LssAddress(0x360, 2, 3, serial) for serial in (1, 2, 3)]
DELAY = 100 * MILLISECOND


class Wires(LssBench):
    """A bus on which only those hear each other that have the same bit rate. rate: the tool's, kbit/s."""

    def __init__(self) -> None:
        super().__init__(ADDRESSES, [4, 5, 255])
        self.rate = 125
        for slave in self.slaves:
            slave.persistent = slave.pending = slave.active = slave.active._replace(bit_rate=125)
        self.stuck: set[int] = set()  # places of devices that miss the switch
        hand_over = self.bus._deliver

        def deliver(receiver: Outbox, frame: Frame) -> None:
            for place, node in enumerate(self.nodes):
                if node.out is receiver and (
                    node.lss.active.bit_rate != self.rate
                    or (place in self.stuck and frame.data[0] == LssService.ACTIVATE_BIT_TIMING)
                ):
                    return
            hand_over(receiver, frame)

        self.bus._deliver = deliver  # type: ignore[method-assign]

    @property
    def rates(self) -> list[int]:
        return [slave.active.bit_rate for slave in self.slaves]

    def switch(self, bit_rate: int) -> None:
        self.run(activate(self.tool, DELAY))
        self.rate = bit_rate
        self.bus.run(DELAY)


def test_all_switch_at_once_and_store_it_in_the_end() -> None:
    bench = Wires()
    assert bench.run(prepare(bench.tool, bench.pace, ADDRESSES, 500, 125)) == []
    assert bench.rates == [125] * 3
    bench.switch(500)
    assert bench.rates == [500] * 3
    assert bench.run(missing(bench.tool, bench.pace, ADDRESSES)) == []
    assert [slave.persistent.bit_rate for slave in bench.slaves] == [125] * 3  # power off and on is the way back
    assert bench.run(store_all(bench.tool, bench.pace, ADDRESSES)) == []
    assert [slave.persistent.bit_rate for slave in bench.slaves] == [500] * 3
    assert bench.ids == [4, 5, 255]


@pytest.mark.parametrize("place", [0, 1, 2])
def test_one_refusal_takes_everything_back(place: int) -> None:
    bench = Wires()
    bench.slaves[place].bit_rates = frozenset({125})
    (refused,) = bench.run(prepare(bench.tool, bench.pace, ADDRESSES, 500, 125))
    assert refused == Refusal(ADDRESSES[place], "the device says: bit timing not supported")
    assert [slave.pending.bit_rate for slave in bench.slaves] == [125] * 3
    assert bench.sent(LssService.ACTIVATE_BIT_TIMING) == 0
    assert bench.none_is_selected


def test_a_device_that_is_not_there_or_lacks_the_service_is_a_refusal_too() -> None:
    class Lacks(LssSlave):
        def receive(self, frame: Frame, now: int) -> None:
            if frame.data[0] not in (LssService.CONFIGURE_BIT_TIMING, LssService.STORE):
                super().receive(frame, now)

    bench = LssBench([])
    bench.bus.attach(Lacks(Outbox(), ADDRESSES[0]))
    refused = bench.run(prepare(bench.tool, bench.pace, ADDRESSES[:1], 500, 125))
    assert "not supported by this device?" in refused[0].remark
    assert "no device with the address" in bench.run(prepare(bench.tool, bench.pace, ADDRESSES[1:2], 500, 125))[0].remark
    (stored,) = bench.run(store_all(bench.tool, bench.pace, ADDRESSES[:1]))
    assert ("not supported by this device?" in stored.remark, stored.is_silent) == (True, True)


def test_a_device_that_missed_the_switch_is_named_and_the_others_come_back() -> None:
    bench = Wires()
    bench.run(prepare(bench.tool, bench.pace, ADDRESSES, 500, 125))
    bench.stuck = {1}
    bench.switch(500)
    assert bench.rates == [500, 125, 500]
    assert bench.run(missing(bench.tool, bench.pace, ADDRESSES)) == [ADDRESSES[1]]
    bench.run(prepare(bench.tool, bench.pace, [ADDRESSES[0], ADDRESSES[2]], 125, 500))
    bench.switch(125)
    assert bench.rates == [125] * 3
    assert bench.run(missing(bench.tool, bench.pace, ADDRESSES)) == []
    assert bench.slaves[1].pending.bit_rate == 500  # it would come back with this one, once somebody lets it store its node-ID
    bench.run(take_back(bench.tool, bench.pace, 125))
    assert [slave.pending for slave in bench.slaves] == [slave.persistent for slave in bench.slaves]
    assert bench.none_is_selected


def test_nobody_speaks_around_the_switch() -> None:
    bench = Wires()
    bench.run(prepare(bench.tool, bench.pace, ADDRESSES, 500, 125))
    bench.bus.sent.clear()
    start = bench.bus.now
    bench.switch(500)
    assert [str(frame)[:6] for _, frame in bench.bus.sent] == ["7E5#04", "7E5#04", "7E5#15"]
    assert bench.bus.now >= start + 2 * DELAY


def test_rates_that_are_not_in_the_table_raise_before_anything_is_sent() -> None:
    bench = Wires()
    with pytest.raises(LocalProtocolError, match="100 kbit/s is not in CiA's table"):
        bench.run(prepare(bench.tool, bench.pace, ADDRESSES, 100, 125))
    assert bench.sent(LssService.SWITCH_GLOBAL) == 0
