"""`canopen tui`: its views on a simulated machine, its keys, and the terminal that it leaves."""

from __future__ import annotations

import asyncio
import os
import pty
import random
import select
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Awaitable, Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import pytest
import trio

pytest.importorskip("textual", reason="textual is not installed: the extra `tui` has it")

from textual.pilot import Pilot
from textual.widgets import Input

from canopen_cli.shared.marks import cells_of
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import Settings
from canopen_cli.tui.app import HELP, MachineView
from canopen_cli.tui.guest import run_beside
from canopen_cli.tui.machine_watch import MOST_LINES, MachineWatch
from canopen_cli.tui.questions import Ask
from canopen_cli.tui.rows import Rows, cell
from canopen_cli.tui.views import traffic_text
from canopen_gateway import GatewaySession, Permission, WatchedObject, open_gateway
from canopen_gateway.traffic import FeedRow
from canopen_master import open_master
from canopen_master.participant.patient_clock import PatientClock
from canopen_master.simulation import SimulatedDevices, simulated_drives
from canopen_proto.frame import Frame
from canopen_transports import BusState, BusStateChanged
from canopen_transports.errors import ReceiveOverrun
from tests.cli.cli_support import Run, stands
from tests.cli.terminal import Terminal, canopen, needs_tmux, terminals
from tests.examples import takes_all
from tests.gateway.gateway_world import gateway
from tests.master.world import BUS as BUS_OF_GATEWAY
from tests.master.world import virtual_time

BUS = "virtual:tui"
LIMIT = 60.0
"""Seconds after which a wait fails."""


class Held:
    """The machine behind a view, for a test to look at."""

    watch: MachineWatch
    simulation: SimulatedDevices


def viewed(
    test: Callable[[Pilot[None], Held], Awaitable[None]], allow: Collection[Permission] = (), size: tuple[int, int] = (80, 24)
) -> None:
    """Run a view of two simulated drives, 3 and 4, and a test that presses its keys."""
    held, opened = Held(), asyncio.Event()

    async def machine() -> None:
        async with (
            simulated_drives([(BUS, 3), (BUS, 4)]) as held.simulation,
            open_master(BUS) as master,
            open_gateway(master, allow=allow) as service,
        ):
            with service.open_session("the view") as session:
                held.watch = MachineWatch(service, session, NodeFiles(settings, settings.screen()))
                opened.set()
                await held.watch.run()

    async def host(ended: asyncio.Future[Any]) -> None:
        waits = asyncio.ensure_future(opened.wait())
        await asyncio.wait((waits, ended), return_when=asyncio.FIRST_COMPLETED)
        view = MachineView(held.watch, BUS)
        async with view.run_test(size=size) as pilot:
            await until(pilot, lambda: len(rows(view)) == 2)
            await test(pilot, held)
        assert view.return_code in (None, 0)

    settings = Settings()
    run_beside(host, lambda: held.watch.leave())(machine, clock=PatientClock())


async def until(pilot: Pilot[None], is_so: Callable[[], object]) -> None:
    """Wait until something is so; fail with a picture of the view."""
    end = time.monotonic() + LIMIT
    while not is_so():
        assert time.monotonic() < end, "\n".join(picture(pilot.app))
        await pilot.pause(0.02)


def picture(view: Any) -> list[str]:
    """Return what is on the screen, line by line."""
    height = view.size.height
    lines = view.screen._compositor.render_strips()
    return ["".join(segment.text for segment in strip).rstrip() for strip in lines][:height]


def test_the_page_of_keys_breaks_no_line() -> None:
    async def look(pilot: Pilot[None], held: Held) -> None:
        await pilot.press("question_mark")
        await until(pilot, lambda: any("This is no emergency stop." in line for line in picture(pilot.app)))
        shown = "\n".join(picture(pilot.app))
        assert [line for line in HELP.splitlines() if line not in shown] == []

    viewed(look, size=(100, 30))


def shows(view: Any, *texts: str) -> bool:
    """Return whether all these texts are on the screen."""
    lines = picture(view)
    shown = "\n".join([*lines, " ".join(map(str.strip, lines))])  # a notice may go on in the next line
    return all(each in shown for each in texts)


def rows(view: Any) -> list[str]:
    """Return the rows of the view's table, as text."""
    table = view.view.query_one(Rows)
    return [" ".join(cell.plain for cell in table.get_row_at(number)) for number in range(table.row_count)]


