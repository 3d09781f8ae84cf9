"""Typed views of devices: a key for every object, under one name each, whatever the file is called in."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given

from canopen_data import load_dictionary
from canopen_data.description import DeviceDescription, DeviceInfo, FileKind
from canopen_data.descriptions import load_description_with_names, samples, with_names
from canopen_data.reading import read_description
from canopen_data.stubs import identifier, stubs_of
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, ObjectType, ReadOnly, ReadWrite, Variable, WriteOnly
from canopen_testing.strategies import device_descriptions
from tests import type_checkers
from tests.examples import examples
from tests.vendor_files import ALL_NAMES, load, needs_vendor_files

KINDS = {Access.RO: ReadOnly, Access.CONST: ReadOnly, Access.WO: WriteOnly}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("Position actual value", "position_actual_value"),
        ("COB-ID SYNC", "cob_id_sync"),
        ("  Output  1..8 (bits) ", "output_1_8_bits"),
        ("24V supply", "n24v_supply"),
        ("class", "class_"),
        ("Float", "float_"),
        ("Größe in µm", "größe_in_μm"),
        ("", "unnamed"),
        ("***", "unnamed"),
        ('"""\nimport os', "import_os"),
    ],
)
def test_names(name: str, expected: str) -> None:
    assert identifier(name) == expected
    assert identifier(expected).rstrip("_") == expected.rstrip("_")


def view_of(text: str) -> Any:
    """What the text makes, run as it stands. No name of the file gets to run."""
    names: dict[str, Any] = {}
    exec(compile(text, "view.py", "exec"), names)
    return names["View"]


def keys_of(view: Any) -> Iterator[tuple[str, Any]]:
    for name, value in vars(view).items():
        if isinstance(value, ReadOnly | ReadWrite | WriteOnly):
            yield name, value
        elif isinstance(value, type):
            yield from ((f"{name}.{field}", key) for field, key in keys_of(value))


def check(description: DeviceDescription) -> Any:
    """Every object has a key of its own, which leads to it and has its access."""
    made = stubs_of(description, "View")
    view = view_of(made.text)
    keys = dict(keys_of(view))
    dictionary = description.dictionary
    assert len(keys) == made.count == len(dictionary)
    assert sorted(keys.values()) == sorted(variable.mux for variable in dictionary)
    for key in keys.values():
        variable = dictionary.variable((key >> 8, key & 0xFF))
        assert type(key) is KINDS.get(variable.access, ReadWrite)
        if key >= 0x100000:
            assert dictionary.variable(key) is variable
    for collision in made.collisions:
        assert len(set(collision.names.values())) == len(collision.names) > 1
    return view


@given(device_descriptions())
@examples(40)
def test_any_description(description: DeviceDescription) -> None:
    check(description)


@pytest.mark.parametrize("name", samples())
def test_the_samples(name: str) -> None:
    view = check(load_description_with_names(name))
    assert view.identity_object.vendor_id == 0x101801
    assert view.producer_heartbeat_time == 0x101700


@needs_vendor_files
@pytest.mark.parametrize("name", ALL_NAMES)
def test_files_of_makers(name: str) -> None:
    check(with_names(read_description(load(name), name), load_dictionary()[0]))


def described(*objects: Object) -> DeviceDescription:
    return DeviceDescription(
        ObjectDictionary(objects), FileKind.EDS, "folder/drive.eds", device_info=DeviceInfo("Maker", product_name="Drive")
    )


def one(index: int, name: str, data_type: DataType = DataType.UNSIGNED8, **more: Any) -> Object:
    return Object.of(name, [Variable(index, 0, name, data_type, **more)])


