"""`canopen sim` with files of devices: what it makes of them, plant files, scripts, side files, and what it says of bad input."""

from __future__ import annotations

from pathlib import Path

import pytest
import trio

from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import ExitCode
from canopen_cli.simulation.devices import named_devices, teller
from canopen_master import open_master
from canopen_master.simulation.device_files import models_of
from canopen_master.simulation.hooks import Script, ScriptError
from canopen_master.simulation.host import DeviceModel
from canopen_master.simulation.parameter_keeper import ParameterKeeper
from canopen_master.simulation.plant import DeviceEntry
from canopen_master.simulation.serving import simulated_devices
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.simulation.drive.node import DriveNode
from tests.cli.cli_support import Run, runner
from tests.master.world import BUS, virtual_time

IO = """[FileInfo]
FileName=io.eds
[DeviceInfo]
VendorName=Nobody
[MandatoryObjects]
SupportedObjects=2
1=0x1000
2=0x1001
[1000]
ParameterName=Device type
DataType=7
AccessType=ro
DefaultValue=0x191
[1001]
ParameterName=Error register
DataType=5
AccessType=ro
[OptionalObjects]
SupportedObjects=3
1=0x1017
2=0x1010
3=0x1011
[1017]
ParameterName=Heartbeat
DataType=6
AccessType=rw
DefaultValue=0
[1010]
ParameterName=Store
ObjectType=8
SubNumber=2
[1010sub0]
ParameterName=n
DataType=5
AccessType=ro
DefaultValue=1
[1010sub1]
ParameterName=All
DataType=7
AccessType=rw
[1011]
ParameterName=Restore
ObjectType=8
SubNumber=2
[1011sub0]
ParameterName=n
DataType=5
AccessType=ro
DefaultValue=1
[1011sub1]
ParameterName=All
DataType=7
AccessType=rw
[ManufacturerObjects]
SupportedObjects=1
1=0x2000
[2000]
ParameterName=Temperature
DataType=4
AccessType=rw
DefaultValue=20000
"""

DCF = IO + "ParameterValue=25000\n[DeviceCommissioning]\nNodeID=9\nBaudrate=500\n"

WORDS = """
[6040]
ParameterName=Controlword
DataType=6
AccessType=rw
[6041]
ParameterName=Statusword
DataType={status}
AccessType=ro
[6502]
ParameterName=Modes
DataType=7
AccessType=ro
"""


def drive_eds(status: int = 6, device_type: str = "0x20192", vendor: str = "Nobody") -> str:
    text = IO.replace("VendorName=Nobody", f"VendorName={vendor}").replace("0x191", device_type)
    text = text.replace("SupportedObjects=3\n1=0x1017", "SupportedObjects=6\n4=0x6040\n5=0x6041\n6=0x6502\n1=0x1017")
    return text + WORDS.format(status=status)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    (tmp_path / "own").mkdir()
    monkeypatch.chdir(tmp_path)
    for name, text in {"io.eds": IO, "io.dcf": DCF, "drive.eds": drive_eds(), "odd.eds": drive_eds(status=9)}.items():
        (tmp_path / name).write_text(text)
    inner = runner(capsys, monkeypatch, tmp_path / "own")
    return lambda *arguments: inner(*arguments, *(() if "-b" in arguments else ("-b", "virtual:files")))


SHORT = ("--seconds", "0.1")


def test_a_file_becomes_a_device(run: Run) -> None:
    outcome = run("sim", "io.eds", "--id", "5", *SHORT)
    assert outcome.status == 0
    assert outcome.err.splitlines() == [
        "node 5 (0x05)  io.eds: plain memory; objects: 8, TPDOs: 0, RPDOs: 0",
        "node 5 (0x05)  NMT pre-operational",
        "1 simulated device on virtual:files, for 0.1 s",
        "That bus ends with this process: with -b udp_multicast another terminal can join.",
    ]


def test_several_files_and_the_node_id_of_a_dcf(run: Run) -> None:
    told = run("sim", "5,7=io.eds", "io.dcf", "0xA=drive.eds", *SHORT).err
    assert "4 simulated devices on" in told
    for text in (
        "node 5 (0x05)  io.eds",
        "node 7 (0x07)  io.eds",
        "node 9 (0x09)  io.dcf",
        "node 10 (0x0A)  drive.eds: a simulated",
    ):
        assert text in told
    assert "node 10 (0x0A)  switch on disabled" in told


