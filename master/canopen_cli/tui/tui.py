"""`canopen tui`: a view of a machine that stays open in a terminal."""

from __future__ import annotations

import asyncio
import errno
import os
import sys
from collections import deque
from typing import Any

from rich.text import Text

from canopen_cli.serve.served import open_with_files
from canopen_cli.shared.importing import importing
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.permissions import allow_option
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.running import run_until_interrupted
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.streams import put_lost_terminal_to_rest
from canopen_cli.tui.guest import run_beside
from canopen_cli.tui.machine_watch import MachineWatch
from canopen_cli.tui.terminal_file import terminal_file
from canopen_gateway import Permission, open_gateway

LEAST_COLUMNS, LEAST_LINES = 40, 10


@command()
@allow_option("What may be changed: write, motion, store, program, nmt, lss")
def tui(settings: Settings, screen: Screen, allow: frozenset[Permission]) -> None:
    """A view that stays open: nodes, objects, emergencies, live values, traffic, drives. Needs the extra `tui`.

    1 to 6 choose a view, ? shows all keys, q or Ctrl-C ends. It only listens until something is looked at: objects are read by
    Enter, drives while their view is shown, node-IDs asked by f. Each kind of change has to be named by --allow, as for `canopen
    serve`, and is asked about. H halts all, always; it is no emergency stop.

    \b
    canopen tui -b demo                     six simulated drives, read-only
    canopen tui -b can0 -e 5=drive.eds --allow write,nmt
    canopen tui -m cell.toml                all buses of a machine
    """
    _require_terminal(settings, screen)
    screen = _HiddenScreen(settings)
    view = _Running(settings, screen, allow)
    run_until_interrupted(settings, screen, view.serve, loop=run_beside(view.show, view.end))
    view.require_good_end()


def _require_terminal(settings: Settings, screen: Screen) -> None:
    """Raise a CommandError if there is no terminal that can show a view; LibraryMissingError."""
    instead = ("canopen top --once", "canopen monitor", "canopen serve web")
    if settings.json:
        raise usage("CO123", "a view has no JSON", tries=("canopen top --json", *instead[1:]))
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise usage("CO122", "a view needs a terminal, for its keys and its picture", seen="nothing was opened", tries=instead)
    if screen.err.is_dumb_terminal:
        term = os.environ.get("TERM", "")
        raise usage(
            "CO122",
            "this terminal can show no view: it cannot move its cursor",
            seen=f"TERM={term}",
            tries=("TERM=xterm canopen tui ..., if it is one after all", *instead),
        )
    with importing():
        import textual  # noqa: F401 - said before a bus is opened


class _HiddenScreen(Screen):
    """A screen whose messages wait while the view stands before it, and are notices of the view."""

    def __init__(self, settings: Settings) -> None:
        super().__init__(verbosity=settings.verbosity, color=not settings.no_color, notes=settings.notes)
        self.notices: deque[tuple[str, bool]] | None = None

    def warn(self, text: str) -> None:
        if self.notices is None:
            super().warn(text)
        else:
            self.notices.append((Text.from_markup(text).plain, False))

    def detail(self, text: str) -> None:
        if self.notices is None:
            super().detail(text)


class _Running:
    """One run of the command: `serve` on trio's side, `show` on asyncio's."""

    def __init__(self, settings: Settings, screen: _HiddenScreen, allow: frozenset[Permission]) -> None:
        self._settings, self._screen, self._allow = settings, screen, allow
        self._watch: MachineWatch | None = None
        self._opened = asyncio.Event()
        self._has_failed = self._is_alone = False

    async def serve(self) -> None:
        """Open the machine, and watch it until the view leaves."""
        settings, screen = self._settings, self._screen
        async with open_with_files(settings, screen) as (master, files), open_gateway(master, allow=self._allow) as service:
            with service.open_session("the view") as session:
                self._watch = MachineWatch(service, session, files)
                self._opened.set()
                await self._watch.run()

    async def show(self, ended: asyncio.Future[Any]) -> None:
        """Show the view once the machine is open, until its user ends it, or the machine is gone."""
        opened = asyncio.ensure_future(self._opened.wait())
        await asyncio.wait((opened, ended), return_when=asyncio.FIRST_COMPLETED)
        if not opened.done():
            opened.cancel()
            return
        assert self._watch is not None
        from canopen_cli.tui.app import MachineView

        if self._settings.no_color:
            os.environ["NO_COLOR"] = "1"
        name = self._settings.named_bus() if self._settings.machine_file() is None else str(self._settings.machine)
        view = MachineView(self._watch, name or "")
        ended.add_done_callback(lambda _: view.exit())
        self._screen.notices = self._watch.notices
        try:
            with terminal_file():
                await view.run_async()
        except OSError as error:
            if error.errno != errno.EIO:
                raise
        finally:
            self._screen.notices = None
        self._is_alone = not sys.stdin.isatty()
        if self._is_alone:
            put_lost_terminal_to_rest()
        self._has_failed = bool(view.return_code)

    def end(self) -> None:
        """End the watch."""
        if self._watch is not None:
            self._watch.leave()

    def require_good_end(self) -> None:
        """Raise a CommandError if the view ended by a failure of its own, or with its terminal."""
        if self._is_alone:
            raise CommandError(ExitCode.INTERRUPTED, "CO132", "interrupted by the end of its terminal")
        if self._has_failed:
            raise CommandError(
                ExitCode.INTERNAL,
                "CO900",
                "the view has failed; what moved was halted",
                seen="its traceback stands above",
                tries=("tell us, with it",),
            )
