"""Sessions of two real C stacks (CANopenNode, Lely CANopen), replayed to our device and to our master: see `recorded`.

Our device hears what the recorded one heard, and has to say the same; our master is told what the recorded one was told, and has
to ask the same and understand the answers. What a device sends is compared for each CAN-ID by itself: their order is a matter of
internal priorities. Where ours may do otherwise, a `Difference` says why (`recorded_scenes`).

Of heartbeats, each recorded one has to name the state that our device is in at that moment. When they come differs: CANopenNode
sends one more at each change of state and begins its period anew, which 7.2.8.3.2.2 neither asks for nor forbids; ours keep
their phase. Lely's first one comes a period after 0x1017 was written, ours at once: the protocol begins "immediately" there.
"""

from __future__ import annotations

import datetime

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.emcy import EmcyReceived
from canopen_proto.frame import EMCY, ERROR_CONTROL, NMT, RPDO1, SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, SYNC, TPDO1, TPDO2
from canopen_proto.heartbeat import HeartbeatLost, HeartbeatReceived, HeartbeatRecovered, NmtStateReported, NodeBooted
from canopen_proto.machine import MILLISECOND, Event
from canopen_proto.nmt import NmtCommand, NmtState, NmtStateChanged
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.sdo.client import SdoAborted, SdoDownloaded, SdoUploaded
from canopen_proto.time_stamp import TimeReceived
from tests.interop.demo_device import NUMBERS, OUTPUTS, TEXT, demo_device
from tests.interop.recorded import (
    FOLDER,
    DeviceReplay,
    Difference,
    Line,
    MasterReplay,
    load,
    needs_recordings,
    sdo_of,
    with_differences,
)
from tests.interop.recorded_scenes import NUMBER, OUT_OF_SCOPE, SCENES, Scene

pytestmark = needs_recordings

by_scene = pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
NAMED = {scene.name: scene for scene in SCENES}


def test_every_recording_is_replayed() -> None:
    assert {path.stem for path in FOLDER.glob("*.log")} <= {*NAMED, *OUT_OF_SCOPE}


# ---- our device in the place of the recorded one ----


def replay_to_device(scene: Scene, lines: list[Line]) -> DeviceReplay:
    """Our device after the recording."""

    def host(replay: DeviceReplay, event: Event) -> None:
        node = replay.node
        if isinstance(event, NmtStateChanged) and event.state is NmtState.OPERATIONAL:
            for number in scene.sends_inputs:
                node.pdos.producers[number].trigger(replay.now)
        if isinstance(event, NmtStateChanged) and event.previous is NmtState.INITIALISING:
            if scene.starts_itself:
                node.execute(NmtCommand.START, replay.now)
            if scene.name == "canopennode-bootup-first-run":  # what it has stored could not be read
                node.raise_error(0x5000, 0, bytes.fromhex("2F74000000"), replay.now)

    replay = DeviceReplay(scene.node_id, demo_device(scene.node_id, scene.changes), host)
    replay.prepare(lines[0].time, scene.state)
    replay.play(lines)
    return replay


def texts(lines: list[Line], can_id: int) -> list[str]:
    """The frames of one CAN-ID."""
    return [line.text for line in lines if line.frame.can_id == can_id]


def of_can_id(differences: tuple[Difference, ...], can_id: int) -> list[Difference]:
    return [difference for difference in differences if difference.theirs.startswith(f"{can_id:03X}#")]


def without_repeats(frames: list[str]) -> list[str]:
    """Without frames that are equal to the one before."""
    return [text for text, before in zip(frames, [None, *frames], strict=False) if text != before]


@by_scene
def test_our_device_says_what_theirs_said(scene: Scene) -> None:
    lines = load(scene.name)
    replay = replay_to_device(scene, lines)
    node_id = scene.node_id
    for can_id in (SDO_SERVER_TO_CLIENT + node_id, EMCY + node_id):
        assert texts(replay.sent, can_id) == with_differences(texts(lines, can_id), of_can_id(scene.differences, can_id))
    for can_id in (TPDO1 + node_id, TPDO2 + node_id):  # an event timer's repetitions are a matter of its clock
        assert without_repeats(texts(replay.sent, can_id)) == without_repeats(texts(lines, can_id))
    boot_up = f"{ERROR_CONTROL + node_id:03X}#00"
    assert texts(replay.sent, ERROR_CONTROL + node_id).count(boot_up) == texts(lines, ERROR_CONTROL + node_id).count(boot_up)
    assert [ours for ours, _ in replay.states] == [theirs for _, theirs in replay.states]


def test_a_written_heartbeat_time_begins_at_once() -> None:
    """As many heartbeats of 100 ms, and then of 1000 ms, as the other one sent."""
    scene = NAMED["canopennode-sdo-write-1017-heartbeat"]
    lines = load(scene.name)
    replay = replay_to_device(scene, lines)
    ours = [line for line in replay.sent if line.frame.can_id == 0x704]
    theirs = [line for line in lines if line.frame.can_id == 0x704]
    assert [line.text for line in ours] == [line.text for line in theirs] == ["704#05"] * 8
    assert all(abs(mine.time - other.time) < 6 * MILLISECOND for mine, other in zip(ours, theirs, strict=True))


