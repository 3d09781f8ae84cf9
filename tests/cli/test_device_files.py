"""-e: a device's own file names its objects, and `canopen info` says whether it is that device."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from tests.cli.cli_support import Run, runner
from tests.data.xdd_files import xdd

DEMO = ("-b", "demo")
IDENTITY = """<CANopenObject index="1018" name="Who" objectType="9">
<CANopenSubObject subIndex="01" name="Maker" objectType="7" dataType="0007" accessType="ro" defaultValue="{}"/>
<CANopenSubObject subIndex="02" name="Product" objectType="7" dataType="0007" accessType="ro" defaultValue="{}"/>
</CANopenObject>
"""
OBJECTS = """<CANopenObject index="1000" name="Kind" objectType="7" dataType="0007" accessType="ro" defaultValue="{}"/>
<CANopenObject index="6041" name="Zustand" objectType="7" dataType="0006" accessType="ro" PDOmapping="TPDO"/>
<CANopenObject index="6081" name="Tempo" objectType="7" dataType="0007" accessType="rw" lowLimit="100" highLimit="9000"/>
<CANopenObject index="6064" name="Ort" objectType="7" dataType="0004" accessType="ro" PDOmapping="TPDO"/>
"""
COMMISSIONED = '<NetworkManagement><deviceCommissioning nodeID="{}" nodeName="" networkName=""/></NetworkManagement>'


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))


def file(
    folder: Path,
    device_type: str = "0x00020192",
    vendor: str = "",
    product: str = "",
    name: str = "drive.xdd",
    node_id: int | None = None,
) -> str:
    """The path of a file that describes a drive."""
    network = "" if node_id is None else COMMISSIONED.format(node_id)
    path = folder / name
    path.write_bytes(xdd(OBJECTS.format(device_type) + IDENTITY.format(vendor, product), network=network))
    return str(path)


# ---- names ----


def test_read_by_the_names_of_the_file_and_of_the_data_files(run: Run, tmp_path: Path) -> None:
    path = file(tmp_path)
    for key in ("Zustand", "statusword", "6041"):
        outcome = run("read", "3", key, "-e", path, "--json", *DEMO)
        assert outcome.status == 0, outcome.err
        assert (outcome.json["name"], outcome.json["value"]) == ("statusword", 0x0240)
        assert "switch_on_disabled" in outcome.json["constants"]


def test_the_option_may_stand_before_the_command(run: Run, tmp_path: Path) -> None:
    assert run("-e", file(tmp_path), *DEMO, "read", "3", "Tempo").status == 0
    assert run(*DEMO, "read", "3", "Tempo").status == ExitCode.USAGE


def test_write_keeps_to_the_limits_of_the_file(run: Run, tmp_path: Path) -> None:
    path = file(tmp_path)
    assert run("write", "3", "Tempo", "9000", "-e", path, "--verify", *DEMO).status == 0
    outcome = run("write", "3", "Tempo", "9001", "-e", path, *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "100..9000" in outcome.err
    assert run("write", "3", "6081", "9001", *DEMO).status == 0


def test_a_file_of_one_node_is_not_that_of_others(run: Run, tmp_path: Path) -> None:
    path = file(tmp_path)
    assert run("read", "3", "Zustand", "-e", f"3={path}", *DEMO).status == 0
    assert run("read", "4", "Zustand", "-e", f"3={path}", *DEMO).status == ExitCode.USAGE
    assert run("read", "4", "Zustand", "-e", f"0x03={path}", "-e", path, *DEMO).status == 0


def test_several_files_are_told_apart_by_their_node_id(run: Run, tmp_path: Path) -> None:
    third, fourth = (file(tmp_path, name=f"{node_id}.xdc", node_id=node_id) for node_id in (3, 4))
    for node in ("3", "4"):
        assert run("read", node, "Zustand", "-e", third, "-e", fourth, *DEMO).status == 0
    assert run("read", "5", "Zustand", "-e", third, "-e", fourth, *DEMO).status == ExitCode.USAGE
    assert run("read", "5", "Zustand", "-e", third, *DEMO).status == 0, "the only one is for all"


def test_files_of_which_nobody_knows_whose_they_are(run: Run, tmp_path: Path) -> None:
    one, other = file(tmp_path), file(tmp_path, name="other.xdd")
    outcome = run("read", "3", "Zustand", "-e", one, "-e", other, "--json", *DEMO)
    assert (outcome.status, outcome.error["code"]) == (ExitCode.USAGE, "CO126")
    assert outcome.error["try"] == [f"-e 5={one}    (it is the file of node 5)"]
    outcome = run("read", "3", "Zustand", "-e", f"3={one}", "-e", f"3={other}", *DEMO)
    assert outcome.status == ExitCode.USAGE
    assert "two files of node 3" in outcome.err


# ---- files that cannot be used ----


def test_a_file_that_is_not_there(run: Run, tmp_path: Path) -> None:
    outcome = run("read", "3", "6041", "-e", str(tmp_path / "none.eds"), *DEMO)
    assert outcome.status == ExitCode.BAD_FILE
    assert "none.eds" in outcome.err
    assert "check the path" in outcome.err


@pytest.mark.parametrize("content", [b"", b"<html/>", b"any text"])
def test_a_file_that_describes_nothing(run: Run, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "thing.eds"
    path.write_bytes(content)
    outcome = run("read", "3", "6041", "-e", str(path), *DEMO)
    assert outcome.status == ExitCode.BAD_FILE
    assert "describes no object" in outcome.err


@pytest.mark.parametrize(("wrong", "told"), [(1, "1 error in it"), (2, "2 errors in it")])
def test_errors_in_a_file_are_counted(run: Run, tmp_path: Path, wrong: int, told: str) -> None:
    path = Path(file(tmp_path))
    text = path.read_text(encoding="utf-8").replace(
        "</CANopenObjectList>", '<CANopenObject index="x"/>' * wrong + "</CANopenObjectList>"
    )
    path.write_text(text, encoding="utf-8")
    outcome = run("read", "3", "Zustand", "-e", str(path), *DEMO)
    assert outcome.status == 0
    assert told in " ".join(outcome.err.split())


# ---- info ----


def test_info_says_that_the_file_fits(run: Run, tmp_path: Path) -> None:
    path = file(tmp_path, product="0x43")
    outcome = run("info", "3", "-e", path, "--json", *DEMO)
    assert outcome.json["file"] == {"name": path, "matches": True, "different": []}
    assert outcome.json["TPDO1"]["objects"][0] == "6041:00"
    assert "MATCH" in run("info", "3", "-e", path, *DEMO).out


def test_info_says_which_fields_do_not_fit(run: Run, tmp_path: Path) -> None:
    path = file(tmp_path, "0x00010192", "0x55", "0x43")
    outcome = run("info", "3", "-e", path, "--json", *DEMO)
    assert outcome.json["file"]["matches"] is False
    assert outcome.json["file"]["different"] == [
        {"field": "device type", "node": 0x20192, "file": 0x10192},
        {"field": "vendor-ID", "node": 0x332, "file": 0x55},
    ]
    text = " ".join(run("info", "3", "-e", path, *DEMO).out.split())
    assert "ANOTHER DEVICE by device type 0x00020192 (file: 0x00010192), vendor-ID 0x00000332 (file: 0x00000055)" in text


def test_info_compares_the_serial_number_with_a_file_of_one_device(run: Run, tmp_path: Path) -> None:
    serial = '<CANopenSubObject subIndex="04" name="Number" objectType="7" dataType="0007" accessType="ro" defaultValue="7"/>'
    for node_id, different in ((None, []), (3, [{"field": "serial number", "node": 1, "file": 7}])):
        path = Path(file(tmp_path, node_id=node_id))
        path.write_bytes(path.read_bytes().replace(b"</CANopenObject>\n</", serial.encode() + b"</CANopenObject>\n</"))
        assert run("info", "3", "-e", str(path), "--json", *DEMO).json["file"]["different"] == different


def test_info_with_a_file_that_says_nothing_of_identity(run: Run, tmp_path: Path) -> None:
    outcome = run("info", "3", "-e", file(tmp_path, ""), "--json", *DEMO)
    assert outcome.json["file"]["matches"] is None
    assert "no identity of the device" in " ".join(run("info", "3", "-e", file(tmp_path, ""), *DEMO).out.split())
    assert "file" not in run("info", "3", "-e", f"4={file(tmp_path)}", "--json", *DEMO).json


def test_commands_that_name_no_object_take_it_too(run: Run, tmp_path: Path) -> None:
    assert run("scan", "-e", file(tmp_path), *DEMO).status == 0
    assert run("nmt", "start", "3", "-e", file(tmp_path), *DEMO).status == 0
