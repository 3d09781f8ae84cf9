"""`canopen device`: a new device passes all checks as it is; so does the device of docs/own-device.md."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from canopen_check.catalogue import CASES, run_all
from canopen_cli.device import skeleton
from canopen_data.declared import describe_device
from canopen_data.descriptions import load_description
from canopen_data.named_files import UnusableFileError
from canopen_master.simulation.device_code import load_device
from canopen_master.simulation.device_files import models_of
from canopen_master.simulation.hooks import ScriptError
from canopen_master.simulation.plant import DeviceEntry
from canopen_proto.declared import DeclaredDevice
from canopen_proto.lss.messages import UNCONFIGURED
from canopen_proto.machine import Outbox
from canopen_proto.verdict import Result
from tests.check.conformance_rig import Fault, Site
from tests.cli.cli_support import Run, runner_in_folder

PAGE = Path(__file__).parents[2] / "docs" / "own-device.md"


def station(folder: Path) -> Path:
    """The example of the page, in a file."""
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    path = folder / "io_station.py"
    path.write_text(example, encoding="utf-8")
    return path


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


def failures(device: type[DeclaredDevice], *, strict: bool) -> list[str]:
    """The cases that are not passed, of all."""
    made = Fault("a device in Python", node=lambda out, node_id, dictionary: device(out, node_id).node)
    site = Site(made, description=describe_device(device), stimulus=False, strict=strict)
    results = site.result_of(lambda bench: run_all(bench))
    assert len(results) == len(CASES)
    assert sum(verdict.result is Result.PASSED for _, verdict in results) > 90
    return [f"{case.number} {verdict}" for case, verdict in results if verdict.result in (Result.FAILED, Result.REMARK)]


@pytest.mark.thorough(2)
@pytest.mark.parametrize("strict", [False, True])
def test_a_new_device_passes_every_case_and_its_files_are_clean(run: Run, strict: bool) -> None:
    made = run("device", "new", "my_station")
    assert made.status == 0
    assert "my_station.py: the device MyStation" in made.err
    for name in ("my_station.eds", "my_station.xdd"):
        assert run("device", "describe", "my_station.py", "-o", name).status == 0
        linted = run("eds", "lint", name)
        assert (linted.status, "nothing found" in linted.err + linted.out) == (0, True)
        assert run("check", name).status == 0
    assert failures(load_device("my_station.py"), strict=strict) == []


@pytest.mark.thorough(2)
@pytest.mark.parametrize("strict", [False, True])
def test_the_station_of_the_page_passes_every_case(run: Run, tmp_path: Path, strict: bool) -> None:
    path = str(station(tmp_path))
    assert failures(load_device(path), strict=strict) == []
    assert run("device", "describe", path, "-o", "station.eds").status == 0
    assert run("eds", "lint", "station.eds").status == 0


def test_names_of_new_devices(run: Run) -> None:
    assert run("device", "new", "Valve-Block 2", "--json").json == {"file": "valve_block_2.py", "class": "ValveBlock2"}
    device = load_device("valve_block_2.py")
    assert (device.__name__, device.nameplate.product_name) == ("ValveBlock2", "Valve Block 2")
    assert "keleton" not in Path("valve_block_2.py").read_text()
    os.mkdir("lib")
    assert run("device", "new", "lib/pump.py").status == 0
    assert load_device("lib/pump.py").__name__ == "Pump"
    assert run("device", "new", "lib/pump").status == 2  # it is there already
    for wrong in ("2nd", "a.b", "", "class", "a__b"):
        refused = run("device", "new", wrong)
        assert (refused.status, "CO001" in refused.err) == (2, True), wrong
    assert isinstance(skeleton.Skeleton.dictionary.source, str)


def test_a_device_is_served_with_values_of_its_own(run: Run) -> None:
    run("device", "new", "pump")
    served = run("sim", "5,6=pump.py", "-b", "virtual:pumps", "--seconds", "1")
    assert served.status == 0
    assert "pump.py: Pump; objects:" in served.err
    assert run("sim", "pump.py", "-b", "virtual:pumps", "--seconds", "1").status == 2  # which node-ID?
    Path("plant.toml").write_text('[[device]]\nfile = "pump.py"\nid = 7\n[device.values]\n1017 = 500\n"Filter time" = 20\n')
    assert run("sim", "plant.toml", "-b", "virtual:pumps", "--seconds", "1").status == 0


def test_devices_without_a_node_id_differ_by_their_serial_numbers(run: Run) -> None:
    """LSS tells them apart by it."""
    run("device", "new", "pump")
    models = models_of([DeviceEntry("pump.py", (UNCONFIGURED, UNCONFIGURED, 5), values={"Filter time": 20})])
    nodes = [model(Outbox()) for model in models]
    assert [node.lss.address[-1] for node in nodes[:2]] == [0, 1]
    assert {node.values.read("Filter time") for node in nodes} == {20}
    assert run("sim", "pump.py", "--id", "255,255", "-b", "virtual:pumps", "--seconds", "1").status == 0


def test_what_the_code_of_a_device_does_wrong_is_told(run: Run) -> None:
    run("device", "new", "pump")
    path = Path("pump.py")
    path.write_text(path.read_text().replace("self.inputs[1] = self.outputs[1]", "self.inputs[3] = 1"))
    told = run("sim", "5=pump.py", "-b", "virtual:pumps", "--seconds", "0.05")
    assert "its code failed in step: IndexError: Highest sub-index supported" in told.err
    path.write_text(path.read_text().replace("0x2001", "0x2000"))
    wrong = run("device", "describe", "pump.py", "-o", "pump.eds")
    assert wrong.status == 6
    assert "CO331" in wrong.err
    assert "0x2000 is 'Input' already; 'Output' needs another place" in wrong.err


def test_what_is_no_device(run: Run) -> None:
    Path("none.py").write_text("from canopen_proto.declared import DeclaredDevice\n\ndef run():\n    pass\n")
    with pytest.raises(ScriptError, match="declares no device"):
        load_device("none.py")
    with pytest.raises(UnusableFileError, match=r"absent\.py"):
        load_device("absent.py")
    assert run("device", "describe", "none.py", "-o", "x.eds").status == 6
    refused = run("device", "describe", "none.py", "-o", "x.txt")
    assert (refused.status, "an .eds or an .xdd can be written" in refused.err) == (2, True)


def test_the_files_say_the_same(run: Run, tmp_path: Path) -> None:
    path = str(station(tmp_path))
    told = run("device", "describe", path, "-o", "station.xdd", "--json").json
    assert told["class"] == "IoStation"
    run("device", "describe", path, "-o", "station.eds")
    one, other = load_description("station.eds"), load_description("station.xdd")
    assert list(one.dictionary) == list(other.dictionary)
    assert one.file_info.description == other.file_info.description == "16 inputs, 16 outputs, 2 + 2 analogue"
