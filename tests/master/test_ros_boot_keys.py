"""The boot-up in the YAML of dcfgen becomes `[network]` and `boot` of each node."""

from __future__ import annotations

import shutil
from importlib import resources
from pathlib import Path

from canopen_master.machine_file import BootSettings, LossReaction, NetworkSettings, StartOrder
from canopen_master.machine_file.boot_entries import network_of
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.ros_configurations import KeyOutcome
from canopen_proto.machine import MILLISECOND, SECOND
from tests.master.test_ros_configurations import Import, assert_every_key_is_told, imported, machine_of

__all__ = ["imported"]  # the fixture


DCFGEN = """
options: {dcf_path: "@MASTER_DCF_PATH@", heartbeat_multiplier: 2.5}
master: {node_id: 1, start_all_nodes: true, stop_all_nodes: true, boot_time: 5000, nmt_inhibit_time: 20}
.pattern: &pattern {dcf: io.eds, mandatory: true, heartbeat_producer: 200}
left:
  <<: *pattern
  node_id: 2
  serial_number: 0x4D
  software_version: 7
  software_file: new.bin
  error_behavior: {1: 2}
right:
  <<: *pattern
  node_id: 3
  mandatory: false
  heartbeat_producer: 0
  boot: false
  reset_communication: false
  revision_number: 0
  restore_configuration: 1
  guard_time: 100
  life_time_factor: 3
  retry_factor: 3
"""


def test_the_boot_up_of_dcfgen(imported: Import, tmp_path: Path) -> None:
    with resources.as_file(resources.files("canopen_data") / "samples" / "sample_io.eds") as sample:
        shutil.copy(sample, tmp_path / "io.eds")
    (tmp_path / "new.bin").write_bytes(b"program")
    made = imported(DCFGEN)
    assert_every_key_is_told(made, tmp_path / "0.yaml")
    machine = machine_of(tmp_path)
    assert machine.network == NetworkSettings(StartOrder.ALL, LossReaction.STOP_ALL, 5 * SECOND, 2 * MILLISECOND)
    left, right = machine.nodes["left"].boot, machine.nodes["right"].boot
    assert left == BootSettings(
        mandatory=True, revision=0x10000, serial=0x4D, heartbeat=200 * MILLISECOND, heartbeat_timeout=500 * MILLISECOND,
        configuration="left.dcf", software=7, program="new.bin",
    )  # fmt: skip
    assert right == BootSettings(
        start=False, keep_alive=True, revision=0, restore=1, guard_time=100 * MILLISECOND, configuration="right.dcf"
    )
    network = network_of(machine, "can0", Dictionaries(machine))
    assert (network.entry.nodes[2].assignment.value, network.entry.nodes[3].assignment.value) == (0x6D, 0x0064_0391)
    assert network.entry.nodes[2].identity == (0xFFFFFF01, 0x401, 0x10000, 0x4D)
    assert network.entry.startup.value == 0x43
    assert [each.key for each in made.report if each.outcome is KeyOutcome.LEFT_OUT] == [
        "left.error_behavior.1"
    ]  # io.eds has no 0x1029


def test_heartbeats_that_nobody_watches(imported: Import, tmp_path: Path) -> None:
    imported("master: {node_id: 1, heartbeat_consumer: false, start_nodes: false}\na: {node_id: 2, heartbeat_producer: 100}")
    machine = machine_of(tmp_path)
    assert machine.network.start is StartOrder.NONE
    assert machine.nodes["a"].boot == BootSettings(heartbeat=100 * MILLISECOND, heartbeat_timeout=0)
