"""NMT master and slave: the table, the frames, and master + slave + heartbeat against a small model."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from canopen_proto.frame import Frame
from canopen_proto.heartbeat import (
    HeartbeatConsumer,
    HeartbeatLost,
    HeartbeatProducer,
    HeartbeatReceived,
    HeartbeatRecovered,
    HeartbeatsSkipped,
    NmtStateReported,
    NodeBooted,
)
from canopen_proto.machine import MILLISECOND, NEVER, Event, FrameIgnored, LocalProtocolError, Outbox
from canopen_proto.nmt import (
    ALL_NODES,
    SERVICES,
    STATE_OF_BYTE,
    TRANSITIONS,
    NmtCommand,
    NmtCommandSent,
    NmtMaster,
    NmtResetRequested,
    NmtSlave,
    NmtState,
    NmtStateChanged,
    Service,
    target_of,
)

INITIALISING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = (
    NmtState.INITIALISING,
    NmtState.STOPPED,
    NmtState.OPERATIONAL,
    NmtState.PRE_OPERATIONAL,
)
ON_THE_BUS = (PRE_OPERATIONAL, OPERATIONAL, STOPPED)
WAY_TO = {
    PRE_OPERATIONAL: NmtCommand.ENTER_PRE_OPERATIONAL,
    OPERATIONAL: NmtCommand.START,
    STOPPED: NmtCommand.STOP,
}


def take(out: Outbox) -> tuple[list[str], list[Event]]:
    frames, events = [str(frame) for frame in out.frames], list(out.events)
    out.frames.clear()
    out.events.clear()
    return frames, events


def slave_in(state: NmtState, node_id: int = 5) -> NmtSlave:
    slave = NmtSlave(Outbox(), node_id)
    if state is not INITIALISING:
        slave.boot(0)
        slave.execute(WAY_TO[state], 0)
    take(slave.out)
    assert slave.state is state
    return slave


# master


@pytest.mark.parametrize(
    ("command", "name", "text"),
    [
        (NmtCommand.START, "start", "000#010C"),
        (NmtCommand.STOP, "stop", "000#020C"),
        (NmtCommand.ENTER_PRE_OPERATIONAL, "enter_pre_operational", "000#800C"),
        (NmtCommand.RESET_NODE, "reset_node", "000#810C"),
        (NmtCommand.RESET_COMMUNICATION, "reset_communication", "000#820C"),
    ],
)
def test_master_sends_each_command_to_one_node_and_to_all(command: NmtCommand, name: str, text: str) -> None:
    master = NmtMaster(Outbox())
    getattr(master, name)(12, 0)
    assert take(master.out) == ([text], [NmtCommandSent(12, command)])
    getattr(master, name)(ALL_NODES, 0)
    assert take(master.out) == ([text[:-2] + "00"], [NmtCommandSent(0, command)])
    assert list(master.can_ids()) == []
    assert master.deadline == NEVER


@pytest.mark.parametrize("node_id", [-1, 128, 200])
def test_master_refuses_other_node_ids_and_sends_nothing(node_id: int) -> None:
    master = NmtMaster(Outbox())
    with pytest.raises(LocalProtocolError, match=f"START: node-ID {node_id} is outside"):
        master.start(node_id, 0)
    assert take(master.out) == ([], [])


# the tables


def test_every_command_is_in_the_table_for_every_state_on_the_bus() -> None:
    assert set(TRANSITIONS) == set(itertools.product(ON_THE_BUS, NmtCommand))
    assert all(TRANSITIONS[state, command] is target_of(command) for state, command in TRANSITIONS)


@pytest.mark.parametrize("state", ON_THE_BUS)
@pytest.mark.parametrize("command", NmtCommand)
def test_slave_follows_the_table(state: NmtState, command: NmtCommand) -> None:
    slave = slave_in(state)
    target = TRANSITIONS[state, command]
    slave.receive(Frame.parse(f"000#{command:02X}05"), 7)
    assert slave.state is target
    expected: list[Event] = [] if target is state else [NmtStateChanged(5, state, target)]
    if target is INITIALISING:
        expected.append(NmtResetRequested(5, command))
    assert take(slave.out) == ([], expected)


# CiA 301 v4.2.0, 7.3.2.2.5: the table as it is printed, services by line
SERVICE_TABLE = {
    Service.BOOT_UP: {INITIALISING},
    Service.PDO: {OPERATIONAL},
    Service.SDO: {PRE_OPERATIONAL, OPERATIONAL},
    Service.SYNC: {PRE_OPERATIONAL, OPERATIONAL},
    Service.TIME: {PRE_OPERATIONAL, OPERATIONAL},
    Service.EMCY: {PRE_OPERATIONAL, OPERATIONAL},
    Service.NMT: {PRE_OPERATIONAL, OPERATIONAL, STOPPED},
    Service.ERROR_CONTROL: {PRE_OPERATIONAL, OPERATIONAL, STOPPED},
}


@pytest.mark.parametrize("state", NmtState)
@pytest.mark.parametrize("service", Service)
def test_services_by_state(state: NmtState, service: Service) -> None:
    assert (service in SERVICES[state]) == (state in SERVICE_TABLE[service])
    assert slave_in(state).allows(service) == (state in SERVICE_TABLE[service])


def test_state_of_byte_masks_the_toggle_bit_and_knows_four_states() -> None:
    named = {byte: state for byte, state in enumerate(STATE_OF_BYTE) if state is not None}
    assert named == {byte + toggle: state for state in NmtState for byte in [int(state)] for toggle in (0, 0x80)}


# slave


def test_slave_boots_once_with_the_boot_up_frame() -> None:
    slave = NmtSlave(Outbox(), 5)
    assert slave.state is INITIALISING
    assert list(slave.can_ids()) == [0x000]
    slave.boot(0)
    assert take(slave.out) == (["705#00"], [NmtStateChanged(5, INITIALISING, PRE_OPERATIONAL)])
    with pytest.raises(LocalProtocolError, match="boot of node 5: it is PRE_OPERATIONAL"):
        slave.boot(0)
    assert take(slave.out) == ([], [])


@pytest.mark.parametrize("command", [NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION])
def test_reset_is_a_request_to_the_node_which_then_boots(command: NmtCommand) -> None:
    slave = slave_in(OPERATIONAL)
    slave.receive(Frame.parse(f"000#{command:02X}00"), 0)
    assert take(slave.out) == ([], [NmtStateChanged(5, OPERATIONAL, INITIALISING), NmtResetRequested(5, command)])
    for text in ("000#0105", "000#01", "000#5000"):  # not on the bus
        slave.receive(Frame.parse(text), 1)
    assert take(slave.out) == ([], [])
    slave.boot(2)
    assert take(slave.out) == (["705#00"], [NmtStateChanged(5, INITIALISING, PRE_OPERATIONAL)])


def test_slave_obeys_commands_to_all_and_not_those_to_others() -> None:
    slave = slave_in(PRE_OPERATIONAL)
    for text in ("000#0106", "000#0285", "000#5506", "000#01FF"):
        slave.receive(Frame.parse(text), 0)
    assert (slave.state, take(slave.out)) == (PRE_OPERATIONAL, ([], []))
    slave.receive(Frame.parse("000#0100"), 0)
    assert take(slave.out) == ([], [NmtStateChanged(5, PRE_OPERATIONAL, OPERATIONAL)])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("000#", "2 bytes, not 0"),
        ("000#01", "2 bytes, not 1"),
        ("000#010500", "2 bytes, not 3"),
        ("000#0305", "0x03 is not an NMT command"),
        ("000#5000", "0x50 is not an NMT command"),
    ],
)
def test_slave_reports_what_makes_no_sense(text: str, reason: str) -> None:
    slave = slave_in(OPERATIONAL)
    slave.receive(Frame.parse(text), 0)
    ((ignored,),) = (take(slave.out)[1],)
    assert isinstance(ignored, FrameIgnored)
    assert (str(ignored.frame), ignored.node_id) == (text, 5)
    assert reason in ignored.reason
    assert slave.state is OPERATIONAL


def test_slave_starts_itself_and_ignores_its_own_commands_while_initialising() -> None:
    slave = NmtSlave(Outbox(), 5)
    slave.execute(NmtCommand.START, 0)
    assert (slave.state, take(slave.out)) == (INITIALISING, ([], []))
    slave.boot(0)
    slave.execute(NmtCommand.START, 0)
    assert slave.state is OPERATIONAL


@pytest.mark.parametrize("node_id", [0, 128, -1])
def test_slave_needs_a_node_id(node_id: int) -> None:
    with pytest.raises(LocalProtocolError, match=f"node-ID {node_id} is outside 1..127"):
        NmtSlave(Outbox(), node_id)


def test_a_recorded_session_of_another_stack_is_what_our_slave_does() -> None:
    """Commands and boot-up as CANopenNode's demo device (node 4) answered them; the states are those of its next heartbeats."""
    slave = slave_in(OPERATIONAL, node_id=4)
    for command, heartbeat in (("000#0204", 0x04), ("000#8004", 0x7F), ("000#0104", 0x05)):
        slave.receive(Frame.parse(command), 0)
        assert slave.state == heartbeat
    slave.receive(Frame.parse("000#8204"), 0)
    slave.boot(0)
    assert take(slave.out)[0] == ["704#00"]


