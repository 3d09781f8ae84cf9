"""`canopen eds fix`: repair an EDS or DCF where no guessing is needed."""

from __future__ import annotations

import difflib

import click

from canopen_cli.shared.eds_files import finding_as_json
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data.checks import check
from canopen_data.description import FileKind
from canopen_data.findings import Severity
from canopen_data.named_files import lines_of, open_description
from canopen_data.repair import repair

_STYLES = {"+": "green", "-": "red", "@": "cyan"}


@command()
@click.argument("path", metavar="FILE")
@click.option("-o", "--output", metavar="OUT", help="The repaired file.")
@click.option("--in-place", is_flag=True, help="Write it back to FILE.")
@click.option("--dry-run", is_flag=True, help="Show what would be changed, as a unified diff, and write nothing.")
def fix(settings: Settings, screen: Screen, path: str, output: str | None, in_place: bool, dry_run: bool) -> int:
    """Repair an EDS or DCF: counts and lists, missing types, forms of numbers, duplicate sections, encoding.

    Each repair is reported. Nothing is guessed: the meaning of the file stays as it was, and no value is made up.
    `canopen eds lint` reports the other faults.

    \b
    canopen eds fix drive.eds --dry-run
    canopen eds fix drive.eds -o fixed.eds
    """
    if sum((output is not None, in_place, dry_run)) != 1:
        tries = (f"canopen eds fix {path} --dry-run", f"canopen eds fix {path} -o fixed.eds")
        raise usage("CO001", "name the place of the repaired file: one of -o OUT, --in-place, --dry-run", tries=tries)
    file = open_description(path, settings.encoding)
    if file.description.kind not in (FileKind.EDS, FileKind.DCF):
        raise usage("CO001", f"{path} is an {file.description.kind}; only EDS and DCF can be repaired")
    repaired = repair(file.description)
    target = path if in_place else output
    if output is not None:
        check_new_file(settings, screen, output, path)
    if target is not None:
        write_file(target, repaired.text.encode("utf-8", "replace"), *(() if in_place else (path,)))
    left = [*repaired.description.findings, *check(repaired.description)]
    left = [each for each in left if each.severity is not Severity.NOTICE]
    new = lines_of(repaired.text)
    lines = list(difflib.unified_diff(file.lines, new, path, f"{path} (repaired)", lineterm=""))
    if settings.json:
        document = {"file": path, "output": target, "repairs": [finding_as_json(each) for each in repaired.repairs]}
        screen.json(document | {"left": [finding_as_json(each) for each in left], "diff": lines if dry_run else None})
    else:
        for each in repaired.repairs:
            where = f"{path}:{each.line}: " if each.line else f"{path}: "
            screen.say(f"{escape(where)}{escape(each.message)} [dim]\\[{each.code}][/]")
        if dry_run:
            for line in lines:
                style = _STYLES.get(line[:1], "")
                screen.out.print(escape(line), style=style, soft_wrap=True, highlight=False)
        told = counted(len(repaired.repairs), "repair")
        more = f"; {counted(len(left), 'finding')} left for you: canopen eds lint {target or path}" if left else ""
        screen.say(f"{told}{f', written to {escape(target)}' if target else ''}{escape(more)}")
    return ExitCode.DIFFERENT if dry_run and repaired.repairs else ExitCode.OK
