"""Machine files: each key, every error with its line, and what is written is read back."""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data import DataError
from canopen_data.durations import duration_text, parse_duration
from canopen_data.findings import DictionaryError
from canopen_data.toml_file import places_of
from canopen_master import ChainSettings, parse_chains
from canopen_master.machine_file import (
    BootSettings,
    BusEntry,
    ChainEntry,
    JointEntry,
    LossReaction,
    MachineFile,
    MasterEntry,
    NetworkSettings,
    NodeEntry,
    StartOrder,
    machine_of_chains,
    machine_text,
    parse_machine,
    read_machine,
)
from canopen_master.machine_file.keys import KEYS, KINDS, MODES, kind_of
from canopen_master.machine_file.toml_text import chain_defaults
from canopen_master.simulation.plant import DeviceEntry
from canopen_proto.drives.axis.settings import MODE_CHANGE_STATES, AxisSettings, HomingStyle
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.axis.watchdog import Watchdog
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.multiplexer import Mux, mux
from tests.examples import examples

CELL = """
[master]
cycle = "4ms"
timeout = "1s"
heartbeat_timeout = "1.5s"
watchdog = { node_id = 126, timeout = "300ms", required = true }

[network]
start = "all"
mandatory_lost = "stop all"
boot_time = "20s"

[simulation]
state = "state.json"

[buses.can0]
bitrate = "1M"

[buses.wrist]
locator = "pcan:PCAN_USBBUS1@500k"

[defaults.nodes]
boot = { mandatory = true, heartbeat = "200ms" }

[defaults.joints]
unit = "degree"
max_speed = 90

[nodes.shoulder]
bus = "can0"
id = 3
boot = { mandatory = false, serial = 0x20, store = true }

[nodes.hand]
bus = "wrist"
id = 3
file = "hand.eds"
encoding = "gbk"
overlay = "units.toml"
profile = "402"
shape = "standard"
script = "hand.py"
defaults = true
values = { 1017 = 500 }
boot = false

[joints.shoulder]
min_position = -170
max_position = 170.5
homing = "standard"
homing_method = 35
homing_timeout = "2min"
keeps_reference = true
offset = -1200
direction = -1
sto_input = { object = "60FD", bit = 31 }
brake_bit = { object = "2000:0A", bit = 0, value = 0 }

[joints.tilt]
node = "hand"
counts_per_turn = 4096
max_speed = inf

[chains.arm]
joints = ["shoulder", "tilt"]
max_missed_cycles = 5
"""


def test_every_part_of_a_machine() -> None:
    machine = parse_machine(CELL)
    watchdog = Watchdog(node_id=126, timeout=300 * MILLISECOND, required=True)
    assert machine.master == MasterEntry(4 * MILLISECOND, SECOND, 1500 * MILLISECOND, watchdog)
    assert machine.state == "state.json"
    assert machine.network == NetworkSettings(StartOrder.ALL, LossReaction.STOP_ALL, 20 * SECOND)
    assert machine.buses == {
        "can0": BusEntry("can0", "can0", 1_000_000),
        "wrist": BusEntry("wrist", "pcan:PCAN_USBBUS1@500k"),
    }
    device = DeviceEntry("hand.eds", (3,), "402", "standard", "hand.py", ("units.toml",), True, {"1017": 500}, "gbk")
    assert machine.nodes == {
        "shoulder": NodeEntry(
            "shoulder", "can0", DeviceEntry("", (3,)), BootSettings(serial=0x20, heartbeat=200 * MILLISECOND, store=True)
        ),
        "hand": NodeEntry("hand", "wrist", device),
    }
    shoulder = AxisSettings(
        unit=Unit.DEGREE,
        direction=-1,
        offset=-1200,
        homing=HomingStyle.STANDARD,
        homing_method=35,
        homing_timeout=120 * SECOND,
        keeps_reference=True,
        min_position=-170,
        max_position=170.5,
        max_speed=90,
        sto_input=DriveBit(mux(0x60FD), 31),
        brake_bit=DriveBit(mux(0x2000, 10), 0, 0),
    )
    tilt = AxisSettings(unit=Unit.DEGREE, counts_per_unit=4096 / 360, max_speed=math.inf)
    assert machine.joints == {"shoulder": JointEntry("shoulder", "shoulder", shoulder), "tilt": JointEntry("tilt", "hand", tilt)}
    settings = ChainSettings(cycle_time=0.004, max_missed_cycles=5, own_pdos=True)
    assert machine.chains == {"arm": ChainEntry("arm", ("shoulder", "tilt"), settings)}
    assert machine.node_of("tilt") is machine.node_of("hand") is machine.node_at("wrist", 3)
    assert machine.node_of("leg") is None


