"""Chain files: what they may hold, and that all that is wrong in one is told with its place."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_master import ChainFileError, JointDescription, open_master, parse_chains, read_chains
from tests.master.world import virtual_time


def test_the_manuals_examples() -> None:
    (chain,) = read_chains("single_device.csv")
    assert (chain.name, chain.buses) == ("chain1", ("/dev/pcan32",))
    assert [(joint.name, joint.node_id) for joint in chain.joints] == [("joint1", 12)]
    (arm,) = read_chains("multiple_devices.csv")
    assert [joint.node_id for joint in arm.joints] == [3, 4, 5, 6, 7, 8]


def test_a_file_by_its_path(tmp_path: Path) -> None:
    path = tmp_path / "my chains.csv"
    path.write_text("arm j can0 5\n")
    (chain,) = read_chains(path)
    assert chain.joints == (JointDescription("j", "can0", 5, 1, 5),)
    assert chain.source == str(path)


def test_several_chains_buses_comments_and_any_white_space() -> None:
    chains = parse_chains("# arms\n\n  left\tj1 can0 0x0C   j2 can1 12 # both\nright j1 can1 13\n")
    assert [chain.name for chain in chains] == ["left", "right"]
    assert chains[0].buses == ("can0", "can1")
    assert [joint.node_id for joint in chains[0].joints] == [12, 12]


@pytest.mark.parametrize(
    ("text", "problems"),
    [
        ("", ["1:1: the file has no chain"]),
        ("# nothing\n", ["1:1: the file has no chain"]),
        ("arm", ["1:4: chain arm has no joints"]),
        ("arm j1", ["1:7: bus and node-ID of 'j1' missing: a joint is NAME BUS NODE-ID"]),
        ("arm j1 can0", ["1:12: node-ID of 'j1' missing: a joint is NAME BUS NODE-ID"]),
        ("arm j1 can0 3 j2 can0", ["1:22: node-ID of 'j2' missing: a joint is NAME BUS NODE-ID"]),
        ("arm j1 can0 200", ["1:13: node-ID 200 is outside 1..127"]),
        ("arm j1 can0 128 j2 can0 5", ["1:13: node-ID 128 is outside 1..127"]),
        ("arm j1 can0 0", ["1:13: node-ID 0 is outside 1..127"]),
        ("arm j1 can0 0x80", ["1:13: node-ID 0x80 is outside 1..127"]),
        ("arm j1 can0 joint2", ["1:13: 'joint2' is not a node-ID (1..127); a joint is NAME BUS NODE-ID"]),
        ("arm j1 can0 -3", ["1:13: '-3' is not a node-ID (1..127); a joint is NAME BUS NODE-ID"]),
        ("arm j1 can0 3 j1 can0 4", ["1:15: chain arm has a joint 'j1' already"]),
        ("arm j1 can0 3 j2 can0 3", ["1:15: node 3 on can0 is j1 of arm already"]),
        ("a j can0 3\nb j can0 3", ["2:3: node 3 on can0 is j of a already"]),
        ("a j can0 3\na j can0 4", ["2:1: there is a chain 'a' already"]),
        ("a j can0 3 k\nb j can0 0\n", ["1:13: bus and node-ID of 'k' missing: a joint is NAME BUS NODE-ID", "2:10: node-ID 0"]),
    ],
)
def test_all_that_is_wrong_is_told_with_line_and_column(text: str, problems: list[str]) -> None:
    with pytest.raises(ChainFileError) as caught:
        parse_chains(text, "my.csv")
    error = caught.value
    assert isinstance(error, ValueError)
    assert error.source == "my.csv"
    found = [f"{line}:{column}: {problem}" for line, column, problem in error.problems]
    assert len(found) == len(problems)
    assert all(each.startswith(wanted) for each, wanted in zip(found, problems, strict=True)), found
    assert all(f"my.csv:{each}" in str(error) for each in found)
    assert "try:" in str(error)


@given(st.text(alphabet="ab 0123x#\n\t-", max_size=60))
def test_any_text_is_chains_or_a_chain_file_error(text: str) -> None:
    try:
        chains = parse_chains(text)
    except ChainFileError as error:
        lines = max(1, len(text.splitlines()))
        assert all(1 <= line <= lines and column >= 1 for line, column, _ in error.problems)
    else:
        nodes = [(joint.bus, joint.node_id) for chain in chains for joint in chain.joints]
        assert len(set(nodes)) == len(nodes)
        assert all(1 <= node_id <= 127 for _, node_id in nodes)


@virtual_time
async def test_the_only_bus_of_a_file_is_the_only_bus_of_the_master() -> None:
    async with open_master("virtual:demo") as master:
        chains = master.load_chains("single_device.csv")
        assert chains["chain1"].devices[0].node.bus == "virtual:demo"
        assert list(chains["chain1"].joints) == ["joint1"]


@virtual_time
async def test_names_in_the_file_are_mapped_to_buses() -> None:
    async with open_master(buses={"can0": "virtual:a", "can1": "virtual:b"}) as master:
        arm = master.load_chains(text="arm j1 can0 3 j2 can1 3")["arm"]
        assert [device.node.bus for device in arm.devices] == ["can0", "can1"]
        with pytest.raises(ChainFileError, match=r"1:15: bus 'can2' is not open; open are can0, can1"):
            master.load_chains(text="leg j1 can0 5 j2 can2 6")


@virtual_time
async def test_two_names_of_one_bus_are_one_bus() -> None:
    async with open_master(buses={"can0": "virtual:a", "can1": "virtual:a"}) as master:
        arm = master.load_chains(text="arm j1 can0 3 j2 can1 4")["arm"]
        assert arm.devices[1].node.bus == "can0"
        with pytest.raises(ChainFileError, match="node 3 on can1 is j1 of arm already"):
            master.load_chains(text="arm j1 can0 3 j2 can1 3")
