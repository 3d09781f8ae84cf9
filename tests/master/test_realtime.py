"""Real time: what the operating system allows, is asked for, gives and gets back. It is stood in for: nothing here needs root."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import pytest

from canopen_data.findings import DictionaryError
from canopen_master import RealtimeRefusedError, open_master
from canopen_master.machine_file import machine_text, parse_machine
from canopen_proto.machine import LocalProtocolError
from canopen_transports import realtime
from canopen_transports.doctor import Health
from canopen_transports.realtime import UNLIMITED, Grant, Realtime, System
from canopen_transports.realtime_checks import check_realtime
from tests.master.world import BUS, simulated, virtual_time

pytestmark = pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="Linux only")


class Computer(System):
    """A stand-in. is_allowed: whether limits allow all. calls: what was changed."""

    def __init__(self, *, is_allowed: bool = True, is_linux: bool = True) -> None:
        self.is_allowed = is_allowed
        self._linux = is_linux
        self.calls: list[str] = []
        self.policy = os.SCHED_OTHER, 0
        self.slack = 50_000

    @property
    def is_linux(self) -> bool:
        return self._linux

    def scheduler(self) -> tuple[int, int]:
        return self.policy

    def set_scheduler(self, policy: int, priority: int) -> None:
        if not self.is_allowed and policy != os.SCHED_OTHER:
            raise PermissionError(1, "Operation not permitted")
        self.policy = policy, priority
        self.calls.append(f"scheduler {policy} {priority}")

    def limit(self, name: str) -> int:
        return UNLIMITED if self.is_allowed else {"RLIMIT_RTPRIO": 0, "RLIMIT_MEMLOCK": 8 << 20}[name]

    def is_root(self) -> bool:
        return False

    def lock_memory(self) -> None:
        self.calls.append("lock")

    def unlock_memory(self) -> None:
        self.calls.append("unlock")

    def timer_slack(self) -> int:
        return self.slack

    def set_timer_slack(self, slack: int) -> None:
        self.slack = slack
        self.calls.append(f"slack {slack}")

    def cores(self) -> int:
        return 2


FIFO, OTHER = getattr(os, "SCHED_FIFO", 1), getattr(os, "SCHED_OTHER", 0)


def test_all_is_given_and_given_back_in_reverse() -> None:
    computer = Computer()
    grant = Grant(Realtime(), computer)
    assert grant.refused == []
    assert [each.name for each in grant.measures] == ["memory locked", "timer slack 1000 ns", "SCHED_FIFO 50"]
    assert grant.end() == []
    assert grant.end() == []
    given = ["lock", "slack 1000", f"scheduler {FIFO} 50"]
    assert computer.calls == [*given, f"scheduler {OTHER} 0", "slack 50000", "unlock"]


def test_what_is_refused_is_said_and_the_rest_is_given() -> None:
    """Memory is not locked within a limit: an allocation would fail later, in the middle of a motion."""
    computer = Computer(is_allowed=False)
    grant = Grant(Realtime(), computer)
    refused = {each.name: (each.refusal, each.remedy) for each in grant.refused}
    assert set(refused) == {"memory locked", "SCHED_FIFO 50"}
    assert "8192 KiB" in refused["memory locked"][0]
    assert "memlock unlimited" in refused["memory locked"][1]
    assert "not permitted" in refused["SCHED_FIFO 50"][0]
    assert "rtprio 50" in refused["SCHED_FIFO 50"][1]
    grant.end()
    assert computer.calls == ["slack 1000", "slack 50000"]


def test_what_is_not_wanted_is_left_alone() -> None:
    computer = Computer()
    grant = Grant(Realtime(priority=0, lock_memory=False, timer_slack=0), computer)
    assert grant.measures == []
    grant.end()
    assert computer.calls == []


def test_another_operating_system_refuses_and_is_not_asked() -> None:
    (refused,) = Grant(Realtime(), Computer(is_linux=False)).refused
    assert refused.refusal == "this is not Linux"
    assert [each.health for each in check_realtime(system=Computer(is_linux=False))] == [Health.NOTE]


@pytest.mark.parametrize("wrong", [{"priority": 100}, {"priority": -1}, {"timer_slack": -1}])
def test_settings_out_of_range(wrong: dict[str, int]) -> None:
    with pytest.raises(LocalProtocolError, match="priority is 0..99"):
        Realtime(**wrong)  # type: ignore[arg-type]


def test_a_real_thread_gets_its_timer_slack_and_gives_it_back() -> None:
    """It needs no permission."""
    system = System()
    before = system.timer_slack()
    grant = Grant(Realtime(priority=0, lock_memory=False, timer_slack=2_000))
    assert (grant.refused, system.timer_slack()) == ([], 2_000)
    grant.end()
    assert system.timer_slack() == before


def findings(root: Path, computer: Computer) -> dict[str, tuple[Health, str, tuple[str, ...]]]:
    return {
        each.subject.removeprefix("real time: "): (each.health, each.seen, each.tries) for each in check_realtime(root, computer)
    }


def test_a_computer_that_is_ready(tmp_path: Path) -> None:
    for number in range(2):
        folder = tmp_path / f"sys/devices/system/cpu/cpu{number}/cpufreq"
        folder.mkdir(parents=True)
        (folder / "scaling_governor").write_text("performance\n")
    (tmp_path / "sys/kernel").mkdir()
    (tmp_path / "sys/kernel/realtime").write_text("1\n")
    computer = Computer()
    computer.slack = 1_000
    found = findings(tmp_path, computer)
    assert set(found) == {"scheduler", "memory", "timer slack", "CPU governor", "kernel", "processors"}
    assert {health for health, _, _ in found.values()} == {Health.OK}


def test_a_computer_that_is_not_ready_is_told_how_to_be(tmp_path: Path) -> None:
    folder = tmp_path / "sys/devices/system/cpu/cpu0/cpufreq"
    folder.mkdir(parents=True)
    (folder / "scaling_governor").write_text("powersave\n")
    found = findings(tmp_path, Computer(is_allowed=False))
    assert "rtprio 50" in found["scheduler"][2][0]
    assert "memlock unlimited" in found["memory"][2][0]
    assert found["timer slack"][1] == "50 us"
    assert "cpupower" in found["CPU governor"][2][0]
    assert "not PREEMPT_RT" in found["kernel"][1]
    assert Health.WARNING not in {health for health, _, _ in found.values()}  # nothing of it has to be mended


@pytest.fixture
def computer(monkeypatch: pytest.MonkeyPatch) -> Computer:
    computer = Computer()
    monkeypatch.setattr(realtime, "System", lambda: computer)
    return computer


def test_a_master_asks_says_and_gives_back(computer: Computer, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "canopen_master")

    @virtual_time
    async def run() -> None:
        async with simulated(3), open_master(BUS, realtime=True) as master:
            assert [each.name for each in master.realtime] == ["memory locked", "timer slack 1000 ns", "SCHED_FIFO 50"]
            assert computer.policy == (FIFO, 50)

    run()
    assert (computer.policy, computer.slack, computer.calls[-1]) == ((OTHER, 0), 50_000, "unlock")
    assert "real time: memory locked, timer slack 1000 ns, SCHED_FIFO 50" in caplog.text


def test_a_master_without_permission_warns_and_works(computer: Computer, caplog: pytest.LogCaptureFixture) -> None:
    computer.is_allowed = False

    @virtual_time
    async def run() -> None:
        async with simulated(3), open_master(BUS, realtime=Realtime()) as master:
            assert await master.node(3).read(0x1000)

    run()
    assert "real time: SCHED_FIFO 50 was not given (RLIMIT_RTPRIO" in caplog.text


def test_a_master_that_needs_it_is_not_opened_without(computer: Computer) -> None:
    """And gives back what it got."""
    computer.is_allowed = False

    @virtual_time
    async def run() -> None:
        async with simulated(3):
            with pytest.raises(RealtimeRefusedError, match="SCHED_FIFO 50"):
                async with open_master(BUS, realtime=Realtime(required=True)):
                    pass

    run()
    assert computer.slack == 50_000


def test_without_the_setting_nothing_is_asked_for(computer: Computer) -> None:
    @virtual_time
    async def run() -> None:
        async with simulated(3), open_master(BUS) as master:
            assert master.realtime == ()

    run()
    assert computer.calls == []


def test_a_machine_file_says_it(computer: Computer) -> None:
    text = '[buses.x]\nlocator = "virtual:test"\n[master]\nrealtime = { priority = 7, lock_memory = false }\n'
    machine = parse_machine(text)
    assert machine.master.realtime == Realtime(priority=7, lock_memory=False)
    assert parse_machine(machine_text(machine)).master.realtime == machine.master.realtime
    assert parse_machine(text.replace("{ priority = 7, lock_memory = false }", "{}")).master.realtime == Realtime()
    with pytest.raises(DictionaryError, match="priority is 0..99"):
        parse_machine(text.replace("7", "700"))

    @virtual_time
    async def run() -> None:
        async with simulated(3), open_master(machine=machine) as master:
            assert [each.name for each in master.realtime] == ["timer slack 1000 ns", "SCHED_FIFO 7"]

    run()
