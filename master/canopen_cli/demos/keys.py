"""The keys of the terminal, for demos that block: each call waits for the answer of `canopen_cli.terminal_keys`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import trio

from canopen_cli.jog import is_terminal
from canopen_cli.problem import usage
from canopen_cli.terminal_keys import END, Keys, key_by_key, read_terminal

ENDS = ("q", "\x1b", END)
"""Keys that end a demo; also the end of the terminal."""


class HeldKeys:
    """Keys that are held. Any thread may ask, one at a time."""

    def __init__(self) -> None:
        self._keys = Keys(lambda: read_terminal())

    def next(self) -> str:
        """Wait for the next key, and return it."""
        return trio.run(self._keys.next)

    def is_held(self, key: str) -> bool:
        """Return whether a key that has just come is held, that is, repeated."""
        return trio.run(self._keys.is_held, key)

    def holder(self, key: str) -> Callable[[], bool]:
        """Return a function that waits for the next repetition of a key that is held, and returns whether it came in time."""
        return lambda: trio.run(self._keys.is_still_held, key)


@contextmanager
def held_keys() -> Iterator[HeldKeys]:
    """Have each key at once while the block runs. Raises Problem without a terminal."""
    if not is_terminal():
        raise usage("CO122", "this demo needs a terminal, whose keys are held", seen="nothing was sent", tries=("canopen move",))
    with key_by_key():
        yield HeldKeys()
