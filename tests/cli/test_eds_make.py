"""`canopen eds doc`, `to-dcf` and `to-cdcf`: pages and settings made of a description."""

from __future__ import annotations

import html.parser
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from canopen_cli.eds import html as eds_html
from canopen_cli.eds import markdown as eds_markdown
from canopen_cli.eds import page as eds_page
from canopen_data.description import FileKind
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer import write_eds
from canopen_proto.dictionary.concise import from_concise
from tests.check.checked_device import GAIN, clean, field, head, info, several, with_variable
from tests.cli.cli_support import Run, runner

EVIL = "<script>alert(1)</script>|`x`*b*"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    Path("drive.eds").write_text(write_eds(clean()))
    return runner(capsys, monkeypatch, tmp_path)


class Tags(html.parser.HTMLParser):
    """Counts tags, and checks that each is closed in its turn."""

    VOID = ("meta", "br")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        self.ids += [value or "" for name, value in attrs if name == "id"]
        self.links += [value or "" for name, value in attrs if name == "href"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


# ---- doc ----


def test_a_page_of_html(run: Run) -> None:
    outcome = run("eds", "doc", "drive.eds", "-o", "drive.html")
    assert (outcome.status, outcome.out) == (0, "")
    page = Path("drive.html").read_text(encoding="utf-8")
    tags = Tags()
    tags.feed(page)
    assert tags.open == []
    assert len(tags.ids) == len(set(tags.ids))
    assert {link.removeprefix("#") for link in tags.links} <= set(tags.ids)
    assert not re.search(r"https?:|src=|@import|url\(", page)
    for text in ("Acme Drive", "Gain", "0..100", "$NODEID+0x200", "controlword · 16", "Names in order", "servo drive"):
        assert text in page


def test_a_page_of_markdown(run: Run) -> None:
    assert run("eds", "doc", "drive.eds", "-o", "drive.md").status == 0
    page = Path("drive.md").read_text(encoding="utf-8")
    assert "| 2000 | **Gain** | UNSIGNED16 | rw | yes | 5 | 0..100 |" in page
    assert "| :01 | First | UNSIGNED16 | rw |  |  |  |" in page
    assert run("eds", "doc", "drive.eds", "--form", "md").out == page


def test_a_page_goes_to_stdout(run: Run) -> None:
    page = run("eds", "doc", "drive.eds").out
    assert page.startswith("<!doctype html>")
    assert run("eds", "doc", "drive.eds", "--json").json["page"] == page
    told = run("eds", "doc", "drive.eds", "-o", "page", "--json").json
    assert (told["output"], told["form"], told["page"]) == ("page", "html", None)
    assert Path("page").read_text() == page


def test_nothing_of_a_file_is_markup() -> None:
    evil = several(
        field(0x2000, 0, name=EVIL, description=EVIL, unit=EVIL),
        field(0x2003, 1, name=EVIL),
        field(0x2002, 0, default=EVIL),
        info(vendor_name=EVIL, product_name=EVIL),
        head(comments=(EVIL, "second")),
        field(0x1A00, 1, default=0x20000010),
    )
    page = eds_page.page_of(evil(clean()))
    tags = Tags()
    tags.feed(eds_html.html_of(page))
    assert tags.open == []
    assert "script" not in tags.seen
    markdown = eds_markdown.markdown_of(page)
    assert "<script" not in re.sub(r"\\.", "", markdown)
    assert all(line.count("|") - line.count("\\|") == 8 for line in markdown.split("\n") if line.startswith("| 2000"))


def test_odd_descriptions_have_pages_too() -> None:
    odd = several(
        field(0x1800, 1, default=0x8000_0181, adds_node_id=False),
        field(0x1A00, 0, default=0xFF),
        field(0x1400, 5, default=100),
        field(0x2000, 0, configured=7),
        field(0x2002, 0, default="long " * 30, configured=""),
        with_variable(replace(GAIN, index=0xB000, name="", default=True)),
        with_variable(replace(GAIN, index=0xD000, name="Far")),
        info(vendor_name="", product_name="", vendor_number=None, bit_rates=frozenset()),
        head(comments=("one",)),
    )
    page = eds_page.page_of(odd(clean()))
    assert page.title == "folder/drive.eds"
    assert [group.title for group in page.groups] == [
        "Communication", "Manufacturer", "Device profile", "Interface profile", "Reserved",
    ]  # fmt: skip
    text = eds_html.html_of(page)
    assert "does not exist until its COB-ID is set" in text
    assert "<th>configured</th>" in text
    assert "multiplexed" in text
    assert "(off)" in eds_markdown.markdown_of(page)
    without_pdos = replace(page, pdos=[])
    assert "PDOs after start-up" not in eds_html.html_of(without_pdos) + eds_markdown.markdown_of(without_pdos)


def test_a_page_does_not_overwrite_its_file(run: Run) -> None:
    before = Path("drive.eds").read_text()
    outcome = run("eds", "doc", "drive.eds", "-o", "./drive.eds")
    assert outcome.status == 2
    assert "it is not overwritten" in outcome.err
    assert Path("drive.eds").read_text() == before


def test_a_page_that_cannot_be_written(run: Run) -> None:
    outcome = run("eds", "doc", "drive.eds", "-o", "none/page.html")
    assert outcome.status == 6
    assert outcome.err.startswith("error CO341: cannot write none/page.html: ")
    assert run("eds", "doc", "drive.eds", "-o", "a\0b").status == 6


# ---- DCF ----


def test_a_dcf_is_made(run: Run) -> None:
    outcome = run(
        "eds", "to-dcf", "drive.eds", "--id", "5", "--bitrate", "500", "--name", "axis", "--set", "1017=200",
        "--set", "gain = 0x10", "-o", "axis5.dcf",
    )  # fmt: skip
    assert outcome.status == 0
    assert "axis5.dcf: DCF of node 5, 2 new settings" in outcome.err
    dcf = read_eds(Path("axis5.dcf").read_bytes())
    assert dcf.kind is FileKind.DCF
    assert dcf.commissioning is not None
    assert (dcf.commissioning.node_id, dcf.commissioning.bit_rate, dcf.commissioning.node_name) == (5, 500, "axis")
    configured = {each.index: each.configured for each in dcf.dictionary if each.configured is not None}
    assert configured == {0x1017: 200, 0x2000: 16}


def test_a_dcf_is_made_of_another_one(run: Run) -> None:
    run("eds", "to-dcf", "drive.eds", "--id", "5", "--set", "1017=200", "-o", "axis5.dcf")
    outcome = run("eds", "to-dcf", "axis5.dcf", "--set", "2000=9", "-o", "again.dcf", "--json")
    assert outcome.json == {
        "file": "axis5.dcf", "output": "again.dcf", "node": 5, "bit_rate": None,
        "settings": [{"index": 0x2000, "sub": 0, "name": "Gain", "value": 9}],
    }  # fmt: skip
    again = read_eds(Path("again.dcf").read_bytes()).dictionary
    assert [each.configured for each in again if each.configured is not None] == [200, 9]


def test_a_bit_rate_that_the_device_does_not_have_is_mentioned(run: Run) -> None:
    outcome = run("eds", "to-dcf", "drive.eds", "--id", "5", "--bitrate", "1000", "-o", "a.dcf")
    assert outcome.status == 0
    assert "does not list 1000 kbit/s" in outcome.err


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["-o", "x.dcf"], "CO120"),
        (["--id", "200", "-o", "x.dcf"], "CO120"),
        (["--id", "5", "--set", "1017", "-o", "x.dcf"], "CO001"),
        (["--id", "5", "--set", "gian=1", "-o", "x.dcf"], "CO302"),
        (["--id", "5", "--set", "gain=1000", "-o", "x.dcf"], "CO304"),
        (["--id", "5", "--set", "gain=101", "-o", "x.dcf"], "CO304"),
        (["--id", "5", "--set", "6041=1", "-o", "x.dcf"], "CO303"),
        (["--id", "5", "-o", "drive.eds"], "CO123"),
        (["--id", "5"], "CO001"),
    ],
)
@pytest.mark.parametrize("command", ["to-dcf", "to-cdcf"])
def test_a_setting_that_cannot_be_is_refused(run: Run, command: str, arguments: list[str], code: str) -> None:
    outcome = run("eds", command, "drive.eds", *arguments, "--json")
    assert outcome.status == 2
    assert json.loads(outcome.err.strip().split("\n")[-1])["code"] == code
    assert not Path("x.dcf").exists()


