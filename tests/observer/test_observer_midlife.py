"""What the observer, and the view behind it, keep of a bus whose devices get other settings in mid-life.

The oracles know no state but the recording so far. Before each look they go through all of it anew.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.frame import COB_ID_INVALID, Frame
from canopen_proto.frame_bits import frame_bits
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.nmt import NmtState
from canopen_proto.observer.bus_view import MAX_INTERVALS, BusView
from canopen_proto.observer.observer import Observer
from canopen_proto.parameter_storage import RESTORE, SIGNATURES, STORE
from tests.examples import examples
from tests.observer.test_decoding import U8, U32, obj
from tests.observer.test_observer_services import written

# ---- which service a CAN-ID belongs to ----

PLAIN, WITH_FILE = 5, 6
IN_FILE = {(0x1800, 1): 0x191, (0x1A00, 0): 1, (0x1A00, 1): 0x6041_0010, (0x1014, 0): 0x192}
CAN_IDS = (0x085, 0x086, 0x185, 0x186, 0x190, 0x191, 0x192, 0x205, 0x206)
"""Those of the predefined connection set for both nodes, and three that others give away."""

Write = tuple[int, int, int, int, str]
"""Node, index, subindex, value; and what comes of it: "confirmed", "refused", "lost" (its answer), "read" (the value is read)."""


FILE = ObjectDictionary(
    [obj(0x1800, (U8, 1), (U32, 0x191)), obj(0x1A00, (U8, 1), (U32, 0x6041_0010)), obj(0x1014, (U32, 0x192), name="COB-ID EMCY")]
)


def _writes() -> st.SearchStrategy[Write]:
    nodes = st.sampled_from([PLAIN, WITH_FILE])
    cob_ids = st.sampled_from([*CAN_IDS, *(each | COB_ID_INVALID for each in CAN_IDS[4:6])])
    outcomes = st.sampled_from(["confirmed"] * 4 + ["refused", "lost", "read"])
    return st.one_of(
        st.tuples(nodes, st.sampled_from([0x1400, 0x1800]), st.just(1), cob_ids, outcomes),
        st.tuples(nodes, st.sampled_from([0x1600, 0x1A00]), st.just(0), st.sampled_from([0, 1]), outcomes),
        st.tuples(nodes, st.sampled_from([0x1600, 0x1A00]), st.just(1), st.sampled_from([0x6040_0010, 0x6041_0010]), outcomes),
        st.tuples(nodes, st.sampled_from([0x1005, 0x1012, 0x1014]), st.just(0), cob_ids, outcomes),
        st.tuples(nodes, st.just(STORE), st.just(1), st.sampled_from([SIGNATURES[STORE], 1]), outcomes),
        st.tuples(nodes, st.just(RESTORE), st.just(1), st.sampled_from([SIGNATURES[RESTORE], 1]), outcomes),
    )


MOVED: Write = (PLAIN, 0x1014, 0, 0x190, "confirmed")
STORED: Write = (PLAIN, STORE, 1, SIGNATURES[STORE], "confirmed")
BOOTS = st.tuples(st.sampled_from([PLAIN, WITH_FILE]))


def frames_of(step: Write | tuple[int]) -> tuple[str, ...]:
    """The frames of a write, or of a boot-up."""
    if len(step) == 1:
        return (f"{0x700 + step[0]:03X}#00",)
    node_id, index, subindex, value, outcome = step
    size = 1 if (index, subindex) in ((0x1600, 0), (0x1A00, 0)) else 4
    request, answer = written(node_id, index, subindex, value, size)
    place = request[6:12]
    if outcome == "refused":
        return request, f"{answer[:4]}80{place}00000108"
    if outcome == "lost":
        return (request,)
    if outcome == "read":
        command = 0x43 | (4 - size) << 2
        return f"{request[:4]}40{place}00000000", f"{answer[:4]}{command:02X}{place}{request[12:]}"
    return request, answer


class Oracle:
    """What two devices hold after these steps, as far as a listener can know, and who has a CAN-ID by that."""

    def __init__(self, steps: list[Write | tuple[int]]) -> None:
        self.shown: dict[int, dict[tuple[int, int], int]] = {PLAIN: {}, WITH_FILE: {}}
        stored: dict[int, dict[tuple[int, int], int]] = {PLAIN: {}, WITH_FILE: {}}
        for step in steps:
            if len(step) == 1:
                self.shown[step[0]] = dict(stored[step[0]])
                continue
            node_id, index, subindex, value, outcome = step
            if outcome in ("refused", "lost"):
                continue
            if index == STORE:
                if value == SIGNATURES[STORE] and outcome == "confirmed":
                    stored[node_id] = dict(self.shown[node_id])
            elif index == RESTORE:
                if value == SIGNATURES[RESTORE] and outcome == "confirmed":
                    stored[node_id] = {}
            else:
                self.shown[node_id][index, subindex] = value

    def value(self, node_id: int, index: int, subindex: int) -> int | None:
        in_file = IN_FILE if node_id == WITH_FILE else {}
        return self.shown[node_id].get((index, subindex), in_file.get((index, subindex)))

    def is_shown(self, node_id: int, *indices: int) -> bool:
        return any(index in indices for index, _ in self.shown[node_id])

    def pdos(self, can_id: int) -> Iterator[tuple[bool, bool, int]]:
        """Those that have it: not shown, received, node-ID. The first one in order counts."""
        for node_id in self.shown:
            for is_received, first, index in ((False, 0x180, 0x1800), (True, 0x200, 0x1400)):
                cob_id = self.value(node_id, index, 1)
                mapped = self.value(node_id, index + 0x200, 0), self.value(node_id, index + 0x200, 1)
                if mapped[0] == 1 and mapped[1] and can_id == (first + node_id if cob_id is None else cob_id):
                    yield not self.is_shown(node_id, index, index + 0x200), is_received, node_id

    def owner(self, can_id: int) -> tuple[str, int]:
        """The service and the node of a CAN-ID."""
        for _, is_received, node_id in sorted(self.pdos(can_id)):
            return f"{Direction.RPDO if is_received else Direction.TPDO} 1", node_id
        for node_id in self.shown:
            for index, service in ((0x1005, "SYNC"), (0x1012, "TIME"), (0x1014, "EMCY")):
                cob_id = self.value(node_id, index, 0)
                is_there = self.is_shown(node_id, index) or can_id > 0x100
                if cob_id is not None and is_there and can_id == (cob_id if service == "EMCY" else cob_id & ~COB_ID_INVALID):
                    return service, node_id if service == "EMCY" else 0
        function, node_id = can_id & 0x780, can_id & 0x7F
        return {0x080: "EMCY", 0x180: "TPDO 1", 0x200: "RPDO 1"}[function], node_id


@examples(500, least=50)
@given(steps=st.lists(_writes() | BOOTS, max_size=25))
@example(steps=[(PLAIN, 0x1A00, 1, 0x6041_0010, "confirmed"), (PLAIN, 0x1A00, 0, 1, "confirmed"), (PLAIN,)])
@example(steps=[MOVED, STORED, (PLAIN, 0x1014, 0, 0x191, "confirmed"), (PLAIN,)])
@example(steps=[MOVED, (PLAIN, STORE, 1, SIGNATURES[STORE], "read"), (PLAIN,)])
@example(steps=[MOVED, STORED, (PLAIN, RESTORE, 1, SIGNATURES[RESTORE], "confirmed"), (PLAIN,)])
def test_each_frame_is_of_the_service_that_has_its_can_id_at_that_moment(steps: list[Write | tuple[int]]) -> None:
    observer, now = Observer(lambda node_id: FILE if node_id == WITH_FILE else None), 0
    for number in range(len(steps) + 1):
        oracle = Oracle(steps[:number])
        for can_id in CAN_IDS:
            now += MILLISECOND
            meaning = observer.observe(Frame(can_id, bytes(2)), now).meaning
            assert (meaning.service, meaning.node_id) == oracle.owner(can_id), (hex(can_id), steps[:number])
        for text in frames_of(steps[number]) if number < len(steps) else ():
            now += MILLISECOND
            observer.observe(Frame.parse(text), now)


# ---- the view ----

SLOT = SECOND // 10
BY_NODES = ["185#0102", "585#6000200000000000", "085#1042090000000000", "085#0000000000000000", "185#R2", "305#01"]
STATES = ["705#00", "705#05", "705#7F", "705#04", "705#42", "706#05", "706#00"]
BY_THE_MASTER = ["080#", "080#07", "000#0100", "000#0205", "000#8106", "000#8000"]
HEARD = st.sampled_from([*BY_NODES, *STATES, *BY_THE_MASTER])
PAUSES = st.sampled_from([0, MILLISECOND, 10 * MILLISECOND, SLOT, SLOT + 1, 7 * SLOT, SECOND, 3 * SECOND])
TOLD = {1: NmtState.OPERATIONAL, 2: NmtState.STOPPED, 0x80: NmtState.PRE_OPERATIONAL, 0x81: NmtState.INITIALISING}
Heard = tuple[Time, Frame]


def in_the_second_before(heard: list[Heard], slot: int) -> tuple[int, int]:
    """Frames and bits of the ten slots before this one."""
    inside = [frame_bits(frame) for time, frame in heard if slot - 10 <= time // SLOT < slot]
    return len(inside), sum(inside)


def states_of(heard: list[Heard]) -> dict[int, tuple[int | None, bool, int]]:
    """Of each node that was heard: its state, whether it has said so itself, how often it has booted."""
    nodes: dict[int, tuple[int | None, bool, int]] = {}
    for _, frame in heard:
        node_id = frame.can_id & 0x7F
        if frame.can_id == 0:
            for each, (_, _, boots) in nodes.items():
                if frame.data[1] in (0, each):
                    nodes[each] = TOLD[frame.data[0]], False, boots
            if frame.data[1] and frame.data[1] not in nodes:
                nodes[frame.data[1]] = None, False, 0
        elif node_id:
            state, is_said, boots = nodes.get(node_id, (None, False, 0))
            if frame.can_id & 0x780 == 0x700:
                state = frame.data[0] or NmtState.PRE_OPERATIONAL
                is_said, boots = True, boots + (not frame.data[0])
            nodes[node_id] = state, is_said, boots
    return nodes


def errors_of(heard: list[Heard]) -> list[int]:
    """Of node 5: the codes of its errors that are present."""
    errors: list[int] = []
    for _, frame in heard:
        if frame.can_id == 0x705 and frame.data == b"\0":
            errors = []
        elif frame.can_id == 0x085:
            code = int.from_bytes(frame.data[:2], "little")
            errors = [*errors, *({code} - set(errors))] if frame.data[2] else []
    return errors


@examples(500, least=50)
@given(entries=st.lists(st.tuples(PAUSES, HEARD, st.sampled_from([0, 0, 0, 125_000, 1_000_000])), min_size=1, max_size=60))
def test_the_figures_of_a_bus_are_those_of_all_its_frames_at_the_bit_rate_of_the_moment(
    entries: list[tuple[Time, str, int]],
) -> None:
    observer, view, now = Observer(), BusView(bitrate=500_000), 0
    heard: list[Heard] = []
    for pause, text, bitrate in entries:
        now += pause
        view.bitrate = bitrate or view.bitrate
        heard.append((now, Frame.parse(text)))
        view.add(heard[-1][1], observer.observe(heard[-1][1], now), now)
        figures = view.figures(now)
        assert (figures.frames_per_second, figures.bits_per_second) == in_the_second_before(heard, now // SLOT)
        assert figures.load == figures.bits_per_second / view.bitrate
        assert figures.elapsed == now - heard[0][0]
        shown = {node.node_id: (node.state, node.is_said, node.booted) for node in figures.nodes}
        assert shown == states_of(heard)
        assert [code for node in figures.nodes if node.node_id == 5 for code in node.errors] == errors_of(heard)
        syncs = [time for time, frame in heard if frame.can_id == 0x080]
        apart = [second - first for first, second in pairwise(syncs)][-MAX_INTERVALS:]
        assert figures.syncs == len(syncs)
        assert (figures.sync is None) == (not apart)
        if figures.sync is not None:
            assert (figures.sync.number, figures.sync.least, figures.sync.most) == (len(apart), min(apart), max(apart))
    total = sum(frame_bits(frame) for _, frame in heard)
    if figures.elapsed:
        assert figures.mean_load == total * SECOND / (figures.elapsed * view.bitrate)
    peak = max(
        in_the_second_before(heard, time // SLOT + 1 if is_end else time // SLOT)[1] for time, _ in heard for is_end in (0, 1)
    )
    assert figures.peak is not None
    assert figures.peak * view.bitrate <= peak + 1e-6