def test_one_file_for_several_nodes(run: Run) -> None:
    assert "3 simulated devices" in run("sim", "io.eds", "--ids", "3-5", *SHORT).err
    assert "node 4 (0x04)  io.eds" in run("sim", "-e", "4=io.eds", *SHORT).err


def test_profiles(run: Run) -> None:
    assert "drive.eds: plain memory" in run("sim", "drive.eds", "--id", "5", "--profile", "none", *SHORT).err
    told = run("sim", "odd.eds", "--id", "5", *SHORT).err
    assert "odd.eds: plain memory" in told
    assert "    no drive moves behind it: statusword (0x6041:00) is VISIBLE_STRING; in CiA 402 it is UNSIGNED16" in told
    outcome = run("sim", "io.eds", "--id", "5", "--profile", "402", *SHORT)
    assert outcome.status == ExitCode.BAD_FILE
    assert "CO332" in outcome.err
    assert "it has no statusword" in outcome.err
    assert "--profile none" in outcome.err


def test_what_is_filled_in_and_what_does_not_work_is_told(run: Run, tmp_path: Path) -> None:
    assert "node 5: supported_drive_modes (0x6502:00) = 1007" in run("sim", "drive.eds", "--id", "5", "-v", *SHORT).err
    many = IO.replace("SupportedObjects=3", "SupportedObjects=11") + "".join(
        f"[180{n}]\nParameterName=TPDO\nObjectType=9\nSubNumber=1\n[180{n}sub0]\nParameterName=n\nDataType=5\nAccessType=ro\n"
        for n in range(8)
    )
    many = many.replace("3=0x1011", "3=0x1011\n" + "\n".join(f"{n + 4}=0x180{n}" for n in range(8)))
    (tmp_path / "many.eds").write_text(many)
    told = run("sim", "many.eds", "--id", "5", *SHORT).err
    assert "    0x1800: TPDO 1 is off: it has no COB-ID (subindex 1)" in told
    assert "    and 3 more: -v shows them" in told
    assert "TPDO 8 is off" not in told
    assert "TPDO 8 is off" in run("sim", "many.eds", "--id", "5", "-v", *SHORT).err


def test_errors_in_a_file_are_counted(run: Run, tmp_path: Path) -> None:
    (tmp_path / "bad.eds").write_text(IO.replace("DataType=4", "DataType=zzz").replace("[2000]", "[2000]\nObjectType=99"))
    told = run("sim", "bad.eds", "--id", "5", *SHORT).err
    assert "canopen eds lint bad.eds" in told


PLANT = """
bus = "virtual:plant"
state = "state.json"
[[device]]
file = "io.eds"
id = 5
script = "anim.py"
overlay = "units.toml"
[device.values]
temp = 30000
[[device]]
file = "io.dcf"
defaults = true
[[device]]
file = "drive.eds"
id = [11, 12]
shape = "schunk"
"""


def plant_in(folder: Path, **files: str) -> Path:
    folder.mkdir(exist_ok=True)
    texts = {
        "plant.toml": PLANT,
        "io.eds": IO,
        "io.dcf": DCF,
        "drive.eds": drive_eds(),
        "anim.py": "def on_read(device, index, subindex):\n    return device['Temperature'] + 1\n",
        "units.toml": '[objects.2000]\naliases = ["temp"]\nunit = "°C"\nfactor = 0.001\n',
    }
    for name, text in {**texts, **files}.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder / "plant.toml"


def test_a_plant_file(run: Run, tmp_path: Path) -> None:
    path = plant_in(tmp_path / "plant")
    outcome = run("sim", str(path), *SHORT)
    assert outcome.status == 0
    assert "4 simulated devices on virtual:files" in outcome.err  # -b counts more
    assert "io.eds: plain memory with a script" in outcome.err


