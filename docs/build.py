"""Build the site: all pages, with their pictures drawn anew, a page for each command, and every public name.

    python docs/build.py --into FOLDER               the site; open FOLDER/index.html, no server is needed
    python docs/build.py --into FOLDER --no-pictures   with the pictures that lie beside the pages

A warning of Sphinx is an error: a link or an anchor that leads nowhere, a page that the navigation does not reach. Needs the
extra `docs`.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import click
from sphinx.cmd.build import main as run_sphinx

sys.path.insert(0, str(Path(__file__).parent))

import charts
import pictures
import reference
from conf import as_rst

from canopen_cli.app import cli

DOCS: Final = Path(__file__).parent
PROJECT: Final = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
"""Pages beside this folder."""


def write_names(folder: Path) -> None:
    """Write a page for each public module: each class and function where it is at home, and references to the others."""
    folder.mkdir()
    for module in reference.public_modules():
        (folder / f"{module}.rst").write_text("\n".join(_module_page(module)), encoding="utf-8")


def _module_page(module: str) -> Iterator[str]:
    yield from (module, "=" * len(module), "", f".. py:module:: {module}", "")
    yield from (f".. automodule:: {module}", "   :no-index:", "")
    elsewhere: list[tuple[str, str]] = []
    for name in sorted(reference.public_modules()[module].__all__, key=str.lower):
        defined = reference.definition_of(module, name)
        home = reference.homes()[f"{defined.module}:{name}"]
        if home != module:
            elsewhere.append((name, home))
            continue
        match reference.KINDS.get(type(defined.node)):
            case None:
                text = defined.text or reference.value_text(defined.node)
                yield from (f".. py:data:: {name}", "", *(f"   {line}" for line in as_rst(text.splitlines())), "")
            case "class":
                yield from (f".. autoclass:: {name}", "   :members:", "   :show-inheritance:", "")
            case _:
                yield from (f".. autofunction:: {name}", "")
    for name, home in elsewhere:
        yield from (f"- ``{name}``: see :py:obj:`{home}.{name}`", "")


def write_commands(folder: Path) -> None:
    """Write a page for each command of the command line, with its subcommands; options that most have only on the first page."""
    folder.mkdir()
    context = click.Context(cli, info_name="canopen")
    shared = [each for each in cli.get_params(context) if isinstance(each, click.Option)]
    (folder / "canopen.md").write_text("\n".join(_command_page(context, shared, [])), encoding="utf-8")
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        inner = click.Context(command, info_name=name, parent=context)
        (folder / f"canopen-{name}.md").write_text("\n".join(_command_page(inner, [], shared)), encoding="utf-8")


def _command_page(context: click.Context, shown: list[click.Option], shared: list[click.Option], depth: int = 1) -> Iterator[str]:
    command = context.command
    yield f"{'#' * depth} {context.command_path}"
    yield ""
    yield from ("```text", command.get_usage(context).removeprefix("Usage: "), "```", "")
    with context.scope():
        formatter = click.HelpFormatter(width=100)
        command.format_help_text(context, formatter)
    yield from _help(formatter.getvalue())
    common = {option.opts[-1] for option in shared}
    own = shown or [
        each for each in command.get_params(context) if isinstance(each, click.Option) and each.opts[-1] not in common
    ]
    records = [record for option in own if (record := option.get_help_record(context)) is not None]
    if records:
        yield from ("| option | |", "|---|---|")
        for names, text in records:
            yield f"| `{reference.cell(names)}` | {reference.cell(text)} |"
        yield ""
    if any(option.opts[-1] in common for option in command.get_params(context) if isinstance(option, click.Option)):
        yield from ("It also takes [the options of most commands](canopen.md).", "")
    if isinstance(command, click.Group) and depth < 3 and context.parent is not None:
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            assert inner is not None
            yield from _command_page(click.Context(inner, info_name=name, parent=context), [], shared, depth + 1)


def _help(text: str) -> Iterator[str]:
    """Yield the text of a help page: sentences as they are, and examples as code."""
    for paragraph in text.strip("\n").split("\n\n"):
        lines = [line.removeprefix("  ") for line in paragraph.splitlines()]
        if any(line.lstrip().startswith("canopen ") for line in lines):
            yield from ("```text", *lines, "```", "")
        else:
            yield from (*lines, "")


def build(into: Path, draw: bool = True) -> int:
    """Build the site into a folder, in place of an older site. Returns Sphinx's status: 0 without a warning."""
    if into.exists() and any(into.iterdir()) and not (into / "objects.inv").is_file():
        raise SystemExit(f"{into} holds something else than a site; nothing was built. Name a new or an empty folder")
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary) / "source"
        shutil.copytree(DOCS, source, ignore=shutil.ignore_patterns("__pycache__"))
        for name in PROJECT:
            text = (DOCS.parent / name).read_text(encoding="utf-8").replace("](docs/", "](")
            (source / name).write_text(text, encoding="utf-8")
        write_names(source / "api")
        write_commands(source / "commands")
        if draw:
            for page in pictures.PICTURED:
                pictures.draw_page(page, source)
            charts.draw_all(source / "charts")
        shutil.rmtree(into, ignore_errors=True)
        return run_sphinx(["-q", "-W", "--keep-going", "-b", "html", "-d", f"{temporary}/trees", str(source), str(into)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--into", type=Path, metavar="FOLDER", required=True)
    parser.add_argument("--no-pictures", action="store_true", help="take those that lie beside the pages")
    arguments = parser.parse_args()
    status = build(arguments.into, draw=not arguments.no_pictures)
    size = sum(path.stat().st_size for path in arguments.into.rglob("*") if path.is_file())
    print(f"{arguments.into}: {size / 1e6:.1f} MB")
    raise SystemExit(status)


if __name__ == "__main__":
    main()