def test_the_shortest_machine_and_what_is_left_out() -> None:
    machine = parse_machine("[buses.can0]\n[nodes.io]\nid = 5\n")
    assert machine == MachineFile({"can0": BusEntry("can0", "can0")}, {"io": NodeEntry("io", "can0", DeviceEntry("", (5,)))})
    assert parse_machine("[buses.can0]\n[master]\nwatchdog = false\n").master.watchdog is None


@pytest.mark.parametrize(("file", "own"), [("", False), ("file = 'sample_drive.eds'", True)])
def test_drives_with_files_exchange_the_pdos_of_these_files(file: str, own: bool) -> None:
    text = f"[buses.can0]\n[defaults.nodes]\n{file}\n[nodes.a]\nid = 5\n[joints.a]\n[chains.c]\njoints = ['a']\n"
    machine = parse_machine(text)
    assert machine.chains["c"].settings.own_pdos is own
    assert machine.chains["c"].settings.mode is (None if own else Mode.INTERPOLATED_POSITION)
    assert parse_machine(f"{text}mode = 'csp'").chains["c"].settings.mode is Mode.CYCLIC_SYNCHRONOUS_POSITION
    assert parse_machine(f"{text}own_pdos = {str(not own).lower()}").chains["c"].settings.own_pdos is not own
    assert parse_machine(machine_text(machine)) == machine


def test_the_default_of_all_nodes_puts_them_into_the_network_list() -> None:
    text = "[buses.can0]\n[defaults.nodes]\nboot = { mandatory = true }\n[nodes]\na = { id = 5 }\nb = { id = 6, boot = false }\n"
    nodes = parse_machine(text).nodes
    assert (nodes["a"].boot, nodes["b"].boot) == (BootSettings(mandatory=True), None)
    assert parse_machine("[buses.can0]\n[nodes.a]\nid = 5\nboot = {}").nodes["a"].boot == BootSettings()


