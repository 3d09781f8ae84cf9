"""The `canopen` command of an install that may lack the libraries of the command line: it says which extra to install."""

from __future__ import annotations

import sys

NEEDED = {"click", "rich", "trio", "can"}


def main() -> int:
    """Run the command line; exit status 3 and one line of advice where its libraries are not installed."""
    try:
        from canopen_master.cli import main as run
    except ModuleNotFoundError as missing:
        if missing.name is None or missing.name.partition(".")[0] not in NEEDED:
            raise
        print(
            f"canopen: the command line needs {missing.name}, which is not installed.\nTry: pip install 'canopen-proto[master]'",
            file=sys.stderr,
        )
        return 3
    return run()
