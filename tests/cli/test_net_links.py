"""`canopen net links`, and what other commands make of the links of a machine file."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from canopen_proto.dictionary.concise import from_concise
from tests.cli.cli_support import Run
from tests.cli.command_examples import json_that_fits
from tests.master.test_machine_links import LINKS, NODES

CELL = NODES + LINKS


@pytest.fixture
def cell(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The machine file, in a folder of the test's own."""
    monkeypatch.chdir(tmp_path)
    path = Path("cell.toml")
    path.write_text(CELL)
    return path


def test_the_table(run: Run, cell: Path) -> None:
    outcome = run("net", "links", str(cell), "-v")
    assert outcome.status == 0, outcome.err
    lines = [re.sub("  +", "  ", line.strip()) for line in outcome.out.splitlines()]
    assert lines[0] == "left: 3 PDOs for the links"
    at = lines.index("0x385  4  each SYNC, timeout 50 ms  from lift  TPDO 3  position_actual_value (0x6064:00)")
    assert lines[at + 1] == "to slide  RPDO 3  target_position (0x607A:00)"
    assert "right: 1 PDO for the links" in lines
    assert "slide RPDO 3  no longer carries controlword (0x6040:00)" in lines
    assert "Nothing was written" in outcome.err
    assert "slide 0x1402:01 = 0x80000406" in outcome.err


def test_json(run: Run, cell: Path) -> None:
    left, right = json_that_fits("net links", run("net", "links", "-m", str(cell), "--json"))
    assert (left["bus"], right["bus"]) == ("left", "right")
    (pdo,) = right["pdos"]
    assert pdo["from"]["node"] == "panel"
    assert pdo["to"] == ["master"]
    assert (pdo["can_id"], pdo["bytes"], pdo["every"], pdo["inhibit_time_ms"], pdo["links"]) == (0x189, 1, None, 5, ["links[3]"])
    assert right["writes"]["panel"][-1]["object"] == "0x1800:01"


def test_concise_dcfs(run: Run, cell: Path) -> None:
    Path("concise").mkdir()
    outcome = run("net", "links", str(cell), "--dcf", "concise")
    assert outcome.status == 0, outcome.err
    assert sorted(path.name for path in Path("concise").iterdir()) == ["lift.cdcf", "panel.cdcf", "slide.cdcf"]
    assert from_concise(Path("concise/panel.cdcf").read_bytes())[-1] == (0x1800, 1, (0x4000_0189).to_bytes(4, "little"))
    assert run("net", "links", str(cell), "--dcf", "concise").status == 2  # they are there already
    assert run("net", "links", str(cell), "--dcf", "nowhere").status == 6


def test_a_node_s_name_leads_out_of_no_folder(run: Run, cell: Path) -> None:
    cell.write_text(CELL.replace("[nodes.panel]", '[nodes."../panel"]').replace('"panel 6000:01"', '"../panel 6000:01"'))
    Path("concise").mkdir()
    outcome = run("net", "links", str(cell), "--dcf", "concise")
    assert (outcome.status, "CO123" in outcome.err) == (2, True)
    assert [*Path("concise").iterdir(), *Path().glob("*.cdcf")] == []


def test_a_link_that_cannot_be(run: Run, cell: Path) -> None:
    cell.write_text(CELL + '[[links]]\nfrom = "lift 6041"\nto = "slide 6060"\n')
    text = "lift statusword (0x6041:00) has 16 bits, slide modes_of_operation (0x6060:00) has 8"
    for command in (("net", "links", str(cell)), ("machine", "check", str(cell))):
        outcome = run(*command)
        assert outcome.status == 1
        assert text in " ".join(outcome.out.split())
    assert run("net", "links", str(cell), "--json").json["findings"][0]["line"] == 48


def test_no_machine_and_no_links(run: Run, cell: Path) -> None:
    assert "CO121" in run("net", "links").err
    Path("bare.toml").write_text(NODES)
    outcome = run("net", "links", "bare.toml")
    assert outcome.status == 2
    assert "has no links" in outcome.err


def test_the_plan_counts_linked_pdos(run: Run, cell: Path) -> None:
    outcome = run("plan", "-m", str(cell))
    assert outcome.status == 0, outcome.err
    lines = [re.sub("  +", "  ", line.strip()) for line in outcome.out.splitlines()]
    assert any(line.startswith("TPDO lift  385  4  10.00 ms") for line in lines)
    assert any(line.startswith("TPDO panel (event)  189  1  5.00 ms") for line in lines)


def test_a_boot_writes_the_links(run: Run, cell: Path) -> None:
    cell.write_text(
        "[defaults.nodes]\nboot = { mandatory = true }\n" + CELL.replace("[nodes.bare]", "[nodes.bare]\nboot = false")
    )
    outcome = run("net", "boot", str(cell), "-b", "demo", "--yes", "--trace", "boot.log")
    assert outcome.status == 0, outcome.err
    frames = Path("boot.log").read_text()
    writes = re.findall(r"606#2302140185030000|606#2B02140532000000", frames)  # RPDO 3: event timer 50 ms, then its COB-ID 0x385
    assert writes == ["606#2B02140532000000", "606#2302140185030000"]
    assert "no boot will write" not in run("net", "links", str(cell)).err


def test_nodes_without_boot_are_told(run: Run, cell: Path) -> None:
    assert "no boot will write to lift, slide, panel" in run("net", "links", str(cell)).err
