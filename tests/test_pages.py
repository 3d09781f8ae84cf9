"""All pages: the navigation reaches each, a test runs the Python on each, and no page is only the beginning of one."""

from __future__ import annotations

import ast
import csv
import io
import json
import re
import shutil
import subprocess
import tomllib
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from canopen_master.machine_file import parse_machine
from tests.docs_build import DOCS

TESTS = Path(__file__).parent
PAGES = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md") if path.name != "index.md")
OTHER_FOLDERS = {"modes": "tests/test_modes_pages.py", "services": "tests/test_recipes.py"}
"""Folders of pages, and the test that runs their Python."""


RUN = {"embedding.md": 9, "extending.md": 6, "asyncio.md": 1, "own-device.md": 1, "start-script.md": 1} | {
    f"modes/{path.name}": 1 for path in (DOCS / "modes").glob("*.md")
}
"""Pages whose tests choose their Python blocks, and how many they run: a new one needs a test, or a mark with a reason."""


class Block(NamedTuple):
    """A block of code: where, in which language, and why it is not run; "" if it is."""

    place: str
    language: str
    code: str
    not_run: str


FENCE = re.compile(r"(?:<!-- not run: ([^\n]+) -->\n)?^( *)```(\S*)\n(.*?)^\2```$", re.MULTILINE | re.DOTALL)


def blocks_of(path: Path) -> list[Block]:
    text = path.read_text(encoding="utf-8")
    return [
        Block(f"{path.name}:{text[: found.start(3)].count(chr(10)) + 1}", found[3], found[4], found[1] or "")
        for found in FENCE.finditer(text)
    ]


FILES = (DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md", DOCS.parent / "SECURITY.md", *sorted(DOCS.rglob("*.md")))
BLOCKS = [block for path in FILES for block in blocks_of(path)]


def python(code: str) -> None:
    compile(code, "a block", "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)


def toml(code: str) -> None:
    document = tomllib.loads(code)
    if document.keys() >= {"buses", "nodes"}:
        parse_machine(code)


def yaml(code: str) -> None:
    pytest.importorskip("ruamel.yaml").YAML(typ="safe").load(code)


def json5(code: str) -> None:
    """As Zenoh's configuration has it: comments, names without quotes, commas at the end."""
    bare = re.sub(r'("(?:[^"\\]|\\.)*")|//[^\n]*', lambda found: found[1] or "", code)
    quoted = re.sub(r"([{,]\s*)([A-Za-z_]\w*)\s*:", r'\1"\2":', bare)
    text = re.sub(r",(\s*[}\]])", r"\1", quoted).strip()
    json.loads(text if text.startswith("{") else f"{{{text.rstrip(',')}}}")


def table(code: str) -> None:
    rows = list(csv.reader(io.StringIO(code), strict=True))
    assert len({len(row) for row in rows}) == 1, "a row has another number of columns"


READERS: dict[str, Callable[[str], object]] = {
    "python": python,
    "py": python,
    "toml": toml,
    "yaml": yaml,
    "xml": lambda code: ElementTree.fromstring(f"<part>{code}</part>"),
    "json": json.loads,
    "json5": json5,
    "csv": table,
}
"""What reads a block of each language. Shell has its own test below; `text`, or none, is what a command or a program prints."""


@pytest.mark.parametrize("language", READERS)
def test_the_blocks_of_a_language_are_of_it(language: str) -> None:
    """Python is run by the tests of its page: this is for the rest, and for what is marked as not run. What only shows a form is
    no Python."""
    found = [block for block in BLOCKS if block.language == language and not re.search(r"\bform\b", block.not_run)]
    for block in found:
        try:
            READERS[language](block.code)
        except Exception as error:
            error.add_note(block.place)
            raise


def test_each_language_has_a_reader() -> None:
    assert len(BLOCKS) > 200
    assert {block.language for block in BLOCKS} - READERS.keys() - {"sh", "text", ""} == set()


BROKEN = {
    "python": "def (:",
    "toml": "a = ",
    "json": "{",
    "json5": "{ a: }",
    "csv": "a,b\n1\n",
    "xml": "<a>",
    "yaml": "a: [",
    "py": "1 +",
}


@pytest.mark.parametrize("language", READERS)
def test_a_broken_block_is_found(language: str) -> None:
    with pytest.raises(Exception, match=r".+"):
        READERS[language](BROKEN[language])


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_a_shell_reads_each_block_of_its_own(tmp_path: Path) -> None:
    """Whether each command is there with its options is looked at in tests/cli/test_page_commands.py."""
    shell = [block for block in BLOCKS if block.language == "sh"]
    for number, block in enumerate(shell):
        (tmp_path / f"{number}.sh").write_text(re.sub(r"<(\w+)>", r"\1", block.code), encoding="utf-8")
    (tmp_path / "broken.sh").write_text("if true\n", encoding="ascii")
    script = 'for file in *.sh; do bash -n "$file" 2>/dev/null || echo "${file%.sh}"; done'
    told = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True).stdout.split()
    assert [shell[int(number)].place for number in told if number != "broken"] == []
    assert told == ["broken"]


def test_the_navigation_reaches_each_page() -> None:
    linked = set(re.findall(r"\]\(([^)#]+\.md)", (DOCS / "index.md").read_text(encoding="utf-8")))
    assert [page for page in PAGES if page not in linked] == []


@pytest.mark.parametrize("page", ["compiled.md", "simulated_drive.md"])
def test_the_python_of_a_page_without_a_test_of_its_own_runs(page: str) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, page, "exec"), {})


@pytest.mark.parametrize("page", PAGES)
def test_the_python_of_a_page_is_run_or_it_says_why_not(page: str) -> None:
    """By a test that names the page: it takes the blocks from there."""
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks = re.findall(r"(<!-- not run: [^\n]+ -->\n)?^```(?:python|py)\n", text, re.MULTILINE)
    if all(blocks):
        return
    folder, _, name = page.rpartition("/")
    if page in RUN:
        assert len([mark for mark in blocks if not mark]) == RUN[page]
    if folder == "services" or name == "cookbook.md":  # whose tests take what has its output behind it
        recipes = re.findall(r"```python\n(?:(?!```).)*```\n\n```text\n", text, re.DOTALL)
        assert len([mark for mark in blocks if not mark]) == len(recipes)
    if folder:
        assert OTHER_FOLDERS[folder]
        return
    sources = (path.read_text(encoding="utf-8") for path in TESTS.rglob("test_*.py"))
    assert any(f'"{name}"' in source for source in sources)