ERRORS = [
    ("[buses.a]\nlocator = 1", "m.toml:2:1: error: buses.a: locator: a locator is expected, not 1"),
    (
        "[buses.a]\nlocator = 'demo'",
        "m.toml:2:1: error: buses.a: locator: 'demo' is the simulated arm of the command line (-b demo), not a bus; try",
    ),
    ("[buses.a]", "m.toml:1:2: error: buses.a: the bus 'a' is not a valid locator: there is no interface 'a'; known are"),
    ("", "m.toml: error: buses: there is none: [buses.NAME] begins one"),
    ("[bus.can0]\n[buses.can0]", "m.toml:1:2: error: the file: there is no entry 'bus'; did you mean buses?"),
    (
        "[buses.a]\nlocator = 'can0@1M'\nbitrate = '500k'",
        "m.toml:3:1: error: buses.a: bitrate: the locator 'can0@1M' has another",
    ),
    (
        "[buses.a]\nlocator = 'kvaser:0'\nbitrate = '500k'",
        "m.toml:3:1: error: buses.a: bitrate: the locator has to tell it: locator = 'kvaser:0@500k'",
    ),
    ("[buses.can0]\nbitrate = 500", 'm.toml:2:1: error: buses.can0: bitrate: a bit rate such as "500k" or "1M" is expected'),
    ("[buses.can0]\n[buses.b]\nlocator = 'can0'", "m.toml:2:2: error: buses.b: it has the locator of 'can0'"),
    (
        "[buses.can0]\n[master]\ncycle = '0ms'",
        'm.toml:3:1: error: master: cycle: a time above 0, such as "10ms" is expected, not',
    ),
    ("[buses.can0]\n[master]\ncycle = 10", "m.toml:3:1: error: master: cycle: a time above 0, such as"),
    ("[buses.can0]\n[master]\nwatchdog = true", "m.toml:3:1: error: master: watchdog: false, or a table is expected, not True"),
    (
        "[buses.can0]\n[master.watchdog]\ntimeout = '1us'",
        "m.toml:3:1: error: master.watchdog: period 100000000 ns and timeout 1000 ns",
    ),
    ("[buses.can0]\n[nodes.a]", "m.toml:2:2: error: nodes.a: it has no id (node-ID)"),
    ("[buses.can0]\n[nodes]\na = 5", "m.toml:3:1: error: nodes: a: a table is expected, not 5"),
    ("[buses.can0]\n[nodes.a]\nid = 0", "m.toml:3:1: error: nodes.a: id: a node-ID of 1..127 is expected, not 0"),
    ("[buses.can0]\n[nodes.a]\nid = [5, 6]", "m.toml:3:1: error: nodes.a: id: a node-ID of 1..127 is expected, not [5, 6]"),
    (
        "[buses.can0]\n[nodes.a]\nid = 5\nbus = 'can1'",
        "m.toml:4:1: error: nodes.a: bus: there is no bus 'can1'; did you mean can0?",
    ),
    ("[buses.can0]\n[buses.can1]\n[nodes.a]\nid = 5", "m.toml:3:2: error: nodes.a: which bus is it on? bus = 'can0' or 'can1'"),
    ("[buses.can0]\n[nodes.a]\nid = 5\n[nodes.b]\nid = 5", "m.toml:4:2: error: nodes.b: it has bus and id of 'a'"),
    ("[buses.can0]\n[nodes.5a]\nid = 5", "m.toml:2:2: error: nodes: 5a: a name has no blanks, and does not begin with a digit"),
    ("[buses.can0]\n[nodes.'a b']\nid = 5", "m.toml:2:2: error: nodes: a b: a name has no blanks"),
    ("[buses.can0]\n[joints.a]", "m.toml:2:2: error: joints.a: there is no node 'a'; [nodes.a] is missing, or node = ..."),
    ("[buses.can0]\n[defaults]\nnode = {}", "m.toml:3:1: error: defaults: there is no entry 'node'; did you mean nodes?"),
    ("[buses.can0]\n[defaults.nodes]\nid = 5", "m.toml:3:1: error: defaults.nodes: there is no entry 'id'"),
]
BOOT = "[buses.can0]\n[nodes.a]\nid = 5\n[nodes.a.boot]\n"  # the next line is the fifth
ERRORS_OF_BOOT = [
    ("mandatori = true", "m.toml:5:1: error: nodes.a.boot: there is no entry 'mandatori'; did you mean mandatory?"),
    ("serial = -1", "m.toml:5:1: error: nodes.a.boot: serial is -1; it has to be in 0..4294967295"),
    ("heartbeat = 200", "m.toml:5:1: error: nodes.a.boot: heartbeat: a time such as"),
    ("heartbeat = '1.5ms'", "m.toml:5:1: error: nodes.a.boot: heartbeat has to be whole milliseconds, 65535 at most"),
    ("heartbeat = '1s'\nheartbeat_timeout = '1s'", "m.toml:6:1: error: nodes.a.boot: heartbeat_timeout must be longer than"),
    ("heartbeat = '1s'\nguard_time = '1s'", "m.toml:5:1: error: nodes.a.boot: a node has a heartbeat or is guarded, not both"),
    ("guard_time = '1s'\nlife_time_factor = 0", "m.toml:6:1: error: nodes.a.boot: guarding needs a life_time_factor above 0"),
    ("program = 'a.bin'", "m.toml:5:1: error: nodes.a.boot: program needs software: the number in 0x1F56 that the program has"),
    ("[network]\nstart = 'some'", "m.toml:6:1: error: network: start: 'each' or 'all' or 'none' is expected, not 'some'"),
    ("[defaults.nodes]\nboot = { x = 1 }", "m.toml:6:1: error: defaults.nodes.boot: there is no entry 'x'"),
]
JOINTS = "[buses.can0]\n[nodes.a]\nid = 5\n[nodes.b]\nid = 6\n[joints.a]\n"  # the next line is the seventh
ERRORS_OF_JOINTS = [
    ("node = 'c'", "m.toml:7:1: error: joints.a: node: there is no node 'c'; there are a, b"),
    ("[joints.c]\nnode = 'a'", "m.toml:7:2: error: joints.c: it has node and axis of 'a'"),
    ("node = 'b'", "m.toml:6:2: error: joints.a: there is a node 'a' too, which is another drive"),
    ("unitt = 'degree'", "m.toml:7:1: error: joints.a: there is no entry 'unitt'; did you mean unit?"),
    ("unit = 'deg'", "m.toml:7:1: error: joints.a: unit: 'radian' or 'degree' or 'turn' or 'millimetre' is expected, not 'deg'"),
    ("direction = 2", "m.toml:7:1: error: joints.a: direction must be 1 or -1; it is 2"),
    ("offset = 1.5", "m.toml:7:1: error: joints.a: offset: a whole number is expected, not 1.5"),
    ("unit = 'turn'\nmin_position = 5\nmax_position = 2", "m.toml:8:1: error: joints.a: min_position must be below max_position"),
    ("halt_time = '1s'\nreaction_time = '0ms'", "m.toml:8:1: error: joints.a: reaction_time must be above 0; it is 0 ns"),
    (
        "unit = 'turn'\n[defaults.joints]\nmin_position = 5\nmax_jerk = 0\n[joints.b]\nunit = 'turn'",
        "m.toml:10:1: error: defaults.joints: max_jerk must be above 0, inf for no limit; it is 0",
    ),
    (
        "unit = 'turn'\nmax_position = 2\n[defaults.joints]\nmin_position = 5",
        "m.toml:8:1: error: joints.a: min_position must be below max_position; they are 5.0 and 2.0",
    ),
    ("max_speed = nan", "m.toml:7:1: error: joints.a: max_speed: a number is expected, not nan"),
    ("max_speed = true", "m.toml:7:1: error: joints.a: max_speed: a number is expected, not True"),
    (f"max_speed = 1{'0' * 400}", "m.toml:7:1: error: joints.a: max_speed: a number is expected, not 1000"),
    ("sto_input = { object = '60FDx', bit = 1 }", "m.toml:7:1: error: joints.a: sto_input: { object = \"60FD\", bit"),
    ("sto_input = { object = '60FD', bit = 64 }", "m.toml:7:1: error: joints.a: sto_input: bit 64 = 1 is no bit of an object"),
    ("max_position = 5", "m.toml:7:1: error: joints.a: max_position: in which unit? unit = 'radian' or 'degree' or 'turn' or"),
    ("counts_per_turn = 5", "m.toml:7:1: error: joints.a: counts_per_turn: it needs unit = 'radian' or 'degree' or 'turn'"),
    ("counts_per_turn = 0\nunit = 'turn'", "m.toml:7:1: error: joints.a: counts_per_turn: a number above 0 is expected, not 0"),
    (
        "counts_per_turn = 5\ncounts_per_unit = 5\nunit = 'degree'",
        "m.toml:7:1: error: joints.a: counts_per_turn: counts_per_unit says it already",
    ),
    ("[chains.x]", "m.toml:7:2: error: chains.x: it has no joints"),
    ("[chains.x]\njoints = []", "m.toml:8:1: error: chains.x: joints: a list of joints is expected, not []"),
    ("[chains.x]\njoints = ['a', 'c']", "m.toml:8:1: error: chains.x: joints: there is no joint 'c'; there are a"),
    ("[chains.x]\njoints = ['a', 'a']", "m.toml:8:1: error: chains.x: joints: 'a' is in it twice"),
    (
        "[chains.x]\njoints = ['a']\n[chains.y]\njoints = [\n  'a'\n]",
        "m.toml:10:1: error: chains.y: 'a' is in chain 'x' already",
    ),
    ("[chains.x]\njoints = ['a']\ncycle_time = 0.01", "m.toml:9:1: error: chains.x: there is no entry 'cycle_time'"),
]  # fmt: skip


