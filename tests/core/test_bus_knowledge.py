"""What a Network remembers of what it heard: from whom, by which service, and what was meant for somebody else."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.bus_knowledge import COPY_TIME, MAX_LATENESS, SLOTS, HeardService, NodeHeard
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtState
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoClient
from canopen_testing.strategies import frames, random_frames
from tests.builds import takes_any_type

TIMEOUT = 500 * MILLISECOND
STATUSWORD = "585#4B4160003702"


def heard_frames(*frames: str) -> Network:
    """A network to which no machine is attached, after these frames, one each millisecond from 1 ms on."""
    network = Network()
    for number, text in enumerate(frames, start=1):
        network.receive(Frame.parse(text), number * MILLISECOND)
    return network


def asking(node_id: int = 5) -> tuple[Network, SdoClient]:
    network = Network()
    client = SdoClient(network.out, node_id, timeout=TIMEOUT)
    network.attach(client)
    return network, client


def give_up(network: Network, client: SdoClient, now: Time) -> Time:
    """A request to which no answer comes in time; when that was."""
    client.upload(0x6041, 0, now)
    network.handle_timeout(now + TIMEOUT)
    network.drain(now + TIMEOUT)
    return now + TIMEOUT


# ---- frames ----


def test_nothing_was_heard() -> None:
    network = Network()
    assert network.last_heard is None
    assert network.heard_nodes() == ()
    assert network.heard(5) == NodeHeard(5, *[None] * 10)
    assert network.hears_all


@pytest.mark.parametrize(
    ("frame", "service", "state"),
    [
        ("705#05", HeardService.HEARTBEAT, NmtState.OPERATIONAL),
        ("705#04", HeardService.HEARTBEAT, NmtState.STOPPED),
        ("705#FF", HeardService.HEARTBEAT, NmtState.PRE_OPERATIONAL),  # an answer to node guarding, with its toggle bit
        ("705#00", HeardService.BOOT_UP, NmtState.PRE_OPERATIONAL),
        ("705#33", HeardService.HEARTBEAT, None),
        ("705#", HeardService.HEARTBEAT, None),
        ("085#1023810000000000", HeardService.EMCY, None),
        (STATUSWORD + "0000", HeardService.SDO, None),
    ],
)
def test_each_service_is_a_sign_of_life(frame: str, service: HeardService, state: NmtState | None) -> None:
    network = heard_frames("706#05", frame)
    heard = network.heard(5)
    assert (heard.time, heard.service, heard.state) == (2 * MILLISECOND, service, state)
    assert heard.state_time == (None if state is None else heard.time)
    assert network.heard_nodes() == (5, 6)
    assert network.last_heard == 2 * MILLISECOND


def test_the_last_sign_counts_and_the_others_are_kept() -> None:
    heard = heard_frames("705#7F", "085#1023", "085#0000", "705#05", STATUSWORD).heard(5)
    assert (heard.time, heard.service) == (5 * MILLISECOND, HeardService.SDO)
    assert (heard.state, heard.state_time) == (NmtState.OPERATIONAL, 4 * MILLISECOND)
    assert heard.emcy == (3 * MILLISECOND, 0)
    assert heard.answer is not None
    assert str(heard.answer.frame) == STATUSWORD
    assert heard.unasked_answer is None  # nobody here asks this node: whose answer it is cannot be told


def test_a_pdo_may_be_anybodys_and_makes_nobody_present() -> None:
    network = heard_frames("185#0102", "385#03", "285#04")
    heard = network.heard(5)
    assert heard.time is None
    assert heard.pdo == (3 * MILLISECOND, Frame.parse("285#04"))
    assert network.heard_nodes() == ()
    assert network.last_heard == 3 * MILLISECOND


def test_what_has_no_node_id_is_nobodys() -> None:
    network = heard_frames("000#0100", "080#", "100#000000000000", "600#", "700#05", "7E5#", "225#01")
    assert network.heard_nodes() == ()
    assert network.last_heard == 7 * MILLISECOND


@pytest.mark.parametrize("frame", ["705#R1", "00000705#05", "1FFFFFFF#"])
def test_remote_frames_and_29_bits_only_say_that_the_bus_lives(frame: str) -> None:
    network = heard_frames(frame)
    assert network.heard_nodes() == ()
    assert network.last_heard == MILLISECOND


def test_what_a_machine_wanted_is_remembered_too() -> None:
    network = Network()
    network.attach(RemoteNode(network.out, 5, ObjectDictionary([])))
    network.receive(Frame.parse("705#05"), 7)
    assert network.heard(5).state is NmtState.OPERATIONAL


def test_a_clock_that_runs_back_makes_nothing_older() -> None:
    network = heard_frames("706#05", "705#05")
    network.receive(Frame.parse("706#05"), 0)
    assert network.heard(6).time == 2 * MILLISECOND


def test_a_driver_that_filters_says_so() -> None:
    network = Network()
    network.hears_all = False
    assert not network.hears_all


@takes_any_type
@pytest.mark.parametrize("node_id", [0, 128, True, "5"])
def test_a_node_id_that_is_none_is_refused(node_id: int) -> None:
    with pytest.raises(LocalProtocolError, match="node-ID"):
        Network().heard(node_id)


# ---- requests and answers ----


def test_requests_of_another_client() -> None:
    network, _ = asking()
    network.receive(Frame.parse("605#4000100000000000"), MILLISECOND)
    heard = network.heard(5)
    assert heard.foreign_request == (MILLISECOND, Frame.parse("605#4000100000000000"))
    assert heard.time is None  # that somebody asks it is no sign of it


def test_an_answer_that_nobody_here_asked_for() -> None:
    network, _ = asking()
    network.receive(Frame.parse("585#4300100092010200"), 3)
    heard = network.heard(5)
    assert heard.unasked_answer == (3, Frame.parse("585#4300100092010200"))
    assert heard.answer == heard.unasked_answer
    assert heard.late_answer is None


def test_an_answer_to_our_own_request_is_no_news() -> None:
    network, client = asking()
    client.upload(0x1000, 0, 0)
    network.receive(Frame.parse("585#4300100092010200"), 3)
    assert network.heard(5).answer is not None
    assert network.heard(5).unasked_answer is None


@pytest.mark.parametrize(("later", "unasked"), [(0, False), (COPY_TIME, False), (COPY_TIME + 1, True)])
def test_a_second_copy_of_an_answer_is_nobody_elses(later: Time, unasked: bool) -> None:
    network, client = asking()
    client.upload(0x1000, 0, 0)
    for now in (MILLISECOND, MILLISECOND + later):
        network.receive(Frame.parse("585#4300100092010200"), now)
    assert (network.heard(5).unasked_answer is not None) is unasked


OTHER_TYPE = "585#4300100000000000"


def test_a_second_answer_with_another_value_is_of_a_second_device() -> None:
    network, client = asking()
    client.upload(0x1000, 0, 0)
    network.receive(Frame.parse("585#4300100092010200"), 3)
    client.upload(0x1018, 1, 4)
    network.receive(Frame.parse(OTHER_TYPE), 5)
    assert network.heard(5).second_answer == (5, Frame.parse(OTHER_TYPE))


@pytest.mark.parametrize("between", ["605#4000100000000000", "585#4B41600037020000", "585#8000100000000206"])
def test_another_clients_request_or_another_object_makes_no_second_device(between: str) -> None:
    network, client = asking()
    client.upload(0x1000, 0, 0)
    for now, frame in enumerate(("585#4300100092010200", "585#4300100092010200", between, OTHER_TYPE), 3):
        network.receive(Frame.parse(frame), now)
    assert network.heard(5).second_answer is None


def test_where_frames_are_filtered_a_second_answer_proves_nothing() -> None:
    network, client = asking()
    network.hears_all = False
    client.upload(0x1000, 0, 0)
    for now, frame in enumerate(("585#4300100092010200", OTHER_TYPE), 3):
        network.receive(Frame.parse(frame), now)
    assert network.heard(5).second_answer is None


@pytest.mark.parametrize("answer", ["585#4B41600037020000", "585#8041600000000206", "585#0041600037020000"])
def test_an_answer_that_came_too_late(answer: str) -> None:
    network, client = asking()
    given_up = give_up(network, client, 0)
    network.receive(Frame.parse(answer), given_up + 240 * MILLISECOND)
    heard = network.heard(5)
    assert heard.late_answer == (given_up + 240 * MILLISECOND, 240 * MILLISECOND)
    assert heard.unasked_answer is None


def test_one_request_has_one_late_answer() -> None:
    network, client = asking()
    given_up = give_up(network, client, 0)
    for number in (1, 2):
        network.receive(Frame.parse("585#4B41600037020000"), given_up + number * 100 * MILLISECOND)
    heard = network.heard(5)
    assert heard.late_answer is not None
    assert heard.late_answer.behind == 100 * MILLISECOND
    assert heard.unasked_answer is not None
    assert heard.unasked_answer.time == given_up + 200 * MILLISECOND


@pytest.mark.parametrize(("answer", "behind"), [("585#4300100092010200", 1), ("585#4B41600037020000", MAX_LATENESS + 1)])
def test_an_answer_about_something_else_or_long_after_is_not_ours(answer: str, behind: Time) -> None:
    network, client = asking()
    network.receive(Frame.parse(answer), give_up(network, client, 0) + behind)
    assert network.heard(5).late_answer is None
    assert network.heard(5).unasked_answer is not None


def test_a_cancelled_request_was_not_given_up_for_silence() -> None:
    network, client = asking()
    client.cancel(client.upload(0x6041, 0, 0), MILLISECOND)
    network.receive(Frame.parse("585#4B41600037020000"), 2 * MILLISECOND)
    assert network.heard(5).late_answer is None


@pytest.mark.parametrize("frame", ["585#", "185#", "605#"])
def test_other_frames_that_a_machine_ignores_are_no_answers(frame: str) -> None:
    network = Network()
    can_id = Frame.parse(frame).key
    network.attach(SdoClient(network.out, 5, request_key=0x7F0, response_key=can_id))
    network.receive(Frame.parse(frame), 1)
    assert network.drain(1)[1]
    assert network.heard(5).unasked_answer is None


# ---- any bus ----


@given(st.lists(frames() | random_frames(), max_size=60))
@example([Frame.parse("085#3081110000000000"), Frame.parse("085#")])
@example([Frame.parse("085#10")])
@example([Frame.parse("705#05"), Frame.parse("705#80")])
def test_whatever_is_heard(frames: list[Frame]) -> None:
    network = Network()
    for node_id in (1, 5):
        network.attach(RemoteNode(network.out, node_id, ObjectDictionary([])))
    for now, frame in enumerate(frames):
        network.receive(frame, now)
    plain = {frame.can_id for frame in frames if not frame.flags}
    present = {can_id & 0x7F for can_id in plain if can_id & 0x7F and can_id & 0x780 in (0x080, 0x580, 0x700) and can_id < 0x780}
    assert set(network.heard_nodes()) == present
    assert network.last_heard == (len(frames) - 1 if frames else None)
    for node_id in range(1, 128):
        heard = network.heard(node_id)
        assert (heard.time is None) == (heard.service is None) == (node_id not in present)
        assert (heard.state is None) == (heard.state_time is None)
        of_node = {base: [each for each in frames if each.key == base + node_id] for base in (0x080, 0x700)}
        emergency, control = (of_node[base][-1].data if of_node[base] else b"" for base in (0x080, 0x700))
        said = int.from_bytes(emergency[:2], "little") if len(emergency) >= 2 else None  # a code is no code by half
        assert (None if heard.emcy is None else heard.emcy.error_code) == said
        states = {0: 127, 4: 4, 5: 5, 127: 127}
        assert heard.state == (states.get(control[0] & 0x7F) if len(control) == 1 else None)
    assert len(network._knowledge.times) == SLOTS


def test_it_stays_bounded() -> None:
    network, client = asking()
    for number in range(50):
        give_up(network, client, number * 2 * SECOND)
        network.receive(Frame(0x585, bytes((0x4B, 0x41, 0x60, 0, number, 0, 0, 0))), number * 2 * SECOND + SECOND)
    knowledge = network._knowledge
    assert (len(knowledge.times), len(knowledge.frames), len(knowledge._late)) == (SLOTS, SLOTS, 1)