def test_heartbeats_beside_the_period_of_canopennode() -> None:
    """It sends one at each change of state (nothing in 7.2.8.3.2.2 says so); without these it sends what ours does."""
    scene = NAMED["canopennode-nmt-commands"]
    lines = load(scene.name)
    replay = replay_to_device(scene, lines)
    commands = [line.time for line in lines if line.frame.can_id == NMT]
    periodic = [
        line for line in lines if line.text == "704#00" or not any(0 < line.time - time < 2 * MILLISECOND for time in commands)
    ]
    assert texts(replay.sent, 0x704) == texts(periodic, 0x704)[1:]  # the very first came before ours was due


@pytest.mark.parametrize("name", ["lely-slave-pdo-sync", "lely-master-boots-lely-slave"])
def test_the_heartbeat_that_lely_leaves_out(name: str) -> None:
    """When 0x1017 is written the protocol begins at once (7.2.8.3.2.2); Lely begins a period later. Then they agree."""
    scene = NAMED[name]
    lines = load(scene.name)
    replay = replay_to_device(scene, lines)
    can_id = ERROR_CONTROL + scene.node_id
    (written,) = [line.time for line in lines if line.text.startswith(f"{SDO_CLIENT_TO_SERVER + scene.node_id:03X}#2B171000")]
    at_once = [line for line in replay.sent if line.frame.can_id == can_id and line.time == written]
    assert len(at_once) == 1
    assert texts([line for line in replay.sent if line not in at_once], can_id) == texts(lines, can_id)


def test_synchronous_pdos_go_with_the_same_sync() -> None:
    """A TPDO at each SYNC, with what a PDO brought that came before the SYNC before (type 0 of the RPDO)."""
    scene = NAMED["lely-slave-pdo-sync"]
    lines = load(scene.name)
    replay = replay_to_device(scene, lines)
    assert texts(replay.sent, 0x185) == texts(lines, 0x185)
    assert replay.node.values.read((NUMBERS, 1)) == 0x1B5A


def test_a_stream_of_synchronous_pdos() -> None:
    scene = NAMED["lely-master-boots-lely-slave"]
    lines = load(scene.name)
    replay = replay_to_device(scene, lines)
    assert texts(replay.sent, 0x184) == texts(lines, 0x184)
    assert len(texts(lines, 0x184)) == 79
    assert replay.node.values.read((NUMBERS, 3)) == 0x1234
    received = [event for event in replay.events if isinstance(event, PdoReceived)]
    assert len(received) == len(texts(lines, 0x204)) - 1  # the last one waits for a SYNC
    assert [entry.index for entry in received[0].mapping.components] == [OUTPUTS, OUTPUTS]


def test_events_of_the_device_that_monitors_another() -> None:
    scene = NAMED["canopennode-heartbeat-consumer-emcy"]
    lines = load(scene.name)
    replay = replay_to_device(scene, lines)
    seen = [event for event in replay.events if isinstance(event, HeartbeatLost | HeartbeatRecovered | NodeBooted)]
    assert [(type(event), event.node_id) for event in seen] == [(HeartbeatLost, 10), (NodeBooted, 10), (HeartbeatRecovered, 10)]
    (lost,) = [line.time for line in replay.sent if line.text.startswith("084#3081")]
    (theirs,) = [line.time for line in lines if line.text.startswith("084#3081")]
    assert abs(lost - theirs) < 2 * MILLISECOND


def test_a_pdo_of_a_wrong_length() -> None:
    """The recording ends with a PDO of two bytes, and does not tell how many were mapped. Four: EMCY 0x8210 (7.5.2.36)."""
    scene = NAMED["canopennode-pdo-length-error-emcy"]
    lines = load(scene.name)
    one_number = {(0x1600, 0): 1, (0x1600, 1): NUMBER, (0x1600, 2): 0}
    replay = replay_to_device(Scene(scene.name, state=scene.state, changes=one_number, sends_inputs=(2,)), lines)
    assert texts(replay.sent, 0x284) == texts(lines, 0x284)
    (emergency,) = texts(replay.sent, 0x084)
    assert emergency.startswith("084#108211")
    assert replay.node.values.read((NUMBERS, 1)) == 0


# ---- our master in the place of the recorded one ----


def replay_to_master(scene: Scene, lines: list[Line]) -> MasterReplay:
    """Our master after the recording."""
    dictionary = demo_device(scene.node_id)
    replay = MasterReplay(scene.node_id, dictionary, sdo_timeout=300 * MILLISECOND)
    remote = replay.remote
    if scene.tpdo:
        remote.add_tpdo(1, TPDO1 + scene.node_id, Mapping.from_parameters(scene.tpdo, dictionary), 0)
    if scene.rpdo:
        mapping = Mapping.from_parameters(scene.rpdo, dictionary)
        replay.rpdo = remote.add_rpdo(1, RPDO1 + scene.node_id, mapping, 1 if scene.rpdo_by_sync else 255)
    replay.play(lines)
    return replay


