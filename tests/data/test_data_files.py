"""The installed data files, a user's own ones before them, and what goes wrong with files and folders."""

from __future__ import annotations

from pathlib import Path

import pytest

import canopen_data
from canopen_data import CHAIN_FILES, DICTIONARY_FILES, DataError
from canopen_data.csv import DictionaryError
from canopen_data.findings import Severity
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, ConstantNotFoundError, Direction, Filler, ObjectDictionary
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.drives.cia402.modes import HomingStatus, describe_status
from canopen_proto.drives.cia402.names import names_in_mode


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home folder without any data files."""
    folder = tmp_path / "home"
    folder.mkdir()
    monkeypatch.setenv("HOME", str(folder))
    monkeypatch.setenv("USERPROFILE", str(folder))
    monkeypatch.delenv("CANOPEN_DATA", raising=False)
    return folder


@pytest.fixture(scope="module")
def dictionary() -> ObjectDictionary:
    return canopen_data.load_dictionary(Path(canopen_data.__file__).parent)[0]


# ---- what is installed ----


def test_the_only_warning_of_the_installed_files_is_the_one_of_the_manual() -> None:
    dictionary, findings = canopen_data.load_dictionary()
    assert [(each.code, each.source) for each in findings] == [("pdo-direction", "installed PDOs.csv")]
    assert "schunk_debug_rPDO" in findings[0].message
    assert dictionary.source == "installed indices.csv"


@pytest.mark.parametrize(
    ("alias", "index", "subindex", "data_type", "access"),
    [
        ("interpolation_data_record:ip_data_position", 0x60C1, 1, DataType.INTEGER32, Access.RW),
        ("sync_timeout_factor", 0x200E, 0, DataType.UNSIGNED8, Access.RW),
        ("controlword", 0x6040, 0, DataType.UNSIGNED16, Access.RW),
        ("statusword", 0x6041, 0, DataType.UNSIGNED16, Access.RO),
        ("modes_of_operation", 0x6060, 0, DataType.INTEGER8, Access.RW),
        ("modes_of_operation_display", 0x6061, 0, DataType.INTEGER8, Access.RO),
        ("torque_actual_value", 0x6077, 0, DataType.INTEGER16, Access.RO),
        ("position_actual_value", 0x6064, 0, DataType.INTEGER32, Access.RO),
        ("ip_time_units", 0x60C2, 1, DataType.UNSIGNED8, Access.RW),
        ("ip_time_index", 0x60C2, 2, DataType.INTEGER8, Access.RW),
        ("NMT", 0, 0, DataType.UNSIGNED8, Access.WO),
    ],
)
def test_the_objects_of_the_manual(
    dictionary: ObjectDictionary, alias: str, index: int, subindex: int, data_type: DataType, access: Access
) -> None:
    found = dictionary.variable(alias)
    assert (found.index, found.subindex, found.data_type, found.access) == (index, subindex, data_type, access)


def test_objects_that_a_master_needs_are_there(dictionary: ObjectDictionary) -> None:
    for index, *subindices in (
        (0x1000,), (0x1001,), (0x1003, 0, 1), (0x1005,), (0x1008,), (0x1014,), (0x1017,), (0x1018, 1, 2, 3, 4), (0x1019,),
        (0x603F,), (0x605A,), (0x605D,), (0x6007,), (0x6065,), (0x606C,), (0x607A,), (0x607C,), (0x607D, 1, 2), (0x6081,),
        (0x6083,), (0x6084,), (0x6085,), (0x6098,), (0x6099, 1, 2), (0x60F4,), (0x60FF,), (0x6502,),
    ):  # fmt: skip
        for subindex in subindices or [0]:
            assert dictionary.get(index, subindex) is not None


def test_aliases_are_the_names_of_the_standard(dictionary: ObjectDictionary) -> None:
    for variable in dictionary:
        standard = find_standard(variable.index, variable.subindex)
        if variable.index != 0x200E:
            assert standard is not None
            assert variable.name in standard.names


@pytest.mark.parametrize(
    ("alias", "constant", "mask", "value"),
    [
        ("NMT", "stop_remote_node", 0xFF, 0x02),
        ("NMT", "start_remote_node", 0xFF, 0x01),
        ("NMT", "enter_pre_operational", 0xFF, 0x80),
        ("NMT", "reset_application", 0xFF, 0x81),
        ("NMT", "reset_communication", 0xFF, 0x82),
        ("controlword", "disable_voltage", 0xFFFF, 0x01),
        ("controlword", "sm_shutdown", 0xFFFF, 0x06),
        ("controlword", "sm_switch_on", 0xFFFF, 0x07),
        ("controlword", "sm_enable_operation", 0xFFFF, 0x0F),
        ("controlword", "start_homing", 0xFFFF, 0x1F),
        ("controlword", "enable_ip_mode", 0xFFFF, 0x1F),
        ("controlword", "reset_fault_0", 0xFFFF, 0x00),
        ("controlword", "reset_fault_1", 0xFFFF, 0x80),
        ("statusword", "not_ready_to_switch_on", 0x4F, 0x00),
        ("statusword", "switch_on_disabled", 0x4F, 0x40),
        ("statusword", "ready_to_switch_on", 0x6F, 0x21),
        ("statusword", "switched_on", 0x6F, 0x23),
        ("statusword", "operation_enable", 0x6F, 0x27),
        ("statusword", "quick_stop_active", 0x6F, 0x07),
        ("statusword", "fault_reaction_active", 0x4F, 0x0F),
        ("statusword", "fault_ds402", 0x4F, 0x08),
        ("statusword", "voltage_enabled", 0x10, 0x10),
        ("statusword", "warning", 0x80, 0x80),
        ("statusword", "drive_is_moving", 0x100, 0x100),
        ("statusword", "remote", 0x200, 0x200),
        ("statusword", "target_reached", 0x400, 0x400),
        ("statusword", "internal_limit_active", 0x800, 0x800),
        ("statusword", "set_point_acknowledge", 0x1000, 0x1000),
        ("statusword", "speed_0", 0x1000, 0x1000),
        ("statusword", "homing_attained", 0x1000, 0x1000),
        ("statusword", "ip_mode_active", 0x1000, 0x1000),
        ("statusword", "following_error", 0x2000, 0x2000),
        ("statusword", "homing_error", 0x2000, 0x2000),
        ("statusword", "manufacturer_statusbit", 0x4000, 0x4000),
        ("statusword", "drive_referenced", 0x8000, 0x8000),
        *[
            (alias, name, 0xFF, value)
            for alias in ("modes_of_operation", "modes_of_operation_display")
            for name, value in (
                ("homing_mode", 6), ("profile_position_mode", 1), ("velocity_mode", 2), ("profile_velocity_mode", 3),
                ("torque_profile_mode", 4), ("interpolated_position_mode", 7), ("hm", 6), ("csp", 8), ("csv", 9), ("cst", 10),
            )
        ],
        ("ip_time_index", "milliseconds", 0xFF, 0xFD),
        ("ip_time_index", "hundredmicroseconds", 0xFF, 0xFC),
        ("supported_drive_modes", "ip", 0x40, 0x40),
        ("quick_stop_option_code", "quick_stop_ramp_and_stay", 0xFFFF, 6),
    ],
)  # fmt: skip
def test_the_constants_of_the_manual(dictionary: ObjectDictionary, alias: str, constant: str, mask: int, value: int) -> None:
    found = dictionary.constant(alias, constant)
    assert (found.mask, found.value) == (mask, value)


def test_exactly_one_state_in_each_status_word(dictionary: ObjectDictionary) -> None:
    states = {"not_ready_to_switch_on", "switch_on_disabled", "ready_to_switch_on", "switched_on", "operation_enable",
              "quick_stop_active", "fault_reaction_active", "fault_ds402"}  # fmt: skip
    for status_word in range(0x80):
        assert len(states.intersection(dictionary.names_of(0x6041, status_word))) <= 1
    assert dictionary.names_of(0x6041, 0x0250) == ("switch_on_disabled", "voltage_enabled", "remote")


def test_the_pdos_of_the_manual(dictionary: ObjectDictionary) -> None:
    rpdo, tpdo, debug = (dictionary.pdo(name) for name in ("schunk_default_rPDO", "schunk_default_tPDO", "schunk_debug_rPDO"))
    names = [[entry.name for entry in pdo.entries] for pdo in (rpdo, tpdo, debug)]
    assert names == [
        ["controlword", "notused16", "interpolation_data_record:ip_data_position"],
        ["statusword", "torque_actual_value", "position_actual_value"],
        ["notused64"],
    ]
    assert [(pdo.cob_base, pdo.direction) for pdo in (rpdo, tpdo, debug)] == [
        (0x200, Direction.RPDO), (0x180, Direction.TPDO), (0x480, Direction.TPDO),
    ]  # fmt: skip
    assert all(pdo.bit_length == 64 for pdo in dictionary.pdos)
    assert dictionary.fillers["notused32"] == Filler("notused32", 32)


def test_every_value_is_written_with_0x() -> None:
    for name in ("indices.csv", "constants.csv"):
        for line in canopen_data.read(name).text.splitlines():
            if line.strip() and not line.startswith("#"):
                numbers = line.split()[1:3] if name == "indices.csv" else line.split()[2:]
                assert all(number.startswith("0x") for number in numbers)


def test_the_chain_files_of_the_manual() -> None:
    assert canopen_data.read_chain_file("single_device.csv").text.split() == ["chain1", "joint1", "/dev/pcan32", "12"]
    joints = [part for number in range(1, 7) for part in (f"joint{number}", "/dev/pcan32", str(number + 2))]
    assert canopen_data.read_chain_file("multiple_devices.csv").text.split() == ["arm1", *joints]


# ---- a user's own files ----


def test_a_file_in_the_home_folder_goes_before_the_installed_one(home: Path) -> None:
    (home / ".canopen").mkdir()
    own = home / ".canopen" / "PDOs.csv"
    own.write_text("mine_tPDO 0x280 statusword torque_actual_value position_actual_value\n")
    dictionary, findings = canopen_data.load_dictionary()
    assert [pdo.name for pdo in dictionary.pdos] == ["mine_tPDO"]
    assert [str(each) for each in findings] == [f"{own}: notice: used instead of the installed PDOs.csv [user-file]"]
    assert findings[0].severity is Severity.NOTICE


def test_the_argument_goes_before_the_environment_and_that_before_the_home_folder(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = [home / ".canopen", tmp_path / "environment", tmp_path / "argument"]
    assert canopen_data.user_folder() is None
    for folder in folders:
        folder.mkdir()
    assert canopen_data.user_folder() == folders[0]
    monkeypatch.setenv("CANOPEN_DATA", str(folders[1]))
    assert canopen_data.user_folder() == folders[1]
    assert canopen_data.user_folder(folders[2]) == folders[2]
    assert canopen_data.user_folder(str(folders[2])) == folders[2]
    assert canopen_data.user_folder("~/.canopen") == folders[0]
    assert canopen_data.load_dictionary(folders[2])[0].source == "installed indices.csv"  # nothing of the user's there


def test_errors_in_a_users_file_name_its_path(tmp_path: Path) -> None:
    (tmp_path / "indices.csv").write_text("statusword 0x6041 0x0 2 ro\nstatusword 0x6041 0x0 2 ro\n")
    (tmp_path / "constants.csv").write_text("")
    (tmp_path / "PDOs.csv").write_text("")
    with pytest.raises(DictionaryError) as caught:
        canopen_data.load_dictionary(tmp_path)
    assert str(caught.value).splitlines() == [
        f"CO301: {tmp_path / 'indices.csv'}:2:1: error: 'statusword' is in line 1 already [duplicate-alias]",
        "  try:   correct the file",
        "  or:    `canopen data init --force` replaces your files by the installed ones",
    ]


def test_the_issues_example_by_names(dictionary: ObjectDictionary) -> None:
    assert dictionary.value_from("controlword", "sm_shutdown") == 6
    assert dictionary.matches("statusword", "operation_enable", 0x0637)
    with pytest.raises(ConstantNotFoundError, match="has no constant 'operation_enabled'; did you mean operation_enable"):
        dictionary.matches("statusword", "operation_enabled", 0x0637)


def test_a_chain_file_by_path_by_name_and_a_users_one(tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "my.csv"
    path.write_text("chain1 joint1 can0 5\n")
    by_path = canopen_data.read_chain_file(path)
    assert (by_path.name, by_path.text, by_path.source, by_path.notice) == ("my.csv", "chain1 joint1 can0 5\n", str(path), None)
    assert canopen_data.read_chain_file("my.csv", tmp_path).notice is None
    assert canopen_data.read("single_device.csv").source == "installed single_device.csv"
    monkeypatch.chdir(tmp_path)
    assert canopen_data.read_chain_file("my.csv").text == by_path.text
    with pytest.raises(DataError) as caught:
        canopen_data.read_chain_file("no.csv", tmp_path)
    assert (caught.value.code, caught.value.failed) == ("CO330", f"there is no data file 'no.csv' in {tmp_path}")
    assert caught.value.tries == ("use one of indices.csv, constants.csv, PDOs.csv, single_device.csv, multiple_devices.csv",)
    with pytest.raises(DataError, match=r"there is no data file '__init__\.py'\n  try:   use one of"):
        canopen_data.read("__init__.py")


# ---- what goes wrong ----


def test_a_folder_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DataError, match=r"the data folder .*/nowhere does not exist\n  try:   `canopen data init` makes one"):
        canopen_data.load_dictionary(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="is not a folder"):
        canopen_data.load_dictionary(tmp_path / "file")
    monkeypatch.setenv("CANOPEN_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(DataError, match=r"the data folder .*/nowhere \(\$CANOPEN_DATA\) does not exist"):
        canopen_data.load_dictionary()


def test_files_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "indices.csv").mkdir()
    with pytest.raises(DataError, match=r"cannot read .*indices\.csv: .*\n  try:   check that it is a file"):
        canopen_data.load_dictionary(tmp_path)
    (tmp_path / "PDOs.csv").write_bytes(b"# f\xfcr\n")
    with pytest.raises(DataError, match=r"PDOs\.csv is not UTF-8 text: line 1 has the byte 0xFC\n  try:   save it as UTF-8"):
        canopen_data.read("PDOs.csv", tmp_path)
    with pytest.raises(DataError, match="cannot read .*: embedded null byte"):
        canopen_data.read("a\0b", tmp_path)
    monkeypatch.setattr(canopen_data, "MAX_FILE_SIZE", 1024**2)
    (tmp_path / "constants.csv").write_bytes(b"#" * (1024**2 + 1))
    with pytest.raises(DataError, match=r"constants\.csv is larger than 1 MiB"):
        canopen_data.read("constants.csv", tmp_path)


def test_without_a_home_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_home(*_: object) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", no_home)
    monkeypatch.setattr(Path, "expanduser", no_home)
    assert canopen_data.load_dictionary()[0].source == "installed indices.csv"
    with pytest.raises(DataError, match=r"there is no home folder\n  try:   name a folder, or set \$CANOPEN_DATA"):
        canopen_data.init()
    with pytest.raises(DataError, match="there is no home folder for ~/data"):
        canopen_data.init("~/data")


# ---- init ----


def test_init_copies_to_the_home_folder_and_says_so(home: Path) -> None:
    copied = canopen_data.init()
    assert [(each.path, each.action) for each in copied] == [
        (home / ".canopen" / name, "created") for name in (*DICTIONARY_FILES, *CHAIN_FILES)
    ]
    dictionary, findings = canopen_data.load_dictionary()
    assert len(dictionary) == len(canopen_data.load_dictionary(Path(canopen_data.__file__).parent)[0])
    assert [each.severity for each in findings] == [Severity.NOTICE] * 3 + [Severity.WARNING]


def test_init_never_overwrites_without_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CANOPEN_DATA", str(tmp_path / "deep" / "data"))
    canopen_data.init()
    own = tmp_path / "deep" / "data" / "indices.csv"
    own.write_text("statusword 0x6041 0x0 2 ro\n")
    assert [each.action for each in canopen_data.init()] == ["kept", "unchanged", "unchanged", "unchanged", "unchanged"]
    assert own.read_text() == "statusword 0x6041 0x0 2 ro\n"
    assert [each.action for each in canopen_data.init(force=True)] == ["replaced"] + ["unchanged"] * 4
    assert own.read_text() == canopen_data.read("indices.csv", Path(canopen_data.__file__).parent).text


def test_init_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for target in (tmp_path / "file", tmp_path / "file" / "below", "a\0b"):
        with pytest.raises(DataError, match="cannot copy the data files to .*\n  try:   `canopen data init -o FOLDER`"):
            canopen_data.init(target)


# ---- a user's own files beside installed ones ----


@pytest.mark.parametrize("mode", [None, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, -3])
def test_a_bit_of_the_statusword_is_called_as_in_the_mode_that_is_active(dictionary: ObjectDictionary, mode: int | None) -> None:
    """Bits 12 and 13 have one name at most, and the texts for people say as much."""
    told = {
        "set_point_acknowledge": "set-point acknowledged", "speed_0": "speed is zero", "ip_mode_active": "interpolation active",
        "drive_follows_command": "follows the command", "following_error": "following error",
        "homing_attained": HomingStatus.ATTAINED, "homing_error": HomingStatus.ERROR_MOVING,
    }  # fmt: skip
    for bit in (0x1000, 0x2000):
        others = dictionary.names_of("statusword", 0x27)
        (*names,) = (each for each in names_in_mode(dictionary.names_of("statusword", 0x27 | bit), mode) if each not in others)
        words = describe_status(0x27 | bit, mode)
        assert [told[name] for name in names] == [word for word in words if word in told.values()]
        assert len(names) <= 1


def test_an_indices_csv_of_few_objects_goes_with_the_installed_files(tmp_path: Path) -> None:
    (tmp_path / "indices.csv").write_text("statusword 0x6041 0x00 2 ro\nmy_object 0x2000 0x01 4 rw\n", "utf-8")
    dictionary, findings = canopen_data.load_dictionary(tmp_path)
    assert "operation_enable" in dictionary.names_of("statusword", 0x27)
    assert "my_object" in dictionary
    assert dictionary.pdos == ()
    left_out = [each for each in findings if each.code == "left-out"]
    assert [(each.severity, each.source) for each in left_out] == [
        (Severity.NOTICE, "installed constants.csv"),
        (Severity.NOTICE, "installed PDOs.csv"),
    ]


def test_errors_of_a_users_file_are_not_buried_under_what_follows_from_them(tmp_path: Path) -> None:
    (tmp_path / "indices.csv").write_text("statusword 0x6041 0x00 uint16 ro\n", "utf-8")
    with pytest.raises(DictionaryError, match="length 'uint16'") as caught:
        canopen_data.load_dictionary(tmp_path)
    assert [each.source for each in caught.value.findings] == [str(tmp_path / "indices.csv")]


def test_a_byte_order_mark_is_no_part_of_the_first_word(tmp_path: Path) -> None:
    (tmp_path / "arm.csv").write_text("chain1 joint1 can0 12\r\n", "utf-8-sig", newline="")
    assert canopen_data.read_chain_file(tmp_path / "arm.csv").text.startswith("chain1 ")
