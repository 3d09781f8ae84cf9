"""The commands of the pages, each as printed there, in virtual time; a page's commands follow each other in one empty folder.

A comment that begins with `status N:` is the exit status that is meant. A block behind `<!-- not run: WHY -->` is left out.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from tests.cli.cli_support import runner_in_folder
from tests.docs_build import DOCS

PAGES = ("start-no-hardware.md", "start-log.md", *(f"services/{path.name}" for path in sorted((DOCS / "services").glob("*.md"))))
BLOCK = re.compile(r"(<!-- not run: [^\n]+ -->\n)?```sh\n(.*?)```", re.DOTALL)


def commands_of(page: str) -> list[tuple[list[str], int]]:
    """The arguments of each command of a page, and its exit status."""
    found = []
    for not_run, block in BLOCK.findall((DOCS / page).read_text(encoding="utf-8")):
        for line in block.splitlines() if not not_run else ():
            if line.startswith("canopen "):
                command, _, comment = line.partition("  #")
                status = re.match(r" status (\d+):", comment)
                found.append((shlex.split(command)[1:], int(status[1]) if status else 0))
    return found


@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page(
    page: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run = runner_in_folder(capsys, monkeypatch, tmp_path)
    commands = commands_of(page)
    assert len(commands) >= 2
    for arguments, status in commands:
        outcome = run(*arguments)
        assert outcome.status == status, (arguments, outcome.err)
        assert outcome.out + outcome.err, arguments
