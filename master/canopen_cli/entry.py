"""The `canopen` command, also of an install that lacks the libraries of the command line: it says which extra to install."""

from __future__ import annotations

import sys

from canopen_cli.importing import LibraryMissing, importing

CANNOT_OPEN = 3


def main() -> int:
    """Run the command line and return its exit status: 3, after two lines of advice, where a library is not installed."""
    try:
        with importing():
            from canopen_cli.app import main as run
        return run()
    except LibraryMissing as missing:
        print(f"canopen: {missing}", file=sys.stderr)
        return CANNOT_OPEN
