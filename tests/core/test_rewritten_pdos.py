"""PDOs that we write while they are exchanged: whoever of us writes one, in whatever way and however far it gets, and whenever
the device is reset, a value that comes by a PDO is the device's or none, and nothing that we send lands in another object. The
master may take in what has come in bursts.

The oracle: each object of the device has one value for ever, and no two have a byte in common. So a wrong mapping shows.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Direction, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import COB_ID_INVALID, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.pdo.configure import PdoRefusedError, configure_pdo, exchange_device_pdos, use_device_pdo
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.procedures.runner import ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure, download
from canopen_proto.remote_node import RemoteNode
from tests.core.bus import Bus
from tests.examples import examples

NODE = 5
U8, U16 = DataType.UNSIGNED8, DataType.UNSIGNED16
INPUTS = {0x2000: (U8, 0x10), 0x2001: (U8, 0x11), 0x2002: (U8, 0x12), 0x2010: (U16, 0x2122), 0x2011: (U16, 0x2324)}
OUTPUTS = {0x3000: (U8, 0x40), 0x3001: (U8, 0x41), 0x3002: (U8, 0x42), 0x3010: (U16, 0x5152), 0x3011: (U16, 0x5354)}
VALUE = {index << 8: value for index, (_, value) in (INPUTS | OUTPUTS).items()}
CAN_IDS = {
    (Direction.TPDO, 1): (0x185, 0x195),
    (Direction.TPDO, 2): (0x285, 0x295),
    (Direction.RPDO, 1): (0x205, 0x215),
    (Direction.RPDO, 2): (0x305, 0x315),
}
"""Two for each PDO: PDOs that share one cannot be told apart by anybody."""


def dictionary() -> ObjectDictionary:
    objects = [standard_object(0x1000, 0x191), standard_object(0x1001), standard_object(0x1018, highest=1)]
    for index, (data_type, _) in (INPUTS | OUTPUTS).items():
        objects.append(Object.of(f"o{index:x}", [Variable(index, 0, f"o{index:x}", data_type, Access.RW, pdo_mappable=True)]))
    for offset in (0, 1):
        objects += [
            standard_object(0x1400 + offset, highest=5, defaults={1: CAN_IDS[Direction.RPDO, offset + 1][0], 2: 255}),
            standard_object(0x1600 + offset, highest=3, defaults={0: 1, 1: 0x30000008 + 0x10000 * offset}),
            standard_object(0x1800 + offset, highest=5, defaults={1: CAN_IDS[Direction.TPDO, offset + 1][0], 2: 255}),
            standard_object(0x1A00 + offset, highest=3, defaults={0: 1, 1: 0x20000008 + 0x10000 * offset}),
        ]
    return ObjectDictionary(objects)


def entries_of(direction: Direction) -> list[int]:
    objects = INPUTS if direction is Direction.TPDO else OUTPUTS
    return [index << 16 | (8 if data_type is U8 else 16) for index, (data_type, _) in objects.items()]


class Stalled(Network):
    """Takes in what has come only so long (ns) after the first of it, all at once."""

    def __init__(self, stall: Time) -> None:
        super().__init__()
        self.stall = stall
        self.due = NEVER
        self.left: list[tuple[Frame, None]] = []

    def receive(self, frame: Frame, now: Time, timestamp: int | None = None) -> None:
        self.left.append((frame, None))
        self.due = min(self.due, now + self.stall)

    def next_deadline(self) -> Time:
        return min(super().next_deadline(), self.due)

    def handle_timeout(self, now: Time) -> None:
        if now >= self.due:
            burst, self.left, self.due = self.left, [], NEVER
            assert self.receive_many(iter(burst), now) is None
        super().handle_timeout(now)


class World:
    """A device whose objects never change, and a master with two PDOs of each direction. stall: ns, see Stalled; 0: it takes in
    each frame by itself."""

    def __init__(self, loss: float, stall: Time = 0) -> None:
        self.loss = loss
        self.stall = stall
        self.bus = Bus(seed=1)
        self.master = self.bus.attach(Stalled(stall) if stall else Network())
        self.remote = RemoteNode(self.master.out, NODE, dictionary())
        self.master.attach(self.remote)
        network = self.bus.attach(Network())
        self.device = LocalNode(network.out, NODE, dictionary())
        network.attach(self.device)
        self.device.boot(0)
        self.bus.run(SECOND)
        self.device.values.store.update(VALUE)
        self.remote.values.store.update(VALUE)
        self.start()
        self.received = 0
        self.bus.disturb((100 * MICROSECOND, 100 * MICROSECOND), loss)

    def reset(self) -> None:
        """Reset the device; its objects have their values again at once. Its boot-up is never lost."""
        self.bus.pump()
        self.bus.disturb((100 * MICROSECOND, 100 * MICROSECOND))
        self.device.execute(NmtCommand.RESET_NODE, self.bus.now)
        self.device.values.store.update(VALUE)
        self.bus.pump()
        self.bus.disturb((100 * MICROSECOND, 100 * MICROSECOND), self.loss)

    def start(self) -> None:
        """Start the device, once the master has heard what was on its way."""
        self.bus.run(self.stall + MILLISECOND)
        self.device.execute(NmtCommand.START, self.bus.now)
        self.remote.on_nmt_command(NmtCommand.START, self.bus.now)

    def look(self) -> None:
        """Have all be sent that can be sent, and compare."""
        if self.device.state is not NmtState.OPERATIONAL:
            self.start()
        now = self.bus.now
        for index in INPUTS:
            self.device.pdos.trigger(index << 8, now)
        for number, producer in self.remote.rpdos.items():
            try:
                self.remote.enable_rpdo(number, now)
            except LocalProtocolError:
                assert (Direction.RPDO, number) in self.remote.unread_pdos
            producer.trigger(now)
        self.remote.on_sync(None, now)
        self.bus.run(2 * MILLISECOND + self.stall)
        for event in self.bus.events:
            if isinstance(event, PdoReceived):
                self.received += 1
                for key, value in zip(event.mapping.muxes, event.values.values(), strict=True):
                    assert value == VALUE[key], (event, f"{key:X}")
        for index in OUTPUTS:
            assert self.device.values.store[index << 8] == VALUE[index << 8], f"{index:X}"
        self.bus.events.clear()


def device_tpdos(world: World) -> list[PdoSettings]:
    """The TPDOs of the device, as its own objects say."""
    found = []
    for number in (1, 2):
        store: Any = world.device.values.store
        count = store[(0x1A00 + number - 1) << 8]
        entries = tuple(store[(0x1A00 + number - 1) << 8 | subindex] for subindex in range(1, count + 1))
        found.append(PdoSettings(number, Direction.TPDO, store[(0x1800 + number - 1) << 8 | 1], 255, entries))
    return found


def by_hand(direction: Direction, number: int, can_id: int, entries: list[int]) -> list[tuple[int, int, bytes]]:
    """The downloads that map a PDO anew, and create it."""
    record = (0x1400 if direction is Direction.RPDO else 0x1800) + number - 1
    present = CAN_IDS[direction, number][0] | COB_ID_INVALID
    mapped = [(record + 0x200, subindex, entry.to_bytes(4, "little")) for subindex, entry in enumerate(entries, start=1)]
    clear, count = (record + 0x200, 0, b"\0"), (record + 0x200, 0, bytes([len(entries)]))
    return [(record, 1, present.to_bytes(4, "little")), clear, *mapped, count, (record, 1, can_id.to_bytes(4, "little"))]


def steps() -> st.SearchStrategy[list[tuple[Any, ...]]]:
    """What the master does, each time for a PDO, and in quarters of a millisecond how long it waits then."""
    place = st.tuples(st.sampled_from(Direction), st.integers(1, 2))

    def of(where: tuple[Direction, int]) -> st.SearchStrategy[tuple[Any, ...]]:
        first, second = CAN_IDS[where]
        cob_id = st.sampled_from([first, first, second, second, first | COB_ID_INVALID])
        left_out = st.sampled_from([(), (), (), (0,), (1,), (1, 2, 3), (1, 2, 3, 4), (6,)])  # of the steps by hand
        entries = st.lists(st.sampled_from(entries_of(where[0])), min_size=1, max_size=3, unique=True)
        return st.one_of(
            st.tuples(st.just("configure"), st.just(where), cob_id, entries),
            st.tuples(st.just("by hand"), st.just(where), cob_id, entries, left_out),
            st.tuples(st.just("use"), st.just(where)),
            st.just(("exchange all",)),
            st.just(("reset",)),
            st.just(("look",)),
        )

    return st.lists(st.tuples(place.flatmap(of), st.sampled_from([0, 1, 2, 3, 5, 8, 13, 40, 80])), min_size=3, max_size=8)


@given(steps(), st.sampled_from([0.0, 0.0, 0.1]), st.sampled_from([0, 0, MILLISECOND, 5 * MILLISECOND, 100 * MILLISECOND]))
@examples(600)
def test_a_value_by_pdo_is_the_devices_or_none_whoever_of_us_writes_the_pdo(
    all_steps: list[tuple[Any, ...]], loss: float, stall: Time
) -> None:
    world = World(loss, stall)
    remote, network = world.remote, world.master
    network.run(exchange_device_pdos(remote), world.bus.now)
    world.bus.run(5 * SECOND)
    world.look()
    for (what, *more), quarters in all_steps:
        now = world.bus.now
        if what == "configure":
            (direction, number), cob_id, entries = more
            network.run(configure_pdo(remote, PdoSettings(number, direction, cob_id, 255, tuple(entries))), now)
        elif what == "by hand":
            (direction, number), cob_id, entries, left_out = more
            for position, download in enumerate(by_hand(direction, number, cob_id, entries)):
                if position not in left_out:
                    remote.sdo.download(*download, now)
        elif what == "use":
            network.run(use_device_pdo(remote, *more[0]), now)
        elif what == "exchange all":
            network.run(exchange_device_pdos(remote), now)
        elif what == "reset":
            world.reset()
        else:
            world.look()
        world.bus.run(quarters * MILLISECOND // 4)
    world.bus.run(SECOND)
    world.look()
    world.bus.disturb((100 * MICROSECOND, 100 * MICROSECOND))
    world.bus.run(20 * SECOND)  # whatever waits for a lost answer has ended
    for pdo in device_tpdos(world):
        if pdo.number in remote.tpdos and pdo.is_valid and pdo.entries:
            exchanged = remote.tpdos[pdo.number]
            assert (exchanged.key, exchanged.mapping.parameters) == (pdo.key, pdo.entries)
    world.master.run(exchange_device_pdos(world.remote), world.bus.now)
    world.bus.run(10 * SECOND)
    assert not world.remote.unread_pdos
    before = world.received
    world.look()
    assert world.received > before or not any(each.is_valid and each.entries for each in device_tpdos(world))


def test_what_a_user_has_described_stands_whatever_is_written() -> None:
    """Who describes the PDOs first, and then sets up the device by bytes, as many masters do, knows what they are."""
    world = World(0.0)
    mapping = Mapping.from_parameters([0x30010008], world.remote.dictionary)
    world.remote.add_rpdo(1, 0x205, mapping, 255)
    world.remote.add_tpdo(1, 0x185, Mapping.from_parameters([0x20010008], world.remote.dictionary), world.bus.now)
    for direction, can_id, entry in ((Direction.RPDO, 0x205, 0x30010008), (Direction.TPDO, 0x185, 0x20010008)):
        for each in by_hand(direction, 1, can_id, [entry]):
            world.remote.sdo.download(*each, world.bus.now)
    world.bus.run(SECOND)
    world.bus.sent.clear()
    world.look()
    assert "205#41" in world.bus.trace()
    assert world.received > 0


def test_an_rpdo_that_was_mapped_anew_is_not_sent_until_it_is_exchanged_anew() -> None:
    world = World(0.0)
    world.master.run(exchange_device_pdos(world.remote), world.bus.now)
    world.bus.run(SECOND)
    world.look()
    for each in by_hand(Direction.RPDO, 1, 0x205, [0x30010008]):
        world.remote.sdo.download(*each, world.bus.now)
    world.bus.run(SECOND)
    world.bus.sent.clear()
    world.look()
    assert not [frame for frame in world.bus.trace() if frame.startswith("205#")]
    with pytest.raises(LocalProtocolError, match="RPDO 1 of node 5 was set up anew"):
        world.remote.enable_rpdo(1, world.bus.now)
    world.master.run(exchange_device_pdos(world.remote), world.bus.now)
    world.bus.run(SECOND)
    world.bus.sent.clear()
    world.look()
    assert "205#41" in world.bus.trace()


@pytest.mark.parametrize("wait", range(13))
def test_a_pdo_that_is_moved_while_it_is_read_is_received_where_it_is(wait: int) -> None:
    world = World(0.0)
    world.master.run(exchange_device_pdos(world.remote), world.bus.now)
    world.bus.run(wait * MILLISECOND // 4)
    for cob_id in (0x185 | COB_ID_INVALID, 0x195):
        world.remote.sdo.download(0x1800, 1, cob_id.to_bytes(4, "little"), world.bus.now)
    world.bus.run(SECOND)
    assert (Direction.TPDO, 1) in world.remote.unread_pdos or world.remote.tpdos[1].key == 0x195


def test_whatever_resets_a_device_never_is_a_pdo_used_by_the_mapping_that_the_reset_has_undone() -> None:
    world = World(0.0)
    remote, network, bus = world.remote, world.master, world.bus
    network.run(exchange_device_pdos(remote), bus.now)
    bus.run(SECOND)
    for direction, cob_id, entry in ((Direction.RPDO, 0x205, 0x3001_0008), (Direction.TPDO, 0x185, 0x2001_0008)):
        network.run(configure_pdo(remote, PdoSettings(1, direction, cob_id, 255, (entry,))), bus.now)
        bus.run(SECOND)
    world.look()
    assert not remote.unread_pdos
    world.reset()
    world.look()
    assert remote.unread_pdos == {(Direction.RPDO, 1), (Direction.TPDO, 1)}  # number 2 is as it was
    with pytest.raises(LocalProtocolError, match="RPDO 1 of node 5 was set up anew, or reset"):
        remote.enable_rpdo(1, bus.now)
    network.run(exchange_device_pdos(remote), bus.now)
    bus.run(SECOND)
    world.reset()
    world.look()
    assert not remote.unread_pdos  # nobody has written it since the last boot


@pytest.mark.parametrize("quarters", range(0, 14, 2))
@pytest.mark.parametrize("direction", Direction)
def test_whoever_sets_up_a_pdo_beside_another_never_are_both_told_that_it_is_done(direction: Direction, quarters: int) -> None:
    """The downloads of two procedures take turns on the wire: the device has some entries of the one and some of the other."""
    world = World(0.0)
    remote, network, bus = world.remote, world.master, world.bus
    network.run(exchange_device_pdos(remote), bus.now)
    bus.run(SECOND)
    cob_id = CAN_IDS[direction, 1][0]
    first, second, third = entries_of(direction)[:3]
    ours = [
        PdoSettings(1, direction, cob_id, 255, (first, second, third)),
        PdoSettings(1, direction, cob_id, 255, (first, third)),
    ]
    ids = []
    for settings in ours:
        ids.append(network.run(configure_pdo(remote, settings), bus.now))
        bus.run(quarters * MILLISECOND // 4)
    bus.run(SECOND)
    ended = {each.request_id: each for each in bus.events if isinstance(each, (ProcedureFinished, ProcedureFailed))}
    store: Any = world.device.values.store
    record = (0x1600 if direction is Direction.RPDO else 0x1A00) << 8
    held = tuple(store[record | subindex] for subindex in range(1, store[record] + 1))
    done = [settings for settings, each in zip(ours, ids, strict=True) if isinstance(ended[each], ProcedureFinished)]
    assert not done or done[-1].entries == held
    for each in ids:
        error = getattr(ended[each], "error", None)
        if error is not None:
            assert isinstance(error, PdoRefusedError)
            assert not error.restored
            assert "somebody else of this program wrote this PDO at the same time" in str(error)
    world.look()
    network.run(exchange_device_pdos(remote), bus.now)
    bus.run(SECOND)
    world.look()


@pytest.mark.parametrize("all_of_them", [False, True])
@pytest.mark.parametrize("direction", Direction)
def test_a_pdo_that_somebody_else_has_destroyed_is_not_exchanged_once_it_was_read_again(
    direction: Direction, all_of_them: bool
) -> None:
    """Or a controlword would go into an RPDO that the device does not have any more."""
    world = World(0.0)
    remote, network, bus = world.remote, world.master, world.bus
    described = Mapping.from_parameters([entries_of(direction)[1]], remote.dictionary)
    add = remote.add_rpdo if direction is Direction.RPDO else partial(remote.add_tpdo, now=0)
    add(2, CAN_IDS[direction, 2][0], described)
    network.run(use_device_pdo(remote, direction, 1), bus.now)
    bus.run(SECOND)
    exchanged: dict[int, Any] = remote.rpdos if direction is Direction.RPDO else remote.tpdos
    assert set(exchanged) == {1, 2}
    record = 0x1400 if direction is Direction.RPDO else 0x1800
    for number in (1, 2):
        world.device.set_value(record + number - 1, 1, CAN_IDS[direction, number][0] | COB_ID_INVALID, bus.now)
    again: Any = exchange_device_pdos(remote) if all_of_them else use_device_pdo(remote, direction, 1)
    network.run(again, bus.now)
    bus.run(SECOND)
    assert set(exchanged) == {2}  # which its user has described


@pytest.mark.parametrize("is_reset", [False, True])
def test_whatever_was_mapped_anew_never_is_another_master_said_to_have_written_what_it_did_not(is_reset: bool) -> None:
    """Its RPDO is told in words by the mapping that the device had when it came, or not at all."""
    world = World(0.0)
    remote, network, bus = world.remote, world.master, world.bus
    heard, objects = remote.foreign_writes, (Mux(0x3000_00), Mux(0x3001_00))
    network.run(exchange_device_pdos(remote), bus.now)
    bus.run(SECOND)
    heard.listen(objects, lambda now: None)

    def said() -> list[Any]:
        bus.run(MILLISECOND)
        return [None if found is None else found.value for found in map(heard.last, objects)]

    bus.send("205#40")
    assert said() == [0x40, None]
    for each in by_hand(Direction.RPDO, 1, 0x205, [0x3001_0008]):
        remote.sdo.download(*each, bus.now)
    bus.run(SECOND)
    assert said() == [None, None]
    bus.send("205#41")
    assert said() == [None, None]
    assert heard.unknown == {0x205}
    if is_reset:
        network.run(exchange_device_pdos(remote), bus.now)
        bus.run(SECOND)
        world.reset()
        assert said() == [None, None]
        bus.send("205#40")
        assert said() == [None, None]
    network.run(exchange_device_pdos(remote), bus.now)
    bus.run(SECOND)
    assert said() == [None, None]  # what came before it was read
    bus.send("205#42")
    assert said() == ([0x42, None] if is_reset else [None, 0x42])


def test_a_pdo_that_has_become_an_mpdo_is_not_exchanged_by_its_old_mapping() -> None:
    world = World(0.0)
    for count, exchanged in ((1, {1, 2}), (254, {2})):
        world.device.values.store[Mux(0x1A00_00)] = count
        world.master.run(exchange_device_pdos(world.remote), world.bus.now)
        world.bus.run(SECOND)
        assert set(world.remote.tpdos) == exchanged


def of_eight_objects() -> ObjectDictionary:
    """A device whose RPDO has so many objects that reading their values takes longer than to map it anew."""
    outputs = [Variable(index, 0, f"o{index:x}", U8, Access.RW, pdo_mappable=True) for index in range(0x3000, 0x3008)]
    objects = [standard_object(0x1000, 0x191), standard_object(0x1001), standard_object(0x1018, highest=1)]
    objects += [Object.of(each.name, [each]) for each in outputs]
    entries = {0: 8} | {number + 1: 0x3000_0008 + 0x1_0000 * number for number in range(8)}
    objects.append(standard_object(0x1400, highest=5, defaults={1: 0x205, 2: 255}))
    objects.append(standard_object(0x1600, highest=8, defaults=entries))
    return ObjectDictionary(objects)


@pytest.mark.parametrize("wait", range(0, 40, 2))
def test_an_rpdo_that_is_mapped_anew_while_its_values_are_read_is_not_exchanged_by_its_old_mapping(wait: int) -> None:
    bus = Bus(seed=1)
    master, network = bus.attach(Network()), bus.attach(Network())
    remote = RemoteNode(master.out, NODE, of_eight_objects())
    master.attach(remote)
    device = LocalNode(network.out, NODE, of_eight_objects())
    network.attach(device)
    device.boot(0)
    bus.run(SECOND)
    bus.disturb((100 * MICROSECOND, 100 * MICROSECOND))
    master.run(exchange_device_pdos(remote), bus.now)
    bus.run(wait * MILLISECOND // 8)
    master.run(configure_pdo(remote, PdoSettings(1, Direction.RPDO, 0x205, 255, (0x3007_0008,))), bus.now)
    bus.run(SECOND)
    assert remote.rpdos[1].mapping.parameters == (0x3007_0008,)
    assert not remote.unread_pdos


@pytest.mark.parametrize("at_sync", [False, True])
def test_an_event_driven_rpdo_that_is_configured_anew_is_sent_when_it_was_sent_before(at_sync: bool) -> None:
    world = World(0.0)
    exchange = exchange_device_pdos(world.remote) if at_sync else use_device_pdo(world.remote, Direction.RPDO, 1)
    world.master.run(exchange, world.bus.now)
    world.bus.run(SECOND)
    world.master.run(configure_pdo(world.remote, PdoSettings(1, Direction.RPDO, 0x205, 255, (0x3001_0008,))), world.bus.now)
    world.bus.run(SECOND)
    world.remote.enable_rpdo(1, world.bus.now)
    world.bus.run(MILLISECOND)
    world.bus.sent.clear()
    world.remote.on_sync(None, world.bus.now)
    world.bus.run(MILLISECOND)
    assert ("205#41" in world.bus.trace()) is at_sync


@pytest.mark.parametrize("wait", [50, 100, 150])
def test_a_tpdo_whose_write_was_cancelled_before_its_answer_came_is_not_received(wait: int) -> None:
    world = World(0.0)
    world.master.run(exchange_device_pdos(world.remote), world.bus.now)
    world.bus.run(SECOND)

    def moved() -> Procedure[None]:
        yield from download(world.remote.sdo, 0x1801, 1, (0x295).to_bytes(4, "little"))

    request_id = world.master.run(moved(), world.bus.now)
    world.bus.run(wait * MICROSECOND)
    world.master.cancel(request_id, world.bus.now)
    world.bus.run(SECOND)
    assert (Direction.TPDO, 2) in world.remote.unread_pdos
    assert 2 not in world.remote.tpdos
