"""Where simulated devices keep what they store."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_master.simulation.parameter_keeper import MAX_FILE_SIZE, ParameterKeeper, StateFileError
from canopen_proto.lss.messages import LssConfiguration

PARAMETERS = {0x101700: b"\xf4\x01", 0x200105: b""}


def test_in_memory() -> None:
    keeper = ParameterKeeper()
    assert keeper.kept(5) is None
    keeper.keep(5, PARAMETERS)
    assert keeper.kept(5) == PARAMETERS
    keeper.keep(5, {})
    assert keeper.kept(5) == {}


def test_in_a_file(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    keeper = ParameterKeeper(path)
    keeper.keep(5, PARAMETERS)
    keeper.keep(6, {})
    assert '"5": {\n   "1017:00": "F401",\n   "2001:05": ""\n  }' in path.read_text()
    again = ParameterKeeper(path)
    assert (again.kept(5), again.kept(6), again.kept(7)) == (PARAMETERS, {}, None)
    (tmp_path / "link.json").symlink_to(path)
    ParameterKeeper(tmp_path / "link.json").keep(7, PARAMETERS)
    assert ParameterKeeper(path).kept(7) == PARAMETERS
    assert {each.name for each in tmp_path.iterdir() if each.is_symlink()} == {"link.json"}
    assert {each.name for each in tmp_path.iterdir()} == {"state.json", "link.json"}


def test_what_cannot_be_written_changes_nothing(tmp_path: Path) -> None:
    keeper = ParameterKeeper(tmp_path / "gone" / "state.json")
    with pytest.raises(FileNotFoundError):
        keeper.keep(5, PARAMETERS)
    assert keeper.kept(5) is None


GOOD = '{"format": "canopen-sim-state 1", "devices": %s}'


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("", "it is not JSON"),
        ("[" * 100_000, "it is not JSON"),
        ("5", 'it does not say "format"'),
        ('{"format": "other"}', 'it does not say "format"'),
        (GOOD % "5", "its devices are not valid"),
        (GOOD % '{"x": {}}', "its devices are not valid"),
        (GOOD % '{"5": 5}', "its devices are not valid"),
        (GOOD % '{"5": {"1017": "00"}}', "'1017' is not an object"),
        (GOOD % '{"5": {"1017:00": "0"}}', "its devices are not valid"),
        (GOOD % '{"5": {"1017:00": 5}}', "its devices are not valid"),
        (" " * (MAX_FILE_SIZE + 1), "it has more than"),
    ],
    ids=range(11),
)
def test_files_that_are_none_of_ours(tmp_path: Path, text: str, seen: str) -> None:
    path = tmp_path / "state.json"
    path.write_text(text)
    with pytest.raises(StateFileError, match=seen):
        ParameterKeeper(path)


def test_what_lss_stores_is_kept_beside_the_parameters(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    keeper = ParameterKeeper(path)
    keeper.keep_lss(255, LssConfiguration(5, 250))
    keeper.keep(7, PARAMETERS)
    again = ParameterKeeper(path)
    assert (again.kept_lss(255), again.kept_lss(7), again.kept(7)) == (LssConfiguration(5, 250), None, PARAMETERS)


@pytest.mark.parametrize("entry", ["5", '{"node_id": 5}', '{"node_id": 128, "bit_rate": 0}', '{"node_id": "5", "bit_rate": 0}'])
def test_an_lss_entry_that_is_none_is_an_error(tmp_path: Path, entry: str) -> None:
    path = tmp_path / "state.json"
    path.write_text('{"format": "canopen-sim-state 1", "devices": {}, "lss": {"255": ' + entry + "}}")
    with pytest.raises(StateFileError, match="not valid"):
        ParameterKeeper(path)
