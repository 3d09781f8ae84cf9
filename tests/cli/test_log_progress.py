"""How far a recording is read, on a terminal: with the time left, and only if it takes long."""

from __future__ import annotations

import io
import os
from pathlib import Path

import pytest
from rich.console import Console

from canopen_cli.live import reading
from canopen_cli.live.reading import LOOK_EACH, FileReading, watched
from canopen_cli.shared.screen import Screen
from canopen_transports.log_files import LogReader
from tests.cli.cli_support import Run


@pytest.fixture
def log(tmp_path: Path) -> LogReader:
    path = tmp_path / "long.log"
    path.write_text("".join(f"({1_700_000_000 + place}.0) can0 705#05\n" for place in range(5 * LOOK_EACH)))
    return LogReader(path)


def on_terminal() -> tuple[Screen, io.StringIO]:
    screen, shown = Screen(), io.StringIO()
    screen.err = Console(file=shown, force_terminal=True, width=300)  # type: ignore[assignment]
    return screen, shown


def test_a_long_file_shows_its_share_and_the_time_left(log: LogReader, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "PATIENCE", 0.0)
    monkeypatch.setattr(reading, "REDRAW", 0.0)
    screen, shown = on_terminal()
    shares = [log.share for _ in watched(screen, log, log)]
    assert len(shares) == 5 * LOOK_EACH
    assert shares == sorted(share for share in shares if share is not None)
    assert "reading" in shown.getvalue()
    assert "%" in shown.getvalue()
    assert "0:00:0" in shown.getvalue() or "-:--:--" in shown.getvalue()


def test_lines_that_are_written_meanwhile_go_to_stdout(
    log: LogReader, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A bar of rich's takes them by itself to where it is drawn."""
    monkeypatch.setattr(reading, "PATIENCE", 0.0)
    monkeypatch.setattr(reading, "REDRAW", 0.0)
    screen, shown = on_terminal()
    for _ in watched(screen, log, log):
        print("a line")
    assert capsys.readouterr().out == "a line\n" * 5 * LOOK_EACH
    assert "reading" in shown.getvalue()
    assert "a line" not in shown.getvalue()


def test_a_short_one_and_a_pipe_show_nothing(log: LogReader) -> None:
    screen, shown = on_terminal()
    assert sum(1 for _ in watched(screen, log, log)) == 5 * LOOK_EACH
    assert shown.getvalue() == ""
    assert log.share is None  # it is closed
    assert sum(1 for _ in watched(Screen(), LogReader(log.path), LogReader(log.path))) == 5 * LOOK_EACH


def test_lines_on_the_same_terminal_take_the_bar_away_for_a_while(log: LogReader, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "PATIENCE", 0.0)
    monkeypatch.setattr(reading, "REDRAW", 0.0)
    screen, shown = on_terminal()
    screen.out = Console(file=io.StringIO(), force_terminal=True, width=300)  # type: ignore[assignment]
    records = iter(both := FileReading(screen, log, log))
    for _ in range(LOOK_EACH + 1):
        next(records)
    assert "reading" in shown.getvalue()
    both.clear()
    assert shown.getvalue().endswith("\x1b[2K")  # the line of the bar is empty
    monkeypatch.setattr(reading, "PATIENCE", 1e9)
    before = shown.getvalue()
    both.clear()
    assert sum(1 for _ in records) == 4 * LOOK_EACH - 1
    assert shown.getvalue() == before


def test_a_pager_keeps_its_terminal(log: LogReader, monkeypatch: pytest.MonkeyPatch) -> None:
    """It reads single keys from it, and draws the lines that it is given there."""
    tty = pytest.importorskip("tty", reason="a terminal of POSIX")
    monkeypatch.setattr(reading, "PATIENCE", 0.0)
    monkeypatch.setattr(reading, "REDRAW", 0.0)
    ours, users = os.openpty()
    screen = Screen()
    with open(users, "w", encoding="utf-8") as terminal:
        screen.err = Console(file=terminal, width=200)  # type: ignore[assignment]
        assert screen.draws
        tty.setcbreak(users)
        assert sum(1 for _ in watched(screen, log, log)) == 5 * LOOK_EACH
        os.set_blocking(ours, False)
        with pytest.raises(BlockingIOError):
            os.read(ours, 1000)
    os.close(ours)


LINES = [
    *("log check a.log", "log convert a.log b.asc", "log decode a.log", "log diff a.log a.log", "log export a.log -o a.csv"),
    *("log stats a.log", "log plot a.log statusword -o a.svg", "log replay a.log -b virtual:x --speed max"),
    *("monitor --log a.log", "top --log a.log", "watch 5 6041 --log a.log", "emcy watch --log a.log"),
]


@pytest.mark.parametrize("line", LINES)
def test_every_command_that_reads_a_recording_shows_how_far_it_is(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = "(1700000000.0) can0 605#4041600000000000\n(1700000001.0) can0 585#4B41600037020000\n"
    Path("a.log").write_text(answer * LOOK_EACH)
    drawn: list[str] = []
    monkeypatch.setattr(reading, "PATIENCE", 0.0)
    monkeypatch.setattr(Screen, "draws", True)
    monkeypatch.setattr(FileReading, "_draw", lambda self: drawn.append(line))
    outcome = run(*line.split())
    assert outcome.status in (0, 1), outcome.err
    assert drawn
