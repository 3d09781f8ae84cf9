"""The recorded LSS sessions of other stacks: our slave answers as theirs did, and our master's frames get their answers."""

from __future__ import annotations

import pytest

from canopen_proto.lss.master import LssMaster, LssReply
from canopen_proto.lss.messages import (
    FROM_MASTER,
    FROM_SLAVE,
    STATES,
    LssAddress,
    LssConfiguration,
    LssService,
    LssState,
    number_of,
)
from canopen_proto.lss.slave import LssSlave
from canopen_proto.machine import Outbox
from tests.core.bus import take_events, take_frames
from tests.interop.recorded import load

SESSIONS = {
    "canopennode-lss-selective": (LssAddress(0, 1, 0, 3), 4),
    "lely-slave-lss": (LssAddress(0, 1, 0, 3), 5),
}


@pytest.mark.parametrize("name", SESSIONS)
def test_our_slave_answers_a_recorded_master_as_the_recorded_slave_did(name: str) -> None:
    address, node_id = SESSIONS[name]
    slave = LssSlave(Outbox(), address, LssConfiguration(node_id))
    expected, answered = [], []
    for line in load(name):
        if line.frame.key == FROM_MASTER:
            slave.receive(line.frame, line.time)
            answered += take_frames(slave.out)
        else:
            assert line.frame.key == FROM_SLAVE
            expected.append(line.text)
    assert answered == expected


@pytest.mark.parametrize("name", SESSIONS)
def test_our_master_sends_what_the_recorded_master_sent_and_takes_the_recorded_answers(name: str) -> None:
    address, node_id = SESSIONS[name]
    lines = load(name)
    requests = [line.text for line in lines if line.frame.key == FROM_MASTER]
    answers = [line for line in lines if line.frame.key == FROM_SLAVE]
    master = LssMaster(Outbox())
    master.frame_gap = 0
    sent, numbers = [], {}
    commands = [int(text[4:6], 16) for text in requests]
    for place, command in enumerate(commands):
        now = place * 10**9
        if command == LssService.SWITCH_GLOBAL:
            master.switch_global(LssState(int(requests[place][6:8], 16)), now)
        elif command == LssService.SELECT_VENDOR:
            master.select(address, now)
        elif command in STATES and command >= LssService.INQUIRE_VENDOR:
            master.inquire(LssService(command), now)
        while master.is_busy and master.deadline <= now:
            master.handle_timeout(now)
        sent += take_frames(master.out)
        if master.is_busy:
            master.receive(answers.pop(0).frame, now)
            master.handle_timeout(now + 10**9)
            (reply,) = take_events(master.out)
            assert isinstance(reply, LssReply)
            assert reply.count == 1
            numbers[reply.service] = number_of(reply.answers[0])
    assert sent == requests
    assert not answers
    assert numbers[LssService.INQUIRE_NODE_ID] == node_id
