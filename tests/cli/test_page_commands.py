"""The commands of the pages, each as printed there, in virtual time; a page's commands follow each other in one empty folder.

A comment that begins with `status N:` is the exit status that is meant. A block behind `<!-- not run: WHY -->` is left out.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from canopen_cli.app import COMMANDS, cli
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
                command = command.partition(" > ")[0]
                status = re.match(r" status (\d+):", comment)
                found.append((shlex.split(command)[1:], int(status[1]) if status else 0))
    return found


@pytest.mark.thorough(12)
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


LINE = re.compile(r"(?:^|[|] |&& )(canopen [^\n|&]*)", re.MULTILINE)


def command_lines() -> list[tuple[str, str]]:
    """Each line of a shell block of README and of the pages that gives a command of ours, with its page."""
    found = []
    for path in (DOCS.parent / "README.md", *sorted(DOCS.rglob("*.md"))):
        for _, block in BLOCK.findall(path.read_text(encoding="utf-8")):
            found += [(path.name, line.partition(" #")[0].strip()) for line in LINE.findall(block.replace("\\\n", " "))]
    return found


def check(command: click.Command, name: str, arguments: list[str], parent: click.Context | None = None) -> None:
    """Raise click's error if a command does not take these arguments. Values are not looked at."""
    context = click.Context(command, info_name=name, parent=parent)
    _, rest, _ = command.make_parser(context).parse_args(arguments)
    if isinstance(command, click.Group):
        if rest:
            inner = command.get_command(context, rest[0])
            assert inner is not None, f"{context.command_path} has no command {rest[0]}"
            check(inner, rest[0], rest[1:], context)
    else:
        assert not rest, f"{context.command_path} does not take {rest}"


def test_each_command_line_of_the_pages_exists_with_its_options() -> None:
    lines = command_lines()
    assert len(lines) > 150
    wrong = []
    for page, line in lines:
        words = [word for word in shlex.split(line.replace("...", ""))[1:] if word not in ("&", ";", "|")]
        redirected = next((place for place, word in enumerate(words) if word.startswith((">", "2>"))), len(words))
        try:
            check(cli, "canopen", words[:redirected])
        except (click.UsageError, AssertionError) as error:
            wrong.append((page, line, str(error)))
    assert wrong == []


def test_the_list_of_commands_has_each_of_them() -> None:
    table = (DOCS / "commands.md").read_text(encoding="utf-8").partition("\nEvery command")[0]
    assert sorted(re.findall(r"`([a-z-]+)`", table)) == sorted(COMMANDS)