def test_names_that_are_shared() -> None:
    fields = [Variable(0x2100, subindex, "Value", DataType.UNSIGNED8) for subindex in (1, 2)]
    description = described(
        one(0x2000, "Speed"), one(0x2001, "speed"), one(0x2002, "Speed 2000"), one(0x6041, "Word"), one(0x6841, "Word"),
        Object.of("Table", fields, ObjectType.ARRAY), one(0x2200, "int"), one(0x2201, "Int"),
    )  # fmt: skip
    view = check(description)
    assert (view.speed_2000_, view.speed_2001, view.speed_2000) == (0x200000, 0x200100, 0x200200)
    assert (view.word, view.word_6841, view.table.value_01) == (0x604100, 0x684100, 0x210001)
    assert (view.int_2200, view.int_2201) == (0x220000, 0x220100)
    shared = {each.name: each.names for each in stubs_of(description, "View").collisions}
    assert shared["word"] == {"0x6041:00": "word", "0x6841:00": "word_6841"}
    assert shared["table.value"] == {"0x2100:01": "table.value_01", "0x2100:02": "table.value_02"}
    assert shared.keys() == {"speed", "word", "table.value", "int_"}


def test_what_an_ide_shows() -> None:
    description = described(
        one(
            0x6064,
            "Position",
            DataType.INTEGER32,
            access=Access.RO,
            unit="deg",
            factor=0.001,
            low_limit=-5,
            default=3,
            pdo_mappable=True,
        ),
        one(0x1014, "COB-ID", DataType.UNSIGNED32, default=0x80, adds_node_id=True, description='a "quoted"\\ text'),
    )
    text = stubs_of(description, "View").text
    assert (
        '    position = ReadOnly[int](0x6064_00)\n    """0x6064:00 Position, INTEGER32, 0.001 deg, -5.., default 3, PDO"""'
        in text
    )
    assert 'default node-ID + 128. a \\"quoted\\"\\\\ text"""' in text
    assert text.startswith('"""Made by `canopen eds stubs` of drive.eds:')
    assert "datetime" not in text
    with_time = stubs_of(described(one(0x2000, "Time", DataType.TIME_OF_DAY)), "View").text
    assert "import datetime\n" in with_time
    assert "time = ReadWrite[datetime.datetime](0x2000_00)" in with_time
    assert view_of(stubs_of(described(), "View").text).__doc__ == "Maker Drive"


def test_a_file_cannot_have_code_run() -> None:
    evil = '"""\nraise SystemExit("run")\n"""'
    description = replace(
        described(one(0x2000, evil, description=evil, unit=evil), Object.of(evil, [Variable(0x2001, 1, evil, DataType.REAL32)])),
        source=evil, device_info=DeviceInfo(evil, product_name=evil),
    )  # fmt: skip
    check(description)


USE = """
from canopen_master import Node
from canopen_master.blocking import BlockingNode, open_master
from canopen_proto import EmcyReceived, PdoReceived, Procedure, RemoteNode
from canopen_proto.procedures import read, write
from drive import Drive
from station import Station


async def right(node: Node, pdo: PdoReceived) -> tuple[int, str, bytes | None, int | None]:
    await node.write(Drive.controlword, 6)
    await node.write("controlword", "sm_shutdown")
    await node.write(Station.filter_time, 5)
    return await node.read(Drive.statusword), await node.read(Drive.manufacturer_device_name), None, pdo.get(Drive.statusword)


def steps(node: RemoteNode) -> Procedure[int]:
    yield from write(node, Drive.controlword, 6)
    return (yield from read(node, Drive.identity_object.vendor_id))


async def wrong(node: Node, pdo: PdoReceived) -> str:
    await node.read(Drive.statuswort)  # type: ignore[attr-defined]
    await node.read(Drive.identity_object.vendor)  # type: ignore[attr-defined]
    await node.write(Drive.statusword, 6)  # type: ignore[call-overload]
    await node.write(Drive.controlword, "six")  # type: ignore[misc]
    await node.write(Drive.controlword, 6.5)  # type: ignore[misc]
    value: str | None = pdo.get(Drive.statusword)  # type: ignore[assignment]
    text: str = await node.read(Drive.statusword)  # type: ignore[arg-type]
    return value or text


def blocking(node: BlockingNode, pdo: PdoReceived) -> tuple[int, str, EmcyReceived]:
    node[Drive.controlword] = 6
    node["controlword"] = "sm_shutdown"
    node.write(Drive.controlword, 6, timeout=1.0)
    node.on(EmcyReceived, lambda emergency: print(emergency.code))
    with node.events(EmcyReceived) as emergencies:
        return node[Drive.statusword], node.read(Drive.manufacturer_device_name), emergencies.receive()


def wrong_blocking(node: BlockingNode) -> str:
    node[Drive.statusword] = 6  # type: ignore[call-overload]
    node[Drive.controlword] = "six"  # type: ignore[misc]
    node.read_int("statusword", timeout="1")  # type: ignore[arg-type]
    node.reed("statusword")  # type: ignore[attr-defined]
    node.on(EmcyReceived, lambda emergency: emergency.kode)  # type: ignore[attr-defined]
    with open_master("virtual:demo", sdo_timeout="1") as master:  # type: ignore[arg-type]
        number: int = master.node(5).read_str("device_name")  # type: ignore[assignment]
    text: str = node[Drive.statusword]  # type: ignore[assignment]
    return text or str(number)


def wrong_steps(node: RemoteNode) -> Procedure[str]:
    yield from write(node, Drive.statusword, 6)  # type: ignore[call-overload]
    return (yield from read(node, Drive.statusword))  # type: ignore[return-value]
"""


