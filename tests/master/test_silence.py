"""Why nobody answered: what was heard picks the cause and the next step."""

from __future__ import annotations

import pytest

from canopen_master import BusChanged, NodeSilentError, SdoTimeoutError, open_master
from canopen_master.silence import LONGER, SCAN, Diagnosis, missing_frame, sdo_silence
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster
from canopen_proto.remote_node import RemoteNode
from canopen_transports import BusState, open_transport
from tests.master.test_pump import Away
from tests.master.world import BUS, simulated, virtual_time

NOW = 100 * SECOND
PREOP = "canopen nmt preop 5    (a node that is Stopped answers again)"
TIMEOUT = 500 * MILLISECOND


class Desk:
    """A network that watches one node; `hear` is at a time before NOW."""

    def __init__(self, node_id: int = 5) -> None:
        self.network = Network()
        self.node = RemoteNode(self.network.out, node_id, ObjectDictionary([]), sdo_timeout=TIMEOUT)
        self.network.attach(self.node)

    def hear(self, frame: str, ago: Time = 120 * MILLISECOND) -> None:
        self.network.receive(Frame.parse(frame), NOW - ago)

    def sdo(self) -> Diagnosis:
        return sdo_silence(self.network, self.node, NOW)

    def pdo(self) -> Diagnosis:
        return missing_frame(self.network, self.node, NOW, "its cable is loose", ["look at it"], pdo=True)


def hearing(*frames: str) -> Desk:
    desk = Desk()
    for frame in frames:
        desk.hear(frame)
    return desk


# ---- a bus that is away ----


def test_the_bus_is_away() -> None:
    desk = hearing("705#05")
    desk.network.outage = "can0 is bus-off: transmit error counter 248"
    assert desk.sdo() == Diagnosis(
        "can0 is bus-off: transmit error counter 248",
        "neither the request nor an answer can pass",
        ("the same once the bus is back", "canopen doctor    (what does the adapter say?)"),
    )
    assert desk.pdo().seen == "can0 is bus-off: transmit error counter 248"


@virtual_time
async def test_an_error_about_silence_tells_that_the_bus_is_away() -> None:
    bus = Away()
    async with open_master(buses={"can0": bus}, sdo_timeout=0.1) as master:
        with master.events(BusChanged) as changes:
            bus.tell(BusState.DOWN)
            await changes.receive()
            with pytest.raises(SdoTimeoutError) as caught:
                await master.node(5).read("statusword")
            assert caught.value.seen == "can0 is down: the plug is down"
            bus.tell(BusState.UP)
            await changes.receive()
            with pytest.raises(SdoTimeoutError) as caught:
                await master.node(5).read("statusword")
            assert caught.value.seen == "nothing at all was heard on this bus"


# ---- a node that is alive ----


def test_stopped() -> None:
    known = hearing("705#04").sdo()
    assert known.seen == "node 5 was last heard 120 ms ago (heartbeat), NMT state STOPPED"
    assert known.cause == "Stopped: no SDO in that state"
    assert known.tries == ("canopen nmt preop 5",)


def test_stopped_by_ourselves() -> None:
    desk = Desk()
    desk.hear("585#4300100092010200", SECOND)
    nmt = NmtMaster(desk.network.out)
    desk.network.attach(nmt)
    nmt.send(NmtCommand.STOP, 5, NOW - SECOND)
    desk.network.drain(NOW - SECOND)
    known = desk.sdo()
    assert "NMT state STOPPED by our command" in known.seen
    assert known.tries == ("canopen nmt preop 5",)
    nmt.send(NmtCommand.RESET_NODE, 5, NOW)
    desk.network.drain(NOW)
    assert desk.sdo().cause == "it was reset, and has not booted since"


