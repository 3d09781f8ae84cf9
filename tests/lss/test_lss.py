"""LSS, the two machines: every service in every state, node-ID and bit rate three times, the exchanges of real stacks."""

from __future__ import annotations

import pytest

from canopen_proto.frame import Frame
from canopen_proto.lss.master import WINDOW, LssAnswerUnexpected, LssMaster, LssReply
from canopen_proto.lss.messages import (
    FROM_MASTER,
    FROM_SLAVE,
    STATES,
    UNCONFIGURED,
    LssAddress,
    LssConfiguration,
    LssService,
    LssState,
    text_of,
)
from canopen_proto.lss.slave import (
    STORE_TIMEOUT,
    LssBitRateSwitched,
    LssNodeIdSet,
    LssResetNeeded,
    LssSilenceBegan,
    LssSilenceEnded,
    LssSlave,
    LssStoreRequested,
)
from canopen_proto.machine import MILLISECOND, FrameIgnored, LocalProtocolError, Outbox
from canopen_proto.nmt import NmtCommand
from tests.core.bus import take_events, take_frames

ADDRESS = LssAddress(0x360, 2, 3, 4)


def slave(node_id: int = UNCONFIGURED, state: LssState = LssState.WAITING, address: LssAddress = ADDRESS) -> LssSlave:
    made = LssSlave(Outbox(), address, LssConfiguration(node_id, 125))
    if state is LssState.CONFIGURATION:
        ask(made, "0401")
    return made


def ask(device: LssSlave, *requests: str) -> str:
    """Send requests; return the answers to the last one, without the zeros at their end."""
    for request in requests:
        device.out.frames.clear()
        device.receive(Frame.parse(f"7E5#{request.ljust(16, '0')}"), 0)
    return " ".join(text.partition("#")[2] for text in take_frames(device.out))


SELECTION = ("4060030000", "4102000000", "4203000000", "4304000000")
RANGE = ("4660030000", "4702000000", "4800000000", "49FFFFFFFF", "4A00000000", "4BFFFFFFFF")

# The answer of an unconfigured slave to a request in a state that takes it; None: nothing.
TAKEN = {
    LssService.SWITCH_GLOBAL: ("0401", None),
    LssService.SELECT_VENDOR: (SELECTION[0], None),
    LssService.SELECT_PRODUCT: (SELECTION[1], None),
    LssService.SELECT_REVISION: (SELECTION[2], None),
    LssService.SELECT_SERIAL: (SELECTION[3], "44"),
    LssService.CONFIGURE_NODE_ID: ("1121", "11"),
    LssService.CONFIGURE_BIT_TIMING: ("130002", "13"),
    LssService.ACTIVATE_BIT_TIMING: ("156400", None),
    LssService.STORE: ("17", "17"),
    LssService.IDENTIFY_VENDOR: (RANGE[0], None),
    LssService.IDENTIFY_PRODUCT: (RANGE[1], None),
    LssService.IDENTIFY_REVISION_LOW: (RANGE[2], None),
    LssService.IDENTIFY_REVISION_HIGH: (RANGE[3], None),
    LssService.IDENTIFY_SERIAL_LOW: (RANGE[4], None),
    LssService.IDENTIFY_SERIAL_HIGH: (RANGE[5], "4F"),
    LssService.IDENTIFY_NON_CONFIGURED: ("4C", "50"),
    LssService.FASTSCAN: ("510000000080", "4F"),
    LssService.INQUIRE_VENDOR: ("5A", "5A6003"),
    LssService.INQUIRE_PRODUCT: ("5B", "5B02"),
    LssService.INQUIRE_REVISION: ("5C", "5C03"),
    LssService.INQUIRE_SERIAL: ("5D", "5D04"),
    LssService.INQUIRE_NODE_ID: ("5E", "5EFF"),
}
ANSWERS_ONLY = {LssService.SELECTED, LssService.IDENTIFIED, LssService.NON_CONFIGURED}


