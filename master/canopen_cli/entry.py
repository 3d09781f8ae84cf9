"""The `canopen` command. If the libraries of the command line are not installed, it names the extra to install."""

from __future__ import annotations

import json
import sys

from canopen_cli.shared.importing import LibraryMissingError, collector_at_rest, importing

CANNOT_OPEN = 3


def main() -> int:
    """Run the command line and return its exit status: 3, after two lines of advice, if a library is missing."""
    try:
        with collector_at_rest():
            with importing():
                from canopen_cli.app import main as run
            return run()
    except LibraryMissingError as missing:
        print(_document(missing) if "--json" in sys.argv else f"canopen: {missing}", file=sys.stderr)
        return CANNOT_OPEN


def _document(missing: LibraryMissingError) -> str:
    failed, _, step = str(missing).partition("\nTry: ")
    from canopen_cli.shared.problem import CommandError, ExitCode

    problem = CommandError(ExitCode.CANNOT_OPEN, "", failed, tries=(step,))
    return json.dumps({**problem.as_json(), "notes": []})