@pytest.mark.parametrize(
    ("frame", "words", "cause", "pdo_cause"),
    [
        ("000#0205", "stop", "Stopped: no SDO in that state", "Stopped: no PDO in that state"),
        ("000#0200", "stop", "Stopped: no SDO in that state", "Stopped: no PDO in that state"),
        ("000#8005", "enter pre operational", "it is busy, or the answer was lost", "Pre-operational: no PDO in that state"),
        ("000#8105", "reset node", "it was reset, and has not booted since", "Initialising: no PDO in that state"),
        ("000#0105", "start", "it is busy, or the answer was lost", "its cable is loose"),
    ],
)
def test_commanded_by_another_master(frame: str, words: str, cause: str, pdo_cause: str) -> None:
    """A node without a heartbeat shows no state, and ours is the one that we commanded."""
    desk = Desk()
    nmt = NmtMaster(desk.network.out)
    desk.network.attach(nmt)
    nmt.send(NmtCommand.START, 5, NOW - SECOND)
    desk.network.drain(NOW - SECOND)
    desk.hear("085#0000000000000000", 500 * MILLISECOND)
    desk.hear(frame, 200 * MILLISECOND)
    for known in (desk.sdo(), desk.pdo()):
        assert "NMT state OPERATIONAL by our command" in known.seen
        assert f"; another master commanded it: NMT {words}, 200 ms ago" in known.seen
    assert (desk.sdo().cause, desk.pdo().cause) == (cause, pdo_cause)
    desk.hear("000#0206", 100 * MILLISECOND)  # for another node
    desk.hear("000#02", 100 * MILLISECOND)
    assert "another master" not in desk.sdo().seen
    desk.hear(frame, 50 * MILLISECOND)
    desk.hear("705#05", 20 * MILLISECOND)  # a heartbeat knows better
    assert (desk.sdo().cause, "another master" in desk.sdo().seen) == ("it is busy, or the answer was lost", False)
    desk.hear(frame, 10 * MILLISECOND)
    nmt.send(NmtCommand.STOP, 5, NOW)
    desk.network.drain(NOW)
    assert (desk.sdo().cause, "another master" in desk.sdo().seen) == ("Stopped: no SDO in that state", False)


def test_a_node_that_was_never_heard_and_was_stopped_by_another_master() -> None:
    known = hearing("706#05", "000#0205").sdo()
    assert known.seen.endswith("; another master commanded it: NMT stop, 120 ms ago")
    assert known.tries[-1] == PREOP


BUFFER = "the kernel's receive buffer for this socket was full"


def test_frames_that_were_lost_here_are_named_before_a_cable() -> None:
    for sign in ("705#05", "585#4300100092010200"):
        desk = Desk()
        desk.hear(sign, 3 * SECOND)
        desk.network.note_gap(12, BUFFER, NOW - SECOND)
        known = desk.sdo()
        assert known.seen.endswith(f"; received frames were lost here 1 s ago, 12 at least: {BUFFER}")
        assert known.cause.startswith("it may be among the frames that were lost here")
        assert desk.pdo().cause.endswith("was busy; or its cable is loose")
        desk.network.note_gap(12, BUFFER, NOW - 6 * SECOND)
        assert ("lost here" in desk.sdo().seen, "lost here" in desk.pdo().seen) == (False, False)
        assert desk.sdo().cause == "its power is off or its cable loose by now, or it is busy"
    stopped = hearing("705#04")
    stopped.network.note_gap(1, BUFFER, NOW)
    assert stopped.sdo().cause == "Stopped: no SDO in that state"
    nobody = hearing("706#05")
    nobody.network.note_gap(1, BUFFER, NOW)
    assert nobody.sdo().seen.endswith(f"received frames were lost here 0 ms ago, 1 at least: {BUFFER}")


def test_just_booted() -> None:
    known = hearing("705#00").sdo()
    assert "last heard 120 ms ago (boot-up), NMT state PRE_OPERATIONAL" in known.seen
    assert known.cause == "it has just started, and is not ready yet"


def test_a_boot_up_of_some_time_ago_explains_nothing() -> None:
    desk = Desk()
    desk.hear("705#00", 3 * SECOND)
    assert desk.sdo().cause == "its power is off or its cable loose by now, or it is busy"


def test_an_answer_that_came_too_late_tells_what_to_wait() -> None:
    desk = Desk()
    asked = NOW - SECOND
    desk.node.sdo.upload(0x6041, 0, asked)
    desk.network.handle_timeout(asked + TIMEOUT)
    desk.hear("585#4B41600037020000", ago=260 * MILLISECOND)
    known = desk.sdo()
    assert "it answered after 740 ms" in known.seen
    assert known.tries == (f"{LONGER}: 2 s",)