ALL_ERRORS = [
    *ERRORS,
    *((BOOT + text, error) for text, error in ERRORS_OF_BOOT),
    *((JOINTS + text, error) for text, error in ERRORS_OF_JOINTS),
]


@pytest.mark.parametrize(("text", "error"), ALL_ERRORS)
def test_what_is_wrong_is_told_once_and_with_its_line(text: str, error: str) -> None:
    with pytest.raises(DictionaryError) as caught:
        parse_machine(text, "m.toml")
    assert [str(each)[: len(error)] for each in caught.value.findings] == [error]


def test_all_errors_are_found_in_one_pass_in_the_order_of_their_lines() -> None:
    text = JOINTS + "unit = 1\n[joints.b]\nunit = 2\n[defaults.joints]\nmax_speed = 'x'\n[chains.x]\njoints = ['c']\n"
    with pytest.raises(DictionaryError) as caught:
        parse_machine(text, "m.toml")
    assert [each.line for each in caught.value.findings] == [7, 9, 11, 13]


def test_files_are_looked_for_beside_the_machine_file(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text("[buses.can0]\n[nodes.a]\nid = 5\nfile = 'a.eds'\noverlay = ['u.toml']\nscript = 's.py'\n")
    with pytest.raises(DictionaryError) as caught:
        read_machine(path)
    assert [(each.line, each.message.partition(":")[2][:28]) for each in caught.value.findings] == [
        (4, " file: there is no file " + repr(str(tmp_path))[:4]),
        (5, " overlay: there is no file " + repr(str(tmp_path))[:1]),
        (6, " script: there is no file " + repr(str(tmp_path))[:2]),
    ]
    path.write_text("[buses.can0]\n[nodes.a]\nid = 5\nfile = 'sample_io.eds'\n")
    machine = read_machine(path)
    assert machine.path("sample_io.eds") == "sample_io.eds"
    (tmp_path / "sample_io.eds").write_text("")
    assert machine.path("sample_io.eds") == str(tmp_path / "sample_io.eds")
    with pytest.raises(DataError, match=r"there is no file '.*other.toml'"):
        read_machine(tmp_path / "other.toml")


def test_a_text_with_strings_of_several_lines_has_errors_without_lines() -> None:
    text = '[buses.can0]\n[nodes.a]\nscript = """\nid = 5\n"""\nid = 500\n'
    assert places_of(text) == {}
    with pytest.raises(DictionaryError, match=r"m.toml: error: nodes.a: id"):
        parse_machine(text, "m.toml")


def test_each_setting_has_a_kind_and_none_is_the_default_of_what_may_be_left_out() -> None:
    for settings in (AxisSettings, ChainSettings, Watchdog, BootSettings, NetworkSettings):
        for each in fields(settings):
            if each.name == "mode":  # which may be None: "auto"
                continue
            assert kind_of(each) in KINDS.values()
            assert (each.default is None) == str(each.type).endswith("| None"), each.name


def test_a_chain_file_becomes_a_machine() -> None:
    chains = parse_chains("left j1 /dev/pcan32 3 j2 socketcan:can1 4\nright j1 /dev/pcan32 5 2 tool 7\n")
    machine = machine_of_chains(chains, {"tool": "virtual:tool"})
    assert {each.name: each.locator for each in machine.buses.values()} == {
        "pcan32": "/dev/pcan32",
        "can1": "socketcan:can1",
        "tool": "virtual:tool",
    }
    assert {name: (each.bus, each.node_id) for name, each in machine.nodes.items()} == {
        "left_j1": ("pcan32", 3),
        "j2": ("can1", 4),
        "right_j1": ("pcan32", 5),
        "n2": ("tool", 7),
    }
    assert {name: each.joints for name, each in machine.chains.items()} == {
        "left": ("left_j1", "j2"),
        "right": ("right_j1", "n2"),
    }
    assert machine.joints["j2"].settings == AxisSettings()
    assert parse_machine(machine_text(machine)) == machine


# ---- what is written is read back ----

NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_.\"'-]{0,5}", fullmatch=True)
TEXTS = st.from_regex(r"[!-~äß][ -~]{0,6}[!-~]", fullmatch=True)
NUMBERS = st.floats(-1e6, 1e6, allow_nan=False).map(lambda value: value + 0.0)
TIMES = st.integers(1, 10**12)


