"""`canopen pdo`: what a node has set up, in words; another mapping, in the order of the standard; several nodes compared."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_proto.abort import AbortCode
from canopen_proto.nmt import NmtState
from tests.cli.backup_world import EDS, NODE, Lasting, lasting_device
from tests.cli.cli_support import Run, runner_in_folder


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch, run: Run) -> Lasting:
    return lasting_device(monkeypatch)


DEMO = ("-b", "demo")


def test_the_pdos_of_a_drive(run: Run) -> None:
    shown = run("pdo", "show", "3", *DEMO)
    rows = [" ".join(line.split()) for line in shown.out.splitlines()[2:]]
    assert rows[1].startswith("TPDO 1 0x183 at each SYNC (1) 8 6041:00 statusword, 6077:00 torque_actual_value")
    assert "6 switched off (--all shows them)" in shown.err
    document = run("pdo", "show", "3", "tpdo1", "RPDO 2", *DEMO, "--json").json
    assert [each["pdo"] for each in document["pdos"]] == ["TPDO 1", "RPDO 2"]
    first, second = document["pdos"]
    assert (first["can_id"], first["bytes"], first["valid"], second["valid"]) == (0x183, 8, True, False)
    assert first["objects"][0] == {"index": 0x6041, "sub": 0, "bits": 16, "name": "statusword"}


def test_a_pdo_that_the_device_lacks(run: Run) -> None:
    outcome = run("pdo", "show", "3", "tpdo9", *DEMO)
    assert outcome.status == ExitCode.SDO_ABORT
    assert "node 3 has no TPDO 9" in outcome.err
    assert run("pdo", "show", "3", "tpdo0", *DEMO).status == ExitCode.USAGE
    assert run("pdo", "show", "3", "upod1", *DEMO).status == ExitCode.USAGE


def test_a_new_mapping_in_the_order_of_the_standard(run: Run, world: Lasting) -> None:
    before = run("pdo", "show", *NODE, "tpdo2", *EDS, "--json").json["pdos"][0]
    words = ("tpdo2", "2000", "--event", "100ms", "--type", "254", *EDS)
    done = run("pdo", "map", *NODE, *words, "--yes", "--json")
    assert done.status == ExitCode.OK, done.err
    assert done.json["before"] == before
    after = done.json["after"]
    assert [each["index"] for each in after["objects"]] == [0x2000]
    assert (after["event_timer_ms"], after["transmission_type"], after["valid"]) == (100, 254, True)
    assert world.state is NmtState.OPERATIONAL  # as before
    assert world.writes == [
        (0x1801, 1), (0x1A01, 0), (0x1A01, 1), (0x1A01, 0), (0x1801, 2), (0x1801, 5), (0x1801, 1),
    ]  # fmt: skip
    assert all(state is NmtState.PRE_OPERATIONAL for *_, state in world.node.writes)
    assert "each 100 ms at the latest" in run("pdo", "show", *NODE, "tpdo2", *EDS).out


def test_by_the_file_of_another_device_nothing_is_mapped(run: Run) -> None:
    words = ("pdo", "map", "3", "tpdo2", "statusword", "-b", "demo", "-e", "sample_io.eds", "--yes")
    refused = run(*words)
    assert refused.status == ExitCode.DIFFERENT, refused.err
    assert "is not of the type that" in refused.err
    assert "--any-device" in refused.err


def test_a_pdo_is_switched_off_and_keeps_its_mapping(run: Run, world: Lasting) -> None:
    done = run("pdo", "map", *NODE, "tpdo2", "--off", *EDS, "--yes", "--json")
    before, after = done.json["before"], done.json["after"]
    assert (before["valid"], after["valid"]) == (True, False)
    assert before["objects"] == after["objects"]
    assert world.writes == [(0x1801, 1)]


def test_nothing_is_sent_without_a_yes_nor_for_what_cannot_be(run: Run, world: Lasting) -> None:
    for words in (
        ("tpdo2",),
        ("tpdo2", "2000"),
        ("tpdo2", "--off", "--type", "1", "--yes"),
        ("tpdo2", "no_such_object", "--yes"),
        ("tpdo2", "1018:01", "--yes"),
        ("tpdo2", *["2000"] * 5, "--yes"),
        ("tpdo2", "2012", "--yes"),
        ("tpdo2", "2012/x", "--yes"),
        ("tpdo2", "2012", "--can-id", "0x605", "--yes"),
    ):
        outcome = run("pdo", "map", *NODE, *words, *EDS)
        assert outcome.status == ExitCode.USAGE, (words, outcome.err)
        assert world.writes == []


def test_a_device_that_refuses_a_step_has_its_old_settings(run: Run, world: Lasting) -> None:
    refused = {3: AbortCode.CANNOT_BE_MAPPED}
    world.prepare = lambda node: setattr(node, "refuse", refused.get)
    before = run("pdo", "show", *NODE, "tpdo2", *EDS, "--json").json
    outcome = run("pdo", "map", *NODE, "tpdo2", "2000", *EDS, "--yes")
    assert outcome.status not in (ExitCode.OK, ExitCode.INTERNAL)
    assert "step 3 of" in outcome.err
    assert "it has its old settings" in outcome.err
    assert "stays Pre-operational" in outcome.err
    world.prepare = lambda node: None
    assert run("pdo", "show", *NODE, "tpdo2", *EDS, "--json").json == before


def test_the_pdos_of_several_nodes(run: Run) -> None:
    outcome = run("pdo", "check", "--ids", "3,4", *DEMO)
    assert outcome.status == ExitCode.OK
    assert "node 3 TPDO 1" in outcome.out
    assert "4 PDOs of 2 nodes: 0 errors, 4 remarks" in outcome.err
    document = run("pdo", "check", "--ids", "3,4", *DEMO, "--json").json
    assert {each["rule"] for each in document["findings"]} == {"unheard", "unsent"}
    assert [each["can_id"] for each in document["flows"]] == [0x183, 0x184, 0x203, 0x204]


def test_two_senders_are_an_error(run: Run, world: Lasting) -> None:
    world.values[0x1801_01] = 0x185
    world.values[0x1800_01] = 0x185
    outcome = run("pdo", "check", *DEMO)
    assert outcome.status == ExitCode.DIFFERENT
    assert "two senders" in outcome.out


def test_nobody_there_to_compare(run: Run, world: Lasting) -> None:
    world.is_there = False
    assert run("pdo", "check", *DEMO).status == ExitCode.NO_ANSWER
