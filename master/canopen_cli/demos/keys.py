"""The keys of the terminal, for demos that block: each call waits for the answer of `canopen_cli.shared.terminal_keys`."""

from __future__ import annotations

import threading
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from functools import partial
from typing import Final, TypeVar

import trio

from canopen_cli.motion.jog import is_terminal
from canopen_cli.shared.problem import usage
from canopen_cli.shared.terminal_keys import END, TerminalKeys, key_by_key, read_terminal

T = TypeVar("T")

_LOOK_UP: Final = 0.5
"""The longest single wait, in seconds: on Windows, a Ctrl-C takes effect only when it is over."""
ENDS: Final = ("q", "\x1b", END)
"""Keys that end a demo; also the end of the terminal."""


class HeldKeys:
    """Keys that are held. Any thread may ask, one at a time."""

    def __init__(self) -> None:
        self._keys = TerminalKeys(lambda: read_terminal())

    def next(self) -> str:
        """Wait for the next key, and return it."""
        return _in_thread(self._keys.next)

    def is_held(self, key: str) -> bool:
        """Return whether a key that has just come is held, that is, repeated."""
        return _in_thread(partial(self._keys.is_held, key))

    def holder(self, key: str) -> Callable[[], bool]:
        """Return a function that waits for the next repetition of a key that is held, and returns whether it came in time."""
        return lambda: _in_thread(partial(self._keys.is_still_held, key))


def _in_thread(function: Callable[[], Awaitable[T]]) -> T:
    """Run an async function in a thread, so that a Ctrl-C ends the waiting here, and return its result."""
    future: Future[T] = Future()

    def work() -> None:
        try:
            future.set_result(trio.run(function))
        except BaseException as error:  # noqa: BLE001 - it belongs to the caller
            future.set_exception(error)

    threading.Thread(target=work, daemon=True, name="keys").start()
    while not future.done():
        wait((future,), _LOOK_UP)
    return future.result()


@contextmanager
def held_keys() -> Iterator[HeldKeys]:
    """Have each key at once while the block runs. Raises CommandError without a terminal."""
    if not is_terminal():
        raise usage("CO122", "this demo needs a terminal, whose keys are held", seen="nothing was sent", tries=("canopen move",))
    with key_by_key():
        yield HeldKeys()
