"""Configurations of ros_canopen and ros2_canopen become machine files: what is taken over, and what is told of the rest."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data import DataError
from canopen_data.descriptions import load_description
from canopen_data.findings import DictionaryError
from canopen_master.machine_file import (
    MachineFile,
    parse_machine,
    read_machine,
)
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.ros_configurations import Choices, Imported, KeyOutcome, import_configuration
from canopen_master.ros_configurations.yaml_text import Value, read_yaml
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, SECOND
from tests import vendor_files
from tests.examples import examples
from tests.ros_configurations import FOLDER, SETS, needs_configurations

ROS1 = """
bus:
  device: can1
  driver_plugin: can::SocketCANInterface
sync:
  interval_ms: 20
  overflow: 0
heartbeat:
  rate: 10
  msg: "77e#05"
name: arm
defaults:
  eds_pkg: my_robot
  eds_file: drive.eds
  switching_state: 4
  pos_to_device: "rint(rad2deg(pos)*100)"
  pos_from_device: "deg2rad(obj6064)/100"
  dcf_overlay:
    "6081": "500"
    60C2sub1: "20"
nodes:
  shoulder:
    id: 3
    dcf_overlay: {"6081": "0x3E8", "1017": "100"}
  node2:
    name: elbow
    id: 4
    pos_to_device: "-pos*1000"
    pos_from_device: "-obj6064/1000"
    homing_timeout_seconds: 30
    publish: ["6064"]
"""

ROS2 = """
options: {dcf_path: "@BUS_CONFIG_PATH@"}
master: {node_id: 5, driver: "ros2_canopen::MasterDriver", sync_period: 4000, baudrate: 500, heartbeat_producer: 200}
defaults:
  dcf: drive.eds
  driver: "ros2_canopen::Cia402Driver"
  position_mode: 8
  scale_pos_to_dev: 2000.0
  scale_pos_from_dev: 0.0005
  sdo:
    - {index: 0x6081, sub_index: 0, value: 700}
    - {index: 0x60C2, sub_index: 1, value: 4}
  tpdo:
    1: {enabled: true, cob_id: auto, transmission: 1, mapping: [{index: 0x6041}, {index: 0x6064, sub_index: 0}]}
    2: {enabled: false}
nodes:
  lift: {node_id: 2, heartbeat_producer: 500, switching_state: 2, homing_method: 35}
  lamp: {node_id: 9, driver: "ros2_canopen::ProxyDriver", polling: true}
joint_limits:
  lift: {has_velocity_limits: true, max_velocity: 1.5, has_position_limits: true, min_position: -2, max_position: 2.5,
         has_acceleration_limits: false, max_acceleration: 3}
