"""A recorded boot-up: Lely's NMT master and its slave. Our master sends what theirs sent, and takes the slave's answers.

That our device answers as theirs did is in test_recorded_sessions.py.
"""

from __future__ import annotations

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.concise import from_concise, pack_concise
from canopen_proto.machine import MILLISECOND
from canopen_proto.manager.boot.assignment import Assignment, Startup
from canopen_proto.manager.boot.entry import BootEntry, NetworkEntry
from canopen_proto.manager.boot.network_boot import BootReport, NetworkBoot
from canopen_proto.network import Network
from canopen_proto.nmt import NmtMaster
from canopen_proto.procedures.runner import ProcedureFinished
from canopen_proto.remote_node import RemoteNode
from tests.interop.recorded import load, needs_recordings

pytestmark = needs_recordings

NODE = 4
REQUEST, ANSWER, HEARTBEAT, NMT = 0x600 + NODE, 0x580 + NODE, 0x700 + NODE, 0x000
EXPEDITED = {0x23: 4, 0x2B: 2, 0x2F: 1}
"""The command of a download -> the length of its data."""


def test_our_master_boots_the_recorded_slave_as_theirs_did() -> None:
    lines = [line for line in load("lely-master-boots-lely-slave") if line.frame.can_id in (REQUEST, ANSWER, HEARTBEAT, NMT)]
    theirs = [line.text for line in lines if line.frame.can_id in (REQUEST, NMT)]
    downloads = [line.frame.data for line in lines if line.frame.can_id == REQUEST and line.frame.data[0] in EXPEDITED]
    configuration = [(int.from_bytes(data[1:3], "little"), data[3], data[4 : 4 + EXPEDITED[data[0]]]) for data in downloads]
    assert len(configuration) == 16

    network = Network()
    nmt, node = NmtMaster(network.out), RemoteNode(network.out, NODE, ObjectDictionary([]))
    network.attach(nmt)
    network.attach(node)
    entry = BootEntry(
        NODE,
        Assignment(is_mandatory=True),
        device_type=0x000F0191,
        product=1,
        consumer_time=600 * MILLISECOND,
        configuration=tuple(from_concise(pack_concise(configuration))),
    )
    startup = Startup(application_starts=True)  # the slave starts itself
    boot = NetworkBoot(network, nmt, NetworkEntry(startup, {NODE: entry}), {NODE: node})

    begun = next(number for number, line in enumerate(lines) if line.text == "000#8200")
    now = lines[begun].time
    network.run(boot.start(), now)
    sent = []
    reports: list[BootReport] = []
    for line in lines[begun:]:
        now = line.time
        if line.frame.can_id in (ANSWER, HEARTBEAT):
            network.receive(line.frame, now)
        else:
            network.handle_timeout(now)
        frames, events = network.drain(now)
        sent += [str(frame) for frame in frames]
        reports += [event.result for event in events if isinstance(event, ProcedureFinished)]
    assert sent == theirs
    assert [(report.is_started, str(report.outcomes[NODE].letter)) for report in reports] == [(True, "0")]