@pytest.mark.parametrize("state", list(LssState))
@pytest.mark.parametrize("service", list(LssService))
def test_every_service_in_every_state(service: LssService, state: LssState) -> None:
    device = slave(state=state)
    request, answer = TAKEN.get(service, (f"{service:02X}", None))
    before = (device.state, device.pending, device.is_silent)
    for group in (SELECTION, RANGE):
        if request in group:
            ask(device, *group[: group.index(request)])  # what has to come before
    heard = ask(device, request)
    if service is LssService.STORE and state is LssState.CONFIGURATION:
        device.complete_store(0, 0)
        (heard,) = (text.partition("#")[2] for text in take_frames(device.out))
    taken = state in STATES.get(service, ())
    assert heard == (answer.ljust(16, "0") if taken and answer else "")
    if not taken:
        assert (device.state, device.pending, device.is_silent) == before
        assert service in ANSWERS_ONLY or len(STATES[service]) == 1


def test_unknown_command_specifiers_are_silent_in_both_states() -> None:
    for state in LssState:
        device = slave(state=state)
        for number in set(range(256)) - set(LssService):
            assert ask(device, f"{number:02X}") == ""
        assert (device.state, take_events(device.out)) == (state, [])


def test_a_frame_of_seven_bytes_is_ignored() -> None:
    device = slave(state=LssState.CONFIGURATION)
    device.receive(Frame.parse("7E5#5E000000000000"), 0)
    assert take_frames(device.out) == []
    (ignored,) = take_events(device.out)
    assert isinstance(ignored, FrameIgnored)


# ---- the exchanges that were recorded with Lely's slave, and with CANopenNode's ----


def test_selection_by_address() -> None:
    device = slave()
    assert [ask(device, each) for each in SELECTION] == ["", "", "", "4400000000000000"]
    assert device.state is LssState.CONFIGURATION
    device = slave()
    assert ask(device, *SELECTION[:3], "4309000000") == ""
    assert ask(device, "5E") == ""  # it was not selected


@pytest.mark.parametrize(
    "frames",
    [
        SELECTION[::-1],
        (SELECTION[0], SELECTION[2], SELECTION[1], SELECTION[3]),
        (SELECTION[0], *SELECTION[2:]),
        (SELECTION[0], "41FF000000", *SELECTION[1:]),
        SELECTION[3:],
        (*SELECTION[:3], "0400", SELECTION[3]),
    ],
)
def test_numbers_out_of_order_select_nobody(frames: tuple[str, ...]) -> None:
    device = slave(address=LssAddress(0x360, 2, 3, 4))
    ask(device, *frames)
    assert device.state is LssState.WAITING


def test_an_address_of_zeros_is_not_selected_by_its_serial_number_alone() -> None:
    device = slave(address=LssAddress(0, 0, 0, 0))
    assert ask(device, "43") == ""
    assert ask(device, "40", "41", "42", "43") == "4400000000000000"


@pytest.mark.parametrize("number", [0x00, 0x80, 0xC8, 0xFE])
def test_impossible_node_ids_are_refused(number: int) -> None:
    device = slave(state=LssState.CONFIGURATION)
    assert ask(device, f"11{number:02X}") == "1101000000000000"
    assert device.pending.node_id == UNCONFIGURED


@pytest.mark.parametrize("entry", ["0005", "0009", "000A", "8002", "0102"])
def test_bit_timings_that_do_not_exist_are_refused(entry: str) -> None:
    device = slave(state=LssState.CONFIGURATION)
    assert ask(device, f"13{entry}") == "1301000000000000"
    assert device.pending.bit_rate == 125


def test_a_bit_rate_that_the_device_does_not_have_is_refused() -> None:
    device = LssSlave(Outbox(), ADDRESS, bit_rates=(125, 250))
    assert ask(device, "0401", "130000") == "1301000000000000"
    assert ask(device, "130003") == "1300000000000000"


def test_ranges_of_addresses_are_inclusive() -> None:
    device = slave()
    assert ask(device, *RANGE) == "4F00000000000000"
    assert ask(device, *RANGE[:4], "4A05000000", RANGE[5]) == ""
    assert ask(device, *RANGE[:2], "4803", "4903", "4A04", "4B04") == "4F00000000000000"
    assert ask(device, *RANGE[:2], "4804", "4904", "4A04", "4B04") == ""
    assert ask(device, *RANGE[:1], "4703", *RANGE[2:]) == ""
    assert ask(slave(5, LssState.CONFIGURATION), *RANGE) == "4F00000000000000"  # in both states, with a node-ID too