@given(st.lists(st.binary(max_size=8)))
def test_no_bytes_make_the_slave_raise(payloads: list[bytes]) -> None:
    slave = slave_in(PRE_OPERATIONAL)
    for data in payloads:
        slave.receive(Frame(0, data), 0)
        if slave.state is INITIALISING:
            slave.boot(0)
        assert len(take(slave.out)[1]) <= 3


# master, slave, heartbeat producer and consumer together, over time

PERIOD = 100 * MILLISECOND
TIMEOUT = 250 * MILLISECOND


class NmtOverTime(RuleBasedStateMachine):
    """A device (slave + heartbeat producer) and a master (NMT master + heartbeat consumer), joined by a bus that can be cut.

    The model is a few variables: the device's state, when its next heartbeat is due, when the consumer gives up.
    """

    @initialize()
    def power_on(self) -> None:
        self.now = 0
        self.device, self.master_box = Outbox(), Outbox()
        self.slave = NmtSlave(self.device, 5)
        self.producer = HeartbeatProducer(self.device, 5)
        self.master = NmtMaster(self.master_box)
        self.consumer = HeartbeatConsumer(self.master_box, 5, TIMEOUT)
        self.cut = False
        self.boot_pending: NmtCommand | None = None
        # the model
        self.state = INITIALISING
        self.period = 0
        self.next_heartbeat = NEVER
        self.watched, self.lost = False, False
        self.gives_up_at = NEVER
        self.known: NmtState | None = None

    def carry(self) -> None:
        """Do what a LocalNode does with its events, and carry what the device sent to the consumer."""
        for happened in self.device.events:
            if isinstance(happened, NmtStateChanged):
                self.producer.set_state(happened.state, self.now)
            elif isinstance(happened, NmtResetRequested):
                self.boot_pending = happened.command
            else:
                assert isinstance(happened, FrameIgnored | HeartbeatsSkipped)
        frames = list(self.device.frames)
        take(self.device)
        for frame in frames:
            assert frame.can_id == 0x705
            booted = frame.data == b"\x00"
            assert booted or frame.data[0] == self.state
            if self.cut:
                continue
            self.consumer.receive(frame, self.now)
            heard = PRE_OPERATIONAL if booted else self.state
            expected: list[Event] = [NodeBooted(5, None)] if booted else [HeartbeatReceived(5, heard, None)]
            if self.lost and not booted:
                expected.append(HeartbeatRecovered(5, heard))
            if self.known is not heard:
                expected.append(NmtStateReported(5, self.known, heard))
            assert take(self.master_box)[1] == expected
            self.known = heard
            if not booted:
                self.watched, self.lost = True, False
            if self.watched and not self.lost:
                self.gives_up_at = self.now + TIMEOUT

    @precondition(lambda self: self.state is INITIALISING)
    @rule()
    def boot(self) -> None:
        self.slave.boot(self.now)
        self.boot_pending = None
        self.state = PRE_OPERATIONAL
        if self.period:
            self.next_heartbeat = self.now + self.period
        self.carry()

    @rule(command=st.sampled_from(NmtCommand), node_id=st.sampled_from([5, 0, 6]))
    def command(self, command: NmtCommand, node_id: int) -> None:
        self.master.send(command, node_id, self.now)
        (text,), _ = take(self.master_box)
        self.slave.receive(Frame.parse(text), self.now)
        if node_id != 6:
            previous, self.state = self.state, TRANSITIONS.get((self.state, command), self.state)
            if self.state is INITIALISING and previous is not INITIALISING:
                self.next_heartbeat = NEVER
                assert NmtResetRequested(5, command) in self.device.events
        self.carry()

    @rule(data=st.binary(max_size=4).filter(lambda data: len(data) != 2))
    def noise(self, data: bytes) -> None:
        self.slave.receive(Frame(0, data), self.now)
        self.carry()

    @rule(period=st.sampled_from([0, PERIOD]))
    def set_heartbeat_time(self, period: int) -> None:
        self.producer.set_period(period, self.now)
        self.period = period
        self.next_heartbeat = self.now + period if period and self.state is not INITIALISING else NEVER
        assert len(self.device.frames) == (self.next_heartbeat < NEVER)
        self.carry()

    @rule(cut=st.booleans())
    def cut_or_join_the_bus(self, cut: bool) -> None:
        self.cut = cut

    @rule(step=st.integers(1, 400))
    def time_passes(self, step: int) -> None:
        """A driver that wakes late: frames first, then the time."""
        self.now += step * MILLISECOND
        self.producer.handle_timeout(self.now)
        due = self.now >= self.next_heartbeat
        assert len(self.device.frames) == due  # never a burst
        if due:
            skipped = (self.now - self.next_heartbeat) // self.period
            assert self.device.events == ([HeartbeatsSkipped(5, skipped)] if skipped else [])
            self.next_heartbeat += (skipped + 1) * self.period
        self.carry()
        self.consumer.handle_timeout(self.now)
        lost = [happened for happened in take(self.master_box)[1] if isinstance(happened, HeartbeatLost)]
        assert bool(lost) == (self.now >= self.gives_up_at)
        if lost:
            assert lost[0].state is self.known
            self.lost, self.known, self.gives_up_at = True, None, NEVER

    @invariant()
    def model_and_machines_agree(self) -> None:
        if not hasattr(self, "now"):
            return
        assert self.slave.state is self.state
        assert self.producer.state is self.state
        assert self.producer.deadline == self.next_heartbeat
        assert (self.consumer.state, self.consumer.lost) == (self.known, self.lost)
        assert self.consumer.deadline == self.gives_up_at
        assert (self.boot_pending is not None) <= (self.state is INITIALISING)


TestNmtOverTime = NmtOverTime.TestCase