"""

Import = Callable[..., Imported]


@pytest.fixture
def imported(tmp_path: Path) -> Import:
    """Import a text, in a folder that has drive.eds, and write what is made there."""
    with resources.as_file(resources.files("canopen_data") / "samples" / "sample_drive.eds") as sample:
        shutil.copy(sample, tmp_path / "drive.eds")

    def run(*texts: str, choices: Choices | None = None) -> Imported:
        paths = [tmp_path / f"{number}.yaml" for number, _ in enumerate(texts)]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        made = import_configuration(paths, tmp_path, choices)
        (tmp_path / "cell.toml").write_text(made.text)
        for name, content in made.files.items():
            (tmp_path / name).write_bytes(content)
        return made

    return run


def machine_of(tmp_path: Path) -> MachineFile:
    machine = read_machine(tmp_path / "cell.toml")
    dictionaries = Dictionaries(machine)
    for node in machine.nodes.values():
        dictionaries.of(node)
    return machine


def told(made: Imported, key: str) -> list[tuple[KeyOutcome, str]]:
    return [(each.outcome, each.text) for each in made.report if each.key == key]


def leaves(value: Value) -> list[Value]:
    below = [leaf for each in (*value.entries.values(), *value.items) for leaf in leaves(each)]
    return below if value.kind in ("map", "list") else [value]


def assert_every_key_is_told(made: Imported, *paths: Path) -> None:
    keys = {(each.source, each.key) for each in made.report}
    for path in paths:
        for leaf in leaves(read_yaml(path.read_bytes(), str(path))):
            parts = leaf.place.replace("[", ".[").split(".")
            above = {".".join(parts[:length]).replace(".[", "[") for length in range(1, len(parts) + 1)}
            assert any((str(path), each) in keys for each in above), leaf.place


def test_ros_canopen(imported: Import, tmp_path: Path) -> None:
    made = imported(ROS1)
    assert (made.kind, made.is_complete) == ("ros_canopen", False)  # `publish` is left out
    assert_every_key_is_told(made, tmp_path / "0.yaml")
    machine = machine_of(tmp_path)
    assert machine.master.cycle == 20 * MILLISECOND
    assert machine.master.watchdog is not None
    assert (machine.master.watchdog.node_id, machine.master.watchdog.period) == (0x7E, 100 * MILLISECOND)
    assert [each.locator for each in machine.buses.values()] == ["can1"]
    assert {name: each.node_id for name, each in machine.nodes.items()} == {"shoulder": 3, "elbow": 4}
    assert machine.chains["arm"].joints == ("shoulder", "elbow")
    shoulder, elbow = (machine.joints[name].settings for name in ("shoulder", "elbow"))
    assert shoulder.unit is Unit.RADIAN
    assert shoulder.counts_per_unit == pytest.approx(5729.577951308232)
    assert "counts_per_turn = 36000\n" in made.text
    assert (elbow.counts_per_unit, elbow.direction, elbow.homing_timeout) == (1000, -1, 30 * SECOND)
    assert shoulder.mode_change_state is State.SWITCHED_ON
    for name, value in (("shoulder", 1000), ("elbow", 500)):  # its own value goes before the default
        dictionary = load_description(tmp_path / f"{name}.dcf").dictionary
        assert dictionary.variable("6081").configured == value
    assert load_description(tmp_path / "shoulder.dcf").dictionary.variable("1017").configured == 100
    assert told(made, "defaults.dcf_overlay.60C2sub1") == [(KeyOutcome.NOT_NEEDED, "a chain sets 0x60C2 by its cycle")]
    assert [each.key for each in made.report if each.outcome is KeyOutcome.LEFT_OUT] == [
        "nodes.node2.publish",
        "joint_limits.shoulder",
        "joint_limits.elbow",
    ]


def test_ros2_canopen(imported: Import, tmp_path: Path) -> None:
    made = imported(ROS2)
    assert (made.kind, made.is_complete) == ("ros2_canopen", True)
    assert_every_key_is_told(made, tmp_path / "0.yaml")
    machine = machine_of(tmp_path)
    assert machine.master.cycle == 4 * MILLISECOND
    assert machine.master.heartbeat_timeout == 1500 * MILLISECOND
    assert machine.master.watchdog is not None
    assert (machine.master.watchdog.node_id, machine.master.watchdog.timeout) == (5, 1000 * MILLISECOND)
    assert [(each.locator, each.bitrate) for each in machine.buses.values()] == [("can0", 500_000)]
    assert {name: each.node_id for name, each in machine.nodes.items()} == {"lift": 2, "lamp": 9}
    assert machine.chains["chain1"].joints == ("lift",)
    assert machine.chains["chain1"].settings.mode is Mode.CYCLIC_SYNCHRONOUS_POSITION
    lift = machine.joints["lift"].settings
    assert (lift.counts_per_unit, lift.unit, lift.homing_method) == (2000, Unit.RADIAN, 35)
    assert (lift.min_position, lift.max_position, lift.max_speed, lift.max_acceleration) == (-2, 2.5, 1.5, None)
    assert lift.mode_change_state is State.SWITCH_ON_DISABLED
    dictionary = load_description(tmp_path / "lift.dcf").dictionary
    assert [dictionary.variable(key).configured for key in ("6081", "1800:01", "1800:02", "1A00:00", "1A00:01", "1A00:02")] == [
        700, 0x182, 1, 2, 0x60410010, 0x60640020,
    ]  # fmt: skip
    assert dictionary.variable("1801:01").configured == 0x80000282


def test_several_files_are_one_configuration(imported: Import, tmp_path: Path) -> None:
    bus, _, nodes = ROS1.partition("name: arm")
    assert imported(bus, f"name: arm{nodes}").text == imported(ROS1).text
    with pytest.raises(DictionaryError, match=r"1\.yaml:1:1: error: name: it is in .*0\.yaml, line 11, too"):
        imported(ROS1, "name: leg")
    alone = imported(bus)
    assert (alone.kind, "[nodes" in alone.text, "[chains" in alone.text) == ("ros_canopen", False, False)


def test_a_device_without_a_controlword_is_no_joint(imported: Import, tmp_path: Path) -> None:
    with resources.as_file(resources.files("canopen_data") / "samples" / "sample_io.eds") as sample:
        shutil.copy(sample, tmp_path / "io.eds")
    made = imported("defaults: {pos_to_device: pos*5, switching_state: 4}\nnodes: {lamp: {id: 9, eds_file: io.eds}}")
    assert made.is_complete
    assert_every_key_is_told(made, tmp_path / "0.yaml")
    machine = machine_of(tmp_path)
    assert (list(machine.nodes), list(machine.joints), list(machine.chains)) == (["lamp"], [], [])


def test_nodes_as_a_list_and_at_the_top(imported: Import) -> None:
    listed = imported("nodes:\n  - {name: j1, id: 3}\n  - {name: j2, id: 4}\n")
    assert list(parse_machine(listed.text).joints) == ["j1", "j2"]
    old = imported('master: {node_id: 1}\ndrive:\n  node_id: 2\n  driver: "ros2_canopen::Cia402Driver"\n')
    assert list(parse_machine(old.text).joints) == ["drive"]
    documented = imported('master: {node_id: 1}\nnodes:\n  - drive: {node_id: 2, driver: "ros2_canopen::Cia402Driver"}\n')
    assert documented.text == old.text


def test_the_defaults_of_both_are_told(imported: Import) -> None:
    first = imported("nodes: {j1: {id: 3}}")
    assert "counts_per_turn = 360000\n" in first.text
    assert told(first, "pos_to_device, pos_from_device")[0][1].endswith("ros_canopen's default, millidegrees")
    second = imported('master: {node_id: 1}\nnodes: {j1: {node_id: 3, driver: "ros2_canopen::Cia402Driver"}}')
    assert "counts_per_unit = 1000\n" in second.text
    assert "ros2_canopen's default" in told(second, "scale_pos_to_dev, scale_pos_from_dev")[0][1]


MULTI = """
master: {node_id: 1}
nodes:
  device:
    node_id: 2
    driver: "ros2_canopen::Cia402Driver"
    num_channels: 3
    channel_names: [left, right]
    scale_pos_to_dev: 100
    scale_pos_from_dev: 0.01
    channels:
      - {offset_pos_to_dev: 10, offset_pos_from_dev: -0.1}
      - {offset_pos_to_dev: 10, offset_pos_from_dev: 5.0, scale_vel_to_dev: 50, scale_vel_from_dev: 0.02}
