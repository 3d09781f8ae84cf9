"""Whatever a client writes to the communication objects of a device that has all of them, and whatever comes from the bus:

nothing raises, served time does not want to be served again, each object can be read, and after a reset the device is as it was
at power-on, down to the frames that it asks for.
"""

from __future__ import annotations

import random

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import Variable
from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.network import Network
from canopen_proto.sdo.server import ObjectAccessPending
from tests.core.devices import INPUT, LIMITED, OUTPUT, TABLE, whole_device

DICTIONARY = whole_device()
WRITABLE = [each for each in DICTIONARY if 0x1000 <= each.index < 0x2000 and each.access.writable]
USUAL = (
    0, 0, 1, 2, 5, 10, 100, 252, 253, 254, 255, 0x80000000, 0x80, 0x40000080, 0x100, 0xC0000100, 0x85, 0x205, 0x185, 0x40000185,
    0x200001C5, 0x20010010, 0x20000010, 0x21000110, 0x00050008, 0x0009_0064, 0x0005_0032, 0x01200000, 0x03210001,
    0x01_2001_00_2001_00_05, 0x02_2100_01_2100_01_05, 0x65766173, 0x64616F6C,
)  # fmt: skip
APT = {
    0x1006: (0, 1000, 20_000),
    0x1007: (0, 500),
    0x100C: (0, 20),
    0x100D: (0, 3),
    0x1010: (0x65766173,),
    0x1011: (0x64616F6C,),
    0x1016: (0, 9 << 16 | 50, 10 << 16 | 20),
    0x1017: (0, 0, 50),
    0x1028: (0x80000000, 0x81),
    0x1201: (0x6A1, 0x6A2, 0x800006A1, 0x800006A2),
    0x1280: (0x609, 0x589, 0x80000609, 0x80000589),
    0x1FA0: (0, 0x0120_0000, 0x0321_0001),
    0x1FD0: (0, 0x0120_0100_2001_0009, 0x0221_0002_2001_0009),
}
"""Values that these objects take."""
ENTRIES = {False: (0x20010010, 0x21000110, 0x21000208), True: (0x20000010, 0x21000110, 0x21000208)}
CAN_IDS = (0x000, 0x080, 0x081, 0x085, 0x100, 0x185, 0x1C5, 0x205, 0x305, 0x405, 0x589, 0x605, 0x605, 0x6A1, 0x705, 0x709)


