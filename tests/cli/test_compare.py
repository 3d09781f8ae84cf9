"""`canopen compare` and `canopen dump`: what they print, and how they end."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_data.describing import describe
from canopen_data.descriptions import load_description
from canopen_data.eds.writer import write_eds
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from tests.cli.backup_world import EDS, NODE, Lasting, answering, change, lasting_device
from tests.cli.cli_support import Run, runner_in_folder
from tests.core.devices import LIMITED, TEXT
from tests.manager.restore_bench import GAIN, device


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch, run: Run) -> Lasting:
    return lasting_device(monkeypatch)


# ---- compare ----


def test_what_differs_between_a_device_and_a_file(run: Run, world: Lasting) -> None:
    change(run, world)
    outcome = run("compare", "5", "before.dcf", "-b", "demo")
    assert outcome.status == ExitCode.DIFFERENT
    assert [line.split()[0] for line in outcome.out.splitlines()[2:]] == ["1801:01", "2003:00", "2012:00"]
    assert "3 differences between node 5 (0x05) and before.dcf" in outcome.err
    rows = run("compare", "before.dcf", "changed.dcf", "--json").json
    assert (rows[0]["index"], rows[0]["left"], rows[0]["right"]) == (0x1801, 0x285, 0x295)
    assert {row["change"] for row in rows} == {"changed"}
    assert rows[0]["role"] == "communication"


def test_defaults_that_a_file_with_settings_leaves_out_are_told(run: Run, world: Lasting) -> None:
    text = Path("device.eds").read_text()
    first = text.index("DefaultValue=", text.index("[2003]"))
    Path("mixed.eds").write_text(text[:first] + "ParameterValue=" + text[first + len("DefaultValue=") :])  # some makers do so
    outcome = run("compare", "5", "mixed.eds", "-b", "demo")
    assert "of mixed.eds: it configures 1 value, and these were compared. Try: --defaults" in outcome.err
    assert "not compared" not in run("compare", "5", "mixed.eds", "--defaults", "-b", "demo").err
    assert "not compared" not in run("compare", "5", "device.eds", "-b", "demo").err  # its values are its defaults


def test_what_is_near_enough_is_equal(run: Run, world: Lasting) -> None:
    change(run, world)

    def objects(*options: str) -> list[int]:
        return [row["index"] for row in run("compare", "before.dcf", "changed.dcf", "--json", *options).json]

    assert objects("--tolerance", "1") == [0x1801, TEXT]
    assert objects("--tolerance", "40%") == [TEXT]
    assert objects("--tolerance", "16") == [TEXT]
    for nonsense in ("-1", "1%%", "x", "nan"):
        assert run("compare", "before.dcf", "changed.dcf", f"--tolerance={nonsense}").status == ExitCode.USAGE


def test_process_data_and_what_only_one_side_has(run: Run, world: Lasting) -> None:
    change(run, world)
    world.values[0x2001_00] = 77
    assert "2001:00" not in run("compare", "5", "changed.dcf", "-b", "demo").out
    assert run("compare", "5", "changed.dcf", "-b", "demo").status == 0
    assert "2001:00" in run("compare", "5", "changed.dcf", "-b", "demo", "--process-data").out
    world.dictionary = device(200, Object.of("image", [Variable(0x2011, 0, "image", DataType.UNSIGNED8)]))
    lacking = Path("before.dcf").read_text().replace("ParameterValue=an I/O device with a long name\n", "")
    Path("lacking.dcf").write_text(lacking)
    missing = run("compare", "before.dcf", "lacking.dcf", "--only", "missing", "--json")
    assert [(row["index"], row["change"]) for row in missing.json] == [(TEXT, "only left")]
    assert run("compare", "before.dcf", "lacking.dcf", "--only", "changed").status == 0
    assert run("compare", "lacking.dcf", "before.dcf").out.splitlines()[-1].split()[2] == "-"
    assert run("compare", "before.dcf", "lacking.dcf", "--defaults").status == 0  # its default is the same


def test_an_eds_stands_for_its_defaults(run: Run, world: Lasting) -> None:
    change(run, world)
    outcome = run("compare", "5", "device.eds", "-b", "demo", "--json")
    assert [row["index"] for row in outcome.json if row["change"] == "changed"] == [0x1801, TEXT, GAIN]
    text = Path("device.eds").read_text().replace("DefaultValue=0x00000285", "DefaultValue=$NODEID+0x280")
    Path("relative.eds").write_text(text)
    assert "depends on that" in run("compare", "relative.eds", "device.eds").err
    assert run("compare", "relative.eds", "device.eds", "--id", "5").status == 0
    assert run("compare", "relative.eds", "device.eds", "--id", "6").status == 1
    assert run("compare", "device.eds", "relative.eds", "--id", "5").status == 0


def test_what_cannot_be_read_is_no_difference_but_told(run: Run, world: Lasting) -> None:
    assert run("backup", *NODE, *EDS, "-o", "before.dcf").status == 0

    world.prepare = lambda node: answering(node, {GAIN: AbortCode.DEVICE_STATE})
    outcome = run("compare", "5", "before.dcf", "-b", "demo")
    assert outcome.status == ExitCode.PARTIAL
    assert "not read: 2012:00 gain: refused" in outcome.err
    assert "0 differences" in outcome.err


def test_a_setting_of_a_file_that_cannot_be_read_is_told_and_makes_a_comparison_partial(run: Run, world: Lasting) -> None:
    assert run("backup", *NODE, *EDS, "-o", "before.dcf").status == 0
    Path("lost.dcf").write_text(Path("before.dcf").read_text().replace("ParameterValue=1.5", "ParameterValue=1,5"))
    for left in (("5", "-b", "demo"), ("lost.dcf",)):
        outcome = run("compare", *left, "lost.dcf")
        assert outcome.status == ExitCode.PARTIAL
        assert "not compared: lost.dcf:" in outcome.err
        assert "0 differences" in outcome.err


def test_files_in_which_nothing_depends_on_the_node_id(run: Run, world: Lasting) -> None:
    objects = device().objects
    Path("plain.eds").write_text(write_eds(describe(ObjectDictionary(objects[index] for index in (0x1000, LIMITED)))))
    assert run("compare", "plain.eds", "plain.eds").status == 0


# ---- dump ----


def test_a_dump_on_the_screen(run: Run, world: Lasting) -> None:
    outcome = run("dump", *NODE, *EDS)
    assert outcome.status == 0
    assert len(outcome.out.splitlines()) == 2 + 135
    assert any(line.split()[:6] == ["2002:00", "limited", "UNSIGNED8", "rw", "10", "0x0A"] for line in outcome.out.splitlines())
    document = run("dump", *NODE, *EDS, "--json").json
    assert len(document["objects"]) == 141
    assert document["node"] == 5


def test_a_dump_into_files(run: Run, world: Lasting) -> None:
    assert run("dump", *NODE, *EDS, "-o", "od.json").status == 0
    objects = {(each["index"], each["sub"]): each for each in json.loads(Path("od.json").read_text())["objects"]}
    assert objects[TEXT, 0]["value"] == "an I/O device with a long name"
    assert run("dump", *NODE, *EDS, "-o", "od.csv").status == 0
    with Path("od.csv").open(newline="") as file:
        rows = {(row["index"], row["sub"]): row for row in csv.DictReader(file)}
    assert rows["2010", "00"]["result"] == "write-only"
    assert rows["2002", "00"]["value"] == "10"
    assert run("dump", *NODE, *EDS, "-o", "od.dcf").status == 0
    assert load_description("od.dcf").dictionary.variable("limited").configured == 10
    assert run("dump", *NODE, *EDS, "-o", "od.xlsx").status == ExitCode.USAGE
    assert run("dump", *NODE, "--walk", "2002").out.splitlines()[-1].split()[0] == "2002:00"