"""


def test_channels_are_axes_and_contradictions_give_no_scale(imported: Import, tmp_path: Path) -> None:
    made = imported(MULTI)
    assert_every_key_is_told(made, tmp_path / "0.yaml")
    machine = parse_machine(made.text)
    assert [(name, each.node, each.axis) for name, each in machine.joints.items()] == [
        ("left", "device", 0),
        ("right", "device", 1),
        ("device/2", "device", 2),
    ]
    assert (machine.joints["left"].settings.counts_per_unit, machine.joints["left"].settings.offset) == (100, 10)
    assert machine.joints["right"].settings.counts_per_unit is None
    outcome, text = told(made, "nodes.device.channels[1].offset_pos_from_dev")[0]
    assert (outcome, text) == (KeyOutcome.LEFT_OUT, "the offsets 10 and 5 do not belong together")
    assert told(made, "nodes.device.dcf")[0][0] is KeyOutcome.LEFT_OUT


def test_a_slide(imported: Import) -> None:
    made = imported(ROS2, choices=Choices("pcan:PCAN_USBBUS1@500k", "lifts", {}, frozenset({"lift"})))
    machine = parse_machine(made.text)
    lift = machine.joints["lift"].settings
    assert (lift.unit, lift.counts_per_unit, lift.max_position, lift.max_speed) == (Unit.MILLIMETRE, 2, 2500, 1500)
    assert list(machine.chains) == ["lifts"]
    assert machine.buses["can0"].locator == "pcan:PCAN_USBBUS1@500k"


@pytest.mark.parametrize(
    ("text", "key", "said"),
    [
        ("sync: {interval_ms: 0}\nnodes: {a: {id: 3}}", "sync.interval_ms", "a chain needs SYNC"),
        ("sync: {overflow: 10}\nnodes: {a: {id: 3}}", "sync.overflow", "without a counter"),
        ("bus: {driver_plugin: my::Driver}\nnodes: {a: {id: 3}}", "bus.driver_plugin", "this driver is not known"),
        ("heartbeat: {rate: 3}\nnodes: {a: {id: 3}}", "heartbeat.rate", "a heartbeat comes each whole number of ms"),
        ("heartbeat: {msg: '123#05'}\nnodes: {a: {id: 3}}", "heartbeat.msg", "not the heartbeat of an operational node"),
        ("nodes: {a: {id: 3, switching_state: 8}}", "nodes.a.switching_state", "8 is the state 'fault'"),
        ("nodes: {a: {id: 3, eds_file: none.eds}}", "nodes.a.eds_file", "there is no file 'none.eds'"),
        ("nodes: {a: {id: 3, eds_pkg: p, eds_file: x.eds}}", "nodes.a.eds_file", "--package p=FOLDER"),
        ("nodes: {a: {id: 3, pos_to_device: 'norm(pos,-1,1)'}}", "nodes.a.pos_to_device", "only a plain factor"),
        ("nodes: {a: {id: 3, pos_from_device: obj2030}}", "nodes.a.pos_from_device", "it reads obj2030, not obj6064"),
        ("nodes: {a: {id: 3, pos_to_device: pos*5}}", "nodes.a.pos_to_device", "not the inverse"),
        ("nodes: {a: {id: 3, vel_to_device: vel*250}}", "nodes.a.vel_to_device", "0x6042 (vl) has another"),
        ("nodes: {a: {id: 3, dcf_overlay: {'6081': '5'}}}", "nodes.a.dcf_overlay.6081", "no DCF can hold it"),
        ("nodes: {a: {id: 3, eds_file: drive.eds, dcf_overlay: {'2FFF': '5'}}}", "nodes.a.dcf_overlay.2FFF", "no object 0x2FFF"),
        ("nodes: {a: {id: 3, eds_file: drive.eds, dcf_overlay: {'6041': '5'}}}", "nodes.a.dcf_overlay.6041", "0x6041:00 is ro"),
        ("nodes: {a: {id: 3, eds_file: drive.eds, dcf_overlay: {'6081': 'x'}}}", "nodes.a.dcf_overlay.6081", "is no value of"),
        ("nodes: {a: {id: 3, eds_file: drive.eds, dcf_overlay: {'1017': '70000'}}}", "nodes.a.dcf_overlay.1017", ""),
        ("nodes: {a: {id: 3, whatever: 5}}", "nodes.a.whatever", "this key is not known"),
        ("other: 1\nnodes: {a: {id: 3}}", "other", "this key is not known"),
        ("nodes: {a: {id: 3}}\njoint_limits: {b: {has_position_limits: true}}", "joint_limits.b", "this key is not known"),
        ("master: {sync_overflow: 10}\nnodes: {a: {node_id: 3}}", "master.sync_overflow", "without a counter"),
        ("master: {node_id: 255}\nnodes: {a: {node_id: 3}}", "master.node_id", "255 is no node-ID"),
        ("master: {}\nnodes: {a: {node_id: 3, software_file: none.bin}}", "nodes.a.software_file", "there is no file 'none.bin'"),
        ("master: {}\nnodes: {a: {node_id: 3, tpdo: {5: {enabled: true}}}}", "nodes.a.tpdo.5", "only the first four PDOs"),
        (
            "master: {}\nnodes: {a: {node_id: 3, driver: Cia402Driver, position_mode: 3}}", "nodes.a.position_mode",
            "3 is no mode in which a chain moves",
        ),
    ],
)  # fmt: skip
def test_what_is_left_out_has_its_reason(imported: Import, text: str, key: str, said: str) -> None:
    outcome, reason = told(made := imported(text), key)[0]
    assert outcome is KeyOutcome.LEFT_OUT
    assert said in reason
    assert not made.is_complete


@pytest.mark.parametrize(
    ("text", "key", "said"),
    [
        ("nodes: {a: {}}\nbus: {}", "nodes.a", "it has no id"),
        ("nodes: {a: {id: 0}}", "nodes.a.id", "a whole number of 1..127 is expected, not 0"),
        ("nodes: {a: {id: 3}, b: {id: 3}}", "nodes.b", "node-ID 3 is that of a already"),
        ("nodes: {a: {id: 3}, b: {id: 4, name: a}}", "nodes.b", "there are two nodes 'a'"),
        ("nodes: [{id: 3}]", "nodes[0]", "it has no name"),
        ("nodes: {a: {id: 3}}\nsync: {interval_ms: 2.5}", "sync.interval_ms", "a whole number"),
        ("nodes: {a: {id: 3}}\nsync: 5", "sync", "a map is expected, not 5"),
        ("nodes: {a: {id: 3, dcf_overlay: {speed: '1'}}}", "nodes.a.dcf_overlay.speed", "an object is an index"),
        ("nodes: {a: {id: 3, dcf_overlay: ['1']}}", "nodes.a.dcf_overlay", "a map is expected"),
        ("nodes: {a: {id: 3, eds_file: \"x\\0y\"}}", "nodes.a.eds_file", "no file name has a zero byte"),
        (f"nodes: {{a: {{id: 3, eds_file: {'x' * 300}}}}}", "nodes.a.eds_file", "the file cannot be looked for"),
        ("nodes: {a: {id: 3}}\nbus: {device: 'zork:1'}", "bus.device", "there is no interface 'zork'"),
        ("nodes: {a: {id: 3, homing_timeout_seconds: 2020-01-01}}", "nodes.a.homing_timeout_seconds", "a value with the tag"),
        ("nodes: {' ': {id: 3}}", "nodes. ", "the name is empty"),
        ("nodes: {a: {id: 3}}\nheartbeat: {rate: often}", "heartbeat.rate", "a number is expected, not often"),
        ("master: {}\nnodes: {a: {driver: x}}", "nodes.a", "it has no node_id"),
        ("master: {}\nnodes: {a: {node_id: 2, sdo: [{index: 0x6081}]}}", "nodes.a.sdo[0]", "an entry has index"),
        ("master: {}\nnodes: {a: {node_id: 2, sdo: {index: 1}}}", "nodes.a.sdo", "a list is expected"),
        ("master: {}\nnodes: {a: {node_id: 2, tpdo: {x: {}}}}", "nodes.a.tpdo.x", "a PDO has a number of 1..512"),
        ("master: {}\nnodes: {a: {node_id: 2, tpdo: {1: {mapping: [{}]}}}}", "nodes.a.tpdo.1.mapping[0]", "an entry has index"),
        ("master: {}\nnodes: {a: {node_id: 2, driver: 402, num_channels: 9}}", "nodes.a.num_channels", "a whole number of 1..8"),
        (
            "nodes: {a: {id: 3}}\njoint_limits: {a: {has_velocity_limits: true, max_velocity: 1e999}}",
            "joint_limits.a.max_velocity", "too large",
        ),
        (
            "nodes: {a: {id: 3}}\njoint_limits: {a: {has_position_limits: true, min_position: 2, max_position: 1}}",
            "joint_limits.a", "min_position 2 is not below max_position 1",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_named_and_ends_nothing(imported: Import, text: str, key: str, said: str) -> None:
    other = "{id: 99}" if "id: " in text and "node_id" not in text and "driver" not in text else "{node_id: 99}"
    if text == "nodes: {a: {}}\nbus: {}":
        other = "{id: 99}"
    with_other = text.replace("nodes: [", "nodes: [{name: other, id: 99}, ").replace("nodes: {", f"nodes: {{other: {other}, ")
    key = key.replace("nodes[0]", "nodes[1]")
    made = imported(with_other)
    assert [reason for outcome, reason in told(made, key) if outcome is KeyOutcome.LEFT_OUT and said in reason], made.report
    assert parse_machine(made.text).nodes["other"].node_id == 99


def test_what_is_no_configuration_is_an_error(imported: Import) -> None:
    with pytest.raises(DictionaryError, match="this is no configuration of ros_canopen"):
        imported("other: 1")


def test_more_than_a_hundred_values_that_cannot_be_used_are_another_kind_of_file(imported: Import) -> None:
    with pytest.raises(DictionaryError, match="it has no id"):
        imported("bus: {}\nnodes: {" + ", ".join(f"n{number}: {{}}" for number in range(102)) + "}")


def test_no_default_stands_in_for_a_part_of_a_scale_that_cannot_be_used(imported: Import) -> None:
    """ros2_canopen's own 1000 counts for a rad would otherwise move the joint by a scale that nobody gave."""
    for keys in ("scale_pos_to_dev: x", "scale_pos_to_dev: x, scale_pos_from_dev: 0.001", "channels: [{offset_pos_to_dev: x}]"):
        made = imported(f"master: {{}}\nnodes: {{a: {{node_id: 2, driver: Cia402Driver, {keys}}}}}")
        assert parse_machine(made.text).joints["a"].settings.counts_per_unit is None
    for text in ("nodes: {a: {id: 2, pos_to_device: []}}", "defaults: 7\nnodes: {a: {id: 2}}"):
        assert parse_machine(imported(text).text).joints["a"].settings.counts_per_unit is None


