"""`protected`: marks a function that a Ctrl-C does not interrupt in its middle, on either loop.

Python raises KeyboardInterrupt anywhere: in the middle of a machine's turn, which would leave core and wire apart. trio holds it
back in functions that are marked. On asyncio `Loop.holding_interrupts` does. A function is marked when its module is loaded, and
no loop runs then.
"""

from __future__ import annotations

from collections.abc import Callable
from types import CodeType, FrameType
from typing import Any, Final, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

_codes: Final[set[CodeType]] = set()
_functions: Final[list[Callable[..., Any]]] = []
_mark_on_trio: list[Callable[[Any], Any]] = []  # trio's own way to mark, once it is loaded


def protected(function: F) -> F:
    """Mark a function; return it."""
    _codes.add(function.__code__)
    if _mark_on_trio:
        _mark_on_trio[0](function)
    else:
        _functions.append(function)
    return function


def tell_trio(mark: Callable[[Any], Any]) -> None:
    """Mark all functions for trio too, also those that come later."""
    _mark_on_trio.append(mark)
    for function in _functions:
        mark(function)
    _functions.clear()


def is_protected(frame: FrameType | None) -> bool:
    """Whether a frame runs for a function that is marked."""
    while frame is not None:
        if frame.f_code in _codes:
            return True
        frame = frame.f_back
    return False
