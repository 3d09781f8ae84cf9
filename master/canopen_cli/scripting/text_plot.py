"""`plot` of `canopen shell`: the values of objects over some seconds, drawn in the terminal as they come.

    >>> plot 5:velocity_actual_value 5:position_actual_value 10s
    >>> await plot("velocity_actual_value", seconds=10)          # of `node`

Each object is read by SDO again and again. Ctrl-C ends it, and what has come stays on the screen.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import trio
from rich.console import Group
from rich.live import Live
from rich.text import Text

from canopen_cli.live.braille import DOWN, curve
from canopen_cli.shared.problem import CommandError, usage
from canopen_cli.shared.screen import Screen, node_text
from canopen_cli.shared.values import physical
from canopen_data.durations import parse_duration
from canopen_master.node import Node
from canopen_master.plain_text import clean
from canopen_proto.dictionary.objects import Variable
from canopen_proto.machine import SECOND

SECONDS: Final = 5.0
EACH: Final = 0.05
"""Seconds between two values of an object."""
MOST: Final = 4
"""Objects that fit on a screen of 24 lines."""
HEIGHT: Final = 4
MIDDLE: Final = (HEIGHT * DOWN - 1) // 2 // DOWN
"""The line in which a curve stands that does not change."""
LABEL: Final = 12
"""Columns for the least and the greatest value, before a curve."""
_LINE: Final = re.compile(r"plot((?:[ \t]+[0-9A-Za-z_][\w:.]*)+)\s*\Z")
_TIME: Final = re.compile(r"[0-9]+(\.[0-9]+)?(s|ms|min)\Z")


def statement_of(line: str) -> str:
    """Return a line of the prompt as Python: `plot 5:statusword 10s` is a call of `plot`."""
    found = _LINE.match(line)
    words = [] if found is None else found[1].split()
    if not words or keyword.iskeyword(words[0]):  # `plot is None`
        return line
    times = [word for word in words if _TIME.match(word)]
    seconds = f", seconds={parse_duration(times[-1]) / SECOND!r}" if times else ""
    return f"await plot({', '.join(repr(word) for word in words if word not in (*times, 'for'))}{seconds})"


@dataclass
class PlottedObject:
    """An object that is drawn. points: seconds since the beginning, and the value."""

    node: Node
    variable: Variable
    points: list[tuple[float, float]] = field(default_factory=list)

    def picture(self, seconds: float, width: int) -> Text:
        """Return its curve, with its name above. seconds: of the whole width."""
        unit = f" {self.variable.unit}" if self.variable.unit else ""
        last = f" = {self.points[-1][1]:.6g}{unit}" if self.points else ""
        picture = Text(clean(f"{node_text(self.node.node_id)}: {self.variable.name}{last}"), style="bold", no_wrap=True)
        inside = [(at / seconds, value, value) for at, value in self.points]
        lines, least, most = curve(inside, max(10, width - LABEL - 1), HEIGHT, gap=1.0)
        for number, line in enumerate(lines):
            bound = {0: most, HEIGHT - 1: least}.get(number) if most > least else {MIDDLE: least}.get(number)
            shown = "" if bound is None or not inside else f"{bound:.6g}"
            picture.append(f"\n{shown:>{LABEL}} ", style="dim")
            picture.append(line, style="cyan")
        return picture


class TextPlot:
    """See this module's text. node_of: the node of a text such as "5"; None stands for the shell's own."""

    def __init__(self, screen: Screen, node_of: Callable[[str | None], Node]) -> None:
        self._screen = screen
        self._node_of = node_of

    async def plot(self, *objects: str, seconds: float = SECONDS) -> None:
        """Read objects again and again, and draw their values. objects: 1 to MOST, such as "5:velocity_actual_value"; without a
        node, of `node`. seconds: how long, at most 3600. Raises a CommandError, and what `Node.read` raises."""
        if not 0 < len(objects) <= MOST or not 0 < seconds <= 3600:
            raise usage(
                "CO001", f"plot takes 1 to {MOST} objects, and up to an hour", tries=("plot 5:velocity_actual_value 10s",)
            )
        plotted = [self._object(word) for word in objects]
        console = self._screen.out
        with Live(console=console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False) as live:
            begun = trio.current_time()
            while (passed := trio.current_time() - begun) <= seconds:
                for each in plotted:
                    value = await each.node.read(each.variable)
                    scaled = physical(each.variable, value)
                    number = value if scaled is None else scaled
                    if not isinstance(number, int | float):
                        raise usage("CO001", f"{each.variable.label} is no number: it cannot be drawn")
                    each.points.append((trio.current_time() - begun, float(number)))
                if console.is_terminal:
                    live.update(self._picture(plotted, seconds, passed), refresh=True)
                await trio.sleep(EACH)
            live.update(self._picture(plotted, seconds, seconds), refresh=True)

    def _object(self, word: str) -> PlottedObject:
        node_text_given, colon, key = word.partition(":")
        if colon and key:
            try:
                node = self._node_of(node_text_given)
                return PlottedObject(node, node.dictionary.variable(key))
            except CommandError:  # no node: a name with a colon in it, of `node`
                if node_text_given.isdecimal():
                    raise
        node = self._node_of(None)
        return PlottedObject(node, node.dictionary.variable(word))

    def _picture(self, plotted: Sequence[PlottedObject], seconds: float, passed: float) -> Group:
        left = Text(f"{max(0.0, seconds - passed):.1f} s left; Ctrl-C ends it", style="dim") if passed < seconds else Text("")
        return Group(*(each.picture(seconds, self._screen.out.width) for each in plotted), left)