def test_a_pdo_is_taken_whole_or_not_at_all(imported: Import, tmp_path: Path) -> None:
    made = imported(ROS2.replace("{index: 0x6041}", "{index: never}"))
    dictionary = load_description(tmp_path / "lift.dcf").dictionary
    assert [dictionary.variable(key).configured for key in ("1800:01", "1A00:00", "1801:01")] == [None, None, 0x80000282]
    assert "without it the PDO would be another one" in told(made, "defaults.tpdo.1")[0][1]


def test_a_pdo_gets_the_keys_of_its_direction(imported: Import, tmp_path: Path) -> None:
    """dcfgen writes event_deadline to RPDOs only, and inhibit_time, event_timer and sync_start to TPDOs only."""
    rpdo = "{cob_id: 0x40000205, transmission: 255, inhibit_time: 10, event_timer: 20, event_deadline: 30, sync_start: 4}"
    tpdo = "{transmission: 255, inhibit_time: 10, event_timer: 20, event_deadline: 30}"
    made = imported(f"master: {{}}\nnodes: {{a: {{node_id: 2, dcf: drive.eds, rpdo: {{1: {rpdo}}}, tpdo: {{1: {tpdo}}}}}}}")
    dictionary = load_description(tmp_path / "a.dcf").dictionary
    configured = {key: dictionary.variable(key).configured for key in ("1400:01", "1400:05", "1800:03", "1800:05")}
    assert configured == {"1400:01": 0x40000205, "1400:05": 30, "1800:03": 10, "1800:05": 20}
    for key in ("rpdo.1.inhibit_time", "rpdo.1.event_timer", "rpdo.1.sync_start", "tpdo.1.event_deadline"):
        assert told(made, f"nodes.a.{key}") == [(KeyOutcome.LEFT_OUT, f"dcfgen writes it to no {key[:4].upper()}")]


