"""Parameters of the node: all their forms, and all errors at once."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from canopen_ros.names import NO_FILE
from canopen_ros.parameters import PARAMETERS, NodeParameters, NoMachineError, ParameterError

ARM = "arm joint1 can0 3  joint2 can0 4"
TOML = """
[master]
cycle = "5ms"
[buses.left]
locator = "socketcan:can0"
[nodes]
elbow = { id = 3 }
[joints]
elbow = { unit = "degree" }
[chains.arm]
joints = ["elbow"]
"""


@pytest.mark.parametrize("chains", [ARM, ARM.replace("  ", " "), [ARM], [["arm", "joint1", "can0", 3, "joint2", "can0", 4]]])
@pytest.mark.parametrize(
    "buses",
    [{"can0": "virtual:x"}, [{"name": "can0", "locator": "virtual:x"}], ["can0=virtual:x"], ["other = virtual:x"]],
)
def test_chains_and_buses_in_every_form(chains: object, buses: object) -> None:
    machine = NodeParameters.from_mapping({"chains": chains, "buses": buses}).machine
    assert [bus.locator for bus in machine.buses.values()] == ["virtual:x"]
    assert machine.chains["arm"].joints == ("joint1", "joint2")
    assert [node.node_id for node in machine.nodes.values()] == [3, 4]


def test_the_manuals_data_file_and_a_chain_file(tmp_path: Path) -> None:
    path = tmp_path / "my.csv"
    path.write_text(ARM)
    for name in ("single_device.csv", str(path)):
        assert NodeParameters.from_mapping({"chains": name}).machine.chains


def test_everything_beside_the_chains() -> None:
    given = {
        "chains": ARM,
        "sync_interval": 4,
        "defaults.unit": "degree",
        "joints.joint1.max_speed": 30.0,
        "joints": {"joint2": {"max_speed": 20.0, "unit": "radian"}},
        "eds": {"joint1": "sample_drive.eds"},
        "simulate": True,
        "velocity_watchdog": 0.2,
        "joint_states_rate": 50,
    }
    parameters = NodeParameters.from_mapping(given)
    machine = parameters.machine
    assert machine.joints["joint2"].settings.max_speed == 20.0
    assert machine.joints["joint2"].settings.unit == "radian"
    assert machine.joints["joint1"].settings.unit == "degree"
    assert machine.joints["joint1"].settings.max_speed == 30.0
    assert machine.nodes["joint1"].device.file == "sample_drive.eds"
    assert not machine.nodes["joint2"].device.file
    assert machine.chains["arm"].settings.cycle_time == 0.004
    assert (parameters.simulate, parameters.velocity_watchdog, parameters.joint_states_rate) == (True, 0.2, 50.0)


def test_a_machine_file_with_other_locators(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(TOML)
    machine = NodeParameters.from_mapping({"machine": str(path)}).machine
    assert machine.chains["arm"].settings.cycle_time == 0.005
    other = NodeParameters.from_mapping({"machine": str(path), "buses": {"left": "virtual:x"}, "sync_interval": 8}).machine
    assert other.buses["left"].locator == "virtual:x"
    assert other.chains["arm"].settings.cycle_time == 0.008
    with pytest.raises(ParameterError, match="has no bus 'right'"):
        NodeParameters.from_mapping({"machine": str(path), "buses": {"right": "virtual:x"}})
    with pytest.raises(ParameterError, match="chains and machine exclude each other"):
        NodeParameters.from_mapping({"machine": str(path), "chains": ARM})


def test_without_a_machine_the_old_sentence_is_said() -> None:
    for empty in ({}, {"chains": ""}, {"chains": []}, {"simulate": True}):
        with pytest.raises(NoMachineError) as raised:
            NodeParameters.from_mapping(empty)
        assert raised.value.failed == NO_FILE


def test_all_errors_at_once() -> None:
    wrong = {
        "chains": ARM,
        "chain": "x",
        "simulate": "yes",
        "velocity_watchdog": 0,
        "goal_time": "long",
        "joint_states_rate": -1,
        "joint_states": "",
        "sync_interval": -10,
        "buses": ["nonsense", {"name": "can9", "locator": "virtual:x"}, {"name": "can0", "locator": 5}],
        "eds": {"joint9": "a.eds"},
        "joints": {"joint8": {}, "joint1": {"unit": "furlong", "max_sped": 3}},
    }
    with pytest.raises(ParameterError) as raised:
        NodeParameters.from_mapping(wrong)
    text = str(raised.value)
    for part in (
        "'chain'; did you mean", "simulate is 'yes'", "velocity_watchdog is 0", "goal_time is 'long'", "joint_states_rate is -1",
        "joint_states is ''", "sync_interval is -10", "'nonsense'", "'can9'", "'can0': 5",
        "'joint9'", "'joint8'", "furlong", "max_sped",
    ):  # fmt: skip
        assert part in text, part


@pytest.mark.parametrize("name", [name for name, each in PARAMETERS.items() if each.least is not None])
def test_numbers_have_ranges(name: str) -> None:
    parameter = PARAMETERS[name]
    assert parameter.least is not None
    assert parameter.most is not None
    for value in (parameter.least, parameter.most):
        NodeParameters.from_mapping({"chains": ARM, name: value})
    for value in (-parameter.most, parameter.most * 1.01, float("nan"), True, "1"):
        with pytest.raises(ParameterError, match=f"{name} is .*; it has to be a number from"):
            NodeParameters.from_mapping({"chains": ARM, name: value})


def test_defaults_are_those_of_the_table() -> None:
    made = NodeParameters.from_mapping({"chains": ARM})
    own = [each.name for each in fields(NodeParameters) if each.name != "machine"]
    assert {name: getattr(made, name) for name in own} == {name: PARAMETERS[name].default for name in own}


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"chains": "arm joint1 can0"}, "node-ID of 'joint1' missing"),
        ({"chains": "nowhere.csv"}, "nowhere.csv"),
        ({"chains": 5}, "chains is 5"),
        ({"chains": ARM, "buses": 5}, "buses is 5"),
        ({"chains": ARM, "eds": 5}, "eds is 5"),
        ({"chains": ARM, "eds": "nowhere.eds"}, "nowhere.eds"),
        ({"chains": ARM, "joints": 5}, "joints is 5"),
        ({"chains": ARM, "joints": {"joint1": 5}}, "joints.joint1 is 5"),
        ({"chains": ARM, "joints": 5, "joints.joint1": 5}, "joints"),
        ({"machine": "nowhere.toml"}, "nowhere.toml"),
    ],
)
def test_what_is_wrong_is_named(given: dict[str, object], text: str) -> None:
    with pytest.raises(ParameterError) as raised:
        NodeParameters.from_mapping(given)
    assert text in str(raised.value)
