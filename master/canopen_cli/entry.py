"""The `canopen` command, also of an install that lacks the libraries of the command line: it says which extra to install.

It stands in this package because all of canopen_master needs trio, and this one nothing but the standard library.

Reading in the command line takes a third of a second, in which no drive is touched. A Ctrl-C in that time simply ends the process
(a shell calls that 130, as ever): Python's KeyboardInterrupt would show where in an import it struck, or be swallowed there.
"""

from __future__ import annotations

import signal
import sys

NEEDED = {"click", "rich", "trio", "can"}
CANNOT_OPEN = 3


def main() -> int:
    """Run the command line; exit status 3 and one line of advice where its libraries are not installed."""
    raises = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else it is ignored: a shell's background job
    if raises:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        from canopen_cli.app import main as run
    except ModuleNotFoundError as missing:
        library = (missing.name or "").partition(".")[0]
        if library not in NEEDED:
            raise
        print(
            f"canopen: the command line needs {library}, which is not installed.\nTry: pip install 'canopen-proto[master]'",
            file=sys.stderr,
        )
        return CANNOT_OPEN
    finally:
        if raises:
            signal.signal(signal.SIGINT, signal.default_int_handler)
    return run()