def test_a_brake_test_is_told_as_what_it_is(imported: Import) -> None:
    made = imported("nodes: {a: {id: 3, braketest_required: true}, b: {id: 4, braketest_required: false}}")
    assert told(made, "nodes.a.braketest_required")[0][0] is KeyOutcome.LEFT_OUT
    assert "Nothing here does; the test is still due" in told(made, "nodes.a.braketest_required")[0][1]
    assert told(made, "nodes.b.braketest_required")[0][0] is KeyOutcome.NOT_NEEDED


def test_a_name_is_made_one(imported: Import) -> None:
    made = imported("nodes: {'1 arm': {id: 3}}")
    assert list(parse_machine(made.text).joints) == ["n1_arm"]
    assert told(made, "nodes.1 arm")[0][1].startswith("the name 'n1_arm'")


def test_a_file_in_its_package(imported: Import, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "workspace" / "my_robot"
    package.mkdir(parents=True)
    (tmp_path / "drive.eds").rename(package / "own.eds")
    text = "nodes: {a: {id: 3, eds_pkg: my_robot, eds_file: own.eds}}"
    assert not imported(text).is_complete
    named = imported(text, choices=Choices(packages={"my_robot": package}))
    assert 'file = "workspace/my_robot/own.eds"' in named.text
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(package.parent))
    assert imported(text).text == named.text
    machine_of(tmp_path)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="there is no file"):
        import_configuration([tmp_path / "none.yaml"], tmp_path)