def written(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Note what the view has written or commanded."""
    found: list[tuple[Any, ...]] = []
    write, nmt = GatewaySession.write, GatewaySession.nmt

    async def noted(self: GatewaySession, *arguments: Any, **options: Any) -> None:
        found.append(arguments)
        await write(self, *arguments, **options)

    async def commanded(self: GatewaySession, *arguments: Any) -> None:
        found.append(arguments)
        await nmt(self, *arguments)

    monkeypatch.setattr(GatewaySession, "write", noted)
    monkeypatch.setattr(GatewaySession, "nmt", commanded)
    return found


def test_its_views(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nodes in words, an object searched for and read, its live value, the traffic, the drives; and nothing was written."""

    async def test(pilot: Pilot[None], held: Held) -> None:
        view: Any = pilot.app
        assert shows(view, "3 (0x03)", "pre-operational", "read-only")
        await pilot.press("enter")
        await pilot.press("slash", *"statusword")
        assert [row.split()[:2] for row in rows(view)] == [["6041:00", "statusword"]]
        await pilot.press("enter", "enter")
        await until(pilot, lambda: shows(view, "6041:00 is 576 (switch_on_disabled, remote)"))
        assert not shows(view, "reading 6041:00")
        await pilot.press("e")
        await until(pilot, lambda: shows(view, "writing 0x6041:00 is not allowed here", "--allow write"))
        assert not shows(view, "gateway")  # which this user has never heard of
        await pilot.press("w", "4")
        await until(pilot, lambda: any("576" in row for row in rows(view)))
        await pilot.press("5")
        await until(pilot, lambda: shows(view, "heartbeat   3  pre-operational", "6041:00 statusword = 576"))
        await pilot.press("slash", "4", "enter")
        await until(pilot, lambda: not shows(view, "  3  ") and shows(view, "heartbeat   4"))
        await pilot.press("exclamation_mark")
        await until(pilot, lambda: shows(view, "No such frame yet"))
        await pilot.press("6")
        await until(pilot, lambda: len(rows(view)) == 2 and shows(view, "it is not enabled", "try: enable it"))
        held.simulation.raise_fault(4, 0x3220)
        await pilot.press("down")
        await until(pilot, lambda: shows(view, "error 0x3220", "fault"))
        await pilot.press("3")
        await until(pilot, lambda: shows(view, "0x3220", "emergency"))
        await pilot.press("a")
        assert all("emergency" in row for row in rows(view))
        assert held.watch.service.traffic(BUS).dropped == 0

    found = written(monkeypatch)
    viewed(test)
    assert found == []


def test_a_write_is_asked_about_twice_and_read_back(monkeypatch: pytest.MonkeyPatch) -> None:
    found = written(monkeypatch)

    async def test(pilot: Pilot[None], held: Held) -> None:
        view: Any = pilot.app
        await pilot.press("2", "slash", *"6081", "enter", "enter")
        await until(pilot, lambda: held.watch.shown.objects.get(WatchedObject(BUS, 3, 0x6081, 0)))
        for answers in (("escape",), (*"700", "escape"), (*"700", "enter", "escape"), (*"700", "enter", *"y", "enter")):
            await pilot.press("e")
            await until(pilot, lambda: isinstance(view.screen, Ask))
            await pilot.press(*answers)
            while isinstance(view.screen, Ask):
                await pilot.press("escape")
        assert found == []
        await pilot.press("e", *"700", "enter", *"yes", "enter")
        await until(pilot, lambda: held.watch.shown.objects[WatchedObject(BUS, 3, 0x6081, 0)].text == "700")
        assert [each[:4] for each in found] == [(BUS, 3, 0x6081, 0)]
        await pilot.press("e", *"never", "enter", *"yes", "enter")
        await until(pilot, lambda: shows(view, "has no constant 'never'"))
        assert len(found) == 1
        await pilot.press("1", "n")
        assert not isinstance(view.screen, Ask)
        await until(pilot, lambda: shows(view, "not allowed", "--allow nmt"))

    viewed(test, [Permission.WRITE])


def test_an_nmt_command_and_the_halts(monkeypatch: pytest.MonkeyPatch) -> None:
    found = written(monkeypatch)

    async def test(pilot: Pilot[None], held: Held) -> None:
        view: Any = pilot.app
        await pilot.press("down", "n", *"start", "enter", *"yes", "enter")
        await until(pilot, lambda: any(row.startswith("4 (0x04)") and "operational" in row.split() for row in rows(view)))
        assert len(found) == 1
        await pilot.press("6")
        await until(pilot, lambda: len(rows(view)) == 2)
        await pilot.press("h")
        await until(pilot, lambda: shows(view, "halted: node 3"))
        await pilot.press("H")
        await until(pilot, lambda: shows(view, "halted: everything"))

    viewed(test, [Permission.NMT])


def test_more_than_may_be_watched_is_refused_and_the_others_go_on() -> None:
    async def test(pilot: Pilot[None], held: Held) -> None:
        view: Any = pilot.app
        places = [WatchedObject(BUS, node_id, 0x1000 + place, 0) for node_id in (3, 4) for place in range(0x11)]
        most = held.watch.service.limits.subscriptions
        assert len(places) > most
        await pilot.press("4")
        for place in places[:most]:
            held.watch.ask_watch(place, "x")
        await until(pilot, lambda: len(rows(view)) == most)
        for place in places[most:]:
            held.watch.ask_watch(place, "x")
        await until(pilot, lambda: shows(view, "CO151"))
        assert not shows(view, "gateway")
        await until(pilot, lambda: len(rows(view)) == most)
        held.watch.ask_watch(places[0], "x")
        held.watch.ask_watch(places[0], "x")
        await until(pilot, lambda: any("131474" in row for row in rows(view)))

    viewed(test)


def test_a_finding_that_the_header_counts_is_there_to_be_read_however_many_frames_came_since() -> None:
    async def test(pilot: Pilot[None], held: Held) -> None:
        texts = ["000#01", *["123#"] * (MOST_LINES + 9)]
        master = held.watch.service.master
        master.bus(BUS).take_in(iter([(Frame.parse(text), None) for text in texts]), master.now())
        await until(pilot, lambda: held.watch.shown.frames >= len(texts))
        lines = [each.text for each in held.watch.shown.traffic if each.kind == "finding"]
        assert len(lines) == held.watch.shown.findings == 1
        assert lines[0].startswith("length: an NMT command of 1 byte")

    viewed(test)


@pytest.mark.parametrize("what", ["the bus is away", "frames are lost"])
@virtual_time
async def test_no_node_is_late_for_what_this_computer_could_not_hear(what: str) -> None:
    """Whether the node went on meanwhile, nobody knows."""
    async with gateway() as (_, service), trio.open_nursery() as nursery:
        with service.open_session("the view") as session:
            watch, bus = MachineWatch(service, session, None), service.master.bus(BUS_OF_GATEWAY)
            nursery.start_soon(watch.run)

            async def beats() -> None:
                for _ in range(8):
                    bus.take_in(iter([(Frame.parse("763#05"), None)]), service.master.now())
                    await trio.sleep(0.1)

            def late() -> list[int]:
                return [each.node_id for each in watch.shown.traffic if each.text.startswith("late heartbeat")]

            await beats()
            if what == "frames are lost":
                await trio.sleep(0.1)
                bus.take_in(iter([ReceiveOverrun("x", 3, "too slow")]), service.master.now())
                await trio.sleep(0.1)
            else:
                bus.take_in(iter([BusStateChanged("x", BusState.DOWN, "unplugged")]), service.master.now())
                await trio.sleep(3)
                assert late() == []
                bus.take_in(iter([BusStateChanged("x", BusState.UP, "plugged in")]), service.master.now())
            await beats()
            assert late() == []
            await trio.sleep(3)
            assert late() == [99], "now it is silent itself"
            nursery.cancel_scope.cancel()


def test_f12_halts_while_something_is_typed(monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(pilot: Pilot[None], held: Held) -> None:
        view: Any = pilot.app
        await pilot.press("2", "slash", *"6081", "enter", "e")
        assert isinstance(view.screen, Ask)
        await pilot.press("H", "f12")
        assert view.screen.query_one(Input).value == "H"
        await until(pilot, lambda: halts == [None])

    halts: list[Any] = []
    halt = MachineWatch.ask_halt
    monkeypatch.setattr(MachineWatch, "ask_halt", lambda self, place: (halts.append(place), halt(self, place)))
    viewed(test, [Permission.WRITE])


def test_it_ends_without_a_traceback_where_the_views_go_before_the_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    """The interval comes once more between the end of the views and its own: at random, so here on purpose."""
    looked: list[bool] = []
    close = MachineView._close_all

    async def closed(self: MachineView) -> None:
        await close(self)
        self.look()
        looked.append(self.is_running)

    async def test(pilot: Pilot[None], held: Held) -> None:
        assert pilot.app.is_running

    monkeypatch.setattr(MachineView, "_close_all", closed)
    viewed(test)
    assert looked == [False]


KEYS = (
    *"1234566fewnparhH!/[]qx0 y",
    *("up", "down", "left", "right", "enter", "escape", "tab", "shift+tab", "pageup", "pagedown", "home", "end", "backspace"),
    *("delete", "f1", "f12", "ctrl+a", "ctrl+z", "ctrl+s", "ctrl+p", "question_mark", "space"),
)


@pytest.mark.parametrize("seed", range(20 if takes_all() else 1))
def test_random_keys_write_nothing_and_move_nothing(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """All is allowed, and each key may come at any time: a write needs a word that no random keys make."""
    found = written(monkeypatch)
    chance = random.Random(seed)

    async def test(pilot: Pilot[None], held: Held) -> None:
        for _ in range(80 if takes_all() else 40):
            key = chance.choice(KEYS)
            if key != "q" or isinstance(pilot.app.focused, Input):  # it ends the view, as it should
                await pilot.press(key)
        assert not pilot.app.return_code
        assert found == []
        for node in held.simulation.drives.values():
            assert stands(node)
            assert not node.drive.state.name.startswith("OPERATION")

    viewed(test, list(Permission), size=(chance.choice((40, 80, 200)), chance.choice((10, 24, 60))))


# ---- a terminal ----


class Pty:
    """`canopen tui` in a pseudo-terminal. before: how the terminal was set. output: all that was written."""

    def __init__(self, *arguments: str, **environment: str) -> None:
        self.own, self.theirs = pty.openpty()
        termios.tcsetwinsize(self.theirs, (24, 80))
        self.before = termios.tcgetattr(self.theirs)
        self.output = b""
        path = os.pathsep.join(each for each in sys.path if each)
        kept = {name: os.environ[name] for name in ("PATH", "HOME", "TMPDIR") if name in os.environ}
        self.process = subprocess.Popen(
            [sys.executable, "-c", "import sys; from canopen_cli.entry import main; sys.exit(main())", "tui", *arguments],
            stdin=self.theirs,
            stdout=self.theirs,
            stderr=self.theirs,
            env={
                **kept,
                "PYTHONPATH": path,
                "TERM": "xterm-256color",
                "LC_ALL": "C.UTF-8",
                "PYTHONFAULTHANDLER": "1",
                **environment,
            },
            start_new_session=True,
            preexec_fn=lambda: os.close(os.open(os.ttyname(0), os.O_RDWR)),  # the first terminal it opens is its own
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while True:
            if not select.select([self.own], [], [], 0.2)[0]:
                if self.process.poll() is not None:
                    return
                continue
            try:
                self.output += os.read(self.own, 1 << 16)
            except OSError:
                return

    def wait_for(self, text: bytes) -> None:
        """Wait until this was written."""
        end = time.monotonic() + LIMIT
        while text not in self.output:
            if time.monotonic() > end:
                self.process.send_signal(signal.SIGABRT)  # faulthandler says where it stands
                self._reader.join(1)
            assert self.process.poll() is None, self.output[-4000:]
            time.sleep(0.02)

    def send(self, keys: bytes) -> None:
        """Press keys."""
        os.write(self.own, keys)

    def press_until_it_ends(self, keys: bytes) -> None:
        """Press keys again and again, as a person would."""
        end = time.monotonic() + LIMIT
        while self.process.poll() is None and time.monotonic() < end:
            self.send(keys)
            time.sleep(0.5)

    def wait(self) -> int:
        """Wait for the end; return the exit status."""
        status = self.process.wait(LIMIT)
        self._reader.join(LIMIT)
        return status

    def close(self) -> None:
        """End what is left."""
        self.process.kill()
        self.process.wait()
        for each in (self.own, self.theirs):
            try:
                os.close(each)
            except OSError:
                continue  # a test has closed it

    def is_as_before(self) -> bool:
        """Whether the terminal is set as it was: line by line, with echo; the picture before it; the cursor is shown; the mouse
        and pasting are left alone."""
        last = {mode: self.output.rfind(b"\x1b[?%d%c" % (mode, sign)) for mode, sign in ((1049, ord("l")), (25, ord("h")))}
        begun = {mode: self.output.rfind(b"\x1b[?%d%c" % (mode, sign)) for mode, sign in ((1049, ord("h")), (25, ord("l")))}
        left = all(last[mode] > begun[mode] for mode in last)
        mouse = self.output.rfind(b"\x1b[?1003l") > self.output.rfind(b"\x1b[?1003h")
        return left and mouse and termios.tcgetattr(self.theirs) == self.before


@pytest.fixture
def opened() -> Iterator[Callable[..., Pty]]:
    made: list[Pty] = []

    def one(*arguments: str, **environment: str) -> Pty:
        made.append(Pty(*arguments, **environment))
        return made[-1]

    yield one
    for each in made:
        each.close()


def random_bytes(chance: random.Random, count: int) -> bytes:
    """Keys, halves of escape sequences, mouse reports, pasted texts, bytes that are no text."""
    pieces = (
        *(bytes([each]) for each in range(1, 256) if each not in (3, 17)),
        *(b"\x1b[%c" % each for each in b"ABCDHFZ"),
        *(b"\x1b[%d~" % each for each in range(1, 25)),
        *(b"1", b"2", b"3", b"4", b"5", b"6", b"\r", b"\t", b"e", b"w", b"n", b"h", b"H") * 6,
        b"\x1b[<0;10;5M\x1b[<0;10;5m",
        b"\x1b[<64;10;5M",
        b"\x1b[200~q\x1b[201~",
        b"\x1b[",
        b"\xff\xfe",
    )
    return b"".join(chance.choice(pieces) for _ in range(count)).replace(b"q", b"x")


def test_random_keys_end_it_with_no_traceback_and_leave_the_terminal_as_it_was(opened: Callable[..., Pty]) -> None:
    terminal = opened("-b", "demo", "--allow", "write,motion,nmt")
    terminal.wait_for(b"pre-operational")
    chance = random.Random(1)
    for _ in range(30):
        terminal.send(random_bytes(chance, 20))
        time.sleep(0.01)  # more at once is one paste for the library that reads keys
    terminal.press_until_it_ends(b"\x1b\x1b\x03")  # half a sequence before it may take the first Ctrl-C for its end
    assert terminal.wait() in (0, -signal.SIGINT)  # the last Ctrl-C may meet an interpreter that is about to end
    assert b"Traceback" not in terminal.output, terminal.output.decode()[-3000:]
    assert terminal.is_as_before()


@pytest.mark.thorough(2)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_in_good_order(opened: Callable[..., Pty], number: int) -> None:
    terminal = opened("-b", "demo")
    terminal.wait_for(b"pre-operational")
    os.kill(terminal.process.pid, number)
    assert terminal.wait() == 0
    assert terminal.is_as_before()
    assert terminal.output.endswith(b"ended\r\n")


def test_a_terminal_that_goes_away_ends_it(opened: Callable[..., Pty]) -> None:
    terminal = opened("-b", "demo")
    terminal.wait_for(b"pre-operational")
    os.close(terminal.theirs)
    os.kill(terminal.process.pid, signal.SIGSTOP)
    os.close(terminal.own)
    os.kill(terminal.process.pid, signal.SIGHUP)
    os.kill(terminal.process.pid, signal.SIGCONT)
    assert terminal.process.wait(LIMIT) in (130, -signal.SIGHUP)  # the signal may find the view ended already


@pytest.mark.thorough
def test_a_bus_that_cannot_be_opened_is_told_on_the_plain_screen(opened: Callable[..., Pty]) -> None:
    terminal = opened("-b", "tcp:127.0.0.1:9")
    assert terminal.wait() == 3
    assert b"CO101" in terminal.output
    assert b"\x1b[?1049h" not in terminal.output


def test_a_terminal_without_a_cursor_is_refused(opened: Callable[..., Pty]) -> None:
    terminal = opened("-b", "demo", TERM="dumb")
    assert terminal.wait() == 2
    assert b"TERM=dumb" in terminal.output


def test_without_a_terminal_it_says_what_to_do_instead(run: Run) -> None:
    outcome = run("tui", "-b", "demo")
    assert outcome.status == 2
    assert "needs a terminal" in outcome.err
    assert "canopen top --once" in outcome.err


@needs_tmux
def test_ascii_marks_where_a_user_says_so(tmp_path: Path) -> None:
    with terminals(tmp_path) as open_one:
        terminal: Terminal = open_one(f"LC_ALL=C {canopen('tui', '-b', 'demo')}")
        terminal.wait_for("pre-operational")
        terminal.press("2")
        terminal.press("?")
        lines = terminal.wait_for("+-", "canopen serve")
        assert all(line.isascii() for line in lines)
        terminal.press("Escape")
        terminal.press("C-c")
        assert terminal.wait_for_end() == 0


def test_each_ascii_mark_is_as_wide_as_what_it_stands_for() -> None:
    assert cells_of("─│┌▀…→°é漢⠿") == "-|+#~>o???*"


def test_strings_of_devices_are_shown_and_never_obeyed() -> None:
    assert cell("\x1b[2J[bold]x[/]").plain == r"\x1b[2J[bold]x[/]"
    assert cell("[bold]x[/]").spans == []


def test_a_line_of_the_traffic_is_cut_at_the_width() -> None:
    line = FeedRow("frame", 1.0, "705#7F", "heartbeat", 5, "x" * 300)
    assert len(traffic_text(line, 80).plain) == 80
    assert traffic_text(line._replace(kind="finding"), 40).plain.startswith("! xxx")