def test_a_concise_dcf_is_made(run: Run) -> None:
    run("eds", "to-dcf", "drive.eds", "--id", "5", "--set", "1017=200", "-o", "axis5.dcf")
    outcome = run("eds", "to-cdcf", "axis5.dcf", "--set", "2000=9", "-o", "axis5.cdcf")
    data = Path("axis5.cdcf").read_bytes()
    assert outcome.err == f"axis5.cdcf: 2 writes, {len(data)} bytes\n"
    assert data.hex(" ") == "02 00 00 00 17 10 00 02 00 00 00 c8 00 00 20 00 02 00 00 00 09 00"
    assert len(from_concise(data)) == 2


def test_what_a_concise_dcf_leaves_out_is_told(run: Run) -> None:
    Path("odd.dcf").write_text(write_eds(field(0x2002, 0, configured="B")(clean(FileKind.DCF))))
    told = run("eds", "to-cdcf", "odd.dcf", "-o", "odd.cdcf", "--json").json
    assert (told["writes"], told["bytes"], told["node"]) == (0, 4, 3)
    assert [each["object"] for each in told["left_out"]] == ["2002:00"]
    talk = run("eds", "to-cdcf", "odd.dcf", "-o", "odd.cdcf", "-v", "--force").err
    assert "left out: 2002:00" in talk
    assert "nothing is configured" in talk


