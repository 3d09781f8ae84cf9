"""Other participants are on the bus: what they do is no fault of the device under test."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from canopen_check.catalogue import BY_NUMBER, run_all
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Machine, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.verdict import Result, Verdict
from tests.check.conformance_rig import Fault, Site
from tests.core.full_device import full_device


class Ticker(Machine):
    """Sends the same frames again and again."""

    def __init__(self, out: Outbox, period: Time, frames: Iterable[str]) -> None:
        super().__init__(out)
        self.period = period
        self.frames = [Frame.parse(each) for each in frames]
        self._arm(period)

    def can_ids(self) -> Iterable[int]:
        return ()

    def handle_timeout(self, now: Time) -> None:
        if now >= self.deadline:
            self.out.frames.extend(self.frames)
            self._arm(now + self.period)


def in_company(period: Time, *frames: str, fault: Fault | None = None) -> Site:
    """A site whose device is not alone."""
    site, network = Site(fault), Network()
    network.attach(Ticker(network.out, period, frames))
    site.world.host(network)
    site.world.advance(2 * period)
    return site


def results(site: Site, *numbers: str) -> dict[str, Verdict]:
    cases = [BY_NUMBER[each] for each in numbers] or [*BY_NUMBER.values()]
    return {case.number: verdict for case, verdict in site.result_of(lambda bench: run_all(bench, cases))}


OTHER_MASTERS = {
    "reads": ("605#4000100000000000", "3.10"),
    "writes the heartbeat time": ("605#2B171000E8030000", "7.102"),
    "starts all nodes": ("000#0100", "9.2"),
}


@pytest.mark.thorough(2)
@pytest.mark.parametrize("what", OTHER_MASTERS)
def test_another_master_is_named_and_the_device_is_not_accused(what: str) -> None:
    frame, number = OTHER_MASTERS[what]
    verdicts = results(in_company(37 * MILLISECOND, frame))
    assert {number: each.failures for number, each in verdicts.items() if each.result is Result.FAILED} == {}
    assert verdicts[number].result is Result.NOT_JUDGED
    assert f"another master is on the bus and sent {frame}, so that the device cannot be judged: " in verdicts[number].reason


@pytest.mark.parametrize("number", ["3.6", "3.7", "3.8", "6.3"])
def test_the_sync_of_another_node_is_named(number: str) -> None:
    verdict = results(in_company(10 * MILLISECOND, "080#"), number)[number]
    assert "080# came, a SYNC of another node, or of the device" in verdict.reason


def test_what_fails_without_a_command_of_another_master_fails() -> None:
    goes_on = Fault("goes on", heard=[("605#2B17100000000000", "605#2B17100064000000")])
    for company in (["77F#05", "100#112233441122", "606#4000100000000000", "000#0106"], ["7E5#5100000000800000"]):
        assert results(in_company(30 * MILLISECOND, *company, fault=goes_on), "7.103")["7.103"].result is Result.FAILED


def test_a_device_is_not_told_to_miss_a_node_that_is_there() -> None:
    """Its own heartbeats would keep the node alive that the case lets be lost."""
    site = in_company(20 * MILLISECOND, *(f"70{node_id}#05" for node_id in (1, 2, 3, 6)))
    verdicts = results(site, "7.104", "7.105", "7.106", "7.107")
    assert {each.result for each in verdicts.values()} == {Result.PASSED}, verdicts


@pytest.mark.thorough
def test_other_devices_on_the_bus_change_no_verdict() -> None:
    site = Site()
    for node_id in (4, 6, 7):
        network = Network()
        node = LocalNode(network.out, node_id, full_device(standard_object(0x1017, 100), node_id=node_id))
        network.attach(node)
        site.world.host(network)
        node.boot(site.world.now)
    assert {number: each for number, each in results(site).items() if each.result is Result.FAILED} == {}
