"""`canopen monitor`: in virtual time. On a terminal: test_live_terminal.py; `canopen log decode`: test_log.py."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_cli.live import source as live_source
from canopen_proto.frame import Frame
from canopen_transports import BusState, BusStateChanged, open_transport
from canopen_transports.errors import ReceiveOverrun, TransportError
from tests.cli.cli_support import Alarm, Run, runner_in_folder, watched_simulations
from tests.cli.test_log import typed

LOG = """\
(100.000000) can0 705#00
(100.100000) can0 605#4041600000000000
(100.101000) can0 585#4B41600050020000
(100.200000) can0 605#4018100100000000
(100.201000) can0 585#4318100178563412
(100.300000) can0 706#05
(100.400000) can0 605#4041600000000000
(100.401000) can0 585#4B41600050020000
(100.500000) can0 605#4041600000000000
(100.501000) can0 585#4B41600037020000
(100.600000) can0 086#1081010000000000
(100.700000) can0 706#05
(100.800000) can0 080#
(100.900000) can0 585#4B41600037020000
(101.000000) can0 385#AA
"""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    run = runner_in_folder(capsys, monkeypatch, tmp_path)
    Path("a.log").write_text(LOG)
    return run


def times(text: str) -> list[int]:
    """The times of the frames that are shown, in ms."""
    return [round(float(line.split()[0]) * 1000) for line in text.splitlines() if line[0] not in "!="]


def test_a_bus_is_shown_as_it_goes_on(run: Run) -> None:
    outcome = run("monitor", "-b", "demo", "--seconds", "0.7")
    lines = outcome.out.splitlines()
    assert lines[0] == "    0.000000 703#00                    boot-up     3"
    assert lines[-1] == "    0.450000 708#7F                    heartbeat   8  pre-operational"
    assert (outcome.status, len(lines)) == (0, 12)
    assert outcome.err.splitlines() == ["demo, for 0.7 s; nothing is sent", "12 frames in 0.7 s, no findings"]


def test_ctrl_c_is_its_usual_end(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    alarm = Alarm()
    watched_simulations(monkeypatch, alarm)
    alarm.set((1.2, signal.SIGINT))
    outcome = run("monitor", "-b", "demo", "--node", "5", "--trace", "t.log")
    assert (outcome.status, len(outcome.out.splitlines())) == (0, 3)
    assert outcome.err.splitlines()[1] == "18 frames in 1.2 s, 3 shown, no findings"
    assert outcome.err.splitlines()[-1] == "ended"
    assert len(Path("t.log").read_text().splitlines()) == 18


FASTSCAN = "".join(
    f"({200 + number / 100:.6f}) can0 {text}\n"
    for number, text in enumerate(
        each
        for request in ("00000000800000", "60030000000001", "02000000000102", "03000100000203", "EEFFC000000300")
        for each in (f"7E5#51{request}", "7E4#4F00000000000000")
    )
)


def test_a_fastscan_is_one_line(run: Run) -> None:
    Path("scan.log").write_text(FASTSCAN + "(200.100000) can0 7E5#5E00000000000000\n")
    outcome = run("monitor", "--log", "scan.log")
    address = "vendor-ID 0x00000360, product code 0x00000002, revision 0x00010003, serial number 0x00C0FFEE"
    summary = f"= LSS: fastscan: {address} is selected (5 requests, 90 ms)"
    asked = "    0.100000 7E5#5E00000000000000      LSS            inquire node-ID?"
    assert outcome.out.splitlines() == [summary, asked]
    assert outcome.err == "11 frames in 0.1 s, 1 shown, no findings\n"
    each = run("monitor", "--log", "scan.log", "-v").out.splitlines()
    assert (len(each), each[0].split()[1], each[9], each[11]) == (12, "7E5#5100000000800000", summary, asked)
    documents = [json.loads(line) for line in run("log", "decode", "scan.log", "--json").out.splitlines()]
    assert [document["summary"] for document in documents if "summary" in document] == [summary.removeprefix("= LSS: ")]
    assert len(documents) == 12
    assert run("monitor", "--log", "scan.log", "--service", "sdo").out == ""


def test_what_a_node_was_told_behind_its_boot_up_is_summed_up(run: Run) -> None:
    """The last SDO answer has no request: it is no value that was read."""
    line = "= boot-up of node 5: 4 values read, 0 written, 0 transfers aborted"
    assert run("monitor", "--log", "a.log").out.splitlines()[-1] == line
    assert line in run("log", "decode", "a.log", "--node", "5", "--service", "boot-up").out
    assert line not in run("log", "decode", "a.log", "--node", "6").out
    assert line not in run("log", "decode", "a.log", "--object", "1018").out


def test_a_recording_is_shown_as_log_decode_does(run: Run) -> None:
    monitored, decoded = run("monitor", "--log", "a.log"), run("log", "decode", "a.log")
    assert monitored.out == decoded.out
    assert (decoded.err, monitored.err) == ("", "15 frames in 1.0 s, 1 finding\n")
    assert run("monitor", "--log", "a.log", "--json").out == run("log", "decode", "a.log", "--json").out


def test_standard_input(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    said = run("monitor", "--log", "a.log").out
    monkeypatch.setattr("sys.stdin", typed(LOG.encode()))
    assert run("monitor", "--log", "-").out == said


STATUSWORD = [100, 101, 400, 401, 500, 501, 900]


@pytest.mark.thorough(3)
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--node", "6"), [300, 600, 700]),
        (("--service", "emcy"), [600]),
        (("--service", "emcy,sync", "--service", "boot-up"), [0, 600, 800]),
        (("--service", "pdo"), [1000]),
        (("--service", "TPDO3"), [1000]),
        (("--service", "tpdo 1,rpdo"), []),
        (("--object", "0x6041"), STATUSWORD),
        (("--object", "6041:00", "--node", "5"), STATUSWORD),
        (("--object", "Statusword"), STATUSWORD),
        (("--object", "1018"), [200, 201]),
        (("--object", "1018:02"), []),
        (("--object", "1018", "--object", "statusword", "--service", "emcy"), []),
        (("--changes", "--node", "5"), [0, 100, 101, 200, 201, 501, 900, 1000]),
        (("--changes", "--node", "6"), [300, 600]),
    ],
)
def test_only_what_was_asked_for(run: Run, options: tuple[str, ...], expected: list[int]) -> None:
    outcome = run("monitor", "--log", "a.log", *options)
    assert (outcome.status, times(outcome.out)) == (0, expected)
    assert f"15 frames in 1.0 s, {len(expected)} shown" in outcome.err


def test_a_pdo_is_one_whatever_its_name(run: Run) -> None:
    Path("b.log").write_text("(1.0) can0 583#4300100092010200\n(1.0) can0 183#3702000064000000\n(2.0) can0 703#05\n")
    assert "schunk_default_tPDO?" in run("monitor", "--log", "b.log", "--service", "pdo").out
    assert times(run("monitor", "--log", "b.log", "--service", "tpdo").out) == [0]
    assert times(run("monitor", "--log", "b.log", "--object", "position_actual_value").out) == [0]


def test_the_changes_of_an_object_are_those_of_its_own_value(run: Run) -> None:
    """A statusword travels with a position that changes in each frame."""
    words = ("3702", "3702", "3706", "3706", "3702")
    lines = [f"({number}.0) can0 183#{word}0000{number:02}000000" for number, word in enumerate(words, 1)]
    Path("c.log").write_text("\n".join(["(0.5) can0 583#4300100092010200", *lines]) + "\n")
    assert times(run("monitor", "--log", "c.log", "--object", "statusword", "--changes").out) == [500, 2500, 4500]
    assert times(run("monitor", "--log", "c.log", "--object", "6064", "--changes").out) == [500, 1500, 2500, 3500, 4500]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--service", "sod"), "there is no service 'sod'"),
        (("--object", "statuswort"), "did you mean statusword?"),
        (("--node", "200"), "node-ID 200 is outside 1..127"),
    ],
)
def test_a_word_that_fits_nothing_is_no_filter(run: Run, options: tuple[str, ...], said: str) -> None:
    outcome = run("monitor", "--log", "a.log", *options)
    assert (outcome.status, outcome.out) == (2, "")
    assert said in outcome.err


def test_a_name_is_that_of_each_nodes_own_file(run: Run) -> None:
    """The other nodes have a statusword, but the file of node 5, which alone shows 0x6041, knows none."""
    outcome = run("monitor", "--log", "a.log", "-e", "5=sample_io.xdd", "--object", "statusword")
    assert (outcome.status, outcome.out) == (0, "")


def test_the_objects_of_a_frame_are_in_its_json(run: Run) -> None:
    lines = [json.loads(line) for line in run("monitor", "--log", "a.log", "--json", "--node", "5").out.splitlines()]
    assert lines[1]["objects"] == [{"node": 5, "index": 0x6041, "sub": 0, "name": "statusword", "value": None, "text": ""}]
    (read,) = lines[2]["objects"]
    assert (read["value"], read["text"][:11]) == (0x250, "592 (0x250,")
    assert lines[0]["time"] == 100 * 10**9


def test_what_is_wrong_with_a_node_is_shown_with_it(run: Run) -> None:
    """A heartbeat that is late is found at the frame of another node."""
    late = "(1.0) can0 605#2316100164000600\n(1.1) can0 585#6016100100000000\n(1.2) can0 706#05\n(9.0) can0 707#05\n"
    Path("b.log").write_text(late)
    lines = run("monitor", "--log", "b.log", "--node", "6").out.splitlines()
    assert [line.split()[0] for line in lines] == ["0.200000", "8.000000", "!"]
    assert lines[2].startswith("! late heartbeat (likely): node 6:")


def test_a_bus_that_falls_silent_is_not_passed_over(run: Run, scripted: Callable[..., None]) -> None:
    """The heartbeat that is late is told without a frame behind it, and so is the end of what the node was told."""
    said = ("706#00", "606#2316100164000500", "586#6016100100000000", "705#05")
    scripted(*((Frame.parse(text), None) for text in said), silence=10)
    outcome = run("monitor", "-b", "virtual:x", "--seconds", "9")
    late, boot = [line for line in outcome.out.splitlines() if line[0] in "!="]
    assert late.startswith("! 3.2500 s: late heartbeat (likely): node 5: no heartbeat for more than 100 ms")
    assert boot.startswith("= boot-up")
    assert "4 frames in 9.0 s, 1 finding" in outcome.err
    scripted(*((Frame.parse(text), None) for text in said), silence=10)
    assert "!" not in run("monitor", "-b", "virtual:x", "--seconds", "9", "--node", "6").out


# ---- what a bus reports ----


class Script:
    """A bus that says one thing a second, and after a silence (seconds) fails."""

    def __init__(self, items: list[Any], silence: float) -> None:
        self._items = items
        self._silence = silence
        self._due = trio.current_time() + 1
        self.locator = "virtual:x"

    async def receive(self) -> Any:
        await trio.sleep_until(self._due)
        if not self._items:
            await trio.sleep(self._silence)
            raise TransportError("CO111", "virtual:x", "virtual:x is lost", seen="unplugged")
        self._due += 1
        return self._items.pop(0)

    async def __aenter__(self) -> None: ...
    async def __aexit__(self, *_: object) -> None: ...


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    def script(*items: Any, silence: float = 0) -> None:
        async def opening(locator: str) -> Script:
            return Script(list(items), silence)

        monkeypatch.setattr(live_source, "open_transport", opening)

    return script


ITEMS = (
    (Frame(0x705, b"\x05"), None),
    ReceiveOverrun("virtual:x", 3, "the queue was full"),
    BusStateChanged("virtual:x", BusState.PASSIVE, "the transmit error counter is 128"),
    (Frame(0x705, b"\x05"), None),
)


def test_losses_and_states_stand_in_their_place(run: Run, scripted: Callable[..., None]) -> None:
    scripted(*ITEMS)
    outcome = run("monitor", "-b", "virtual:x")
    assert outcome.out.splitlines() == [
        "    0.000000 705#05                    heartbeat   5  operational",
        "! 1.0000 s: 3 received frames lost on virtual:x: the queue was full",
        "! 2.0000 s: virtual:x: error-passive: the transmit error counter is 128",
        "    3.000000 705#05                    heartbeat   5  operational",
    ]
    assert outcome.status == 4
    assert "3 frames lost before they came here" in outcome.err
    assert "error CO111: virtual:x is lost" in outcome.err


def test_losses_and_states_as_json(run: Run, scripted: Callable[..., None]) -> None:
    scripted(*ITEMS)
    lines = [json.loads(line) for line in run("monitor", "-b", "virtual:x", "--json").out.splitlines()]
    assert [line.get("lost") for line in lines] == [None, 3, 0, None]
    assert lines[2]["report"] == "virtual:x: error-passive"


def test_it_sends_nothing(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[str] = []

    async def listen() -> None:
        async with await open_transport("virtual:x") as other:
            await other.send(Frame(0x605, b"\x40\x41\x60\0\0\0\0\0"))
            while True:
                heard.append(str(await other.receive()))

    opening = live_source.open_transport

    async def opened(locator: str) -> Any:
        transport = await opening(locator)
        trio.lowlevel.spawn_system_task(listen)
        return transport

    monkeypatch.setattr(live_source, "open_transport", opened)
    assert times(run("monitor", "-b", "virtual:x", "--seconds", "10").out) == [0]
    assert heard == []