def test_only_devices_without_a_node_id_say_so() -> None:
    assert ask(slave(), "4C") == "5000000000000000"
    assert ask(slave(5), "4C") == ""


def test_fastscan_positions() -> None:
    device = slave()
    assert ask(device, "510000000080") == "4F00000000000000"
    assert ask(device, "51000000001F0000") == "4F00000000000000"
    assert ask(device, "51000000001F0202") == ""  # another number than its position
    assert ask(device, "5160030000000001") == "4F00000000000000"
    assert ask(device, "5160030000000001") == ""  # the position is 1 now
    assert ask(device, "5100000000200101") == ""  # there is no bit 32
    assert ask(device, "5102000000000102", "5103000000000203", "5104000000000300") == "4F00000000000000"
    assert device.state is LssState.CONFIGURATION


@pytest.mark.parametrize("node_id", [UNCONFIGURED, 7])
def test_fastscan_is_for_those_without_a_node_id_active_or_pending(node_id: int) -> None:
    device = slave(node_id)
    ask(device, "0401", "1122" if node_id == UNCONFIGURED else "11FF", "0400")
    assert ask(device, "510000000080") == ""


# ---- persistent, pending, active ----


def test_a_node_keeps_its_id_until_reset_communication() -> None:
    device = slave(5, LssState.CONFIGURATION)
    assert ask(device, "1121") == "1100000000000000"
    assert ask(device, "5E") == "5E05000000000000"
    assert take_events(device.out) == [LssNodeIdSet(5, 0x21)]
    ask(device, "0400")
    assert take_events(device.out) == []  # it does not reset itself: it is in use
    device.reset(NmtCommand.RESET_COMMUNICATION, 0)
    assert (device.active.node_id, device.persistent.node_id, device.state) == (0x21, 5, LssState.WAITING)
    device.reset(NmtCommand.RESET_NODE, 0)
    assert device.active.node_id == 5  # it was not stored


def test_a_node_that_lost_its_id_goes_at_reset_communication() -> None:
    device = slave(5, LssState.CONFIGURATION)
    assert ask(device, "11FF") == "1100000000000000"
    assert (device.is_configured, device.node_id) == (True, 5)
    device.reset(NmtCommand.RESET_COMMUNICATION, 0)
    assert (device.is_configured, device.node_id) == (False, 0)


def test_the_first_node_id_needs_a_reset_when_configuration_is_left() -> None:
    device = slave(state=LssState.CONFIGURATION)
    ask(device, "1121")
    take_events(device.out)
    ask(device, "0401")
    assert take_events(device.out) == []
    ask(device, "0400")
    assert take_events(device.out) == [LssResetNeeded(0)]
    ask(slave(), "0400")
    assert take_events(device.out) == []


def test_leaving_without_a_node_id_needs_no_reset() -> None:
    device = slave(state=LssState.CONFIGURATION)
    ask(device, "1121", "11FF", "0400")
    assert LssResetNeeded(0) not in take_events(device.out)


@pytest.mark.parametrize(("error", "answer"), [(0, "17"), (2, "1702"), (0xFF, "17FF07")])
def test_the_host_stores(error: int, answer: str) -> None:
    device = slave(state=LssState.CONFIGURATION)
    assert ask(device, "1121", "17") == ""
    assert take_events(device.out)[-1] == LssStoreRequested(0, LssConfiguration(0x21, 125))
    assert ask(device, "5E") == ""  # one request at a time
    device.complete_store(error, 0, 7 if error == 0xFF else 0)
    assert take_frames(device.out) == [f"7E4#{answer.ljust(16, '0')}"]
    assert device.persistent.node_id == (0x21 if error == 0 else UNCONFIGURED)
    device.complete_store(0, 0)  # late: nothing
    assert take_frames(device.out) == []


def test_a_host_that_does_not_answer_has_failed_to_store() -> None:
    device = slave(state=LssState.CONFIGURATION)
    ask(device, "17")
    device.handle_timeout(STORE_TIMEOUT - 1)
    assert take_frames(device.out) == []
    device.handle_timeout(STORE_TIMEOUT)
    assert take_frames(device.out) == ["7E4#1702000000000000"]


