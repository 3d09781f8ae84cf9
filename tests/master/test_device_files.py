"""Simulated devices made of files by a program: what is told, and the errors of entries that cannot be served."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_data import DataError
from canopen_data.named_files import UnusableFileError, open_description, read_text
from canopen_master.errors import DeviceRefusedError, NoDriveInFileError
from canopen_master.machine_file import parse_machine
from canopen_master.simulated_machine import devices_of_machine, drives_of_machine
from canopen_master.simulation.device_files import FileRead, MakingEvent, ModelMade, models_of, read_plant
from canopen_master.simulation.drive_files import drive_of
from canopen_master.simulation.plant import DeviceEntry
from canopen_proto.simulation.drive.settings import Shape

DRIVE, IO = "sample_drive.eds", "sample_io.eds"


def test_each_device_and_its_file_are_told() -> None:
    told: list[MakingEvent] = []
    models = models_of([DeviceEntry(DRIVE, (5, 6)), DeviceEntry(IO, (7,), values={"1017": 500})], told.append)
    assert [(each.node_id, each.drive is not None) for each in models] == [(5, True), (6, True), (7, False)]
    assert [event.file.path for event in told if isinstance(event, FileRead)] == [DRIVE, IO]
    assert [event.model for event in told if isinstance(event, ModelMade)] == models
    heartbeat = models[2].dictionary.get(0x1017)
    assert heartbeat is not None
    assert heartbeat.configured == 500


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ([DeviceEntry(IO)], "CO127: which node-ID is sample_io.eds to have?\n  seen:  the file names none"),
        (
            [DeviceEntry(IO, (5,)), DeviceEntry(DRIVE, (5,))],
            f"CO127: there are two devices of node-ID 5: of {IO} and of {DRIVE}\n",
        ),
        ([DeviceEntry(IO, (5,), values={"1017": 70_000})], "CO127: sample_io.eds: values: "),
        ([DeviceEntry(IO, (5,), values={"2FFF": 1})], "CO127: sample_io.eds: values: "),
    ],
)
def test_an_entry_that_cannot_be_served(entries: list[DeviceEntry], said: str) -> None:
    with pytest.raises(DeviceRefusedError) as caught:
        models_of(entries)
    assert str(caught.value).startswith(said)


def test_a_file_of_no_drive() -> None:
    with pytest.raises(NoDriveInFileError, match="sample_io.eds cannot be a simulated drive: it has no"):
        models_of([DeviceEntry(IO, (5,), profile="402")])
    with pytest.raises(NoDriveInFileError, match="sample_io.eds describes no drive that can be moved: it has no"):
        drive_of(open_description(IO).description)


def test_paths_of_a_plant_file_are_beside_it(tmp_path: Path) -> None:
    (tmp_path / "own.eds").write_bytes(open_description(IO).data)
    path = tmp_path / "plant.toml"
    path.write_text('state = "s.json"\n[[device]]\nfile = "own.eds"\nscript = "a.py"\n[[device]]\nfile = "sample_drive.eds"\n')
    plant = read_plant(path)
    assert plant.state == str(tmp_path / "s.json")
    assert [(each.file, each.script) for each in plant.devices] == [
        (str(tmp_path / "own.eds"), str(tmp_path / "a.py")),
        (DRIVE, ""),
    ]


def test_a_text_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(UnusableFileError, match="CO330: there is no file ") as caught:
        read_text(tmp_path / "none")
    assert caught.value.tries == ("check the path",)
    (tmp_path / "latin").write_bytes(b"\xe4")
    with pytest.raises(DataError, match="is not UTF-8 text: line 1 has the byte 0xE4"):
        read_text(tmp_path / "latin")


def test_the_devices_and_the_drives_of_a_machine() -> None:
    machine = parse_machine(
        """
        [buses]
        main = { locator = "virtual:a" }
        other = { locator = "virtual:b" }
        [nodes.elbow]
        bus = "main"
        id = 3
        file = "sample_drive.eds"
        shape = "schunk"
        [nodes.io]
        bus = "main"
        id = 7
        file = "sample_io.eds"
        [nodes.joint]
        bus = "other"
        id = 3
        [joints.elbow]
        node = "elbow"
        [joints.wrist]
        node = "joint"
        """
    )
    made = devices_of_machine(machine)
    assert {name: (locator, len(makers)) for name, (locator, makers) in made.items()} == {
        "main": ("virtual:a", 2),
        "other": ("virtual:b", 1),
    }
    assert list(devices_of_machine(machine, {"other": "virtual:c"})) == ["other"]
    assert {name: file.shape for name, file in drives_of_machine(machine).items()} == {"elbow": Shape.SCHUNK_POWERBALL}
