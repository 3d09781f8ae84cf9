"""A device whose firmware (a DOMAIN) its host takes and gives piece by piece, by block and by segmented transfer."""

from __future__ import annotations

from typing import Any

import pytest

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Event, Outbox
from canopen_proto.sdo.client import SdoAborted, SdoClient, SdoDownloaded, SdoUploaded
from canopen_proto.sdo.server import ObjectAccessPending
from tests.core.block_pair import pattern
from tests.core.bus import Bus

FIRMWARE, LOG = 0x1F50, 0x2000
DICTIONARY = ObjectDictionary(
    [
        Object.of("firmware", [Variable(FIRMWARE, 0, "firmware", DataType.DOMAIN)]),
        Object.of("log", [Variable(LOG, 0, "log", DataType.DOMAIN, Access.RO)]),
    ]
)


class Device:
    """The device, its host, and a client."""

    def __init__(self) -> None:
        self.bus = Bus()
        self.client = self.bus.attach(SdoClient(Outbox(), 12))
        self.node = self.bus.attach(LocalNode(Outbox(), 12, DICTIONARY))
        self.node.boot(0)
        self.node.deferred |= {FIRMWARE, LOG}
        self.node.in_pieces |= {FIRMWARE, LOG}
        self.firmware = b""
        self.pieces = 0
        self.bus.on_event = self.serve

    def serve(self, report: Event) -> None:
        if not isinstance(report, ObjectAccessPending):
            return
        self.pieces += 1
        if report.data is None:
            piece = self.firmware[report.offset : report.offset + 1024]
            more = report.offset + 1024 < len(self.firmware)
            self.node.complete(report.access_id, piece, self.bus.now, more=more, size=len(self.firmware))
        else:
            self.firmware = self.firmware[: report.offset] + report.data
            self.node.complete(report.access_id, None, self.bus.now)


@pytest.mark.parametrize("block", [True, "auto", False])
def test_firmware_down_and_up(block: Any) -> None:
    device, image = Device(), pattern(10_000)
    device.client.download(FIRMWARE, 0, image, device.bus.now, block=block)
    device.bus.settle()
    assert device.bus.take_events(SdoDownloaded)
    assert device.firmware == image
    assert device.pieces >= 10
    device.client.upload(FIRMWARE, 0, device.bus.now, block=block)
    device.bus.settle()
    (uploaded,) = device.bus.take_events(SdoUploaded)
    assert uploaded.data == image
    assert device.pieces >= 20


@pytest.mark.parametrize("block", [True, False])
def test_access_rights_come_first(block: bool) -> None:
    device = Device()
    device.client.download(LOG, 0, pattern(100), 0, block=block)
    device.bus.settle()
    (aborted,) = device.bus.take_events(SdoAborted)
    assert aborted.abort_code == 0x06010002
    assert device.pieces == 0