def test_a_device_without_storage_says_so() -> None:
    device = LssSlave(Outbox(), ADDRESS, can_store=False)
    assert ask(device, "0401", "17") == "1701000000000000"


def test_the_two_delays_of_a_new_bit_rate() -> None:
    device = slave(5, LssState.CONFIGURATION)
    assert ask(device, "130002") == "1300000000000000"
    assert device.active.bit_rate == 125
    assert ask(device, "156400") == ""
    assert take_events(device.out) == [LssSilenceBegan(5, 500, 100 * MILLISECOND)]
    assert ask(device, "5E") == ""
    assert device.deadline == 100 * MILLISECOND
    device.handle_timeout(130 * MILLISECOND)  # a late driver
    assert take_events(device.out) == [LssBitRateSwitched(5, 500)]
    assert (device.active.bit_rate, ask(device, "5E"), device.deadline) == (500, "", 200 * MILLISECOND)
    device.handle_timeout(200 * MILLISECOND)
    assert take_events(device.out) == [LssSilenceEnded(5)]
    assert ask(device, "5E") == "5E05000000000000"


def test_a_slave_refuses_a_stored_node_id_that_is_none() -> None:
    with pytest.raises(LocalProtocolError, match="128"):
        LssSlave(Outbox(), ADDRESS, LssConfiguration(128))
    with pytest.raises(LocalProtocolError, match="0 is outside"):
        slave().load(LssConfiguration(0))


# ---- the master ----


def master() -> LssMaster:
    made = LssMaster(Outbox())
    made.frame_gap = 0
    return made


def replies(device: LssMaster, *answers: str, end: int = WINDOW) -> LssReply:
    for text in answers:
        device.receive(Frame.parse(f"7E4#{text.ljust(16, '0')}"), 2 * MILLISECOND)
    device.handle_timeout(end)
    (reply,) = take_events(device.out)
    assert isinstance(reply, LssReply)
    return reply


def test_the_masters_frames() -> None:
    device = master()
    device.switch_global(LssState.CONFIGURATION, 0)
    device.activate_bit_timing(100 * MILLISECOND, 0)
    assert take_frames(device.out) == ["7E5#0401000000000000", "7E5#1564000000000000"]
    for command, frame in (
        (lambda: device.configure_node_id(0x21, 0), "1121"),
        (lambda: device.configure_bit_timing(2, 0), "130002"),
        (lambda: device.store(0, window=WINDOW), "17"),
        (lambda: device.inquire(LssService.INQUIRE_SERIAL, 0), "5D"),
        (lambda: device.identify_non_configured(0), "4C"),
        (lambda: device.fastscan(0x12345678, 31, 2, 3, 0), "51785634121F0203"),
    ):
        command()
        assert take_frames(device.out) == [f"7E5#{frame.ljust(16, '0')}"]
        assert replies(device).answers == ()


def test_frames_of_one_command_have_a_gap_and_one_outcome() -> None:
    device = LssMaster(Outbox())
    request_id = device.select(ADDRESS, 0)
    sent = take_frames(device.out)
    for number in (1, 2, 3):
        device.handle_timeout(number * MILLISECOND)
        sent += take_frames(device.out)
    assert sent == [f"7E5#{each.ljust(16, '0')}" for each in SELECTION]
    reply = replies(device, "44", end=3 * MILLISECOND + WINDOW)
    assert (reply.request_id, reply.service, reply.count) == (request_id, LssService.SELECTED, 1)


def test_a_master_waits_the_whole_window_or_a_guard_time_after_an_answer() -> None:
    device = master()
    device.identify_non_configured(0)
    assert device.deadline == WINDOW
    device.receive(Frame.parse("7E4#5000000000000000"), 2 * MILLISECOND)
    assert device.deadline == WINDOW
    assert replies(device, "50").count == 2
    device.identify_non_configured(WINDOW, guard=5 * MILLISECOND)
    device.receive(Frame.parse("7E4#5000000000000000"), WINDOW + 2 * MILLISECOND)
    assert device.deadline == WINDOW + 7 * MILLISECOND
    device.receive(Frame.parse("7E4#5000000000000000"), 2 * WINDOW - 1)
    assert device.deadline == 2 * WINDOW  # never beyond the window