def test_an_answer_that_came_far_too_late() -> None:
    desk = Desk()
    desk.node.sdo.timeout = 14 * SECOND
    desk.node.sdo.upload(0x6041, 0, NOW - 20 * SECOND)
    desk.network.handle_timeout(NOW - 6 * SECOND)
    desk.hear("585#4B41600037020000", ago=SECOND)
    assert "it answered after 19 s" in desk.sdo().seen
    assert desk.sdo().tries == (LONGER,)


def test_another_client() -> None:
    known = hearing("705#05", "605#4000100000000000", "585#4300100092010200").sdo()
    assert "another client asked it 120 ms ago (0x605: read 1000:00" in known.seen
    assert "another SDO client talks to it" in known.cause


def test_answers_that_were_not_for_us() -> None:
    known = hearing("705#05", "585#4300100092010200").sdo()
    assert "answers seen on 0x585 that were not for us, the last 120 ms ago: read 1000:00" in known.seen
    assert "NMT state OPERATIONAL 120 ms ago" not in known.seen
    assert "two devices have node-ID 5" in known.cause
    assert "client" not in known.cause  # its requests would have been heard
    assert known.tries == ("take one of the two off the bus", SCAN)
    desk = hearing("705#05", "585#4300100092010200")
    desk.network.hears_all = False
    assert "another SDO client talks to it (its requests are filtered)" in desk.sdo().cause


def test_the_state_has_an_age_of_its_own() -> None:
    desk = Desk()
    desk.hear("705#05", 3 * SECOND)
    desk.hear("085#1023810000000000", 150 * MILLISECOND)
    seen = desk.sdo().seen
    assert seen.startswith("node 5 was last heard 150 ms ago (emergency), NMT state OPERATIONAL 3 s ago; emergency 0x2310 (")
    desk.hear("085#0000000000000000", 100 * MILLISECOND)
    assert "0x2310" not in desk.sdo().seen


@pytest.mark.parametrize(("ago", "text"), [(40 * SECOND, "40 s ago"), (90 * SECOND, "90 s ago")])
def test_a_node_that_was_heard_long_ago(ago: Time, text: str) -> None:
    desk = Desk()
    desk.hear("705#05", ago)
    known = desk.sdo()
    assert known.seen.startswith(f"node 5 was last heard {text} (heartbeat)")
    assert "power is off" in known.cause
    assert SCAN in known.tries


def test_its_own_pdos_are_a_sign_of_life_whatever_their_cob_id() -> None:
    desk = Desk()
    desk.node.heard_at[0x604100] = NOW - 20 * MILLISECOND
    assert desk.sdo().seen == "node 5 was last heard 20 ms ago (PDO)"
    desk.hear("705#05")
    assert desk.sdo().seen.startswith("node 5 was last heard 20 ms ago (PDO), NMT state OPERATIONAL 120 ms ago")


# ---- a node that is silent ----


def test_nothing_at_all() -> None:
    known = Desk().sdo()
    assert known.seen == "nothing at all was heard on this bus"
    assert "bit rate" in known.cause
    assert "wiring" in known.cause


@pytest.mark.parametrize(
    ("others", "text"),
    [
        ((6,), "only node 6 was heard"),
        ((6, 7), "only nodes 6 and 7 were heard"),
        (range(10, 19), "only nodes 10, 11, 12, 13, 14, 15, 16, 17 and 1 more were heard"),
    ],
)
def test_only_others(others: tuple[int, ...], text: str) -> None:
    known = hearing(*(f"{0x700 + node_id:03X}#05" for node_id in others)).sdo()
    assert known.seen == f"nothing was heard of it: {text}"
    assert known.cause == "no device has this node-ID, or its power is off; or it is Stopped and has no heartbeat"
    assert known.tries == ("check the node-ID 5 (0x05) and its power", SCAN, PREOP)


def test_a_lost_heartbeat_is_no_sign_of_life() -> None:
    desk = Desk()
    desk.node.heartbeat.set_timeout(1000 * MILLISECOND, NOW - 2 * SECOND)
    desk.hear("705#05", 1200 * MILLISECOND)
    desk.network.handle_timeout(NOW)
    known = desk.sdo()
    assert "alive" not in known.seen
    assert known.seen.startswith("its heartbeat is lost, node 5 was last heard 1.2 s ago (heartbeat)")
    assert known.cause.startswith("its power is off or its cable loose by now")
    desk.hear("705#05", 0)
    assert desk.sdo().seen.startswith("node 5 was last heard")


