"""A minute of joint states at 100 Hz: none is lost without being counted, and they come in order. Jitter is told, not judged.

How long anything takes here decides nothing: DDS numbers all that is published on a topic, the node counts its SYNCs in
/diagnostics, and the times of publishing bring both together. On a busy computer SYNCs may be skipped: the node counts them.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tests.ros2.client import Client, parameters, running

SECONDS = 60
SECOND = 10**9
PERIOD = SECOND // 100
TO_JUDGE = 15  # counts at the beginning, and at the end: the node gives one a second
JOINTS = [f"joint{number}" for number in range(1, 7)]
MACHINE = """
[master]
cycle = "10ms"
timeout = "3s" # and a long watchdog: this computer may be busy with other things
watchdog = { timeout = "5s" }

[buses.can0]

[chains.arm]
joints = ["joint1", "joint2", "joint3", "joint4", "joint5", "joint6"]
""" + "".join(f'\n[nodes.{joint}]\nbus = "can0"\nid = {node}\n\n[joints.{joint}]\n' for node, joint in enumerate(JOINTS, 3))


class State(NamedTuple):
    """A joint state. number: that of DDS. published: when, in ns. stamp: in ns."""

    number: int
    published: int
    stamp: int


class Count(NamedTuple):
    """The counts of the chain in the diagnostics, and when they were published, in ns."""

    published: int
    state: str
    cycles: int
    skipped: int


class Record:
    """Keeps joint states and counts, as they come."""

    def __init__(self, client: Client) -> None:
        self.states: list[State] = []
        self.counts: list[Count] = []
        client.node.create_subscription(JointState, "/joint_states", self._keep_state, 10_000)
        client.node.create_subscription(DiagnosticArray, "/diagnostics", self._keep_count, 1000)

    def _keep_state(self, message: Any, info: Mapping[str, Any]) -> None:
        assert list(message.name) == JOINTS
        stamp = message.header.stamp
        self.states.append(
            State(info["publication_sequence_number"], info["source_timestamp"], stamp.sec * SECOND + stamp.nanosec)
        )

    def _keep_count(self, message: Any, info: Mapping[str, Any]) -> None:
        (chain,) = [status for status in message.status if status.name == "ros_canopen: chain: arm"]
        values = {each.key: each.value for each in chain.values}
        cycles, skipped = int(values["SYNC cycles"]), int(values["skipped cycles"])
        self.counts.append(Count(info["source_timestamp"], values["state"], cycles, skipped))

    def state_at(self, count: Count) -> State:
        """The last joint state before a count."""
        return [state for state in self.states if state.published <= count.published][-1]

    def numbers_at(self, count: Count) -> tuple[int, int]:
        """The least and the most joint states that were published before a count: equal unless DDS lost some just there."""
        behind = [state.number for state in self.states if state.published > count.published]
        return self.state_at(count).number, behind[0] - 1


@pytest.mark.timeout(600)
def test_a_minute_of_joint_states_is_complete_and_in_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(MACHINE, encoding="utf-8")
    with running(tmp_path, *parameters(machine=file, simulate="true")), Client() as client:
        for service in ("init", "home"):
            answer = client.trigger(f"/arm/{service}")
            assert answer.success, answer.message
        slowly = JointTrajectoryPoint(positions=[0.5] * 6, time_from_start=Duration(sec=10 * SECONDS))
        client.publish(JointTrajectory, "/arm/joint_trajectory", JointTrajectory(joint_names=JOINTS, points=[slowly]))
        client.listen_to_state("arm")
        client.until(lambda: [each.data for each in client.heard["/arm/state"]][-1:] == ["moving"], "it moves")
        record = Record(client)
        client.until(lambda: record.states and record.counts, "joint states and diagnostics")
        begin = record.states[0].stamp
        client.until(lambda: record.states[-1].stamp > begin + SECONDS * SECOND, "a minute of them", 5.0 * SECONDS)
        seen = len(record.counts)
        client.until(lambda: len(record.counts) > seen, "one more count")
        last = record.counts[-1].published
        client.until(lambda: record.states[-1].published > last, "one more joint state")
    with capsys.disabled():
        print(f"\n{told(record)}")
    check(record)


def check(record: Record) -> None:
    """Assert order and number."""
    for before, behind in pairwise(record.states):
        assert behind.number > before.number
        assert behind.stamp >= before.stamp  # the oldest joint's: two SYNCs without an answer between have one
    counts = [each for each in record.counts if each.published >= record.states[0].published]
    assert {each.state for each in counts} == {"moving"}  # the node counts SYNCs only while the chain follows
    # A count may be published before joint states that wait for the publisher: for a moment it is ahead. A loss would stay
    ahead = [each.cycles - record.numbers_at(each)[1] for each in counts]
    lost = statistics.median(ahead[-TO_JUDGE:]) - statistics.median(ahead[:TO_JUDGE])
    assert abs(lost) <= 1, f"{lost} SYNCs without a joint state, or joint states without a SYNC"
    # Each period has a joint state, or was skipped and counted. The age of a stamp is less than the largest interval
    begin, end = record.state_at(counts[0]), record.state_at(counts[-1])
    periods = end.number - begin.number + counts[-1].skipped - counts[0].skipped
    largest = max(behind.stamp - before.stamp for before, behind in pairwise(record.states))
    assert abs(end.stamp - begin.stamp - periods * PERIOD) <= largest + 2 * PERIOD


def told(record: Record) -> str:
    """The jitter in words."""
    states, counts = record.states, record.counts
    of_stamps = [(behind.stamp - before.stamp) / 1e6 for before, behind in pairwise(states)]
    of_publishing = [(behind.published - before.published) / 1e6 for before, behind in pairwise(states)]
    lost = states[-1].number - states[0].number + 1 - len(states)
    text = f"{len(states)} joint states in {(states[-1].stamp - states[0].stamp) / SECOND:.2f} s, {lost} lost by DDS; "
    text += f"{counts[-1].cycles - counts[0].cycles} SYNCs, {counts[-1].skipped - counts[0].skipped} skipped"
    for name, intervals in (("stamps", of_stamps), ("publishing", of_publishing)):
        mean, sd = statistics.mean(intervals), statistics.stdev(intervals)
        text += f"\n{name}: interval {mean:.3f} ms, sd {sd:.3f}, max {max(intervals):.3f}"
    return text
