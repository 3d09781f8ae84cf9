"""`canopen eds doc`: make one readable page of a device description."""

from __future__ import annotations

import sys

import click

from canopen_cli.eds.html import html_of
from canopen_cli.eds.markdown import markdown_of
from canopen_cli.eds.page import page_of
from canopen_cli.shared.eds_files import tell_faults
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.screen import Screen, escape
from canopen_data.named_files import open_description

FORMS = {".html": "html", ".htm": "html", ".md": "md", ".markdown": "md"}


@command()
@click.argument("path", metavar="FILE")
@click.option("-o", "--output", metavar="OUT", help="The page: OUT.html or OUT.md. Without it, the page goes to stdout.")
@click.option("--form", type=click.Choice(["html", "md"]), help="By default what the name of OUT says, else html.")
def doc(settings: Settings, screen: Screen, path: str, output: str | None, form: str | None) -> None:
    """Make one readable page of a device description: HTML that needs nothing else, or Markdown.

    \b
    canopen eds doc drive.eds -o drive.html
    canopen eds doc drive.eds --form md
    """
    if output is not None:
        check_new_file(settings, screen, output, path)
    file = open_description(path, settings.encoding)
    if form is None:
        ending = "" if output is None else output[output.rfind(".") :].lower() if "." in output else ""
        form = FORMS.get(ending, "html")
    page = page_of(file.description)
    text = html_of(page) if form == "html" else markdown_of(page)
    if output is not None:
        write_file(output, text.encode("utf-8", "replace"), path)
    if settings.json:
        screen.json({"file": path, "form": form, "output": output, "page": None if output is not None else text})
        return
    tell_faults(screen, file)
    if output is None:
        sys.stdout.write(text)
    else:
        screen.say(f"{escape(output)}: {len(page.names)} names, {len(page.pdos)} PDOs of {escape(page.title)}")