def test_no_concise_dcf_is_made_without_a_setting_that_cannot_be_read(run: Run) -> None:
    text = write_eds(field(0x2000, 0, configured=9)(clean(FileKind.DCF)))
    Path("lost.dcf").write_text(text.replace("ParameterValue=9", "ParameterValue=99999"))
    outcome = run("eds", "to-cdcf", "lost.dcf", "-o", "lost.cdcf")
    assert outcome.status == 6
    assert "ParameterValue '99999' is outside 0..65535 (UNSIGNED16)" in outcome.err
    assert not Path("lost.cdcf").exists()


# ---- stubs ----


def test_stubs_tell_the_names_that_are_shared(run: Run) -> None:
    twice = several(with_variable(replace(GAIN, index=0x2010)), with_variable(replace(GAIN, index=0x2011, name="class")))
    Path("twice.eds").write_text(write_eds(twice(clean())))
    made = run("eds", "stubs", "twice.eds", "-o", "my-drive.py")
    assert made.status == 0
    assert "several objects are called gain: 0x2000:00 gain_2000, 0x2010:00 gain_2010" in made.err
    text = Path("my-drive.py").read_text()
    assert "class MyDrive:" in text
    assert "class_ = ReadWrite[int](0x2011_00)" in text
    told = run("eds", "stubs", "twice.eds", "-o", "other.py", "--class", "Axis", "--json").json
    assert (told["class"], told["keys"]) == ("Axis", text.count("(0x"))
    assert told["collisions"] == [{"name": "gain", "names": {"0x2000:00": "gain_2000", "0x2010:00": "gain_2010"}}]


def test_stubs_know_the_units_of_a_side_file(run: Run) -> None:
    Path("units.toml").write_text('[objects.2000]\nunit = "V"\nfactor = 0.1\n')
    assert run("eds", "stubs", "drive.eds", "-o", "drive.py", "--overlay", "units.toml").status == 0
    assert '"""0x2000:00 Gain, UNSIGNED16, 0.1 V, 0..100, default 5, PDO"""' in Path("drive.py").read_text()


@pytest.mark.parametrize("name", ["2nd", "a b", "class", "", "int"])
def test_a_class_needs_a_name_of_python(run: Run, name: str) -> None:
    refused = run("eds", "stubs", "drive.eds", "-o", "x.py", "--class", name)
    assert (refused.status, "CO001" in refused.err) == (2, True)
    assert not Path("x.py").exists()
