"""A part of a recording, by `--since` and `--until`: one grammar for all commands that read one; and times by the clock."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_cli.live.window import Moment, Window, time_of_day
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_proto.machine import SECOND
from tests.cli.cli_support import Run, runner_in_folder
from tests.cli.test_log_data import BEGIN, LOG
from tests.examples import examples

NOON = 1_700_046_000
"""2023-11-15T11:00:00 UTC."""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    made = runner_in_folder(capsys, monkeypatch, tmp_path)
    Path("bus.log").write_text(LOG)
    Path("plain.log").write_text(LOG.replace(f"({BEGIN}", "(0").replace(f"({BEGIN + 1}", "(1").replace(f"({BEGIN + 2}", "(2"))
    return made


@pytest.mark.parametrize(
    ("window", "frames"),
    [
        ((), 7),
        (("--since", "1s"), 4),
        (("--since", "1", "--until", "1.5s"), 2),
        (("--since", "1s", "--until", "1500ms"), 2),
        (("--since", "22:13:21"), 4),
        (("--since", "22:13:21", "--until", "22:13:21.9"), 2),
        (("--since", "2023-11-14T22:13:21", "--until", "2023-11-14T23:13:21.9+01:00"), 2),
    ],
)
def test_each_command_takes_the_same_part(run: Run, window: tuple[str, ...], frames: int) -> None:
    lines = run("log", "decode", "bus.log", *window).out.splitlines()
    assert len([line for line in lines if not line.startswith(("!", "="))]) == frames
    assert run("log", "stats", "bus.log", *window, "--json").json["frames"] == frames
    assert run("log", "convert", "bus.log", "part.log", *window, "--force", "--json").json["frames"] == frames
    replayed = run("log", "replay", "bus.log", "-b", "virtual:x", "--speed", "max", *window, "--json")
    assert replayed.json["frames"] == frames
    assert run("log", "export", "bus.log", "-o", "part.csv", *window, "--force").status == ExitCode.OK


@pytest.mark.parametrize("window", [("--since", "99s"), ("--since", "22:13"), ("--until", "2001-01-01T00:00:00")])
def test_a_part_without_a_frame_is_told(run: Run, window: tuple[str, ...]) -> None:
    """22:13 is that of the next day. `log check` would have no findings, and a file that is there would be empty."""
    Path("part.log").write_text("old")
    for words in ("decode bus.log", "check bus.log", "stats bus.log", "convert bus.log part.log --force", "diff bus.log bus.log"):
        outcome = run("log", *words.split(), *window)
        assert outcome.status == ExitCode.USAGE
        assert "no frame of bus.log is in this part" in outcome.err
        assert "it is 2.001 s long, from 22:13:20.000 to 22:13:22.001" in outcome.err
    assert run("log", "export", "bus.log", "-o", "part.csv", *window).status == ExitCode.USAGE
    assert not Path("part.csv").exists()
    assert Path("part.log").read_text() == "old"


def test_a_part_that_runs_backwards_is_refused(run: Run) -> None:
    outcome = run("log", "decode", "bus.log", "--since", "2s", "--until", "1s")
    assert (outcome.status, "--until is before --since" in outcome.err) == (ExitCode.USAGE, True)


def test_rates_are_those_of_the_part_and_never_of_the_time_between_its_frames(run: Run) -> None:
    """Two frames at once are no load of 80 %: whatever few frames are in a part, the bus was watched for all of it."""
    times = (0.0, 0.9, 0.9004, 2.0)
    Path("few.log").write_text("".join(f"({100 + each:.6f}) can0 705#05\n" for each in times))
    found = run("log", "stats", "few.log", "--since", "0.5", "--until", "1", "--json").json
    assert (found["frames"], found["seconds"], found["ids"][0]["per_second"]) == (2, 0.5, 4.0)
    assert found["load_percent"] < 0.1
    assert run("log", "stats", "few.log", "--since", "0.5", "--json").json["seconds"] == 1.5, "to the last frame, at least"
    assert run("log", "stats", "few.log", "--until", "77s", "--json").json["seconds"] == 2.0, "nobody watched longer"


@pytest.mark.parametrize("window", [(), ("--since", "0.9s"), ("--until", "1s")])
def test_a_few_frames_at_once_have_no_rate(run: Run, window: tuple[str, ...]) -> None:
    """When the recorder began and ended, no frame tells."""
    Path("two.log").write_text("(100.0) can0 705#05\n(100.9) can0 705#05\n(100.9004) can0 705#05\n")
    outcome = run("log", "stats", "two.log", *window)
    assert "s, too short for a rate" in outcome.out
    found = run("log", "stats", "two.log", *window, "--json").json
    assert (found["load_percent"], found["ids"][0]["per_second"], found["ids"][0]["load_percent"]) == (None, None, None)


def test_the_story_of_a_part_counts_the_frames_of_the_part_and_tells_each_thing_in_it_once(run: Run) -> None:
    """ "0 x abort, and 36 times more" names nothing: what came before the part was never told."""
    again = "({0}.0) can0 605#4000200000000000\n({0}.1) can0 585#8000200000000206\n({0}.2) can0 085#1081010000000000\n"
    Path("again.log").write_text("".join(again.format(100 + each) for each in range(6)))
    whole = run("log", "check", "again.log")
    assert ("1 x abort: an SDO transfer is aborted, and 5 times more" in whole.err, "18 frames" in whole.err) == (True, True)
    part = run("log", "check", "again.log", "--since", "3s", "--until", "4.9s")
    assert "1 x abort: an SDO transfer is aborted, and 1 time more" in part.err
    assert "1 x EMCY: a node tells an error, or the end of its errors, and 1 time more" in part.err
    assert "6 frames, 2 events" in part.err
    assert [line.split()[0] for line in part.out.splitlines()] == ["3.100000", "3.200000"]


def test_a_mapping_before_the_part_is_known_in_it(run: Run) -> None:
    """What stands before it is looked at: else a PDO would be unknown as soon as a part is asked for."""
    set_up = ["23001A0110004160", "2F001A0001000000", "2301180185010000"]
    told = "".join(f"({BEGIN}.{place}) can0 605#{each} T\n({BEGIN}.{place}5) can0 585#60{each[2:8]}00000000 R\n"
                   for place, each in enumerate(set_up, 1))  # fmt: skip
    Path("mapped.log").write_text(f"{told}({BEGIN + 5}.0) can0 185#3702 R\n")
    assert "statusword" in run("log", "decode", "mapped.log", "--since", "4s").out


def test_what_is_wrong_outside_of_the_part_is_not_told(run: Run) -> None:
    Path("odd.log").write_text(LOG + f"({BEGIN + 3}.0) can0 085#2032050000000000 R\n")
    assert run("log", "check", "odd.log").status == ExitCode.DIFFERENT
    assert run("log", "check", "odd.log", "--until", "2.5s").status == ExitCode.OK
    assert run("log", "diff", "bus.log", "odd.log", "--until", "2.5s").status == ExitCode.OK
    assert run("log", "diff", "bus.log", "odd.log", "--rate", "100").status == ExitCode.DIFFERENT


def test_times_by_the_clock(run: Run) -> None:
    first = run("log", "decode", "bus.log", "--clock").out.splitlines()[0]
    assert first.startswith("22:13:20.000 ")
    Path("odd.log").write_text(f"({BEGIN + 3}.0) can0 085#2032050000000000 R\n")
    assert run("log", "check", "odd.log", "--clock").out.startswith("22:13:23.000 ")


def test_a_recording_without_a_date_has_no_clock(run: Run) -> None:
    assert len(run("log", "decode", "plain.log", "--since", "1s").out.splitlines()) >= 4
    outcome = run("log", "decode", "plain.log", "--since", "22:13:21")
    assert outcome.status == ExitCode.USAGE
    assert "no time of day" in outcome.err


@pytest.mark.parametrize("text", ["yesterday", "25:00:00", "12:60", "1:2:3:4", "-5", "", "2023-13-01", "12:00:05 pm", "nan"])
def test_what_is_no_time(run: Run, text: str) -> None:
    outcome = run("log", "decode", "bus.log", "--since", text)
    assert outcome.status == ExitCode.USAGE
    assert "is no time" in outcome.err


@given(st.integers(0, 86_399), st.integers(0, 86_399))
@examples(50)
def test_a_time_of_day_is_the_first_one_at_or_behind_the_beginning(begun: int, wanted: int) -> None:
    first = (NOON // 86_400 * 86_400 + begun) * SECOND
    moment = Moment().convert(time.strftime("%H:%M:%S", time.gmtime(wanted)), None, None)
    there = first + (wanted - begun) % 86_400 * SECOND
    here = there - time.localtime(NOON).tm_gmtoff * SECOND
    window = Window(moment, moment)
    assert any(window.has(each, first) for each in (there, here, here + 86_400 * SECOND))
    assert time_of_day(there).count(":") == 2


def test_a_window_that_asks_for_nothing_has_all() -> None:
    assert Window().has(0, 0)
    with pytest.raises(CommandError):
        Window(Moment().convert("12:00", None, None)).has(0, 0)