def test_the_bus_of_a_plant_file(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    outcome = runner(capsys, monkeypatch, tmp_path / "own")("sim", str(plant_in(tmp_path)), *SHORT)
    assert "4 simulated devices on virtual:plant" in outcome.err


@virtual_time
async def serve_plant(path: Path) -> None:
    screen = Settings().screen()
    plant = named_devices([str(path)], None, DeviceEntry(""))
    assert plant.state == str(path.parent / "state.json")
    made = models_of(plant.devices, teller(screen))
    keeper = ParameterKeeper(Path(plant.state))
    async with simulated_devices({BUS: made}, keeper=keeper) as simulation, open_master(BUS) as master:
        node = master.node(5, made[0].dictionary)
        assert await node.read("temp") == 30001  # the script's answer
        assert await node.read("temp") == 30002
        other = master.node(9, made[1].dictionary)
        assert await other.read("temperature") == 20000  # the default, and not what the DCF has configured
        await other.write("temperature", 21000)
        await other.write((0x1010, 1), 0x65766173)
        drives = [simulation.drives[node_id] for node_id in (11, 12)]
        assert all(isinstance(each, DriveNode) and each.drive.settings.shape.value == "schunk" for each in drives)
        assert await master.node(11, made[2].dictionary).read(0x6502) == 0x43
    again = ParameterKeeper(Path(plant.state)).kept(9)
    assert again is not None
    assert again[0x200000] == (21000).to_bytes(4, "little")


def test_a_plant_is_served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own").mkdir()
    monkeypatch.setenv("CANOPEN_DATA", str(tmp_path / "own"))
    serve_plant(plant_in(tmp_path / "plant"))


@virtual_time
async def serve_dcf(path: str) -> None:
    made = models_of(named_devices([path], None, DeviceEntry("")).devices, teller(Settings().screen()))
    async with simulated_devices({BUS: made}) as simulation, open_master(BUS) as master:
        node = master.node(9, made[0].dictionary)
        assert await node.read("temperature") == 25000
        await node.write((0x1011, 1), 0x64616F6C)
        await master.nmt(0x81, 9)
        await trio.sleep(0.1)
        assert await node.read("temperature") == 20000
        assert simulation.drives == {}


def test_a_dcf_has_what_it_configures_until_the_defaults_are_restored(run: Run) -> None:
    serve_dcf("io.dcf")


def test_the_makers_drives_are_known(run: Run, tmp_path: Path) -> None:
    (tmp_path / "joint.eds").write_text(drive_eds(vendor="SCHUNK GmbH"))
    (made,) = models_of(named_devices(["joint.eds"], (3,), DeviceEntry("")).devices, teller(Settings().screen()))
    assert made.drive is not None
    assert made.drive.shape.value == "schunk"


def test_scripts_tell_on_stderr(run: Run, tmp_path: Path) -> None:
    (tmp_path / "anim.py").write_text("def setup(device):\n    device.say('[bold] here')\n    1 / 0\n")
    outcome = run("sim", "io.eds", "--id", "5", "--script", "anim.py", "-q", *SHORT)
    assert outcome.status == 0
    assert outcome.err.splitlines() == [
        "node 5: [bold] here",
        "node 5: anim.py:3: in setup: ZeroDivisionError: division by zero",
    ]


@pytest.mark.parametrize(
    ("arguments", "status", "texts"),
    [
        (("nothing.eds", "--id", "5"), ExitCode.BAD_FILE, ["CO330", "there is no file 'nothing.eds'"]),
        (
            ("io.eds",),
            ExitCode.USAGE,
            ["CO127", "which node-ID is io.eds to have?", "the file names none", "canopen sim io.eds --id 5"],
        ),
        (("zero.dcf",), ExitCode.USAGE, ["the file names none"]),
        (("5=io.eds", "5=drive.eds"), ExitCode.USAGE, ["CO127", "there are two devices of node-ID 5"]),
        (("5=io.eds", "drive.eds", "--id", "6"), ExitCode.USAGE, ["CO127", "--id is for one file"]),
        (("200=io.eds",), ExitCode.USAGE, ["CO120"]),
        (("own", "--id", "5"), ExitCode.BAD_FILE, ["own"]),
        (("text.eds", "--id", "5"), ExitCode.BAD_FILE, ["CO301", "text.eds describes no object"]),
        (("plant.toml", "io.eds"), ExitCode.USAGE, ["CO127", "plant.toml is a plant file"]),
        (("plant.toml",), ExitCode.BAD_FILE, ["CO330", "there is no file 'plant.toml'"]),
        (("wrong.toml",), ExitCode.BAD_FILE, ["CO301", "wrong.toml: error: device 1: it has no file"]),
        (("values.toml",), ExitCode.USAGE, ["CO127", "values: Temperature (0x2000:00): INTEGER32 takes an integer, not 1.5"]),
        (("io.eds", "--id", "5", "--script", "none.py"), ExitCode.BAD_FILE, ["CO330", "there is no file 'none.py'"]),
        (("io.eds", "--id", "5", "--script", "bad.py"), ExitCode.BAD_FILE, ["CO331", "bad.py:1: invalid syntax"]),
        (
            ("io.eds", "--id", "5", "--script", "late.py"),
            ExitCode.BAD_FILE,
            ["CO331", "late.py:1: ZeroDivisionError", "the script"],
        ),
        (("io.eds", "--id", "5", "--overlay", "bad.py"), ExitCode.BAD_FILE, ["CO301", "bad.py:1:"]),
        (
            ("io.eds", "--id", "5", "--overlay", "latin.toml"),
            ExitCode.BAD_FILE,
            ["CO330", "latin.toml is not UTF-8 text: line 1 has the byte 0xE4"],
        ),
        (("io.eds", "--id", "5", "--overlay", "huge.toml"), ExitCode.BAD_FILE, ["CO330", "huge.toml is larger than 16 MiB"]),
        (
            ("io.eds", "--id", "5", "--state", "bad.py"),
            ExitCode.BAD_FILE,
            ["CO333", "bad.py is not a state file"],
        ),
    ],
)
def test_bad_input(run: Run, tmp_path: Path, arguments: tuple[str, ...], status: int, texts: list[str]) -> None:
    files = {
        "zero.dcf": DCF.replace("NodeID=9", "NodeID=200"),
        "text.eds": "hello",
        "wrong.toml": "[[device]]\n",
        "values.toml": '[[device]]\nfile = "io.eds"\nid = 5\n[device.values]\n2000 = 1.5\n',
        "bad.py": "def (",
        "late.py": "1 / 0",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "latin.toml").write_bytes(b"# \xe4\n")
    with (tmp_path / "huge.toml").open("wb") as huge:
        huge.truncate(1 << 25)
    outcome = run("sim", *arguments, *SHORT)
    for text in texts:
        assert text in outcome.err
    assert outcome.status == status


@virtual_time
async def test_a_script_that_fails_leaves_no_device_behind() -> None:
    with pytest.raises(ScriptError):
        await _fail()


async def _fail() -> None:
    model = DeviceModel(ObjectDictionary([]), 5, script=Script("1 / 0"))
    async with simulated_devices({BUS: [model]}):
        pass


# ---- reading by side files


def test_read_shows_units_and_names(run: Run, tmp_path: Path) -> None:
    (tmp_path / "units.toml").write_text(
        '[objects.6064]\naliases = ["position"]\nunit = "deg"\nfactor = 0.001\n'
        "[objects.6041.bits]\nfollowing = 9\n[objects.9999]\n"
    )
    outcome = run("read", "3", "position", "statusword", "--overlay", "units.toml", "-b", "demo")
    assert outcome.status == 0
    assert "-14000 = -14 deg" in outcome.out
    assert "following" in outcome.out
    document = run("read", "3", "position", "--overlay", "units.toml", "--json", "-b", "demo").json
    assert (document["physical"], document["unit"], document["value"]) == (-14.0, "deg", -14000)
    plain = run("read", "3", "6064", "--json", "-b", "demo").json
    assert (plain["physical"], plain["unit"]) == (None, "")
    assert "objects.9999" in run("read", "3", "position", "--overlay", "units.toml", "-v", "-b", "demo").err
    told = run("write", "3", "6081", "5", "--overlay", "units.toml", "-b", "demo").out
    assert "5 (0x00000005)" in told


def test_its_address_for_programs(run: Run) -> None:
    assert run("sim", "--id", "3,5", "-b", "virtual:x", "--seconds", "0.1", "--json").json == {
        "bus": "virtual:x",
        "nodes": [3, 5],
    }


def test_it_says_that_it_simulates_once_the_bus_is_open(run: Run) -> None:
    outcome = run("sim", "-b", "tcp:127.0.0.1:9")
    assert outcome.status == ExitCode.CANNOT_OPEN
    assert outcome.err.startswith("error CO101")
