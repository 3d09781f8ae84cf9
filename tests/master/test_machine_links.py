"""`[[links]]` of a machine file: each key, every error with its line, the PDOs on its buses, and what the chains keep."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from canopen_data.findings import DictionaryError
from canopen_data.toml_file import places_of
from canopen_master.exchanges import exchange_of_file, exchange_with_links
from canopen_master.machine_file import MachineFile, machine_text, parse_machine, read_machine
from canopen_master.machine_file.boot_entries import network_of
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.machine_file.keys import KEYS
from canopen_master.machine_file.links import linked_buses, linked_writes, plan_bus
from canopen_proto.dictionary import Direction
from canopen_proto.dictionary.concise import pack_concise
from canopen_proto.machine import MILLISECOND, Event
from canopen_proto.manager.linking import MASTER, End, Link, LinkPlan, Timing
from canopen_proto.network import Network
from canopen_proto.pdo.configure import exchange_device_pdos
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.procedures.runner import ProcedureFinished
from canopen_proto.remote_node import RemoteNode
from tests.manager.linked_devices import Linked

NODES = """
[buses.left]
locator = "virtual:left"
bitrate = "1M"

[buses.right]
locator = "virtual:right"
bitrate = "1M"

[nodes.lift]
bus = "left"
id = 5
file = "sample_drive.eds"

[nodes.slide]
bus = "left"
id = 6
file = "sample_drive.eds"

[nodes.panel]
bus = "right"
id = 9
file = "sample_io.eds"

[nodes.bare]
bus = "left"
id = 7

[joints.gear]
node = "slide"
"""
LINKS = """
[[links]]
from = "lift position_actual_value"
to = "gear target_position"
timeout = "50ms"

[[links]]  # two
from = ["lift statusword", "slide statusword"]
to = "master"
every = 2

