"""`canopen demo --eds`: drives made of a file, and the PDOs that it describes."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_data.configured import with_configured
from canopen_data.describing import describe
from canopen_data.description import Commissioning, DeviceInfo, FileKind
from canopen_data.eds.writer import write_eds
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.dictionary import Direction
from canopen_proto.drives.cia402.homing_methods import HOMING_METHODS
from canopen_proto.pdo.slots import described_pdos
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import Shape
from tests import vendor_files
from tests.cli.cli_support import SHORT, TWO, Alarm, Run, runner, watched_simulations


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))


@pytest.fixture
def simulations(monkeypatch: pytest.MonkeyPatch) -> list[SimulatedDevices]:
    return watched_simulations(monkeypatch, Alarm())


def written(path: Path, shape: Shape = Shape.SCHUNK_POWERBALL, values: dict[int, int] | None = None) -> str:
    """A DCF of a simulated drive, with values that differ from its defaults."""
    vendor = "SCHUNK GmbH" if shape is Shape.SCHUNK_POWERBALL else "Acme"
    description = describe(drive_dictionary(shape), device_info=DeviceInfo(vendor_name=vendor))
    described = with_configured(description, values or {}, Commissioning(node_id=3))
    path.write_text(write_eds(described, FileKind.DCF), encoding="utf-8")
    return str(path)


def tpdos(simulation: SimulatedDevices, node_id: int = 3) -> dict[int, list[int]]:
    """What the valid TPDOs of a drive carry: indices, by number."""
    pdos = described_pdos(simulation.drives[node_id].values.dictionary, node_id)
    return {each.number: [entry >> 16 for entry in each.entries] for each in pdos if each.direction is Direction.TPDO}


def joints(out: str) -> list[list[str]]:
    return [line.split() for line in out.splitlines() if line.startswith("joint") and "(" in line]


@pytest.mark.parametrize("shape", Shape)
def test_drives_made_of_a_file_home_and_move(run: Run, tmp_path: Path, shape: Shape) -> None:
    outcome = run("demo", *SHORT, "--eds", written(tmp_path / "drive.dcf", shape))
    assert outcome.status == 0, outcome.err
    assert [line[:2] for line in joints(outcome.out)] == [[f"joint{n}", str(n + 2)] for n in range(1, 7)]
    assert all("yes" in line for line in joints(outcome.out))
    assert "6 simulated drives made of" in outcome.err


def test_a_dcf_says_which_pdos_and_defaults_leave_that_out(run: Run, simulations: list[SimulatedDevices], tmp_path: Path) -> None:
    path = written(tmp_path / "drive.dcf", values={0x1A0000: 2, 0x1A0002: 0x60640020})
    assert run("demo", *TWO, "--eds", path).status == 0
    assert run("demo", *TWO, "--eds", path, "--defaults").status == 0
    assert [tpdos(simulation) for simulation in simulations] == [{1: [0x6041, 0x6064]}, {1: [0x6041, 0x6077, 0x6064]}]


def test_only_one_joint_of_a_file(run: Run, tmp_path: Path) -> None:
    outcome = run("demo", *TWO, "--eds", f"4={written(tmp_path / 'drive.dcf')}")
    assert outcome.status == 0, outcome.err


def test_a_file_whose_pdos_do_not_carry_the_set_points(run: Run, simulations: list[SimulatedDevices], tmp_path: Path) -> None:
    outcome = run("demo", *TWO, "--eds", written(tmp_path / "drive.dcf", values={0x160000: 1}))
    assert outcome.status == 0, outcome.err
    store = simulations[0].drives[3].values.store
    assert [store[0x160000], store[0x160001], store[0x160002]] == [2, 0x60400010, 0x60C10120]  # it has got another mapping


def test_a_file_of_a_drive_that_takes_no_set_points(run: Run, tmp_path: Path) -> None:
    outcome = run("demo", *TWO, "--eds", written(tmp_path / "drive.dcf", Shape.STANDARD, values={0x650200: 0x24}))
    assert outcome.status == 12
    assert "csp: 0x6502 of the drive lists pv, hm" in outcome.err
    assert "pp: 0x6502" in outcome.err


def test_a_file_of_no_drive(run: Run) -> None:
    outcome = run("demo", "--eds", "sample_io.xdd")
    assert outcome.status == 6
    assert "CO332" in outcome.err
    assert "statusword" in outcome.err


def test_defaults_of_nothing(run: Run) -> None:
    outcome = run("demo", "--defaults")
    assert outcome.status == 2
    assert "--eds" in outcome.err


@pytest.mark.parametrize(
    ("options", "carried"),
    [
        ((), {1: [0x6041, 0x6061], 3: [0x6064, 0x606C]}),
        (("--defaults",), {1: [0x6041, 0x6077, 0x6064]}),
    ],
)
def test_the_schunk_arm(
    run: Run, simulations: list[SimulatedDevices], options: tuple[str, ...], carried: dict[int, list[int]]
) -> None:
    path = vendor_files.path_of("schunk-powerball-lwa4p.dcf")
    outcome = run("demo", *TWO, "--eds", str(path), *options)
    assert outcome.status == 0, outcome.err
    assert all("yes" in line for line in joints(outcome.out))
    seen = tpdos(simulations[0])
    assert {number: seen[number] for number in carried} == carried


DRIVE_FILES = {
    "schunk-powerball-lwa4p.dcf": "interpolated position (ip)",
    "inovance-e35.eds": "cyclic synchronous position (csp)",
    "ros2-cia402-slave.eds": "interpolated position (ip)",
    "maxon-epos2.eds": "profile position (pp)",
    "cia-402.eds": "profile position (pp)",
    "faulhaber-605.3150.51-V.eds": "profile position (pp)",
    "faulhaber-605.3150.70-B.eds": "profile position (pp)",
}


@pytest.mark.parametrize("name", DRIVE_FILES)
def test_any_drives_file_moves(run: Run, simulations: list[SimulatedDevices], name: str) -> None:
    outcome = run("demo", *TWO, "--eds", str(vendor_files.path_of(name)))
    assert outcome.status == 0, outcome.err
    assert all("yes" in line for line in joints(outcome.out))
    assert f"✔ mode   {DRIVE_FILES[name]}: the first of csp, ip and pp that" in outcome.err


def test_zeros_in_0x60E3_are_no_list(run: Run, tmp_path: Path) -> None:
    """As in the files of maxon's EPOS4 and Elmo's Gold: the list is there, without values."""
    count = len(HOMING_METHODS)
    zeros = {0x60E3_00 + number: 0 for number in range(1, count + 1)}
    outcome = run("demo", *SHORT, "--eds", written(tmp_path / "drive.dcf", Shape.STANDARD, zeros))
    assert outcome.status == 0, outcome.err
    assert all("yes" in line for line in joints(outcome.out))


def test_drives_without_homing_are_not_homed(run: Run, tmp_path: Path) -> None:
    modes = 1 << 6 | 1 << 7  # ip, csp
    outcome = run("demo", *SHORT, "--eds", written(tmp_path / "drive.dcf", Shape.STANDARD, {0x6502_00: modes}))
    assert outcome.status == 0, outcome.err
    assert all("no" in line for line in joints(outcome.out))
    assert "6 joints without homing" in outcome.out + outcome.err
