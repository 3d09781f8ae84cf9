"""`WorkingThreads`: the threads whose work a program in a world awaits. The world's time stands still while one works.

asyncio tells its loop of each (`run_in_executor`). trio tells nobody: the function by which it starts them is replaced for the
run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from trio import _threads


class WorkingThreads:
    """See this module's text."""

    def __init__(self) -> None:
        self._working: dict[object, str] = {}
        self._has_news = False

    def begins(self, name: str) -> Callable[[], None]:
        """Take note of one. Returns the function to call when its result is there; by any thread. name: for people."""
        token = object()
        self._working[token] = name

        def ends() -> None:
            self._has_news = True
            self._working.pop(token, None)

        return ends

    @property
    def names(self) -> list[str]:
        """Return those that work now."""
        return [*self._working.values()]

    def take_news(self) -> bool:
        """Return whether one has ended since the last look: its result may wait for the loop."""
        has_news, self._has_news = self._has_news, False
        return has_news


def watch_threads(threads: WorkingThreads) -> Callable[[], None]:
    """Take note of the threads of this trio run. Returns the function that ends it."""
    start: Any = getattr(_threads, "start_thread_soon", None)
    if start is None:
        raise RuntimeError("this version of trio starts threads in another way: use trio 0.33 to 0.35")

    def start_noted(fn: Callable[[], Any], deliver: Callable[[Any], object], name: str | None = None) -> None:
        ends = threads.begins(name or repr(fn))

        def deliver_noted(result: Any) -> None:
            deliver(result)
            ends()

        start(fn, deliver_noted, name)

    _threads.start_thread_soon = start_noted  # type: ignore[attr-defined]

    def give_back() -> None:
        _threads.start_thread_soon = start  # type: ignore[attr-defined]

    return give_back
