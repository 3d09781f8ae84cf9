"""The `canopen` command, also of an install that lacks the libraries of the command line: it says which extra to install.

It stands in this package because all of canopen_master needs trio, and this one nothing but the standard library. Reading in the
command line takes a third of a second; a Ctrl-C in that time ends it as at any other.
"""

from __future__ import annotations

import sys

NEEDED = {"click", "rich", "trio", "can"}
CANNOT_OPEN = 3
INTERRUPTED = 130


def main() -> int:
    """Run the command line; exit status 3 and one line of advice where its libraries are not installed."""
    try:
        from canopen_master.cli import main as run
    except ModuleNotFoundError as missing:
        library = (missing.name or "").partition(".")[0]
        if library not in NEEDED:
            raise
        print(
            f"canopen: the command line needs {library}, which is not installed.\nTry: pip install 'canopen-proto[master]'",
            file=sys.stderr,
        )
        return CANNOT_OPEN
    except KeyboardInterrupt:
        print("interrupted by Ctrl-C", file=sys.stderr)
        return INTERRUPTED
    return run()