@by_scene
def test_our_master_asks_what_theirs_asked(scene: Scene) -> None:
    lines = load(scene.name)
    replay = replay_to_master(scene, lines)
    for can_id in (NMT, SYNC, SDO_CLIENT_TO_SERVER + scene.node_id, RPDO1 + scene.node_id):
        assert texts(replay.sent, can_id) == with_differences(texts(lines, can_id), of_can_id(scene.master_differences, can_id))


@by_scene
def test_our_master_gets_what_theirs_got(scene: Scene) -> None:
    lines = load(scene.name)
    replay = replay_to_master(scene, lines)
    transfers = sdo_of(lines, scene.node_id)
    for transfer, outcome in zip(transfers, replay.outcomes, strict=True):
        assert isinstance(outcome, SdoUploaded | SdoDownloaded | SdoAborted)
        assert (outcome.index, outcome.subindex) == (transfer.index, transfer.subindex)
        if not transfer.complete:
            assert isinstance(outcome, SdoAborted)
            assert (outcome.abort_code, outcome.origin) == (AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT)
        elif transfer.abort_code is not None:
            assert isinstance(outcome, SdoAborted)
            assert (outcome.abort_code, outcome.origin) == (transfer.abort_code, AbortOrigin.PEER)
        elif transfer.is_upload:
            assert isinstance(outcome, SdoUploaded)
            assert outcome.data == transfer.data
        else:
            assert isinstance(outcome, SdoDownloaded)


@by_scene
def test_our_master_understands_the_device(scene: Scene) -> None:
    """Each heartbeat, boot-up, emergency and TPDO is one event, with what the frame says."""
    lines = load(scene.name)
    replay = replay_to_master(scene, lines)
    node_id = scene.node_id
    expected: list[tuple[type[Event], object]] = []
    for line in lines:
        data = line.frame.data
        if line.frame.can_id == ERROR_CONTROL + node_id:
            expected.append((HeartbeatReceived, data[0]) if data[0] else (NodeBooted, None))
        elif line.frame.can_id == EMCY + node_id:
            expected.append((EmcyReceived, (int.from_bytes(data[:2], "little"), data[2], data[3:])))
        elif line.frame.can_id == TPDO1 + node_id and scene.tpdo:
            expected.append((PdoReceived, data))
    seen: list[tuple[type[Event], object]] = []
    for event in replay.events:
        match event:
            case HeartbeatReceived(state=state):
                seen.append((HeartbeatReceived, state))
            case NodeBooted():
                seen.append((NodeBooted, None))
            case EmcyReceived(code=code, error_register=register, vendor_data=vendor_data):
                seen.append((EmcyReceived, (code, register, vendor_data)))
            case PdoReceived(data=data):
                seen.append((PdoReceived, data))
    assert seen == expected


def test_the_texts_that_were_read() -> None:
    replay = replay_to_master(NAMED["canopennode-sdo-segmented-upload-string"], load("canopennode-sdo-segmented-upload-string"))
    read = [outcome.data for outcome in replay.outcomes if isinstance(outcome, SdoUploaded)]
    assert read == [b"CANopenDemoLinux", b"---", b"str", TEXT, b"\xc8\x3d\xbb" + bytes(7)]
    assert replay.remote.values.read(0x1008) == "CANopenDemoLinux"


def test_the_states_that_were_reported() -> None:
    replay = replay_to_master(NAMED["canopennode-nmt-commands"], load("canopennode-nmt-commands"))
    states = [event.state for event in replay.events if isinstance(event, NmtStateReported)]
    operational, stopped, pre_operational = NmtState.OPERATIONAL, NmtState.STOPPED, NmtState.PRE_OPERATIONAL
    assert states == [operational, stopped, pre_operational, operational, pre_operational, stopped, pre_operational]


def test_the_values_that_a_pdo_brought() -> None:
    replay = replay_to_master(NAMED["lely-slave-pdo-sync"], load("lely-slave-pdo-sync"))
    values = [event.get((NUMBERS, 1)) for event in replay.events if isinstance(event, PdoReceived)]
    assert values == [0, 0, 0, 0, 0, 0, 7000, 7000, 7001, 7001, 7002]


def test_the_emergency_of_a_first_run() -> None:
    replay = replay_to_master(NAMED["canopennode-bootup-first-run"], load("canopennode-bootup-first-run"))
    (emergency,) = [event for event in replay.events if isinstance(event, EmcyReceived)]
    assert (emergency.code, emergency.text, emergency.length) == (0x5000, "device hardware", 8)


def test_the_time_that_was_sent() -> None:
    """A device that is no TIME consumer by its 0x1012, as the recorded one, does not look at it; one that is reports it."""
    scene = NAMED["canopennode-time"]
    lines = load(scene.name)
    deaf = replay_to_device(scene, lines)
    hearing = replay_to_device(Scene(scene.name, changes={(0x1012, 0): 0x80000100}), lines)
    received = [[event for event in replay.events if isinstance(event, TimeReceived)] for replay in (deaf, hearing)]
    moment = datetime.datetime(2023, 11, 14, 22, 13, 20, tzinfo=datetime.UTC)
    assert [[event.time for event in events] for events in received] == [[], [moment]]