# ---- configurations of others ----


@needs_configurations
@pytest.mark.parametrize("names", [*SETS, *[(name,) for names in SETS for name in names if len(names) > 1]])
def test_configurations_of_others_are_read_and_every_key_is_told(names: tuple[str, ...], tmp_path: Path) -> None:
    paths = [FOLDER / name for name in names]
    made = import_configuration(paths, tmp_path)
    assert_every_key_is_told(made, *paths)
    assert parse_machine(made.text).buses
    assert all(each.text for each in made.report)


@needs_configurations
def test_the_page_has_the_figures(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "ros-migration.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| .* \| (\d+) \| (\d+) \| (\d+) \| .* \|$", page, re.MULTILINE)
    made = [import_configuration([FOLDER / name for name in names], tmp_path) for names in SETS]
    counts = [[sum(each.outcome is outcome for each in one.report) for outcome in KeyOutcome] for one in made]
    assert [list(map(int, row)) for row in rows] == counts


@needs_configurations
@vendor_files.needs_vendor_files
def test_with_the_devices_files_nearly_all_is_taken_over(tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    shutil.copy(vendor_files.path_of("schunk-powerball-lwa4p.dcf"), tmp_path / "config" / "Schunk_0_63.dcf")
    shutil.copy(vendor_files.path_of("ros2-cia402-slave.eds"), tmp_path / "cia402_slave.eds")
    for name in (*SETS[0], *SETS[3]):
        shutil.copy(FOLDER / name, tmp_path / name)
    arm = import_configuration([tmp_path / name for name in SETS[0]], tmp_path)
    left_out = [each.key for each in arm.report if each.outcome is KeyOutcome.LEFT_OUT]
    assert [key for key in left_out if not key.startswith("joint_limits.")] == ["defaults.vel_to_device"]
    assert sorted(arm.files) == [f"arm_{number}_joint.dcf" for number in range(1, 7)]
    system = import_configuration([tmp_path / name for name in SETS[3]], tmp_path)
    left_out = [each.key for each in system.report if each.outcome is KeyOutcome.LEFT_OUT]
    assert all(key.startswith("joint_limits.") for key in left_out), left_out


# ---- whatever is in the file ----

_JUNK = (
    '"junk"', "-7", "2.5", "[1, x]", "{a: 1}", "!x y", "!y [1]", "2020-01-01", "null", '""', "1.0e+400", "true", "123456789012",
)  # fmt: skip


def texts_with(value: Value, place: str, junk: str) -> str:
    """The text of a file, with junk in one place."""
    if value.place == place and place:
        return junk
    if value.kind == "map":
        return "{" + ", ".join(f"{json.dumps(key)}: {texts_with(each, place, junk)}" for key, each in value.entries.items()) + "}"
    if value.kind == "list":
        return "[" + ", ".join(texts_with(each, place, junk) for each in value.items) + "]"
    return json.dumps(value.text) if value.kind == "str" else value.text or "null"


def places_of(value: Value) -> list[str]:
    return [value.place, *(place for each in (*value.entries.values(), *value.items) for place in places_of(each))]


def assert_the_rest_is_imported(whole: Value, place: str, junk: str, folder: Path) -> None:
    path = folder / "any.yaml"
    path.write_text(texts_with(whole, "", ""))
    wanted = parse_machine(import_configuration([path], folder).text)
    path.write_text(texts_with(whole, place, junk))
    made = import_configuration([path], folder)
    assert_every_key_is_told(made, path)
    left = {name: each.node_id for name, each in parse_machine(made.text).nodes.items()}
    for name, node in wanted.nodes.items():
        named = {each.entries["name"].text: key for key, each in whole.entries["nodes"].entries.items() if "name" in each.entries}
        key = f"nodes.{named.get(name, name)}"
        if place != "nodes" and not f"{place}.".startswith(f"{key}."):
            assert left[name] == node.node_id, (place, junk, name)


@pytest.mark.parametrize("text", [ROS1, ROS2, MULTI])
@given(data=st.data())
@examples(25)
def test_any_one_value_may_be_junk_and_the_rest_is_imported(text: str, data: st.DataObject) -> None:
    whole = read_yaml(text.encode(), "any")
    place = data.draw(st.sampled_from(sorted(set(places_of(whole)) - {""})))
    with tempfile.TemporaryDirectory() as folder:
        assert_the_rest_is_imported(whole, place, data.draw(st.sampled_from(_JUNK)), Path(folder))


@needs_configurations
@pytest.mark.parametrize("names", SETS)
@given(data=st.data())
@examples(15)
def test_any_one_value_of_others_may_be_junk_and_the_rest_is_imported(names: tuple[str, ...], data: st.DataObject) -> None:
    wholes = [read_yaml((FOLDER / name).read_bytes(), name) for name in names]
    whole = Value("map", "", "", "any", 0, {key: each for one in wholes for key, each in one.entries.items()})
    place = data.draw(st.sampled_from(sorted(set(places_of(whole)) - {""})))
    with tempfile.TemporaryDirectory() as folder:
        assert_the_rest_is_imported(whole, place, data.draw(st.sampled_from(_JUNK)), Path(folder))


_SCALARS = st.one_of(
    st.integers(),
    st.integers(-3, 300),
    st.floats(),
    st.booleans(),
    st.none(),
    st.text(max_size=4),
    st.sampled_from(["drive.eds", "pos*1000", "obj6064/1000", "77f#05", "auto", "0x7F0064", "1e999", "\0", "..", "/"]),
)
_KEYS = st.sampled_from([
    "id", "node_id", "name", "eds_file", "eds_pkg", "dcf", "dcf_path", "driver", "index", "sub_index", "value", "enabled",
    "cob_id", "mapping", "6081", "60C2sub1", "1", "2", "device", "interval_ms", "rate", "msg", "drive", "has_position_limits",
    "min_position", "max_position", "sync_period", "baudrate", "heartbeat_producer", "offset_pos_to_dev", "scale_pos_to_dev",
])  # fmt: skip
_ANYTHING = st.recursive(
    _SCALARS, lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(_KEYS, inner, max_size=4)), max_leaves=12
)
_OF_NODES = (
    "name", "eds_file", "dcf", "dcf_overlay", "pos_to_device", "pos_from_device", "vel_to_device", "switching_state", "sdo",
    "tpdo", "rpdo", "num_channels", "channel_names", "channels", "position_mode", "heartbeat_producer", "heartbeat_multiplier",
    "scale_pos_to_dev", "scale_pos_from_dev", "scale_vel_to_dev", "homing_method", "homing_timeout_seconds", "publish",
    "mandatory", "boot", "reset_communication", "revision_number", "software_version", "software_file", "guard_time",
    "life_time_factor", "retry_factor", "error_behavior", "restore_configuration",
)  # fmt: skip
_OF_FILES = ("bus", "sync", "heartbeat", "name", "defaults", "joint_limits", "options", "master", "other")


@given(
    ident=st.sampled_from([{"id": 3}, {"node_id": 3, "driver": "Cia402Driver"}]),
    node=st.dictionaries(st.sampled_from(_OF_NODES), _ANYTHING, max_size=5),
    file=st.dictionaries(st.sampled_from(_OF_FILES), _ANYTHING, max_size=3),
)
@examples(40)
def test_any_values_give_a_machine_or_a_clear_error(ident: dict[str, Any], node: dict[str, Any], file: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "any.yaml"
        path.write_text(json.dumps({**file, "nodes": {"drive": {**node, **ident}}}))
        try:
            made = import_configuration([path], Path(folder))
        except DictionaryError as error:
            assert error.findings
        else:
            assert_every_key_is_told(made, path)