def write_samples(folder: Path) -> list[Path]:
    """The views of two samples, and what somebody writes with them."""
    files = {"drive.py": ("sample_drive.eds", "Drive"), "station.py": ("sample_io.eds", "Station")}
    for file, (sample, name) in files.items():
        (folder / file).write_text(stubs_of(load_description_with_names(sample), name).text, encoding="utf-8")
    (folder / "use.py").write_text(USE, encoding="utf-8")
    return [folder / file for file in (*files, "use.py")]


@pytest.mark.thorough
@type_checkers.LONG
@pytest.mark.parametrize("checker", [type_checkers.MYPY, type_checkers.PYRIGHT])
def test_type_checkers_take_what_is_right_and_refuse_each_mistake(
    checker: str, pytestconfig: pytest.Config, tmp_path: Path
) -> None:
    type_checkers.check(checker, write_samples(tmp_path), pytestconfig, tmp_path)


KEY = re.compile(r"^( *)(?:class (\w+):|(\w+) = (ReadOnly|ReadWrite|WriteOnly)\[([\w.]+)\])", re.MULTILINE)


def uses_of(module: str, text: str) -> Iterator[str]:
    """Functions that use one key of each kind and type, rightly and wrongly, and names that are not there."""
    yield f"import {module}\nprint({module}.View.no_such_object)  # type: ignore"
    seen = set()
    path = [module]
    for indent, holder, name, kind, type_of_value in KEY.findall(text):
        del path[1 + len(indent) // 4 :]
        if holder:
            path.append(holder)
            if len(path) > 2:
                yield f"print({'.'.join(path)}.no_such_field)  # type: ignore"
        elif (kind, type_of_value) not in seen:
            seen.add((kind, type_of_value))
            key = ".".join((*path, name))
            yield f"""
async def {module}_{len(seen)}(node: Node, value: {type_of_value}) -> {type_of_value}:
    await node.write({key}, value){"  # type: ignore" if kind == "ReadOnly" else ""}
    await node.write({key}, None)  # type: ignore
    wrong: list[None] = await node.read({key})  # type: ignore
    print(wrong)
    return await node.read({key}){"  # type: ignore" if kind == "WriteOnly" else ""}
"""


@needs_vendor_files
@pytest.mark.thorough
@type_checkers.LONG
@pytest.mark.parametrize("checker", [type_checkers.MYPY, type_checkers.PYRIGHT])
def test_type_checkers_on_files_of_makers(checker: str, pytestconfig: pytest.Config, tmp_path: Path) -> None:
    use = ["import datetime\nfrom canopen_master import Node\nprint(datetime)"]
    files = []
    for number, name in enumerate(ALL_NAMES):
        text = stubs_of(with_names(read_description(load(name), name), load_dictionary()[0]), "View").text
        files.append(tmp_path / f"view{number}.py")
        files[-1].write_text(text, encoding="utf-8")
        uses = [*uses_of(f"view{number}", text)]
        assert len(uses) > 5
        use += uses
    files.append(tmp_path / "use.py")
    files[-1].write_text("\n".join(use), encoding="utf-8")
    type_checkers.check(checker, files, pytestconfig, tmp_path)
