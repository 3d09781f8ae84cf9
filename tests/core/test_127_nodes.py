"""A full network: 127 drives boot, are configured by SDO and supervised by one master, in virtual time, the same each time."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from canopen_proto.heartbeat import HeartbeatLost
from canopen_proto.machine import SECOND
from canopen_proto.nmt import NmtState

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))  # the plant is a benchmark's, too

from plant import Plant


def test_127_nodes_boot_are_configured_and_supervised() -> None:
    plant = Plant(seed=1)
    assert plant.start() == [0x43] * 127
    plant.bus.run(SECOND)
    assert all(node.nmt_state is NmtState.OPERATIONAL for node in plant.remote.values())
    assert not any(isinstance(event, HeartbeatLost) for event in plant.bus.events)

    plant.bus.networks.remove(plant.devices[64])
    plant.bus.run(SECOND)
    assert [event.node_id for event in plant.bus.events if isinstance(event, HeartbeatLost)] == [64]


@pytest.mark.thorough
def test_two_runs_with_one_seed_give_one_trace() -> None:
    traces = []
    for seed in (7, 7, 8):
        plant = Plant(seed)
        plant.start()
        traces.append([(time, str(frame)) for time, frame in plant.bus.sent])
    assert traces[0] == traces[1]
    assert traces[0] != traces[2]
