"""Ask a person during a command, while the bus goes on: heartbeats are sent, and Ctrl-C ends the command as ever.

The answers come from stdin, line by line. An empty line is the default, which is safe for each question: nothing moves by it. No
more input ends the command as a Ctrl-C does.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Sequence

import click
import trio

from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.screen import Screen, escape
from canopen_master.plain_text import clean


class Questions:
    """The questions of one command. agrees: nobody is asked; each default is taken, and whatever may move does (--yes)."""

    def __init__(self, screen: Screen, *, agrees: bool = False) -> None:
        self._screen = screen
        self.agrees = agrees
        self._input = b""

    async def ask(self, question: str, default: str = "", *, shown: str | None = None) -> str:
        """Return the answer, without blanks around it. shown: what is shown as the default, instead of itself."""
        offered = default if shown is None else shown
        asked = f"{escape(question)} {escape(f'[{offered}]' if offered else '')} "
        if self.agrees:
            self._screen.say(asked)
            return default
        self._screen.ask(asked)
        return (await self._line()).strip() or default

    async def may(self, question: str) -> bool:
        """Return whether something may be done. Anything but yes is no."""
        asked = f"[bold]{escape(question)}[/] {escape('[y/N]')} "
        if self.agrees:
            self._screen.say(f"{asked}yes (--yes)")
            return True
        self._screen.ask(asked)
        return (await self._line()).strip().lower() in ("y", "yes")

    async def number(self, question: str, default: float | None, unit: str = "", *, above_zero: bool = False) -> float | None:
        """Return a finite number, or `default` for an empty answer. Asks again for what is none, and for one that is not above 0
        if it has to be. unit: shown behind the default."""
        while True:
            shown = "none" if default is None else f"{default:.10g} {unit}".strip()
            answer = await self.ask(question, shown=shown)
            if not answer:
                return default
            try:
                number = float(answer)
            except ValueError:
                number = math.nan
            if math.isfinite(number) and (number > 0 or not above_zero):
                return number
            self._screen.say(f"[yellow]{escape(repr(answer))} is no number{' above 0' * above_zero}[/]")

    async def choice(self, question: str, choices: Sequence[str], default: str) -> str:
        """Return one of the choices. Asks again for what is none."""
        while True:
            answer = await self.ask(f"{question} ({', '.join(choices)})", default)
            if answer in choices:
                return answer
            self._screen.say(f"[yellow]{escape(repr(answer))} is none of {', '.join(choices)}[/]")

    async def _line(self) -> str:
        while b"\n" not in self._input:
            read = await read_input()
            if not read:
                self._screen.say("")
                raise CommandError(ExitCode.INTERRUPTED, "CO132", "by the end of the input")
            self._input += read
        line, _, self._input = self._input.partition(b"\n")
        return line.decode(errors="replace")


def is_asked(screen: Screen) -> bool:
    """Return whether there is a person to ask."""
    return screen.err.is_terminal and sys.stdin.isatty()


def require_somebody(screen: Screen, question: str, yes: bool) -> None:
    """Raise a CommandError if a question has to be answered, now or after minutes of looking, and there is nobody to ask."""
    if not (yes or is_asked(screen)):
        raise usage("CO122", f"{question}. This must be confirmed", seen="nothing was sent", tries=("the same with --yes",))


def confirm(screen: Screen, question: str, yes: bool, *, needed: bool) -> None:
    """Ask the user to confirm a dangerous command, unless --yes did. Raises a CommandError if it is not confirmed."""
    if yes or not needed:
        return
    require_somebody(screen, question, yes)
    if not click.confirm(f"{clean(question)}. Go on?", err=True):
        raise CommandError(ExitCode.INTERRUPTED, "CO132", "by you: nothing was sent")


async def read_input() -> bytes:
    """Wait for input, and return what is there; nothing at its end."""
    # Not by sys.stdin: a thread that waits in it keeps its lock, and the process could not end after a Ctrl-C
    return await trio.to_thread.run_sync(os.read, sys.stdin.fileno(), 4096, abandon_on_cancel=True)
