"""Import the parts of the command line: end quietly on a Ctrl-C meanwhile, and say which library is missing.

The imports of a command take a third of a second, and no drive is touched meanwhile. A Ctrl-C in that time simply ends the
process (a shell reports 130, as always): Python's KeyboardInterrupt would show the place in the import, or be swallowed there.
"""

from __future__ import annotations

import gc
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

LIBRARIES: Final = (
    dict.fromkeys(("click", "rich", "trio", "can", "tomli_w"), "master")
    | dict.fromkeys(("starlette", "hypercorn", "prometheus_client"), "web")
    | {"mcp": "mcp", "textual": "tui"}
)
"""The libraries that a command may lack, and the extra that has each. The core and the data files need none of them."""


class LibraryMissingError(Exception):
    """Raised if one of LIBRARIES is not installed."""

    def __init__(self, library: str) -> None:
        extra = LIBRARIES[library]
        what = "the command line" if extra == "master" else "this command"
        super().__init__(f"{what} needs {library}, which is not installed.\nTry: pip install 'canopen-proto[{extra}]'")


def library_missing(error: ModuleNotFoundError) -> LibraryMissingError | None:
    """Return the error for a module of LIBRARIES; None for any other."""
    library = (error.name or "").partition(".")[0]
    return LibraryMissingError(library) if library in LIBRARIES else None


@contextmanager
def collector_at_rest() -> Iterator[None]:
    """Run a whole command within this block. The garbage collector rests until `start_is_over`, and from the end of the block on.

    What was imported stays to the end of the process. The collector would look at all of it again and again, and once more at
    the end: a fifth of the time of a short command.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def start_is_over() -> None:
    """Let the garbage collector work from here on, if it rests. It leaves alone what is there now."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


@contextmanager
def importing() -> Iterator[None]:
    """Import within this block. Raises LibraryMissingError in place of the ModuleNotFoundError of one of LIBRARIES."""
    # Keep another handler: a shell sets SIG_IGN for background jobs. And only the main thread may set one.
    raises = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    ends = raises and threading.current_thread() is threading.main_thread()
    if ends:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    except ModuleNotFoundError as missing:
        if (named := library_missing(missing)) is None:
            raise
        raise named from None
    finally:
        if ends:
            signal.signal(signal.SIGINT, signal.default_int_handler)