def test_answers_that_nobody_waits_for() -> None:
    device = master()
    late = Frame.parse("7E4#4F00000000000000")
    device.receive(late, 0)
    device.inquire(LssService.INQUIRE_NODE_ID, 0)
    device.receive(late, 0)
    device.receive(Frame.parse("7E4#5E"), 0)
    first, second, short = take_events(device.out)
    assert first == second == LssAnswerUnexpected(0, late)
    assert isinstance(short, FrameIgnored)
    assert replies(device, "5E05").answers == (bytes.fromhex("5E05000000000000"),)


def test_a_busy_master_and_impossible_arguments_raise_and_change_nothing() -> None:
    device = master()
    for wrong in (
        lambda: device.configure_node_id(0, 0),
        lambda: device.configure_bit_timing(256, 0),
        lambda: device.activate_bit_timing(MILLISECOND + 1, 0),
        lambda: device.activate_bit_timing(65_536 * MILLISECOND, 0),
        lambda: device.select(LssAddress(1 << 32, 0, 0, 0), 0),
        lambda: device.fastscan(-1, 0, 0, 0, 0),
        lambda: device.inquire(LssService.STORE, 0),
    ):
        with pytest.raises(LocalProtocolError):
            wrong()
        assert not device.is_busy
    device.store(0)
    take_frames(device.out)
    with pytest.raises(LocalProtocolError, match="waiting for answers"):
        device.store(0)
    assert take_frames(device.out) == []


def test_a_command_can_be_given_up() -> None:
    device = LssMaster(Outbox())
    request_id = device.select(ADDRESS, 0)
    assert device.cancel(request_id, 0)
    assert not device.cancel(request_id, 0)
    assert take_events(device.out) == [LssReply(0, request_id, LssService.SELECTED, (), 0, 0)]
    device.handle_timeout(MILLISECOND)
    assert take_frames(device.out) == ["7E5#4060030000000000"]
    assert [*device.can_ids(), *slave().can_ids()] == [FROM_SLAVE, FROM_MASTER, FROM_MASTER]


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        ("7E5#0401000000000000", "all slaves: configuration"),
        ("7E5#0407000000000000", "all slaves: state 7"),
        ("7E5#1121000000000000", "node-ID becomes 33"),
        ("7E5#11FF000000000000", "node-ID becomes none (unconfigured)"),
        ("7E4#1101000000000000", "slave: configure node-ID: node-ID out of range"),
        ("7E4#1100000000000000", "slave: configure node-ID: done"),
        ("7E5#1300020000000000", "bit rate becomes 500 kbit/s"),
        ("7E5#1300090000000000", "bit rate becomes automatic"),
        ("7E5#1380020000000000", "bit rate becomes entry 2 of table 128"),
        ("7E4#13FF010000000000", "slave: configure bit timing: the maker's own error 1"),
        ("7E5#1564000000000000", "switch to the new bit rate after 100 ms, and again so long silence"),
        ("7E5#1700000000000000", "store node-ID and bit rate"),
        ("7E4#1702000000000000", "slave: store: access to the storage failed"),
        ("7E5#4060030000000000", "select vendor 0x00000360"),
        ("7E4#4400000000000000", "slave: I am selected"),
        ("7E5#49FFFFFFFF000000", "identify revision high 0xFFFFFFFF"),
        ("7E4#4F00000000000000", "slave: yes"),
        ("7E5#4C00000000000000", "who has no node-ID?"),
        ("7E4#5000000000000000", "slave: I have no node-ID"),
        ("7E5#5100000000800000", "fastscan begins: who has no node-ID?"),
        ("7E5#51000000801F0000", "fastscan: is the vendor-ID 0x80000000 down to bit 31?"),
        ("7E5#5104000000000300", "fastscan: is the serial number 0x00000004?"),
        ("7E5#5D00000000000000", "inquire serial?"),
        ("7E4#5D04000000000000", "slave: serial 0x00000004"),
        ("7E4#5EFF000000000000", "slave: node-ID none (unconfigured)"),
        ("7E5#99", "master: 99"),
        ("7E4#", "slave: no data"),
        ("7E4#0400000000000000", "slave: 04 00 00 00 00 00 00 00"),
    ],
)
def test_frames_in_words(frame: str, text: str) -> None:
    assert text_of(Frame.parse(frame)) == text
