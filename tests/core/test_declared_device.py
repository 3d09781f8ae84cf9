"""A device declared in code: its dictionary, its values, what it is asked and told, and what its mistakes do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, ValueRangeError
from canopen_proto.declared import DeclaredDevice, DeviceCodeFailed, Nameplate, Rpdo, Tpdo, array, variable
from canopen_proto.declared.dictionary import dictionary_of
from canopen_proto.dictionary import Access, ObjectDictionary
from canopen_proto.dictionary.standard import STANDARD, standard_object
from canopen_proto.local_node import LocalNode
from canopen_proto.lss.messages import UNCONFIGURED
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outbox
from canopen_proto.multiplexer import mux
from canopen_proto.sdo.events import ObjectWritten
from canopen_proto.simulation.boot_loader import BootLoader, boot_loader_dictionary
from tests.core.device_bench import PRE_OPERATIONAL, RESET_NODE, START, SYNC, DeviceBench
from tests.examples import examples

PLATE = Nameplate("Kettle", "Maker", vendor_id=0x7F, product_code=2, device_type=0x0002_0191)


class Kettle(DeclaredDevice):
    """Boils water."""

    nameplate = PLATE
    period = 10 * MILLISECOND

    heaters = array(0x6200, "Heater", DataType.UNSIGNED8, ["Base", "Lid"], access=Access.RWW)
    probes = array(0x6401, "Probe", DataType.INTEGER16, 2, access=Access.RO, pdo=True, unit="0.1 degC")
    limit = variable(0x2000, "Limit", DataType.UNSIGNED8, 100, high_limit=110, unit="degC")
    water = variable((0x2100, 1), "Tank:Water", DataType.REAL32, access=Access.RO, pdo=True)
    label = variable((0x2100, 2), "Tank:Label", DataType.VISIBLE_STRING, "kitchen")
    is_on = variable(0x2200, "Is on", DataType.BOOLEAN, access=Access.RO)
    pdos = (Rpdo(1, heaters), Tpdo(1, probes), Tpdo(2, water, transmission_type=1), Tpdo(5, probes[2], event_time=SECOND))

    def __init__(self, out: Outbox, node_id: int, dictionary: ObjectDictionary | None = None) -> None:
        super().__init__(out, node_id, dictionary)
        self.log: list[str] = []
        self.level = 1.5
        self.broken: type[Exception] | None = None

    def start(self) -> None:
        self.log.append("start")

    def step(self) -> None:
        if self.broken is not None:
            raise self.broken("no water")
        self.log.append(f"step {self.now // MILLISECOND}")

    def sync(self) -> None:
        self.log.append("sync")

    def stop(self, error_code: int) -> None:
        self.log.append(f"stop {error_code:04X}")
        self.heaters[1] = 0

    @limit.check
    def _even(self, value: int) -> AbortCode | None:
        return AbortCode.INVALID_VALUE if value % 2 else None

    @limit.on_write
    def _limited(self, value: int) -> None:
        self.log.append(f"limit {value}")
        self.probes[1] = 10 * value

    @heaters.on_write
    def _heat(self, subindex: int, value: int) -> None:
        self.log.append(f"heater {subindex} = {value}")
        self.is_on = any(self.heaters)

    @water.on_read
    def _level(self) -> Any:
        return self.level


class Bare(DeclaredDevice):
    """Has nothing but what each device has."""

    nameplate = Nameplate("Bare")


def kettle(kind: type[Kettle] = Kettle) -> tuple[DeviceBench, Kettle]:
    made: list[Kettle] = []

    def make(out: Outbox, node_id: int, dictionary: ObjectDictionary) -> LocalNode:
        made.append(kind(out, node_id))
        return made[0].node

    bench = DeviceBench(make=make)
    assert made[0].log == ["start"]
    made[0].log.clear()
    return bench, made[0]


# ---- the dictionary ----


def test_the_objects_are_as_declared() -> None:
    dictionary = Kettle.dictionary
    assert [variable.name for variable in dictionary.objects[0x6200].variables.values()] == [
        "Highest sub-index supported", "Base", "Lid",
    ]  # fmt: skip
    assert dictionary.variable("Probe:Probe 2").unit == "0.1 degC"
    assert dictionary.at(0x2000, 0).high_limit == 110
    assert dictionary.at(0x2100, 0).default == 2
    assert dictionary.variable("Tank:Label").default == "kitchen"
    assert dictionary.at(0x1018, 1).default == 0x7F
    assert dictionary.at(0x1008, 0).default == "Kettle"
    assert dictionary.at(0x1400, 1).default_of(5) == 0x205
    assert dictionary.at(0x1801, 1).default_of(5) == 0x4000_0285
    assert dictionary.at(0x1804, 1).default_of(0) == 0xC000_0000
    assert (dictionary.at(0x1804, 5).default, dictionary.at(0x1801, 2).default) == (1000, 1)
    assert [dictionary.at(0x1A00, each).default for each in range(3)] == [2, 0x6401_0110, 0x6401_0210]


def test_standard_objects_are_found_by_their_names_in_the_standard_table() -> None:
    found = 0
    for (index, subindex), standard in STANDARD.items():
        if Kettle.dictionary.get(index, subindex) is not None and index < 0x2000:
            assert Kettle.dictionary.variable(standard.name).mux == standard.mux
            found += 1
    assert found > 20


def test_further_standard_objects_and_those_that_are_left_out() -> None:
    class Plain(Kettle):
        standard = (standard_object(indices.PRODUCER_HEARTBEAT_TIME, 500), standard_object(indices.GUARD_TIME, 0))
        without = (indices.STORE_PARAMETERS, indices.RESTORE_DEFAULT_PARAMETERS)

    assert Plain.dictionary.at(0x1017, 0).default == 500
    assert Plain.dictionary.has_index(0x100C)
    assert not Plain.dictionary.has_index(0x1010)
    assert Kettle.dictionary.at(0x1017, 0).default == 0


def test_a_class_without_a_nameplate_declares_for_those_below_it() -> None:
    class Shared(DeclaredDevice):
        hours = variable(0x2000, "Hours", DataType.UNSIGNED32)

    class Whole(Shared):
        nameplate = Nameplate("Whole")

    assert not hasattr(Shared, "dictionary")
    with pytest.raises(LocalProtocolError, match="Shared has no nameplate: `nameplate = Nameplate"):
        Shared(Outbox(), 5)
    assert Whole.dictionary.at(0x2000, 0).name == "Hours"


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (lambda: variable(0x1017, "Heartbeat", DataType.UNSIGNED16), "0x1017: a device declares objects at 0x2000"),
        (lambda: variable((0x2000, 1), "Field", DataType.UNSIGNED8), "record:field"),
        (lambda: variable((0x2000, 255), "A:B", DataType.UNSIGNED8), "record:field"),
        (lambda: variable(0x2000, "A:B", DataType.UNSIGNED8), "record:field"),
        (lambda: array(0x2000, "None", DataType.UNSIGNED8, 0), "has 0 entries"),
        (lambda: array(0x2000, "Many", DataType.UNSIGNED8, 255), "has 255 entries"),
        (lambda: Tpdo(513, Kettle.probes), "1..512"),
        (lambda: Tpdo(1, *[Kettle.probes] * 3), "96 bits"),
        (lambda: Tpdo(1, Kettle.heaters), "TPDO 1 cannot carry Base"),
        (lambda: Rpdo(1, Kettle.probes), "RPDO 1 cannot carry Probe 1"),
        (lambda: Rpdo(1, Kettle.limit), "cannot carry Limit"),
        (lambda: dictionary_of(PLATE, [Kettle.limit, Kettle.limit]), "is 'Limit' already"),
        (lambda: dictionary_of(PLATE, [Kettle.water, Kettle.water]), "is 'Tank' already"),
    ],
)
def test_a_declaration_that_cannot_be_is_refused(wrong: Any, text: str) -> None:
    with pytest.raises(LocalProtocolError, match=text):
        wrong()


def test_an_object_never_stands_in_place_of_what_a_device_is_made_of() -> None:
    own = {name for name in {*dir(Bare), *vars(Bare(Outbox(), 5))} if not name.startswith("__")}
    assert {"acting", "deadline", "node", "now", "out", "pdos", "period", "start", "_declared"} <= own
    for name in own | {"nameplate", "__init__"}:
        text = rf"Wrong\.{name}: 0x2000 'Period' needs another attribute.* node, now, on_sync, out"
        with pytest.raises(LocalProtocolError, match=text):
            type("Wrong", (DeclaredDevice,), {name: variable(0x2000, "Period", DataType.UNSIGNED16, 100)})
    with pytest.raises(LocalProtocolError, match=r"Wrong\.period: .* \bstep\b"):
        type("Wrong", (Kettle,), {"period": array(0x2000, "Periods", DataType.UNSIGNED16, 2)})


@pytest.mark.parametrize(
    ("facts", "text"),
    [
        ({"product_code": -1}, "product_code=-1 .*0..0xFFFFFFFF"),
        ({"vendor_id": 1 << 40}, "vendor_id=1099511627776 "),
        ({"revision": "x"}, "revision='x' "),
        ({"serial_number": True}, "serial_number=True "),
        ({"device_type": 1.0}, "device_type=1.0 "),
        ({"vendor_name": None}, "vendor_name=None .*a text"),
        ({"product_name": 5}, "product_name=5 "),
        ({"hardware_version": 1}, "hardware_version=1 "),
        ({"software_version": "1 \u0394"}, "VISIBLE_STRING"),
        ({"description": b"kettle"}, "description=b'kettle' "),
        ({"bit_rates": 500}, "bit_rates=500 "),
        ({"bit_rates": {500_000}}, "500000.*kbit/s: 10, 20, 50"),
    ],
)
def test_a_nameplate_that_cannot_be_is_refused_when_it_is_made(facts: dict[str, Any], text: str) -> None:
    with pytest.raises(LocalProtocolError, match=text):
        Nameplate(**{"product_name": "Kettle"} | facts)


def test_what_is_no_nameplate_is_refused_with_its_class() -> None:
    with pytest.raises(LocalProtocolError, match="Wrong.nameplate is 'Kettle', no Nameplate"):
        type("Wrong", (DeclaredDevice,), {"nameplate": "Kettle"})


def test_a_default_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueRangeError, match="Small"):
        variable(0x2000, "Small", DataType.UNSIGNED8, 256)
    with pytest.raises(ValueRangeError, match="Low"):
        array(0x2000, "Low", DataType.UNSIGNED8, 2, 1, low_limit=5)


# ---- values ----


def test_a_value_that_is_set_goes_out_once() -> None:
    bench, device = kettle()
    assert "185#00000000" in bench.tell(START)
    with device.acting(bench.now):
        device.probes[2] = 0x102
        device.probes[2] = 0x102
    assert bench.take() == ["185#00000201"]
    assert bench.number(0x6401, 2) == 0x102
    assert (list(device.probes), len(device.probes), device.label) == ([0, 0x102], 2, "kitchen")


def test_a_value_that_cannot_be_is_refused() -> None:
    _, device = kettle()
    with device.acting(0), pytest.raises(ValueRangeError, match="Probe 1"):
        device.probes[1] = 1 << 15
    with pytest.raises(IndexError, match=r"1\.\.2"):
        device.probes[3]
    with pytest.raises(IndexError, match=r"1\.\.2"):
        device.probes[0] = 1
    with pytest.raises(AttributeError, match="Probe is an array: set its values"):
        device.probes = [1, 2]  # type: ignore[assignment]


# ---- what a device is asked and told ----


def test_a_write_is_checked_first_and_acted_on_behind() -> None:
    bench, device = kettle()
    bench.tell(START)
    assert bench.write(0x2000, 0, 50, 1) is None
    assert bench.others == ["185#F4010000"]
    assert bench.write(0x2000, 0, 51, 1) == AbortCode.INVALID_VALUE
    assert bench.write(0x2000, 0, 112, 1) == AbortCode.VALUE_TOO_HIGH
    assert (device.limit, device.log) == (50, ["limit 50"])
    assert bench.write(0x6401, 1, 5, 2) == AbortCode.READ_ONLY


def test_pdos_are_told_entry_by_entry() -> None:
    bench, device = kettle()
    bench.tell(START, "205#0700")
    assert device.log == ["heater 1 = 7", "heater 2 = 0"]
    assert device.is_on
    bench.tell(PRE_OPERATIONAL)
    assert device.log[2:] == ["stop 8100"]
    assert list(device.heaters) == [0, 0]


def test_outputs_are_safe_when_their_pdo_does_not_come_in_its_event_time() -> None:
    class Watched(Kettle):
        pdos = (Rpdo(1, Kettle.heaters, event_time=50 * MILLISECOND),)

    bench, device = kettle(Watched)
    bench.tell(START, "205#0700")
    bench.wait(40)
    bench.tell("205#0701")
    assert bench.wait(49) == []
    assert list(device.heaters) == [7, 1]
    assert bench.wait(1) == ["90 085#5082110100000000"]
    assert (list(device.heaters), device.log[-1]) == ([0, 1], "stop 8250")  # Kettle.stop is about heater 1
    bench.wait(100)
    assert device.log.count("stop 8250") == 1
    assert bench.tell("205#0900") == ["085#0000000000000000"]
    assert list(device.heaters) == [9, 0]


def test_a_read_asks_the_device_and_so_does_a_tpdo_at_sync() -> None:
    bench, device = kettle()
    assert bench.read(0x2100, 1) == b"\x00\x00\xc0\x3f"
    device.level = 2.0
    bench.tell(START)
    assert bench.tell(SYNC) == ["285#00000040"]
    assert device.log == ["sync"]
    device.level = AbortCode.LOCAL_CONTROL  # type: ignore[assignment]
    assert bench.read(0x2100, 1) == AbortCode.LOCAL_CONTROL
    assert device.water == 2.0


def test_the_entries_of_an_array_are_asked_by_subindex_and_their_number_is_not() -> None:
    class Probed(Kettle):
        levels = array(0x6402, "Level", DataType.UNSIGNED8, 2, access=Access.RO)

        @levels.on_read
        def _measure(self, subindex: int) -> int:
            return 10 * subindex

    bench, _ = kettle(Probed)
    assert [bench.number(0x6402, subindex) for subindex in range(3)] == [2, 10, 20]


def test_steps_keep_their_phase_and_begin_again_with_a_reset() -> None:
    bench, device = kettle()
    bench.wait(25)
    assert device.log == ["step 10", "step 20"]
    bench.now += 30 * MILLISECOND
    bench.network.handle_timeout(bench.now)  # late: 25 ms over the one that was due
    bench.wait(5)
    assert device.log[2:] == ["step 55", "step 60"]
    device.log.clear()
    bench.write(0x2000, 0, 50, 1)
    bench.tell(RESET_NODE)
    bench.wait(10)
    assert device.log == ["limit 50", "stop 8100", "start", "step 70"]
    assert device.limit == 100


def test_a_device_without_a_period_makes_no_steps() -> None:
    class Still(Kettle):
        period = 0

    bench, device = kettle(Still)
    bench.wait(1000)
    assert device.log == []


def test_outputs_are_no_parameters_that_come_back_with_the_power() -> None:
    bench, device = kettle()
    bench.tell(START, "205#0700")
    bench.write(0x2000, 0, 50, 1)
    device.node.storage.begin(0x1010, 1)
    device.node.storage.commit(0x1010, 1)
    saved = device.node.storage.saved
    assert saved[Kettle.limit.variables[0].mux] == 50
    assert not [mux for mux in saved if mux >> 8 == 0x6200]


def test_errors_of_the_device() -> None:
    bench, device = kettle()
    with device.acting(bench.now):
        device.raise_error(0x4210, b"\x01")
    assert bench.take() == ["085#1042090100000000"]
    assert bench.number(0x1001) == 9
    with device.acting(bench.now):
        device.clear_error(0x4210)
    assert bench.take() == ["085#0000000000000000"]


def test_lss_gives_it_a_node_id() -> None:
    device = Kettle(Outbox(), UNCONFIGURED)
    assert device.node.lss.address[:2] == (0x7F, 2)
    assert not device.node.lss.is_configured


# ---- mistakes ----


def test_an_exception_of_a_step_brings_the_outputs_to_rest_and_is_told() -> None:
    bench, device = kettle()
    bench.tell(START, "205#0700")
    device.log.clear()
    device.broken = ZeroDivisionError
    bench.events.clear()
    sent = bench.wait(25)
    assert [each for each in sent if "085#" in each] == ["10 085#0062010000000000"]
    assert device.log == ["stop 6200", "stop 6200"]
    assert list(device.heaters) == [0, 0]
    failed = bench.seen(DeviceCodeFailed)
    assert [(each.node_id, each.function, str(each.error)) for each in failed] == [(5, "step", "no water")] * 2


def test_an_exception_of_an_access_is_an_abort() -> None:
    class Faulty(Kettle):
        def _level(self) -> Any:
            return "full"  # no REAL32

        def _even(self, value: int) -> AbortCode | None:
            raise KeyError(value)

        def _limited(self, value: int) -> None:
            raise KeyError(value)

    bench, device = kettle(Faulty)
    assert bench.read(0x2100, 1) == AbortCode.CANNOT_TRANSFER
    assert bench.write(0x2000, 0, 50, 1) == AbortCode.CANNOT_TRANSFER
    assert [each.function for each in bench.seen(DeviceCodeFailed)] == ["_level", "_even"]
    assert device.limit == 100
    device.node.values.store[0x200000] = 1
    bench.wait(1)
    assert bench.number(0x2000) == 1
    assert "stop 6200" not in device.log


def test_a_client_is_never_told_that_a_write_was_done_if_the_device_failed_to_act_on_it() -> None:
    class Faulty(Kettle):
        long = variable(0x2001, "Long", DataType.VISIBLE_STRING, "old")
        date = variable(0x2002, "Date", DataType.UNSIGNED8)

        @long.on_write
        def _long(self, value: str) -> None:
            raise OSError(value)

        def _limited(self, value: int) -> None:
            self.probes[1] = value  # before the fault: a TPDO tells it
            raise OSError(value)

    bench, device = kettle(Faulty)
    bench.tell(START)
    store = device.node.values.store
    store.update({mux(0x1020, 1): 7, mux(0x1020, 2): 8})
    assert bench.write(0x2000, 0, 50, 1) == AbortCode.CANNOT_TRANSFER
    assert device.limit == bench.number(0x2000) == 100, "a write that is aborted changes nothing"
    assert store[mux(0x1020, 1)] == 7, "so what is configured has not changed either"
    in_segments = bench.tell("605#2101200007000000", f"605#01{b'further'.hex()}")
    assert in_segments[-1] == "585#8001200020000008"
    assert device.long == "old"
    assert [each.function for each in bench.seen(DeviceCodeFailed)] == ["_limited", "_long"]
    assert bench.seen(ObjectWritten) == []
    assert bench.write(0x2002, 0, 3, 1) is None
    assert (device.date, store[mux(0x1020, 1)]) == (3, 0)


def test_a_value_of_a_pdo_stays_though_the_device_failed_to_act_on_it() -> None:
    class Faulty(Kettle):
        def _heat(self, subindex: int, value: int) -> None:
            raise OSError(value)

    bench, device = kettle(Faulty)
    bench.tell(START, "205#0700")
    assert list(device.heaters) == [7, 0]
    assert [each.function for each in bench.seen(DeviceCodeFailed)] == ["_heat", "_heat"]


# ---- a device with a program ----


def test_a_program_can_be_written_into_a_device_that_has_a_boot_loader() -> None:
    class Updatable(Kettle):
        standard = tuple(boot_loader_dictionary(0).objects[index] for index in (0x1F50, 0x1F51, 0x1F56, 0x1F57))

        def make_node(self, out: Outbox, node_id: int, dictionary: ObjectDictionary) -> LocalNode:
            return BootLoader(out, node_id, dictionary=dictionary)

    bench, device = kettle(Updatable)
    assert bench.number(0x1F51, 1) == 1
    assert bench.write(0x2000, 0, 50, 1) is None
    assert bench.write(0x1F51, 1, 0, 1) is None  # stop
    assert bench.number(0x1F51, 1) == 0
    assert (device.limit, "start" in device.log) == (50, False)
    assert bench.write(0x1F51, 1, 1, 1) is None  # start: it boots into its program
    assert "50 705#00" in bench.wait(55)
    assert (device.limit, device.log[-1]) == (100, "start")
    assert bench.number(0x1F51, 1) == 1


# ---- any frames ----


class Moody(Kettle):
    """Its code fails whenever `mood` says so."""

    mood: Iterator[bool] = iter(())

    def _may_fail(self) -> None:
        if next(self.mood, False):
            raise RuntimeError("not today")

    def start(self) -> None:
        self._may_fail()

    def step(self) -> None:
        self._may_fail()

    def sync(self) -> None:
        self._may_fail()

    def stop(self, error_code: int) -> None:
        self._may_fail()

    def _limited(self, value: int) -> None:
        self._may_fail()

    def _heat(self, subindex: int, value: int) -> None:
        self._may_fail()

    def _level(self) -> Any:
        self._may_fail()
        return 1.0


OBJECTS = [0x1000, 0x1010, 0x1017, 0x1400, 0x1800, 0x1A00, 0x2000, 0x2100, 0x6200, 0x6401, 0x7000]
ACCESSES = st.tuples(
    st.sampled_from([0x23, 0x2B, 0x2F, 0x40]), st.sampled_from(OBJECTS), st.integers(0, 3), st.binary(min_size=4, max_size=4)
)
FRAMES = st.one_of(
    ACCESSES.map(lambda each: f"605#{each[0]:02X}{each[1].to_bytes(2, 'little').hex()}{each[2]:02X}{each[3].hex()}"),
    st.binary(max_size=8).map(lambda data: f"205#{data.hex()}"),
    st.sampled_from([START, PRE_OPERATIONAL, RESET_NODE, SYNC, "000#0205", "000#8205", "285#R8"]),
)


@given(st.lists(FRAMES, max_size=30), st.lists(st.booleans(), max_size=60))
@examples(60)
def test_whatever_comes_and_whatever_its_code_does_the_node_answers(frames: list[str], moods: list[bool]) -> None:
    class Device(Moody):
        mood = iter(moods)

    bench = DeviceBench(make=lambda out, node_id, dictionary: Device(out, node_id).node)
    for number, frame in enumerate(frames):
        bench.tell(frame)
        bench.wait(number % 15)
    bench.tell("605#8000000000000008", RESET_NODE)
    bench.wait(10)
    assert bench.number(0x1000) == 0x0002_0191
    assert all(type(each.error) is RuntimeError for each in bench.seen(DeviceCodeFailed))
