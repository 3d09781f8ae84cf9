"""`canopen eds lint`, `show` and `diff`: what they print, and how they end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from canopen_data.checks import RULES
from canopen_data.description import FileKind
from canopen_data.eds.writer import write_eds
from tests.check.checked_device import clean, field, head
from tests.cli.cli_support import Run, runner


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    text = write_eds(clean())
    Path("drive.eds").write_text(text, encoding="utf-8")
    Path("faulty.eds").write_text(text.replace("drive.eds", "faulty.eds").replace("DefaultValue=5\n", "DefaultValue=101\n"))
    Path("drive.dcf").write_text(write_eds(field(0x2000, 0, configured=7)(clean(FileKind.DCF))).replace("drive.eds", "drive.dcf"))
    return runner(capsys, monkeypatch, tmp_path)


# ---- lint ----


def test_a_clean_file_ends_well(run: Run) -> None:
    outcome = run("eds", "lint", "drive.eds")
    assert (outcome.status, outcome.out) == (0, "")
    assert outcome.err == "drive.eds (EDS, utf-8, 17 objects): nothing found\n"


def test_a_finding_is_shown_with_its_line_and_a_mark(run: Run) -> None:
    outcome = run("eds", "lint", "faulty.eds")
    line = Path("faulty.eds").read_text().split("\n").index("DefaultValue=101") + 1
    assert outcome.status == 1
    assert outcome.out == (
        f"faulty.eds:{line}:14: warning CO301 in [2000] Gain: DefaultValue=101 is outside its limits 0..100 [default-limits]\n"
        f"{line:>6} | DefaultValue=101\n"
        f"       | {'':13}^\n"
    )
    assert outcome.err == "faulty.eds (EDS, utf-8, 17 objects): 1 warning\n"


def test_findings_about_the_head_of_the_file_have_lines_too(run: Run) -> None:
    text = Path("drive.eds").read_text()
    Path("drive.eds").write_text(text.replace("NrOfRXPDO=1", "NrOfRXPDO=9"))
    outcome = run("eds", "lint", "drive.eds")
    line = text.split("\n").index("NrOfRXPDO=1") + 1
    assert outcome.out.startswith(f"drive.eds:{line}:11: warning CO301 in [DeviceInfo]: NrOfRXPDO=9, but the file has 1 RPDO")


def test_findings_as_json(run: Run) -> None:
    outcome = run("eds", "lint", "faulty.eds", "--json")
    assert outcome.status == 1
    document = outcome.json
    assert (document["kind"], document["objects"], document["warnings"], document["errors"]) == ("EDS", 17, 1, 0)
    (finding,) = document["findings"]
    assert (finding["code"], finding["severity"], finding["column"]) == ("default-limits", "warning", 14)
    both = run("eds", "lint", "faulty.eds", "drive.eds", "none.eds", "--json")
    assert both.status == 6
    assert [len(each.get("findings", ())) for each in both.json] == [1, 0, 0]
    assert both.json[2]["error"]["code"] == "CO330"


def test_notices_count_when_strict(run: Run) -> None:
    Path("other.eds").write_text(Path("drive.eds").read_text())
    lenient, strict = run("eds", "lint", "other.eds"), run("eds", "lint", "other.eds", "--strict")
    assert (lenient.status, strict.status) == (0, 1)
    assert "notice CO301 in [FileInfo]: FileName=drive.eds, but the file is called other.eds [file-name]" in lenient.out


def test_many_findings_are_cut(run: Run) -> None:
    text = Path("drive.eds").read_text().replace("AccessType=rw", "AccessType=odd")
    Path("odd.eds").write_text(text)
    few = run("eds", "lint", "odd.eds", "--max-errors", "2")
    every = run("eds", "lint", "odd.eds", "--max-errors", "0")
    assert few.out.count("CO301") == 2
    assert "more: --max-errors 0 shows all" in few.err
    assert every.out.count("CO301") > 5


def test_what_a_terminal_would_obey_is_not_shown(run: Run) -> None:
    text = Path("drive.eds").read_text().replace("ParameterName=Gain", "ParameterName=\x1b[31mGain[red]")
    Path("evil.eds").write_text(text.replace("DefaultValue=5\n", "DefaultValue=101\n"))
    outcome = run("eds", "lint", "evil.eds")
    assert "\x1b" not in outcome.out
    assert "[31mGain[red]: DefaultValue=101" in outcome.out


def test_long_lines_are_cut_around_the_mark(run: Run) -> None:
    text = Path("drive.eds").read_text().replace("DefaultValue=5\n", f"DefaultValue={' ' * 200}101{' ' * 200}\n")
    Path("drive.eds").write_text(text)
    outcome = run("eds", "lint", "drive.eds")
    shown, mark = outcome.out.split("\n")[1:3]
    assert len(shown) < 140
    assert shown[mark.index("^")] == "1"


@pytest.mark.parametrize("content", [b"", b"\x00\xff", b"hello\n", b"<html></html>", b"[FileInfo]\n"])
def test_what_describes_no_device_cannot_be_read(run: Run, content: bytes) -> None:
    Path("junk.eds").write_bytes(content)
    outcome = run("eds", "lint", "junk.eds", "--json")
    assert outcome.status == 6
    assert outcome.json["error"]["code"] == "CO301"
    told = run("eds", "show", "junk.eds").err
    assert told.startswith("error CO301: junk.eds describes no object")
    assert "line 0" not in told
    assert "eds lint" not in told, "which has no more to say of such a file"


def test_a_file_that_is_not_there(run: Run) -> None:
    outcome = run("eds", "lint", "none.eds")
    assert outcome.status == 6
    assert outcome.err.startswith("error CO330: there is no file 'none.eds'")


def test_the_rules_are_listed(run: Run) -> None:
    told = run("eds", "lint", "--rules").out
    assert all(rule.code in told for rule in RULES)
    assert len(run("eds", "lint", "--rules", "--json").json) == len(RULES)
    assert run("eds", "lint").status == 2


def test_the_group_tells_its_commands(run: Run) -> None:
    outcome = run("eds", "--help")
    assert outcome.status == 0
    assert all(name in outcome.out for name in ("lint", "show", "diff", "fix", "doc", "stubs", "to-dcf", "to-cdcf"))
    assert run("eds", "nonsense").status == 2


# ---- show ----


def test_all_of_a_file_is_shown(run: Run) -> None:
    outcome = run("eds", "show", "drive.eds")
    assert outcome.status == 0
    lines = outcome.out.split("\n")
    assert "vendor     Acme (0x77)" in lines
    assert "type       servo drive (CiA 402), 0x00020192" in lines
    rpdo = next(line for line in lines if line.startswith("RPDO1"))
    assert rpdo.split() == [
        "RPDO1",
        "$NODEID+0x200",
        "event-driven",
        "(255)",
        "24",
        "controlword",
        "(16),",
        "(8",
        "unused",
        "bits)",
    ]
    gain = next(line for line in lines if line.startswith("2000"))
    assert gain.split() == ["2000", "Gain", "UNSIGNED16", "rw", "yes", "5", "0..100"]
    assert any(line.split()[:2] == ["2003", "Table"] for line in lines)
    assert "configured" not in outcome.out
    assert "17 objects" in outcome.err


def test_what_a_dcf_configures_is_shown(run: Run) -> None:
    outcome = run("eds", "show", "drive.dcf")
    gain = next(line for line in outcome.out.split("\n") if line.startswith("2000"))
    assert gain.split() == ["2000", "Gain", "UNSIGNED16", "rw", "yes", "5", "0..100", "7"]
    assert "node             axis 3 (0x03)" in outcome.out


@pytest.mark.parametrize(
    ("key", "places"),
    [
        ("2000", ["2000"]),
        ("0x2003", ["2003", ":00", ":01", ":02"]),
        ("table", ["2003", ":00", ":01", ":02"]),
        ("2003:01", ["2003:01"]),
        ("second", ["2003:02"]),
        ("Gain", ["2000"]),
    ],
)
def test_chosen_objects_are_shown(run: Run, key: str, places: list[str]) -> None:
    rows = run("eds", "show", "drive.eds", key).out.strip().split("\n")[2:]
    assert [row.split()[0] for row in rows] == places


def test_an_object_that_is_not_there(run: Run) -> None:
    outcome = run("eds", "show", "drive.eds", "gian")
    assert outcome.status == 2
    assert outcome.err.startswith("error CO302: object 'gian' is not in the dictionary")
    assert "did you mean Gain" in outcome.err


def test_a_file_as_json(run: Run) -> None:
    document = run("eds", "show", "drive.dcf", "--json").json
    assert document["device"]["vendor_number"] == 0x77
    assert document["commissioning"] == {"node": 3, "name": "axis", "bit_rate": 500}
    assert [each["name"] for each in document["pdos"]] == ["RPDO1", "TPDO1"]
    assert document["pdos"][0]["entries"][1] == {"object": "0005", "name": "UNSIGNED8", "bits": 8, "dummy": True}
    (gain,) = run("eds", "show", "drive.dcf", "gain", "--json").json
    assert gain["variables"][0]["configured"] == 7
    assert run("eds", "show", "drive.eds", "--json").json["commissioning"] is None


def test_odd_pdos_are_shown(run: Run) -> None:
    odd = field(0x1800, 1, default=0x8000_0181, adds_node_id=False)(field(0x1A00, 0, default=0xFF)(clean()))
    odd = field(0x1400, 1, default=None)(field(0x1400, 2, default=None)(field(0x1600, 1, default=0x20990010)(odd)))
    odd = field(0x1800, 5, default=100)(field(0x1800, 3, default=50)(field(0x1800, 2, default=4)(odd)))
    Path("odd.eds").write_text(write_eds(odd))
    rows = [line.split("  ") for line in run("eds", "show", "odd.eds").out.split("\n") if line[1:5] == "PDO1"]
    cells = [[cell.strip() for cell in row if cell.strip()] for row in rows]
    assert cells[0] == ["RPDO1", "not given (off)", "not given", "24", "2099:00 (16), (8 unused bits)"]
    assert cells[1] == [
        "TPDO1", "0x181 (off)", "every 4 SYNCs, at most every 5 ms, at least every 100 ms", "0", "multiplexed",
    ]  # fmt: skip


def test_a_file_without_pdos(run: Run) -> None:
    device = clean()
    objects = {index: each for index, each in device.dictionary.objects.items() if index in (0x1000, 0x1001, 0x2000)}
    small = replace(device, dictionary=type(device.dictionary)(objects.values()), optional=(), manufacturer=(0x2000,))
    Path("small.eds").write_text(write_eds(head(mandatory=(0x1000, 0x1001))(small)))
    assert "PDO1" not in run("eds", "show", "small.eds").out


def test_faults_are_mentioned(run: Run) -> None:
    Path("odd.eds").write_text(Path("drive.eds").read_text().replace("DataType=0x0006", "DataType=0xZZ"))
    outcome = run("eds", "show", "odd.eds")
    assert outcome.status == 0
    assert "in it; canopen eds lint odd.eds" in outcome.err


# ---- diff ----


def test_the_same_file_does_not_differ(run: Run) -> None:
    outcome = run("eds", "diff", "drive.eds", "drive.eds")
    assert (outcome.status, outcome.out) == (0, "")


def test_differences_are_shown(run: Run) -> None:
    outcome = run("eds", "diff", "drive.eds", "drive.dcf")
    assert outcome.status == 1
    assert outcome.out.split("\n")[:2] == ["+ commissioning", "~ 2000:00 Gain: ParameterValue - -> 7"]
    assert "2 differences between drive.eds and drive.dcf" in outcome.err


def test_differences_as_json(run: Run) -> None:
    outcome = run("eds", "diff", "drive.eds", "faulty.eds", "--json")
    assert outcome.status == 1
    assert outcome.json == [
        {"change": "changed", "index": 0x2000, "sub": 0, "name": "Gain", "field": "DefaultValue", "before": 5, "after": 101}
    ]


def test_all_kinds_of_values_differ_as_json(run: Run) -> None:
    text = Path("drive.eds").read_text().replace("$NODEID+0x200", "0x202").replace("BaudRate_500=1", "BaudRate_500=0")
    Path("b.eds").write_text(text.replace("DataType=0x0004", "DataType=0x0003").replace("DefaultValue=5\n", ""))
    found = run("eds", "diff", "drive.eds", "b.eds", "--json").json
    values = {(each["name"], each["field"]): (each["before"], each["after"]) for each in found}
    assert values["device", "bit_rates"] == ([500], [])
    assert values["Gain", "DefaultValue"] == (5, None)
    assert values["Offset", "DataType"] == ("INTEGER32", "INTEGER16")
    assert ("$NODEID+0x200", 0x202) in values.values()


def test_the_encoding_of_a_file_is_guessed_or_named(run: Run, tmp_path: Path) -> None:
    text = "[DeviceInfo]\nVendorName={}\n[1000]\nParameterName={}\nObjectType=7\nDataType=7\nAccessType=ro\n"
    chinese, russian = tmp_path / "chinese.eds", tmp_path / "russian.eds"
    chinese.write_bytes(text.format("伺服电机", "设备类型").encode("gbk"))
    russian.write_bytes(text.format("Привод", "тип").encode("cp1251"))
    assert "设备类型" in run("eds", "show", str(chinese)).out
    assert "read as GBK (Chinese), which is a guess: --encoding names another one" in run("eds", "lint", str(chinese)).out
    assert "тип" in run("eds", "show", str(russian), "--encoding", "cp1251").out
    outcome = run("eds", "show", str(russian), "--encoding", "rot13")
    assert outcome.status == 2
    assert "is not an encoding such as gbk" in outcome.err