class Anything:
    """A device, and somebody who does anything to it. Deterministic by its seed."""

    def __init__(self, seed: int) -> None:
        self.source = random.Random(seed)
        self.network = Network()
        self.node = LocalNode(self.network.out, 5, DICTIONARY)
        self.network.attach(self.node)
        self.now: Time = 0
        self.node.boot(0)
        self.drain()

    def drain(self) -> None:
        frames, events = self.network.drain(self.now)
        for frame in frames:
            assert len(frame.data) <= 8
            assert frame.can_id <= (0x1FFFFFFF if frame.flags & EXTENDED else 0x7FF)
            assert not frame.flags & REMOTE  # a device asks nobody
        for access in events:
            if isinstance(access, ObjectAccessPending) and self.source.random() < 0.8:
                self.node.storage.to_keep(access.index, access.subindex)
                answer = None if self.source.random() < 0.8 else AbortCode.HARDWARE_ERROR
                self.node.complete(access.access_id, answer, self.now)
                self.drain()

    def write(self) -> None:
        variable = self.source.choice(WRITABLE)
        assert variable.size is not None
        usual = self.source.random() < 0.9
        value = self.source.choice(USUAL) if usual else self.source.getrandbits(8 * variable.size)
        if variable.index in APT and self.source.random() < 0.7:
            value = self.source.choice(APT[variable.index])
        self.download(variable, value)

    def remap(self) -> None:
        """Set up a PDO, by the order that the standard wants: an ordinary one or a multiplexed one, mostly."""
        source = self.source
        is_tpdo, number = source.random() < 0.5, source.randrange(4)
        base, kind = (0x1800 if is_tpdo else 0x1400) + number, source.choice((0, 1, 2, 2, 0xFE, 0xFF))
        steps = [(base, 1, 0x80000000), (base + 0x200, 0, 0)]
        steps += [(base + 0x200, each, source.choice(ENTRIES[is_tpdo])) for each in (1, 2)]
        steps += [(base + 0x200, 0, kind), (base, 2, source.choice((0, 1, 2, 252, 253, 254, 255)))]
        steps += [(base, each, source.choice((0, 0, 20))) for each in (3, 5)]
        steps += [(base, 1, source.choice((0x1C5, 0x400001C5, 0x185 if is_tpdo else 0x205, 0x200001C5)))]
        for index, subindex, value in steps:
            self.download(DICTIONARY.variable((index, subindex)), value)

    def download(self, variable: Variable, value: int) -> None:
        assert variable.size is not None
        data = (value % (1 << 8 * variable.size)).to_bytes(variable.size, "little")
        address = bytes((variable.index & 0xFF, variable.index >> 8, variable.subindex))
        if variable.size <= 4:
            command = 0x23 | 4 - variable.size << 2
            self.receive(Frame(0x605, bytes((command,)) + address + data.ljust(4, b"\x00")))
        else:
            self.receive(Frame(0x605, b"\x21" + address + variable.size.to_bytes(4, "little")))
            self.receive(Frame(0x605, b"\x00" + data[:7]))
            self.receive(Frame(0x605, b"\x1d" + data[7:].ljust(7, b"\x00")))

    def receive(self, frame: Frame) -> None:
        self.network.receive(frame, self.now)
        self.drain()

    def hear(self) -> None:
        source = self.source
        keys = self.network.can_ids()
        key = source.choice(keys) if source.random() < 0.7 else source.choice(CAN_IDS)
        flags = key >> 29
        data = b"" if flags & REMOTE else source.randbytes(source.choice((0, 1, 2, 2, 6, 8, 8)))
        if key == 0:
            data = bytes((source.choice((1, 1, 1, 1, 1, 1, 1, 1, 1, 2, 0x80, 0x80, 0x81, 0x82)), source.choice((0, 5))))
        elif len(data) == 8 and source.random() < 0.7:  # an MPDO, perhaps
            data = bytes.fromhex(source.choice(("8501200007000000", "8000210107000000", "0901200007000000", "8501300007000000")))
        elif key & 0x780 == 0x700 and data:
            data = b"\x05"
        self.receive(Frame(key & 0x1FFFFFFF, data, flags))

    def act(self) -> None:
        choice = self.source.randrange(6)
        match choice:
            case 0:
                self.node.set_value(INPUT, 0, self.source.randrange(-9, 9), self.now)
            case 1:
                self.node.raise_error(0x1000, 1, b"", self.now, error_class=self.source.choice((None, 1, 2, 3)))
            case 2:
                self.node.clear_error(0x1000, self.now)
            case 3:
                self.node.bus_off(self.now)
            case 4:
                self.node.bus_recovered(self.now)
            case _:
                self.node.set_value(TABLE, self.source.randrange(1, 4), self.source.randrange(9), self.now)
        self.drain()

    def wait(self) -> None:
        end = self.now + self.source.choice((0, 1, 20, 300)) * MILLISECOND
        for _ in range(50):
            if self.network.next_deadline() > end:
                break
            self.now = max(self.now, self.network.next_deadline())
            self.network.handle_timeout(self.now)
            self.drain()
        self.now = end
        for _ in range(50):  # late, all at once; an EMCY or an MPDO that waits may take a turn of its own
            self.network.handle_timeout(end)
            self.drain()
            if self.network.next_deadline() > end:
                break
        assert self.network.next_deadline() > end

    def check_readable(self) -> None:
        for variable in DICTIONARY:
            data = self.node.values.raw(variable.index, variable.subindex)
            assert variable.decode(data) == self.node.values[variable.mux]


@pytest.mark.thorough(6)
@pytest.mark.parametrize("seed", range(12))
def test_anything_is_done_to_a_device(seed: int) -> None:
    anything = Anything(seed)
    steps = [anything.write] * 6 + [anything.hear] * 4 + [anything.act, anything.remap] + [anything.wait] * 2
    for number in range(1500):
        anything.source.choice(steps)()
        if number % 100 == 0:
            anything.check_readable()
    anything.check_readable()


@pytest.mark.thorough(4)
@pytest.mark.parametrize("seed", range(12, 20))
def test_after_a_reset_a_device_is_as_at_power_on(seed: int) -> None:
    """Twice: once with the defaults, once with what was stored meanwhile."""
    anything = Anything(seed)
    steps = [anything.write] * 6 + [anything.hear] * 3 + [anything.remap] + [anything.wait] * 2
    for _ in range(2):
        for _ in range(600):
            anything.source.choice(steps)()
        anything.receive(Frame(0x000, b"\x81\x05"))
        fresh = Network()
        node = LocalNode(fresh.out, 5, DICTIONARY)
        fresh.attach(node)
        kept = {
            mux: node.dictionary.variable((mux >> 8, mux & 0xFF)).encode(value)
            for mux, value in anything.node.storage.saved.items()
        }
        assert node.storage.load(kept) == []
        node.boot(0)
        assert node.values.store == anything.node.values.store
        assert sorted(fresh.can_ids()) == sorted(anything.network.can_ids())
        assert node.state is anything.node.state
        assert anything.node.communication.emcy.active == ()
        anything.node.values.store[LIMITED << 8] = 11
        anything.node.values.store[OUTPUT << 8] = 3