def of_class(settings: type, **known: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    """Settings of a class with any values of their fields' types that it takes."""
    by_type = {
        "bool": st.booleans(),
        "int": st.integers(1, 100),
        "float": NUMBERS.map(lambda value: abs(value) + 1),
        "str": TEXTS,
        "Time": TIMES,
        "HomingStyle": st.sampled_from(HomingStyle),
        "Unit": st.sampled_from(Unit),
        "State": st.sampled_from(MODE_CHANGE_STATES),
        "StartOrder": st.sampled_from(StartOrder),
        "LossReaction": st.sampled_from(LossReaction),
        "DriveBit": st.builds(DriveBit, st.integers(0, 0xFFFFFF).map(Mux), st.integers(0, 63), st.integers(0, 1)),
    }
    chosen = dict(known)
    for each in fields(settings):
        if each.name not in known:
            default = st.none() if each.default is None else st.just(each.default)
            chosen[each.name] = default | by_type[str(each.type).removesuffix(" | None")]
    return st.builds(settings, **chosen)


@st.composite
def machines(draw: st.DrawFn) -> MachineFile:
    buses = draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
    rates = st.none() | st.sampled_from([125_000, 1_000_000, 83_333])
    axes = of_class(
        AxisSettings,
        direction=st.sampled_from([1, -1]),
        min_position=st.none() | st.floats(-1e6, -1),
        max_position=st.none() | st.floats(1, 1e6) | st.just(math.inf),
    )
    axes = axes.map(lambda each: each if each.unit or each.counts_per_unit else replace(each, counts_per_unit=1.0))  # type: ignore
    times = st.integers(1, 5000).map(lambda value: value * MILLISECOND)
    watchdog = st.builds(
        Watchdog,
        st.integers(1, 127),
        st.just(2 * MILLISECOND),
        times.map(lambda time: time + 3 * MILLISECOND),
        st.integers(-5, 5),
    )
    names = draw(st.lists(NAMES, max_size=5, unique=True))
    places = draw(
        st.lists(st.tuples(st.sampled_from(buses), st.integers(1, 127)), min_size=len(names), max_size=len(names), unique=True)
    )
    devices = st.builds(
        DeviceEntry,
        st.just("") | TEXTS,
        profile=st.sampled_from(["auto", "402", "none"]),
        shape=st.sampled_from(["", "schunk"]),
        script=st.just("") | TEXTS,
        overlays=st.lists(TEXTS, max_size=2).map(tuple),
        defaults=st.booleans(),
        values=st.dictionaries(TEXTS, st.integers(-5, 500) | TEXTS, max_size=2),
        encoding=st.just("") | TEXTS,
    )
    milliseconds = st.none() | st.integers(0, 1000).map(lambda value: value * MILLISECOND)
    timeouts = st.none() | st.just(2 * SECOND)
    nothing = {"guard_time": st.just(0), "program": st.just("")}
    boots = of_class(BootSettings, heartbeat=milliseconds, heartbeat_timeout=timeouts, **nothing)
    nodes = {
        name: NodeEntry(name, bus, replace(draw(devices), node_ids=(node_id,)), draw(st.none() | boots))
        for name, (bus, node_id) in zip(names, places, strict=True)
    }
    prefix = "of." if draw(st.booleans()) else ""
    joints = {f"{prefix}{name}": JointEntry(f"{prefix}{name}", name, draw(axes)) for name in names}
    joints = joints if not set(joints) & set(nodes) or not prefix else {}
    cycle = draw(TIMES)
    chains = {}
    if joints:
        cut = draw(st.integers(1, len(joints)))
        for number, part in enumerate(filter(None, (tuple(joints)[:cut], tuple(joints)[cut:]))):
            settings = draw(of_class(ChainSettings, cycle_time=st.just(cycle / SECOND), mode=st.sampled_from([*MODES.values()])))
            chains[f"c{number}"] = ChainEntry(f"c{number}", part, settings)
    return MachineFile(
        {name: BusEntry(name, f"virtual:{number}", draw(rates)) for number, name in enumerate(buses)},
        nodes,
        joints,
        chains,
        MasterEntry(cycle, draw(TIMES), draw(st.just(0) | TIMES), draw(st.none() | watchdog)),
        draw(st.just("") | TEXTS),
        draw(of_class(NetworkSettings)),
    )


@examples(25)
@given(machines())
def test_a_machine_that_is_written_is_read_back(machine: MachineFile) -> None:
    text = machine_text(machine)
    again = parse_machine(text)
    assert again == machine
    assert machine_text(again) == text


@given(TIMES)
def test_a_time_that_is_written_is_read_back(time: int) -> None:
    assert parse_duration(duration_text(time)) == time


@given(st.text(alphabet="[].\"'ab =#\n1,{}", max_size=60))
def test_places_are_those_of_the_text(text: str) -> None:
    lines = text.split("\n")
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        tables = {}
    for path, (line, column) in places_of(text).items():
        assert re.match(r"[\[ab1\"']", lines[line - 1][column - 1])
        if len(path) == 1 and tables and not any(char in text for char in "\"'"):
            assert path[0] in tables or "[[" in text or "," in text or "{" in text or "[\n" in text


def test_each_key_stands_on_the_page_with_its_default() -> None:
    page = (Path(__file__).parents[2] / "docs" / "machine.md").read_text(encoding="utf-8")
    found = {}
    for section, table in re.findall(
        r"^`\[(\w+|nodes\.NAME\.boot)(?:\.NAME)?\]`(.*?)(?=^`\[|\Z)", page, re.DOTALL | re.MULTILINE
    ):
        rows = re.findall(r"^\| (`.*?) \| .*? \| .*? \|", table, re.MULTILINE)
        found[section] = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert {section: sorted(keys) for section, keys in found.items()} == {
        **{section: sorted(keys) for section, keys in KEYS.items() if section != "links"},
        "nodes.NAME.boot": sorted(each.name for each in fields(BootSettings)),
    }
    (example,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    machine = parse_machine(example, folder=Path())
    assert set(machine.chains) == {"arm", "lift"}
    watchdog = re.search(r"\| `(\{ node_id.*?\})` \|", page)
    assert watchdog is not None
    assert parse_machine(f"[buses.can0]\n[master]\nwatchdog = {watchdog[1]}") == parse_machine("[buses.can0]")


def test_a_chain_of_joints_with_and_without_files() -> None:
    machine = parse_machine(CELL)
    settings = machine.chains["arm"].settings
    assert (settings.mode, settings.own_pdos) == (Mode.INTERPOLATED_POSITION, True)
    assert chain_defaults(("none",), machine.nodes, machine.joints) == ("ip", False)
    assert chain_defaults(("tilt",), machine.nodes, machine.joints) == ("auto", True)
    assert replace(machine, source="x") == machine


@pytest.mark.parametrize("no_text", [None, b"[buses.can0]", Path("machine.toml")])
def test_what_is_no_text_is_told_as_such(no_text: Any) -> None:
    with pytest.raises(LocalProtocolError, match="machine.toml: the text of a file is expected, not"):
        parse_machine(no_text)
