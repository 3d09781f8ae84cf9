"""What a recorder, a bus or a clock has lost is told as that: never as a fault of a node, and never in silence."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from canopen_cli.live import source as live_source
from canopen_cli.shared.problem import ExitCode
from canopen_proto.frame import Frame
from canopen_transports import BusState, BusStateChanged
from canopen_transports.errors import ReceiveOverrun
from canopen_transports.log_files import LOSSES, LogReader
from tests.cli.cli_support import Run, runner_in_folder
from tests.cli.test_monitor import Script

OVERRUN = "({0}) can0 20000004#0001000000000000\n"
BOTH = "({0:.3f}) can0 703#05\n({1:.3f}) can0 704#05\n"


def beats(begin: float, end: float) -> str:
    """Heartbeats of two nodes, one in 100 ms each, from one second to another."""
    steps = range(round(begin * 10), round(end * 10))
    return "".join(BOTH.format(step / 10, step / 10 + 0.01) for step in steps)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """A bus that says one thing a second, or nothing for None; then nothing for ten seconds, and fails."""

    class WithPauses(Script):
        async def receive(self) -> Any:
            while (item := await super().receive()) is None:
                pass
            return item

    def script(*items: Any) -> None:
        async def opening(locator: str) -> Script:
            return WithPauses(list(items), 10)

        monkeypatch.setattr(live_source, "open_transport", opening)

    return script


# ---- a recorder that was overrun ----


@pytest.mark.parametrize("command", [("log", "decode", "a.log"), ("monitor", "--log", "a.log"), ("log", "check", "a.log")])
def test_every_command_believes_the_recorder_that_it_lost_frames(run: Run, command: tuple[str, ...]) -> None:
    """An answer that nobody has asked for: its request was lost, as the recorder says."""
    Path("a.log").write_text(
        "(1.0) can0 605#4041600000000000\n(1.001) can0 585#4B41600037020000\n"
        + OVERRUN.format("1.5")
        + "(1.6) can0 585#4B41600033020000\n"
    )
    said = run(*command).out
    assert said.count("missing") == 2, "the rule and its words, once"
    assert "missing: frames are missing here: the controller of the recorder was overrun" in said


def test_top_believes_it_too(run: Run) -> None:
    Path("a.log").write_text(beats(1, 4) + OVERRUN.format("13.9") + beats(14, 15))
    (bus,) = run("top", "--log", "a.log", "--json").json
    assert bus["found"] == {"missing": 1}


def test_an_overrun_behind_the_last_frame_is_told(run: Run) -> None:
    Path("a.log").write_text(beats(1, 2) + OVERRUN.format("2.5"))
    outcome = run("log", "check", "a.log")
    assert ("frames are missing: the controller" in outcome.out, outcome.status) == (True, ExitCode.DIFFERENT)
    assert run("log", "check", "a.log", "--until", "0.5s").status == ExitCode.OK


@pytest.mark.parametrize("kind", sorted(LOSSES))
def test_a_recording_says_where_it_lacks_frames_or_that_its_kind_cannot_say_it(run: Run, scripted: Any, kind: str) -> None:
    frame = Frame.parse("705#05"), None
    scripted(frame, ReceiveOverrun("virtual:x", 3, "the queue was full"), frame, frame)
    outcome = run("log", "record", f"new{kind}", "-b", "virtual:x", "--for", "5s", "--json")
    assert (outcome.status, outcome.json["frames"], outcome.json["lost"]) == (ExitCode.OK, 3, 3)
    assert "3 frames lost before they came here" in outcome.err
    reader = LogReader(Path(f"new{kind}"))
    assert len(list(reader)) == 3
    assert reader.overruns == (0 if "where frames were lost" in LOSSES[kind] else 1)
    assert run("log", "convert", f"new{kind}", "copy.log").status == ExitCode.OK
    copied = LogReader(Path("copy.log"))
    assert (len(list(copied)), copied.overruns) == (3, reader.overruns)


# ---- a bus that was away ----


def test_a_bus_that_is_away_accuses_no_node(run: Run, scripted: Any) -> None:
    """The adapter was pulled out for five seconds: who was silent then, nobody knows."""
    said = "606#23161001B80B0500", "586#6016100100000000", "705#05"  # node 6 waits 3 s for node 5
    frames = [(Frame.parse(text), None) for text in said]
    away, up = BusStateChanged("virtual:x", BusState.DOWN, "unplugged"), BusStateChanged("virtual:x", BusState.UP, "back")
    scripted(*frames, away, *[None] * 4, up, frames[2])
    assert "late heartbeat" not in run("monitor", "-b", "virtual:x", "--for", "11s").out
    scripted(*frames, BusStateChanged("virtual:x", BusState.PASSIVE, "many errors"), *[None] * 5, frames[2])
    assert "late heartbeat" in run("monitor", "-b", "virtual:x", "--for", "11s").out, "it was there all the time"


@pytest.mark.parametrize(
    ("report", "found"),
    [
        (ReceiveOverrun("virtual:x", 3, "too slow"), {"missing": 1}),
        (BusStateChanged("virtual:x", BusState.DOWN, "unplugged"), {"missing": 1}),
        (BusStateChanged("virtual:x", BusState.PASSIVE, "many errors"), {"late heartbeat": 1}),
    ],
)
def test_top_accuses_no_node_of_what_nobody_heard(run: Run, scripted: Any, report: Any, found: dict[str, int]) -> None:
    said = "606#2316100108070500", "586#6016100100000000", "705#05", "706#05", "705#05"  # node 6 waits 1.8 s for node 5
    frames = [(Frame.parse(text), None) for text in said]
    scripted(*frames[:3], report, *frames[3:])
    (bus,) = run("top", "-b", "virtual:x", "--for", "6.5s", "--json").json
    assert (bus["found"], bus["frames"]) == (found, 5)


# ---- a clock that was set ----


def test_rates_are_right_where_the_clock_went_back(run: Run) -> None:
    """Two recordings in one file, or a recorder whose clock was set: 10 s of 20 frames a second, and 10 s more."""
    Path("one.log").write_text(beats(1000, 1020))
    Path("back.log").write_text(beats(1000, 1010) + beats(10, 20))
    found = run("log", "stats", "back.log", "--json").json
    assert [each["per_second"] for each in found["ids"]] == pytest.approx([10, 10], rel=0.02)
    assert "the clock of the frames went back 1 time" in run("log", "stats", "back.log").err
    assert run("log", "diff", "one.log", "back.log").status == ExitCode.OK, "no rate differs"
    part = run("log", "stats", "back.log", "--since", "995", "--json")  # nobody knows which of the two is meant
    assert part.status == ExitCode.USAGE or part.json["load_percent"] is None


def test_two_recordings_of_one_hour_behind_each_other_are_one_hour(run: Run) -> None:
    """`cat can0.log can1.log`: the clock of neither went back."""
    Path("both.log").write_text(beats(10, 20) + beats(10, 20).replace("can0", "can1"))
    outcome = run("log", "stats", "both.log", "--json")
    assert [each["per_second"] for each in outcome.json["ids"]] == pytest.approx([10] * 4, rel=0.02)
    assert "went back" not in run("log", "stats", "both.log").err


def test_a_clock_that_went_back_is_no_load_and_hides_no_silence(run: Run) -> None:
    """The frames of a minute do not come in the second in which the clock is again where it was."""
    Path("back.log").write_text(beats(100, 110) + beats(50, 115))
    outcome = run("log", "check", "back.log", "--bitrate", "10k")
    assert (outcome.out, outcome.status) == ("", ExitCode.OK)
    assert "the clock of the frames went back 1 time" in outcome.err
    silent = "".join(line for line in beats(53, 60).splitlines(True) if "703" not in line)
    Path("silent.log").write_text(beats(100, 110) + beats(50, 53) + silent)
    told = [json.loads(line) for line in run("log", "check", "silent.log", "--json").out.splitlines()]
    assert [(each["rule"], each["node_id"]) for each in told] == [("late heartbeat", 3)]


@pytest.mark.parametrize("command", [("log", "replay", "back.log", "-b", "virtual:x"), ("monitor", "-b", "file:back.log")])
def test_a_replay_keeps_its_pace_where_the_clock_went_back(run: Run, command: tuple[str, ...]) -> None:
    """All frames behind the jump in one moment: a drive would get its whole path at once."""
    Path("back.log").write_text(beats(100, 102) + beats(10, 12))
    assert run(*command, "--trace", "sent.log").status == ExitCode.OK
    times = [record.time for record in LogReader(Path("sent.log"))]
    assert len(times) == 80
    assert (times[-1] - times[0]) / 1e9 == pytest.approx(3.9, abs=0.15)


def test_who_waits_for_emergencies_is_told_that_none_can_come(run: Run, scripted: Any) -> None:
    """A bus that is down has no errors to tell, and a frame that was lost may have been one."""
    emergency = Frame.parse("085#1081010000000000"), None
    away = BusStateChanged("virtual:x", BusState.DOWN, "unplugged")
    scripted(emergency, ReceiveOverrun("virtual:x", 3, "too slow"), away, None, emergency)
    outcome = run("emcy", "watch", "-b", "virtual:x", "--for", "7s")
    assert len(outcome.out.splitlines()) == 2
    assert "3 received frames lost on virtual:x: too slow" in outcome.err
    assert "virtual:x: down: unplugged" in outcome.err
    Path("a.log").write_text("(1.0) can0 085#1081010000000000\n" + OVERRUN.format("1.5") + "(1.6) can0 085#0000000000000000\n")
    assert "the controller of the recorder was overrun" in run("emcy", "watch", "--log", "a.log").err
