"""Settings of Sphinx for the site. `python docs/build.py` runs it, over a copy of this folder with the pages that it makes.

The same pages are read on GitHub: so the navigation is index.md, a page like any other one. Its sections become those of the
sidebar (`with_navigation`), and links to sources outside this folder become plain text.
"""

from __future__ import annotations

import builtins
import re
from collections.abc import Iterator
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any, Final

from sphinx.application import Sphinx
from sphinx.domains.python import PythonDomain

project = "canopen-proto"
author = "The canopen-proto authors"
release = version = version_of("canopen-proto")

extensions = ["myst_parser", "sphinx.ext.autodoc"]
exclude_patterns = ["*.py"]
myst_heading_anchors = 4

html_theme = "furo"
html_title = f"canopen-proto {release}"
html_show_sourcelink = html_copy_source = False
html_show_sphinx = html_show_copyright = False
html_permalinks_icon = "#"
html_show_search_summary = False  # which the search fetches: a browser refuses that to pages of a disk
html_static_path = ["static"]
html_css_files = ["site.css"]
html_search_scorer = str(Path(__file__).parent / "static" / "scores.js")

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
add_module_names = False
toc_object_entries = False

LINK: Final = re.compile(r"\]\(([^)#\s]+\.md)[^)]*\)")
OUTSIDE: Final = re.compile(r"\[([^]]*)\]\(\.\./(?:tests|master|transports|data|canopen_proto|fuzz|benchmarks)[^)]*\)")
MADE: Final = {"Commands": "commands", "Every name": "api"}
"""Sections of the sidebar that are only in the site: a folder that docs/build.py makes."""


def with_navigation(text: str, folder: Path) -> str:
    """Return index.md with a hidden table of contents for each of its sections: the pages that the section links to."""
    text = text.replace("](../", "](")  # pages beside this folder: docs/build.py puts them into it
    listed: dict[str, list[str]] = {}
    for section in text.split("\n## ")[1:]:
        title, _, body = section.partition("\n")
        listed[title] = list(dict.fromkeys(link.removesuffix(".md") for link in LINK.findall(body)))
    for title, made in MADE.items():
        if (folder / made).is_dir():
            listed[title] = sorted(f"{made}/{path.stem}" for path in (folder / made).iterdir())
    return text + "".join(_contents(title, pages) for title, pages in listed.items() if pages)


def _contents(title: str, pages: list[str]) -> str:
    return "\n".join(("", "```{toctree}", ":hidden:", ":maxdepth: 1", f":caption: {title}", "", *pages, "```", ""))


def read_page(app: Sphinx, name: str, source: list[str]) -> None:
    """Sphinx's source-read: make of a page for GitHub a page of the site."""
    text = OUTSIDE.sub(r"\1", source[0])
    source[0] = with_navigation(text, Path(app.srcdir)) if name == "index" else text


def read_docstring(app: Sphinx, kind: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    """Sphinx's autodoc-process-docstring: docstrings here are text with `code`, lists and indented examples."""
    lines[:] = list(as_rst(lines))


CODE: Final = re.compile(r"`([^`]+)`")
MARKUP: Final = re.compile(r"([\\*|_`])")
ITEM: Final = re.compile(r" *(?:-|\d+\.) ")


def as_rst(lines: list[str]) -> Iterator[str]:
    """Yield a docstring as reStructuredText: nothing in it is markup but `code`, lists, and what is indented."""
    for paragraph in re.split(r"\n\s*\n", "\n".join(lines).strip("\n")) if any(lines) else ():
        each = paragraph.splitlines()
        if all(line.startswith("    ") for line in each):
            yield from ("::", "", *each, "")
            continue
        parts: list[str] = []
        for line in each:
            if parts and not ITEM.match(line):
                parts[-1] += f" {line.strip()}"  # code may go over the end of a line
            else:
                parts.append(line)
        for part in parts:
            yield from (_inline(part), "")


def _inline(line: str) -> str:
    parts = CODE.split(line)  # text, code, text ...
    for place, part in enumerate(parts):
        if place % 2:
            apart = "\\ " if re.match(r"[\w(]", parts[place + 1]) else ""  # code ends only before a space or a sign
            parts[place] = f"``{part}``{apart}"
        else:
            bold = r"\*\*([^*]+)\*\*"
            pieces = re.split(bold, part)  # text, bold, text ...
            parts[place] = "".join(
                f"**{each}**" if number % 2 else MARKUP.sub(r"\\\1", each) for number, each in enumerate(pieces)
            )
    return "".join(parts)


class OurNames(PythonDomain):
    """A name of Python itself, such as `object`, is none of ours, also where classes of ours have fields of that name."""

    def find_obj(self, env: Any, module: Any, owner: Any, name: str, kind: Any, searchmode: int = 0) -> Any:
        return [] if hasattr(builtins, name) else super().find_obj(env, module, owner, name, kind, searchmode)


def setup(app: Sphinx) -> None:
    app.add_domain(OurNames, override=True)
    app.connect("source-read", read_page)
    app.connect("autodoc-process-docstring", read_docstring)
