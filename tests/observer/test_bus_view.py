"""A bus in figures: rates, load, states, errors and jitter, from frames and their times alone."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.frame_bits import frame_bits
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.nmt import NmtState
from canopen_proto.observer.bus_view import MAX_EMERGENCIES, MAX_ERRORS, MAX_FINDINGS, MAX_INTERVALS, BusFigures, BusView
from canopen_proto.observer.observer import Observer
from canopen_testing.strategies import near_valid_frames, random_frames
from tests.examples import examples


class Watched:
    """An observer with a view behind it."""

    def __init__(self, bitrate: int = 0) -> None:
        self.observer = Observer(bitrate=bitrate)
        self.view = BusView(bitrate=bitrate)
        self.now: Time = 0

    def hear(self, *texts: str, apart: Time = 10 * MILLISECOND) -> BusFigures:
        """Take frames, the first one after `apart`, and return the figures at the last one."""
        for text in texts:
            self.now += apart
            frame = Frame.parse(text)
            self.view.add(frame, self.observer.observe(frame, self.now), self.now)
        return self.view.figures(self.now)


def test_a_view_of_nothing() -> None:
    figures = BusView(bitrate=500_000).figures(SECOND)
    assert (figures.nodes, figures.frames, figures.load, figures.peak, figures.mean_load) == ((), 0, 0.0, 0.0, None)
    assert (figures.sync, figures.sync_counter, figures.findings, figures.elapsed) == (None, None, (), 0)


def test_rates_are_those_of_the_last_whole_second() -> None:
    watched = Watched(bitrate=125_000)
    figures = watched.hear(*["185#0102"] * 300)
    bits = frame_bits(Frame.parse("185#0102"))
    assert (figures.frames, figures.frames_per_second, figures.bits_per_second) == (300, 100, 100 * bits)
    assert figures.load == figures.peak == 100 * bits / 125_000
    (node,) = figures.nodes
    assert (node.node_id, node.frames_per_second, node.bits_per_second) == (5, 100, 100 * bits)
    later = watched.view.figures(watched.now + SECOND // 2)
    assert 45 <= later.frames_per_second <= 55
    silent = watched.view.figures(watched.now + 5 * SECOND)
    assert (silent.frames_per_second, silent.load, silent.peak, silent.frames) == (0, 0.0, figures.peak, 300)
    assert silent.nodes[0].frames_per_second == 0
    assert silent.mean_load == 300 * bits / 125_000 / (silent.elapsed / SECOND)


def test_the_peak_is_the_busiest_second() -> None:
    watched = Watched(bitrate=125_000)
    watched.hear(*["185#0102"] * 50, apart=20 * MILLISECOND)
    watched.hear(*["185#0102"] * 100, apart=MILLISECOND)
    figures = watched.hear(*["185#0102"] * 100, apart=50 * MILLISECOND)
    peak = 100 + 45, 100 + 50
    bits = frame_bits(Frame.parse("185#0102"))
    assert figures.frames_per_second == 20
    assert figures.peak is not None
    assert peak[0] <= figures.peak * 125_000 / bits <= peak[1]
    assert BusView().figures(0).load is None


def test_states() -> None:
    watched = Watched()
    (node,) = watched.hear("705#00").nodes
    assert (node.state, node.is_said, node.booted) == (NmtState.PRE_OPERATIONAL, True, 1)
    (node,) = watched.hear("000#0105").nodes
    assert (node.state, node.is_said) == (NmtState.OPERATIONAL, False)
    (node,) = watched.hear("705#05").nodes
    assert (node.state, node.is_said) == (NmtState.OPERATIONAL, True)
    assert isinstance(node.state, NmtState), "also in the compiled core"
    nodes = watched.hear("706#7F", "000#0200", "706#7F").nodes
    assert [(node.state, node.is_said) for node in nodes] == [(NmtState.STOPPED, False), (NmtState.PRE_OPERATIONAL, True)]
    assert [node.state for node in watched.hear("705#42", "706#85").nodes] == [0x42, NmtState.OPERATIONAL]


def test_who_was_heard_and_when() -> None:
    watched = Watched()
    (node,) = watched.hear("605#4041600000000000").nodes
    assert (node.last_heard, node.heard_by, node.state) == (None, "", None), "it was only spoken to"
    (node,) = watched.hear("585#4B41600037020000", "605#4041600000000000", "705#R1").nodes
    assert (node.last_heard, node.heard_by, node.frames) == (20 * MILLISECOND, "SDO", 4)


def test_transfers_and_aborts() -> None:
    watched = Watched()
    watched.hear("605#4041600000000000", "585#4B41600037020000", "605#2B40600006000000", "585#6040600000000000")
    figures = watched.hear("605#4099600000000000", "585#8099600000000206")
    assert (figures.transfers, figures.aborts) == (2, 1)
    assert (figures.nodes[0].transfers, figures.nodes[0].aborts) == (2, 1)


def test_periods_and_jitter() -> None:
    watched = Watched()
    assert watched.hear("080#").sync is None
    watched.hear("080#", apart=9 * MILLISECOND)
    figures = watched.hear("080#", apart=11 * MILLISECOND)
    assert figures.sync is not None
    assert figures.sync == (2, 9 * MILLISECOND, 10.0 * MILLISECOND, 11 * MILLISECOND, 1.0 * MILLISECOND)
    assert (figures.syncs, figures.sync_counter) == (3, None)
    assert watched.hear("080#07").sync_counter == 7
    (node,) = watched.hear("705#05", "705#05", "705#05", apart=100 * MILLISECOND).nodes
    assert node.heartbeat is not None
    assert (node.heartbeat.number, node.heartbeat.mean, node.heartbeat.deviation) == (2, 100 * MILLISECOND, 0)
    assert watched.hear("705#00").nodes[0].heartbeat is None, "the time without the node is no interval"


def test_errors_that_are_present() -> None:
    watched = Watched()
    (node,) = watched.hear("085#1042090102030405", "085#3081110000000000", "085#1042190000000000").nodes
    assert (node.errors, node.register) == ((0x4210, 0x8130), 0x19)
    assert [(each.code, each.time // MILLISECOND) for each in node.emergencies] == [(0x4210, 10), (0x8130, 20), (0x4210, 30)]
    assert node.emergencies[0].data == bytes((1, 2, 3, 4, 5))
    assert "emperature" in node.emergencies[0].text
    (node,) = watched.hear("085#0000110000000000").nodes
    assert node.errors == (0x4210, 0x8130), "it does not say which one is gone"
    (node,) = watched.hear("085#0000000000000000").nodes
    assert (node.errors, node.register, len(node.emergencies)) == ((), 0, 5)
    assert watched.hear("085#1042090000000000", "705#00").nodes[0].errors == ()


def test_findings() -> None:
    watched = Watched()
    figures = watched.hear("000#01", "000#01", "705#0505")
    assert figures.found == {"length": 3}
    assert [(time // MILLISECOND, finding.node_id) for time, finding in figures.findings] == [(10, 0), (20, 0), (30, 5)]


@given(st.lists(st.tuples(near_valid_frames() | random_frames(), st.integers(0, SECOND)), max_size=40))
@examples(100)
def test_any_frames_are_counted_and_nothing_grows(entries: list[tuple[Frame, int]]) -> None:
    observer, view, now = Observer(), BusView(bitrate=500_000), 0
    for frame, after in entries:
        now += after
        view.add(frame, observer.observe(frame, now), now)
        figures = view.figures(now)
        assert figures.load is not None
        assert figures.peak is not None
        assert 0 <= figures.load <= figures.peak
    figures = view.figures(now)
    assert figures.frames == len(entries)
    assert view.figures(now + 2 * SECOND).frames_per_second == 0


def test_memory_is_bounded() -> None:
    watched = Watched()
    errors = [f"085#{number % 256:02X}{0x10 + number // 256:02X}010000000000" for number in range(400)]
    figures = watched.hear(*errors, *["080#"] * 400, *["000#01"] * 100)
    (node,) = figures.nodes
    assert (len(node.errors), len(node.emergencies)) == (MAX_ERRORS, MAX_EMERGENCIES)
    assert len(figures.findings) == MAX_FINDINGS
    assert figures.found["length"] == 100
    assert figures.sync is not None
    assert figures.sync.number == MAX_INTERVALS
