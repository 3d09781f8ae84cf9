"""A stop waits for nothing on a further SDO channel: neither for a long transfer there, nor behind a controlword that waits."""

from __future__ import annotations

import pytest

from canopen_proto.drives import axis as drive
from canopen_proto.frame import Frame, routing_key
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.procedures.steps import SdoTransferError, download, upload
from canopen_proto.sdo.client import SdoClient
from tests.drives.reference_drive import OE
from tests.drives.test_whoever_else_speaks import Bench, running

TO_SERVER, FROM_SERVER = 0x645, 0x5C5


class OneAtATime:
    """A drive with a second SDO server, whose program serves one transfer at a time: it sends a segment of a long object each
    200 ms, and looks at nothing else until it is over, or aborted."""

    def __init__(self, bench: Bench) -> None:
        self.drive = bench.drive
        self.world = bench.world
        self.is_open = False
        self.waiting: list[Frame] = []
        self.drive.member.on_frame = self.hear

    def hear(self, frame: Frame, now: Time) -> None:
        if frame.can_id == TO_SERVER:
            if frame.data[0] & 0xE0 == 0x40:
                self.is_open = True
                self.drive.send(FROM_SERVER, bytes([0x41]) + frame.data[1:4] + (1 << 20).to_bytes(4, "little"))
            elif frame.data[0] & 0xE0 == 0x60 and self.is_open:
                toggle = frame.data[0] & 0x10
                self.world.after(200 * MILLISECOND, lambda: self.drive.send(FROM_SERVER, bytes([toggle]) + bytes(7)))
            elif frame.data[0] == 0x80:
                self.is_open = False
                for each in self.waiting:
                    self.drive.hear(each, now)
                self.waiting.clear()
        elif frame.can_id == 0x605 and self.is_open:
            self.waiting.append(frame)
        else:
            self.drive.hear(frame, now)


def second_channel(bench: Bench) -> SdoClient:
    return bench.axis.remote.add_sdo_channel(routing_key(TO_SERVER), routing_key(FROM_SERVER))


@pytest.mark.parametrize("stop", [drive.quick_stop, drive.halt, drive.shut_down, drive.engage_brake])
def test_a_stop_ends_a_long_transfer_on_a_further_channel_of_a_device_that_serves_one_at_a_time(stop) -> None:  # type: ignore[no-untyped-def]
    bench = Bench()
    running(bench)
    OneAtATime(bench)
    client = second_channel(bench)
    backup = bench.master.start(upload(client, 0x1F50, 1))
    bench.world.advance(500 * MILLISECOND)
    began = bench.world.now
    assert bench.run(stop(bench.axis)) == ""
    assert bench.world.now - began < SECOND
    bench.world.advance(2 * SECOND)
    assert bench.drive.stands
    with pytest.raises(SdoTransferError, match="was given up: a stop of its drive went before it"):
        bench.master.result(backup)


def test_a_stop_beside_a_long_transfer_on_a_further_channel_leaves_it_alone_if_the_drive_answers() -> None:
    bench = Bench()
    running(bench)
    second = OneAtATime(bench)
    backup = bench.master.start(upload(second_channel(bench), 0x1F50, 1))
    bench.world.advance(500 * MILLISECOND)
    second.is_open, second.waiting = False, []  # from now on it serves both
    assert bench.run(drive.quick_stop(bench.axis)) == ""
    assert not bench.master.has_ended(backup)


def test_a_halt_of_a_drive_whose_state_is_not_known_waits_for_no_transfer_on_its_own_channel() -> None:
    bench = Bench()
    running(bench)
    answer = bytes([0x41, 0x50, 0x1F, 0x01]) + (1 << 20).to_bytes(4, "little")
    hear = bench.drive.hear

    def long(frame: Frame, now: Time) -> None:
        if frame.can_id == 0x605 and frame.data[:4] == b"\x40\x50\x1f\x01":
            bench.drive.send(0x585, answer)
        elif frame.can_id == 0x605 and frame.data[0] & 0xE0 == 0x60:
            toggle = frame.data[0] & 0x10
            bench.world.after(200 * MILLISECOND, lambda: bench.drive.send(0x585, bytes([toggle]) + bytes(7)))
        else:
            hear(frame, now)

    bench.drive.member.on_frame = long
    backup = bench.master.start(upload(bench.axis.remote.sdo, 0x1F50, 1))
    bench.world.advance(500 * MILLISECOND)
    began = bench.world.now
    assert bench.run(drive.halt(bench.axis)) == ""
    assert bench.drive.stands
    assert bench.world.now - began < SECOND
    with pytest.raises(SdoTransferError, match="was given up"):
        bench.master.result(backup)


def test_no_controlword_that_waits_on_a_further_channel_comes_behind_a_stop() -> None:
    bench = Bench()
    running(bench)
    device = OneAtATime(bench)
    client = second_channel(bench)
    bench.master.start(upload(client, 0x1F50, 1))
    waits = bench.master.start(download(client, 0x6040, 0, b"\x0f\x00"))
    bench.world.advance(100 * MILLISECOND)
    assert bench.run(drive.shut_down(bench.axis)) == ""
    bench.world.advance(5 * SECOND)
    assert bench.drive.state != OE
    assert not device.waiting
    assert not [each for each in bench.world.bus().trace if str(each.frame).startswith("645#2B4060")]
    with pytest.raises(SdoTransferError, match="was given up"):
        bench.master.result(waits)
