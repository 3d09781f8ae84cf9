"""All pages: the navigation reaches each, a test runs the Python on each, and no page is only the beginning of one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs_build import DOCS

TESTS = Path(__file__).parent
PAGES = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md") if path.name != "index.md")
OTHER_FOLDERS = {"modes": "tests/test_modes_pages.py", "services": "tests/test_recipes.py"}
"""Folders of pages, and the test that runs their Python."""


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
    if folder:
        assert OTHER_FOLDERS[folder]
        return
    sources = (path.read_text(encoding="utf-8") for path in TESTS.rglob("test_*.py"))
    assert any(f'"{name}"' in source for source in sources)