@pytest.mark.parametrize(
    ("age", "seen"), [(1900, "node 5 was last heard 1.9 s ago (heartbeat)"), (3000, "node 5 was last heard 3 s ago (heartbeat)")]
)
def test_a_frame_of_seconds_ago_is_no_sign_of_life(age: int, seen: str) -> None:
    desk = Desk()
    desk.hear("705#05", age * MILLISECOND)
    assert desk.sdo().seen.startswith(seen)
    assert desk.sdo().cause.startswith("its power is off") is (age > 2000)


def test_decimal_for_hexadecimal() -> None:
    desk = Desk(10)
    desk.hear("710#05")
    assert desk.sdo().cause.startswith("perhaps node 16 was meant, which is 0x10; or ")


def test_where_frames_are_filtered_nothing_is_said_of_others() -> None:
    for frames in ((), ("706#05",)):
        desk = hearing(*frames)
        desk.network.hears_all = False
        known = desk.sdo()
        assert "other nodes may be there" in known.seen
        assert "only" not in known.seen
        assert "bit rate" in known.cause


def test_frames_that_show_no_node() -> None:
    assert "frames were (120 ms ago), but none shows whose it is" in hearing("080#").sdo().seen


def test_a_pdo_that_may_be_its_own() -> None:
    known = hearing("185#01").sdo()
    assert known.seen == "nothing was heard of it but a PDO on 0x185 120 ms ago, which may be another node's"
    assert "no device has node-ID 5" in known.cause
    assert "another node's: only node 6 was heard" in hearing("185#01", "706#05").sdo().seen


def test_another_client_gets_no_answer_either() -> None:
    assert "another client asked it too, and got no answer" in hearing("605#4000100000000000").sdo().seen


# ---- other things that were waited for ----


@pytest.mark.parametrize(
    ("frames", "cause", "tries"),
    [
        (("705#05",), "its cable is loose", ("look at it",)),
        (("705#7F",), "Pre-operational: no PDO in that state", ("canopen nmt start 5",)),
        (("085#0000",), "its cable is loose", ("look at it",)),
    ],
)
def test_missing_pdos(frames: tuple[str, ...], cause: str, tries: tuple[str, ...]) -> None:
    known = hearing(*frames).pdo()
    assert (known.cause, known.tries) == (cause, tries)
    assert known.seen.startswith("node 5 was last heard")


def test_missing_pdos_of_nobody() -> None:
    assert Desk().pdo().seen == "nothing at all was heard on this bus"


def test_a_missing_heartbeat_is_no_proof_of_absence() -> None:
    desk = hearing("706#05")
    known = missing_frame(desk.network, desk.node, NOW, "it sends none", ["switch it on"], pdo=False)
    assert known.cause == "it sends none; or no device has this node-ID, or its power is off"
    assert known.tries == ("switch it on", "check the node-ID 5 (0x05) and its power", SCAN)
    desk.hear("585#4300100092010200")
    assert missing_frame(desk.network, desk.node, NOW, "it sends none", [], pdo=False).cause == "it sends none"


# ---- as the master tells it ----


@virtual_time
async def test_a_wrong_node_id_beside_two_others() -> None:
    async with simulated(6, 7), open_master(BUS) as master:
        for node_id in (6, 7):
            await master.node(node_id).read("statusword")
        with pytest.raises(SdoTimeoutError) as caught:
            await master.node(5).read("statusword")
        assert "only nodes 6 and 7 were heard" in caught.value.seen
        with pytest.raises(NodeSilentError) as silent:
            await master.node(5).wait_for_boot(0.5)
        assert "only nodes 6 and 7 were heard" in silent.value.seen


@virtual_time
async def test_a_slow_device() -> None:
    async with open_master(BUS, sdo_timeout=0.2) as master:
        device = await open_transport(BUS)
        with pytest.raises(SdoTimeoutError, match="nothing at all was heard"):
            await master.node(5).read("statusword")
        await device.send(Frame.parse("585#4B41600037020000"))
        with pytest.raises(SdoTimeoutError, match="it answered after 20. ms, too late"):
            await master.node(5).read("controlword")
        await device.aclose()