[[links]]
from = "panel 6000:01"
to = "master"
event_driven = true
inhibit_time = "5ms"
event_timer = "1s"
"""


def planned(text: str, bus: str = "left") -> LinkPlan:
    machine = parse_machine(text)
    return plan_bus(machine, bus, Dictionaries(machine))


def test_each_key() -> None:
    links = parse_machine(NODES + LINKS).links
    assert links == (
        Link(
            "links[1]",
            (End("lift", "position_actual_value"),),
            (End("slide", "target_position"),),
            Timing(timeout=50 * MILLISECOND),
        ),
        Link("links[2]", (End("lift", "statusword"), End("slide", "statusword")), (End(MASTER),), Timing(every=2)),
        Link("links[3]", (End("panel", "6000:01"),), (End(MASTER),), Timing(0, 5 * MILLISECOND, 1000 * MILLISECOND)),
    )


def test_links_that_are_written_are_read_back() -> None:
    machine = parse_machine(NODES + LINKS)
    assert parse_machine(machine_text(machine)) == machine


def test_each_key_stands_on_the_page() -> None:
    page = (Path(__file__).parents[2] / "docs" / "machine.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"^`\[\[links\]\]`(.*?)(?=^`\[|^## )", page, re.DOTALL | re.MULTILINE)
    rows = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    assert [name for row in rows for name in re.findall(r"`(\w+)`", row)] == list(KEYS["links"])


@pytest.mark.parametrize(
    ("link", "error"),
    [
        ('to = "master"', "31:3: error: links[1]: it has no 'from'"),
        ('from = "lift 6041"', "31:3: error: links[1]: it has no 'to'"),
        (
            'from = "lifd 6041"\nto = "master"',
            "32:1: error: links[1]: from: there is no node 'lifd'; did you mean lift or slide?",
        ),
        ('from = "lift"\nto = "master"', "32:1: error: links[1]: from: which object of 'lift'?"),
        ('from = "master 6041"\nto = "lift 6040"', "32:1: error: links[1]: from: 'master 6041': the master has no objects"),
        ('from = "lift 6041"\nto = "panel 6200:01"', "31:3: error: links[1]: its nodes are on several buses (left, right)"),
        (
            'from = "lift 6041"\nto = "master"\nevery = 0',
            "34:1: error: links[1]: every: a number of SYNCs, 1..240 is expected",
        ),
        ('from = "lift 6041"\nto = "master"\nevry = 1', "34:1: error: links[1]: there is no entry 'evry'"),
        (
            'from = "lift 6041"\nto = "master"\nevery = 1\nevent_driven = true',
            "35:1: error: links[1]: event_driven: it is",
        ),
        (
            'from = "lift 6041"\nto = "master"\ninhibit_time = "5ms"',
            "31:3: error: links[1]: inhibit time and event",
        ),
        (
            'from = "lift 6041"\nto = "master"\ntimeout = "5us"',
            "31:3: error: links[1]: timeout 0.005 ms: a device counts",
        ),
        ('from = ["lift 6041", "slide 6041"]\nto = "lift 6040"', "31:3: error: links[1]: 2 objects cannot feed the same one"),
        ('from = "master"\nto = "master"', "31:3: error: links[1]: from the master to the master"),
        ('from = 5\nto = "master"', "32:1: error: links[1]: from: "),
    ],
)
def test_errors_with_their_lines(link: str, error: str) -> None:
    with pytest.raises(DictionaryError) as caught:
        parse_machine(f"{NODES}[[links]]\n{link}\n", "m.toml")
    (finding,) = caught.value.findings
    assert str(finding).startswith(f"m.toml:{error}")


def test_links_that_are_no_list_of_tables_and_a_node_called_master() -> None:
    with pytest.raises(DictionaryError, match="a list of tables"):
        parse_machine(f"links = 5\n{NODES}")
    with pytest.raises(DictionaryError, match="this node needs another name"):
        parse_machine(f"{NODES}[nodes.master]\nbus = 'left'\nid = 1\n{LINKS}")
    with pytest.raises(DictionaryError, match="is axis 1 of 'lift'"):
        parse_machine(NODES + '[joints.second]\nnode = "lift"\naxis = 1\n[[links]]\nfrom = "second 6041"\nto = "master"\n')


def test_each_array_of_tables_has_its_place() -> None:
    text = "[a]\nb = 1\n[[c]]\nd = 1\n [[ c ]] # more\nd = 2\n[[c.e]]\nf = 1\n"
    assert places_of(text) == {
        ("a",): (1, 2),
        ("a", "b"): (2, 1),
        ("c",): (3, 3),
        ("c", "1"): (3, 3),
        ("c", "1", "d"): (4, 1),
        ("c", "2"): (5, 5),
        ("c", "2", "d"): (6, 1),
        ("c", "e"): (7, 3),
        ("c", "e", "1"): (7, 3),
        ("c", "e", "1", "f"): (8, 1),
    }


# ---- the PDOs


def test_the_pdos_of_each_bus() -> None:
    machine = parse_machine(NODES + LINKS)
    assert linked_buses(machine) == ["left", "right"]
    left = planned(NODES + LINKS)
    assert [(each.can_id, str(each.timing)) for each in left.transfers] == [
        (0x185, "every 2 SYNCs"),
        (0x186, "every 2 SYNCs"),
        (0x385, "each SYNC, timeout 50 ms"),
    ]
    (panel,) = planned(NODES + LINKS, "right").transfers
    assert str(panel.timing) == "event-driven, inhibit 5 ms, timer 1000 ms"
    assert linked_writes(parse_machine(NODES), "left", Dictionaries(machine)) == {}


def test_gearing_of_two_simulated_drives() -> None:
    """By the writes of the machine file, the actual position of one is the set-point of the other."""
    linked = Linked(planned(NODES + LINKS))
    linked.nodes["lift"].values.store[0x606400] = 123_456
    linked.sync()
    linked.sync()
    assert linked.nodes["slide"].values.store[0x607A00] == 123_456


def test_links_that_cannot_be_name_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    wrong = '[[links]]\nfrom = "lift nothing"\nto = "master"\n[[links]]\nfrom = "bare 6041"\nto = "master"\n'
    path.write_text(NODES + LINKS + wrong)
    machine = read_machine(path)
    with pytest.raises(DictionaryError) as caught:
        plan_bus(machine, "left", Dictionaries(machine))
    texts = [str(each).removeprefix(str(path)) for each in caught.value.findings]
    assert texts[0].startswith(":48:3: error: links[4] (lift nothing -> master): lift: object 'nothing' is not in the dictionary")
    assert texts[1].startswith(":51:3: error: links[5] (bare 6041 -> master): no file describes a node 'bare' on this bus")


CHAIN = """
[joints.lift]
[chains.arm]
joints = ["gear"]
"""


def test_what_a_chain_sends_is_no_target_of_a_link() -> None:
    with pytest.raises(DictionaryError, match=r"slide target_position \(0x607A:00\) is in RPDO . already, which its chain sends"):
        planned(NODES + CHAIN + LINKS)


@pytest.mark.parametrize(
    ("source", "target"), [("lift 6061", "gear 6060"), ("lift 6064", "gear 60FF"), ("lift 6064", "slide 60C1:01")]
)
def test_no_link_commands_a_drive_that_a_chain_moves(source: str, target: str) -> None:
    """Not even by an object that the chain does not use: another mode would obey it."""
    link = f'[[links]]\nfrom = "{source}"\nto = "{target}"\n'
    assert planned(NODES + link).transfers
    with pytest.raises(DictionaryError, match="commands a drive that a chain moves; only its chain may do so"):
        planned(NODES + CHAIN + link)


def test_a_chain_s_pdo_feeds_a_link_too() -> None:
    """The gear's chain hears its position at each SYNC; so does the lift, and nothing of the gear's changes."""
    plan = planned(NODES + CHAIN + '[[links]]\nfrom = "slide position_actual_value"\nto = "lift target_position"\n')
    (transfer,) = plan.transfers
    assert transfer.sender is not None
    assert transfer.sender.is_shared
    assert plan.changed == ["lift"]
    (slide,) = [each for each in plan.members if each.name == "slide"]
    assert transfer.sender.settings in slide.used
    (lift,) = transfer.receivers
    assert sum(entry & 0xFF for entry in lift.settings.entries) == transfer.size * 8


def test_pdos_of_a_chain_stay() -> None:
    machine = parse_machine(NODES + CHAIN + '[[links]]\nfrom = "slide 6041"\nto = "master"\nevery = 7\n')
    with pytest.raises(DictionaryError, match="slide has no TPDO left for it: its TPDOs are all taken"):
        plan_bus(machine, "left", Dictionaries(machine))


def test_named_pdos_of_a_chain_stay() -> None:
    text = CHAIN + "own_pdos = false\nmode = 'ip'\n" + '[[links]]\nfrom = "slide 606C"\nto = "master"\n'
    (slide,) = [each for each in planned(NODES + text).members if each.name == "slide"]
    assert [(pdo.direction, pdo.cob_id & 0x7FF) for pdo in slide.used] == [(Direction.RPDO, 0x206), (Direction.TPDO, 0x186)]


def test_the_links_begin_where_the_configuration_of_a_boot_ends(tmp_path: Path) -> None:
    """The concise DCF moves TPDO 1 of the lift to a CAN-ID that the links must not give to anybody else."""
    moved = PdoSettings(1, Direction.TPDO, 0x4000_0486, 1, (0x6041_0010,))
    (tmp_path / "lift.cdcf").write_bytes(pack_concise(moved.steps()))
    boot = 'boot = { configuration = "lift.cdcf" }\n\n[nodes.slide]'
    links = '[[links]]\nfrom = "slide velocity_actual_value"\nto = "master"\n'
    machine = parse_machine(NODES.replace("\n[nodes.slide]", boot) + links, folder=tmp_path)
    dictionaries = Dictionaries(machine)
    (transfer,) = plan_bus(machine, "left", dictionaries).transfers
    assert transfer.sender is not None
    assert transfer.sender.name == "TPDO 4"
    assert transfer.can_id == 0x680  # its own are taken; a new device may come with node-ID 127, and send on 0x1FF
    booted = network_of(machine, "left", dictionaries, linked_writes(machine, "left", dictionaries)).entry.nodes
    assert booted[5].configuration == tuple(moved.steps())


def test_what_a_node_exchanges_by_its_links() -> None:
    machine = parse_machine(NODES + LINKS)
    dictionaries = Dictionaries(machine)
    plans = {bus: plan_bus(machine, bus, dictionaries) for bus in linked_buses(machine)}
    found = {}
    for name in ("lift", "slide", "panel"):
        node = machine.nodes[name]
        counted = exchange_of_file(name, node.node_id, dictionaries.of(node))
        found[name] = exchange_with_links(counted, name, plans[node.bus])
    by_file = exchange_of_file("slide", 6, dictionaries.of(machine.nodes["slide"])).exchange
    assert (0x185, 2) in found["lift"].exchange.tpdo
    assert (0x385, 4) in found["lift"].exchange.tpdo
    assert len(found["slide"].exchange.rpdo) < len(by_file.rpdo)  # one is fed by the lift, which sends it
    assert 0x385 not in {can_id for can_id, _ in found["slide"].exchange.rpdo}
    assert found["panel"].exchange.events == ((0x189, 1, 5 * MILLISECOND),)


def test_an_event_driven_link_without_times_is_not_counted() -> None:
    text = '[[links]]\nfrom = "lift velocity_actual_value"\nto = "master"\nevent_driven = true\n'
    machine: MachineFile = parse_machine(NODES + text)
    dictionaries = Dictionaries(machine)
    plan = plan_bus(machine, "left", dictionaries)
    counted = exchange_with_links(exchange_of_file("lift", 5, dictionaries.of(machine.nodes["lift"])), "lift", plan)
    can_id = plan.transfers[0].can_id
    assert f"TPDO {can_id:03X} has no inhibit time and no event timer" in counted.left_out
    assert replace(counted.exchange, events=()) == counted.exchange


def test_a_master_hears_linked_pdos_by_the_devices_own_settings() -> None:
    """It exchanges the PDOs that it reads from the devices, also those that only they exchange with each other."""
    linked = Linked(planned(NODES + LINKS))
    network = Network()
    events: list[Event] = []
    linked.world.host(network, on_event=events.append)
    remotes = {}
    for each in linked.plan.members:
        remotes[each.name] = RemoteNode(network.out, each.node_id, each.dictionary)
        network.attach(remotes[each.name])
        network.run(exchange_device_pdos(remotes[each.name]), linked.world.now)
    linked.world.advance(100 * MILLISECOND)
    assert len([event for event in events if isinstance(event, ProcedureFinished)]) == 2
    linked.nodes["lift"].values.store[0x606400] = 77
    linked.sync()
    linked.sync()
    assert remotes["lift"].values.store[0x606400] == 77
    assert {event.number for event in events if isinstance(event, PdoReceived) and event.node_id == 5} >= {1, 3}
    assert linked.nodes["slide"].values.store[0x607A00] == 77
