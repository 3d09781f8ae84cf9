"""`canopen top`: the picture as text, and the command in a pipe."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest
import trio
from rich.console import Console, RenderableType

from canopen_cli.live import source as live_source
from canopen_cli.live.top_view import SILENT, BusShown, TopView, as_json, is_silent, picture, plain
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.observer.bus_view import BusView
from canopen_proto.observer.observer import Observer
from canopen_transports import BusState, BusStateChanged
from tests.cli.cli_support import Run, runner

LOG = """\
(1.000000) can0 705#00
(1.100000) can1 706#05
(2.000000) can0 705#05
(2.200000) can0 080#
(2.210000) can0 080#
(2.220000) can0 080#
(2.300000) can0 085#3081110000000000
(2.400000) can0 605#4041600000000000
(2.410000) can0 585#4B41600040020000
(3.000000) can0 705#05
"""


def recorded(text: str = LOG, bitrate: int = 0) -> tuple[BusView, Time]:
    """Return the view of can0 in a log, and the time of its last frame."""
    observer, view, now = Observer(bitrate=bitrate), BusView(bitrate=bitrate), 0
    for line in text.splitlines():
        seconds, channel, frame = line.split()
        if channel == "can0":
            now = round(float(seconds.strip("()")) * SECOND)
            can_id, _, data = frame.partition("#")
            made = Frame(int(can_id, 16), bytes.fromhex(data))
            view.add(made, observer.observe(made, now), now)
    return view, now


def shown(view: BusView, last: Time, now: Time | None = None, **more: object) -> TopView:
    now = last if now is None else now
    made = TopView("socketcan:can0", (BusShown("can0", view.figures(now), now, last, view.bitrate),))
    return made._replace(**more)  # type: ignore[arg-type]


def lines(renderable: RenderableType, width: int) -> list[str]:
    console = Console(width=width, color_system=None)
    with console.capture() as captured:
        console.print(renderable)
    return [line.rstrip() for line in captured.get().rstrip("\n").split("\n")]


def drawn(view: TopView, width: int = 80, height: int = 24, paused: float | None = None) -> list[str]:
    found = lines(picture(view, width, height, paused), width)
    assert len(found) == height
    assert all(len(line) <= width for line in found)
    return found


def test_a_bus_at_80_by_24() -> None:
    view, last = recorded(bitrate=125_000)
    found = drawn(shown(view, last))
    assert found[0].startswith("socketcan:can0")
    assert found[0].endswith("7 frames/s, load 0.5% of 125k, peak 0.5%")
    assert found[1] == "SYNC each 10.00 ms, from 10.00 to 10.00, standard deviation 0.00 ms"
    assert found[2] == "9 frames in 2.0 s, SDO: 1 value"
    assert found[3].split() == ["node", "state", "heard", "heartbeat", "frames/s", "load", "%", "SDO", "errors"]
    assert found[4].split() == ["5", "(0x05)", "operational", "0.0", "s", "1000", "±0.0", "ms", "4", "0.3", "1", "0x8130"]
    assert found[-2].startswith(" 0.7 s ago  node 5  EMCY 0x8130 life guard error or heartbeat error")
    assert found[-1] == "q end   p pause   s sort"


def test_a_node_that_is_silent_does_not_look_alive() -> None:
    view, last = recorded()
    now = last + 3 * SECOND + 1
    (node,) = view.figures(now).nodes
    assert is_silent(node, now)
    assert not is_silent(node, now - 1)
    assert not is_silent(node._replace(heartbeat=None), last + SILENT)
    assert is_silent(node._replace(heartbeat=None), last + SILENT + 1)
    assert is_silent(node._replace(last_heard=None), now)
    found = drawn(shown(view, last, now))
    assert "5 (0x05) SILENT, operational 3.0 s" in found[4]
    assert found[0].endswith("0 frames/s, 0 kbit/s")
    assert found[1] == "NOTHING HEARD FOR 3.0 s"
    colours = Console(width=80, force_terminal=True, color_system="standard")
    with colours.capture() as captured:
        colours.print(picture(shown(view, last, now), 80, 24))
    assert "\x1b[2mSILENT" in captured.get()  # dim
    assert "\x1b[32m" not in captured.get()  # not green


def test_whom_a_scan_has_asked_and_nobody_has_heard_is_one_line_and_no_node() -> None:
    asked = "".join(f"(3.{node:03}) can0 {0x600 + node:X}#4000100000000000\n" for node in range(1, 128) if node not in (8, 9, 11))
    view, last = recorded(LOG + asked)
    found = drawn(shown(view, last))
    assert found[4].startswith("5 (0x05)")
    assert not any("SILENT" in each or "the terminal is too low" in each for each in found)
    assert found[-2] == "spoken to, and never heard: 1-4, 6-7, 10, 12-127"
    assert found[-2] in lines(plain(shown(view, last), 80), 80)
    assert len(as_json(shown(view, last))[0]["nodes"]) == 124  # for programs that want them all


def test_a_state_that_was_only_commanded_is_no_fact() -> None:
    view, last = recorded(f"{LOG}(3.10) can0 000#0205\n")
    assert "told: stopped" in drawn(shown(view, last))[4]


def test_a_state_that_was_said_long_ago_is_not_the_present_one() -> None:
    view, last = recorded(f"{LOG}(6.5) can0 585#4B41600040020000\n")  # it answers SDO, and sends no heartbeat any more
    assert "was operational" in drawn(shown(view, last))[4]
    view, last = recorded("(1.0) can0 705#00\n(9.0) can0 585#4B41600040020000\n")  # without a heartbeat
    assert "was pre-op" in drawn(shown(view, last))[4]


def test_a_sync_that_has_stopped_is_not_shown_as_running() -> None:
    view, last = recorded()
    assert drawn(shown(view, last, last + SECOND))[1] == "SYNC has stopped 1.8 s ago; it came each 10.00 ms"
    view, last = recorded("(1.0) can0 080#\n(3.0) can0 705#05\n")
    assert drawn(shown(view, last))[1] == "one SYNC, 2.0 s ago"
    assert drawn(shown(recorded("(3.0) can0 705#05\n")[0], last))[1] == "no SYNC"


@pytest.mark.parametrize("heartbeat", ["05", "7F", "04"])
def test_all_columns_fit_for_the_longest_state(heartbeat: str) -> None:
    view, last = recorded("".join(f"({second}.0) can0 77F#{heartbeat}\n" for second in range(1, 10)))
    for now in (last, last + 9 * SECOND):
        assert "…" not in drawn(shown(view, last, now))[4]


def test_what_does_not_fit_is_counted() -> None:
    view, last = recorded("".join(f"(1.{node:03}) can0 {0x700 + node:X}#05\n" for node in range(1, 100)))
    for height in (8, 24, 40):
        found = drawn(shown(view, last), height=height)
        rows = sum("operational" in line for line in found)
        assert rows > 0
        assert f"... {99 - rows} nodes more: the terminal is too low" in found
    assert not [line for line in drawn(shown(view, last), height=110) if "more" in line]


def test_emergencies_get_their_lines_beside_many_nodes() -> None:
    nodes = "".join(f"(1.{node:03}) can0 {0x700 + node:X}#05\n" for node in range(1, 60))
    faults = "".join(f"(2.{number}) can0 081#31{number}000000000000\n" for number in range(10, 20))
    view, last = recorded(nodes + faults)
    found = drawn(shown(view, last))
    assert sum("EMCY" in line for line in found) == 4
    assert found[-2].split()[:2] == ["0.0", "s"] or "0.0 s ago" in found[-5]


def test_the_orders_of_the_nodes() -> None:
    text = "(1.3) can0 705#05\n" + 4 * "(1.4) can0 706#05\n" + "(1.5) can0 087#3081110000000000\n"
    view, last = recorded(text)

    def order(sort: str) -> list[int]:
        return [int(line.split()[0]) for line in drawn(shown(view, last + SECOND // 2, sort=sort)) if " (0x" in line]

    assert order("node") == [5, 6, 7]
    assert order("load")[0] == 6
    assert order("silence") == [5, 6, 7]
    assert order("errors")[0] == 7


def test_a_picture_that_is_held_says_so() -> None:
    view, last = recorded()
    assert drawn(shown(view, last), paused=7.2)[0].endswith("PAUSED 7 s AGO")


def test_a_long_name_leaves_room() -> None:
    view, last = recorded()
    found = drawn(shown(view, last, source=f"/{'long/' * 30}can0"), width=60)
    assert found[0].startswith("…")
    assert found[0].endswith("kbit/s")


@pytest.mark.parametrize("width", [46, 60, 80])
def test_a_narrow_table_leaves_columns_out_and_no_words_cut(width: int) -> None:
    view, last = recorded()
    found = drawn(shown(view, last, sort="load"), width=width)
    head = next(line for line in found if line.startswith("node"))
    assert {"state", "heard", "errors"} <= {*head.split()}
    assert "%" in head or "bit/s" in head  # by which it is sorted
    assert ("heartbeat" in head) is (width == 80)
    table = [line for line in found if line.startswith("node") or " (0x" in line]
    assert len(table) >= 2
    assert not any("…" in line for line in table)


# ---- the command ----


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own").mkdir()
    (tmp_path / "t.log").write_text(LOG)
    return runner(capsys, monkeypatch, tmp_path / "own")


def test_a_file_is_one_table_for_each_bus(run: Run) -> None:
    outcome = run("top", "--log", "t.log", "--bitrate", "125k")
    assert outcome.status == 0
    assert [line.split()[0] for line in outcome.out.splitlines() if " (0x" in line] == ["5", "6"]
    assert "t.log can0" in outcome.out
    assert "\x1b" not in outcome.out


def test_json(run: Run) -> None:
    first, second = run("top", "--log", "t.log", "--json").json
    assert (first["bus"], second["bus"]) == ("can0", "can1")
    (node,) = first["nodes"]
    assert (node["node"], node["state"], node["is_silent"], node["errors"]) == (5, "operational", False, [0x8130])
    assert node["emergencies"][0]["text"].startswith("life guard")
    assert first["sync"]["number"] == 2
    assert first["load"] is None


class FaultyBus:
    """A bus that reports these states, after as many heartbeats, and then is silent."""

    def __init__(self, beats: int, states: list[BusState]) -> None:
        self._items: list[object] = [(Frame(0x705, b"\x05"), None)] * beats
        self._items += [BusStateChanged("virtual:x", state, "the cable is loose") for state in states]

    async def receive(self) -> object:
        if not self._items:
            await trio.sleep_forever()
        return self._items.pop(0)

    async def __aenter__(self) -> None: ...
    async def __aexit__(self, *_: object) -> None: ...


def on_faulty_bus(
    run: Run, monkeypatch: pytest.MonkeyPatch, beats: int, *states: BusState
) -> tuple[str, list[dict[str, object]]]:
    """Return what people see, and what programs get."""
    command = ("top", "-b", "virtual:x", "--seconds", "0.2")
    found = []
    for more in ((), ("--json",)):

        async def opening(locator: str) -> FaultyBus:
            return FaultyBus(beats, list(states))

        monkeypatch.setattr(live_source, "open_transport", opening)
        found.append(run(*command, *more))
    text = found[0].out + found[0].err
    return text, found[1].json if beats else []


@pytest.mark.parametrize("state", [BusState.BUS_OFF, BusState.DOWN, BusState.PASSIVE, BusState.NO_ACKNOWLEDGE])
def test_a_bus_that_is_not_well_is_told_to_people_and_to_programs(
    run: Run, monkeypatch: pytest.MonkeyPatch, state: BusState
) -> None:
    text, (bus,) = on_faulty_bus(run, monkeypatch, 2, state)
    told = f"the bus is {state.name.lower().replace('_', '-')}: the cable is loose"
    assert told in text
    assert (bus["bus_state"], bus["notes"]) == (state.value, [told])
    text, _ = on_faulty_bus(run, monkeypatch, 0, state)
    assert "no frame came on virtual:x" in text
    assert told in text


def test_a_bus_that_is_well_again_is_not_accused(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    text, (bus,) = on_faulty_bus(run, monkeypatch, 2, BusState.BUS_OFF, BusState.ACTIVE)
    assert "the bus is" not in text
    assert (bus["bus_state"], bus["notes"]) == ("error-active", [])


def test_standard_input(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BufferedReader(io.BytesIO(LOG.encode()))))
    outcome = run("top", "--log", "-")
    assert outcome.status == 0
    assert "5 (0x05)" in outcome.out


def test_a_bus_is_listened_to_for_three_heartbeats(run: Run) -> None:
    outcome = run("top", "-b", "demo", "--trace", "out.log")
    assert outcome.status == 0
    assert outcome.out.count("pre-operational") == 6
    assert "(0 " not in outcome.out
    assert not [line for line in Path("out.log").read_text().splitlines() if line.endswith("T")], "nothing is sent"


def test_the_machine_file_tells_the_bit_rate(run: Run) -> None:
    Path("cell.toml").write_text('[buses.arm]\nlocator = "file:t.log?speed=max"\nbitrate = "250k"\n')
    outcome = run("top", "-m", "cell.toml")
    assert outcome.status == 0, outcome.err
    assert "% of 250k" in outcome.out


def test_two_recordings_in_one_file(run: Run) -> None:
    Path("two.log").write_text("(1000.0) can0 705#05\n(10.0) can0 706#05\n(14.0) can0 706#05\n")
    outcome = run("top", "--log", "two.log")
    assert "5 (0x05) SILENT" in outcome.out, "what was heard 4 s before does not look present"
    assert "the clock of the frames went back 1 time" in outcome.out


def test_a_file_with_a_name_for_each_frame_takes_no_more_memory(run: Run) -> None:
    Path("many.log").write_text("".join(f"({number}.0) bus{number} 705#05\n" for number in range(1, 40)))
    outcome = run("top", "--log", "many.log")
    assert outcome.out.count("5 (0x05)") == 16
    assert "only the first 16 buses are shown" in outcome.out


def test_nothing_came(run: Run) -> None:
    Path("empty.log").write_text("")
    assert run("top", "--log", "empty.log").status == 6
    Path("fd.log").write_text("(1.0) can0 123##1AA\n")
    assert "seen:  1 entry passed over, the last: a CAN FD frame" in run("top", "--log", "fd.log").err
    outcome = run("top", "-b", "virtual:nobody")
    assert (outcome.status, "no frame came on virtual:nobody" in outcome.err) == (5, True)
    assert "no frame came on demo" in run("top", "-b", "demo", "--seconds", "0").err
    assert run("top", "--log", "t.log", "--bitrate", "5").status == 2
    assert run("top").status == 2


def test_sixty_milliseconds_and_more_are_whole_numbers() -> None:
    view, last = recorded("".join(f"({number / 10:.2f}) can0 080#\n" for number in range(1, 20)))
    assert drawn(shown(view, last))[1].startswith("SYNC each 100 ms")
    assert view.figures(last + MILLISECOND).syncs == 19
