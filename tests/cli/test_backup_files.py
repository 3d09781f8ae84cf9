"""Devices made of files, backed up, changed and restored by the command line over a bus: samples of ours, and real devices'."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from canopen_data.descriptions import load_description
from canopen_proto.datatypes import Value, is_integer, range_of
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.dictionary.roles import Role, roles_in
from canopen_proto.manager.parameters.backup import same_value
from tests.cli.backup_world import NODE, lasting
from tests.cli.cli_support import runner
from tests.vendor_files import ALL_NAMES, needs_vendor_files, path_of

STRANGE_PDOS = ("canopen-sample.eds", "cia-301.eds")
"""Their PDOs carry what they do not have, or have the CAN-ID of NMT: once off, they cannot be valid again."""
MAX_CHANGES = 25
STORE = (0x1010, 0x1011)


def changes(dictionary: ObjectDictionary, values: dict[int, Value]) -> Iterator[tuple[Variable, int]]:
    """Other values for settings: another heartbeat, PDOs off, and application objects at their limits.

    An object whose default is outside its own limits is left alone: no device could be set to that again.
    """
    roles = roles_in(dictionary, values)
    for variable in dictionary:
        value = values.get(variable.mux)
        if (
            roles[variable.mux] not in (Role.COMMUNICATION, Role.APPLICATION)
            or not variable.access.readable
            or not isinstance(value, int)
        ):
            continue
        bounds = range_of(variable.data_type)
        if bounds is None or not is_integer(variable.data_type):
            continue
        low = bounds[0] if variable.low_limit is None else int(variable.low_limit)
        high = bounds[1] if variable.high_limit is None else int(variable.high_limit)
        is_pdo = variable.index in range(0x1400, 0x1C00)
        if is_pdo and variable.subindex == 1 and variable.index & 0x200 == 0:
            yield variable, value | 0x8000_0000
        elif variable.index == 0x1017:
            yield variable, 250
        elif variable.index >= 0x2000 and low <= value <= high:
            yield variable, high if value != high else low


@pytest.mark.parametrize("name", ["sample_io.xdd", *(pytest.param(name, marks=needs_vendor_files) for name in ALL_NAMES)])
def test_a_device_is_backed_up_changed_and_restored(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = str(path_of(name).resolve()) if name in ALL_NAMES else name
    run = runner(capsys, monkeypatch, tmp_path)
    monkeypatch.chdir(tmp_path)
    dictionary = load_description(path).dictionary
    world = lasting(monkeypatch, dictionary)
    outcome = run("backup", *NODE, "-e", path, "-o", "before.dcf")
    assert outcome.status == 0, outcome.err
    assert run("compare", "5", "before.dcf", "-b", "demo").status == 0
    before = dict(world.values)
    changed = list(changes(dictionary, before))[-MAX_CHANGES:]
    if name in STRANGE_PDOS:
        changed = [(variable, value) for variable, value in changed if variable.index not in range(0x1400, 0x1C00)]
    world.values.update({variable.mux: value for variable, value in changed})
    count = sum(before[variable.mux] != value for variable, value in changed)
    found = run("compare", "5", "before.dcf", "-b", "demo", "--json")
    assert len(found.json) == count > 0
    outcome = run("restore", "5", "before.dcf", "-b", "demo", "--yes", "--verify")
    assert outcome.status == 0, outcome.err
    for key, value in before.items():
        if key >> 8 not in (*STORE, 0x1003):  # these are no settings, and the device makes their values
            variable = dictionary.variable((key >> 8, key & 0xFF))
            assert same_value(variable, world.values[key], value), variable.label
    assert run("compare", "5", "before.dcf", "-b", "demo").status == 0
