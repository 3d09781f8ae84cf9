"""`DeclaredDevice`: a device written in Python. A class declares its objects, its PDOs and its nameplate, and says what it does.

    class Thermometer(DeclaredDevice):
        nameplate = Nameplate("Thermometer", device_type=0x0002_0194)
        period = 100 * MILLISECOND

        temperature = variable(0x2000, "Temperature", DataType.INTEGER16, access=Access.RO, pdo=True, unit="0.1 degC")
        pdos = (Tpdo(1, temperature),)

        def step(self) -> None:
            self.temperature = 215

    device = Thermometer(network.out, 5)
    network.attach(device.node)
    device.node.boot(now)

It is the application of a `LocalNode`, which has every service: SDO, PDO, heartbeat, SYNC, EMCY, LSS, storing. So it is pure:
frames and time go in, frames and events come out, and each host of the core runs it.

The methods `start`, `step`, `sync` and `stop` do nothing here; a device overrides what it needs. They and the methods of its
objects are called while the node works: `now` is the time, and setting a value sends the event-driven TPDOs that carry it. From
outside of them, `acting` stands around every change. None of them may wait; what takes time is served by the host
(`LocalNode.deferred`).

An exception in one of them is a fault of the device, not of its peers: DeviceCodeFailed tells it, EMCY 0x6200 goes to the bus,
and a client that has asked gets 0x08000020. A write that failed in this way leaves the value from before in the object; what a
PDO brought stays. If the work of the device itself failed (`start`, `step`, `sync`), `stop` follows.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any, ClassVar, Final

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.declared.dictionary import dictionary_of
from canopen_proto.declared.nameplate import Nameplate
from canopen_proto.declared.objects import Declared
from canopen_proto.declared.pdos import Rpdo, Tpdo
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.objects import Access, Object, Variable
from canopen_proto.error_codes import register_bits_of
from canopen_proto.group import Settling
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import NEVER, Event, LocalProtocolError, Machine, Outbox, Time
from canopen_proto.multiplexer import Mux, index_of, mux, split_mux
from canopen_proto.nmt import NmtState

SOFTWARE_ERROR: Final = 0x6200
"""EMCY code of an exception in the code of a device: user software. CiA 301 v4.2.0, table 26."""
_OWN_WORK: Final = ("start", "step", "sync")
"""The methods after whose failure the outputs are brought to their safe state."""


class DeviceCodeFailed(Event):
    """The code of a device raised an exception, `error`. function: the name of the method."""

    __match_args__ = ("node_id", "function", "error")

    def __init__(self, node_id: int, function: str, error: Exception) -> None:
        self.node_id = node_id
        self.function = function
        self.error = error


class DeclaredDevice(Machine):
    """See this module's text. node: its LocalNode. now: the time, ns, while one of its methods runs.

    nameplate: what it is. pdos: after power-on. standard: further communication objects (`standard_object`), or others in place
    of those that each device has (declared/dictionary.py); without: indices of these that it does not have. period: from one
    `step` to the next, ns; 0 = no steps. dictionary: all of its objects; made with the class.
    """

    nameplate: ClassVar[Nameplate]
    pdos: ClassVar[Sequence[Rpdo | Tpdo]] = ()
    standard: ClassVar[Sequence[Object]] = ()
    without: ClassVar[Collection[int]] = ()
    period: ClassVar[Time] = 0
    dictionary: ClassVar[ObjectDictionary]
    node: LocalNode
    now: Time
    _declared: ClassVar[dict[Mux, Declared]]
    _shown: ClassVar[tuple[Mux, ...]]

    def __init_subclass__(cls) -> None:
        """Make the dictionary; a class without a nameplate has none. Raises LocalProtocolError if a declaration cannot be, or has
        a name of `DeclaredDevice` itself."""
        super().__init_subclass__()
        names = {name: value for each in reversed(cls.__mro__) for name, value in vars(each).items()}
        named = {name: value for name, value in names.items() if isinstance(value, Declared)}
        _refuse_reserved(cls.__name__, named)
        if not hasattr(cls, "nameplate"):
            return
        if not isinstance(cls.nameplate, Nameplate):
            raise LocalProtocolError(f"{cls.__name__}.nameplate is {cls.nameplate!r}, no Nameplate")
        declared = list(named.values())
        served = ((variable, each) for each in declared for variable in each.variables if each.serves(variable))
        cls._declared = {variable.mux: each for variable, each in served}
        cls._shown = tuple(key for key, each in cls._declared.items() if each.reads and each.variables[-1].pdo_mappable)
        cls.dictionary = dictionary_of(cls.nameplate, declared, cls.pdos, cls.standard, cls.without)

    def __init__(self, out: Outbox, node_id: int, dictionary: ObjectDictionary | None = None) -> None:
        """out: of the network that `node` is attached to. node_id: 1..127, or UNCONFIGURED: LSS gives it one. dictionary: the
        same objects with other values at power-on, such as a serial number of its own; None = that of the class.

        Raises LocalProtocolError if the class has no nameplate.
        """
        if not hasattr(self, "nameplate"):
            name = type(self).__name__
            raise LocalProtocolError(f"{name} has no nameplate: `nameplate = Nameplate({name!r})` in the class makes it a device")
        self.node = self.make_node(out, node_id, self.dictionary if dictionary is None else dictionary)
        super().__init__(self.node.inner)
        self.now: Time = 0
        outputs = {index_of(key) for key, each in self._declared.items() if each.variables[-1].access is Access.RWW}
        self.node.storage.excluded |= outputs  # set-points and outputs are no parameters: none may come back with the power
        self.node.pdos.sends_on_start = (
            True  # a master that relies on event-driven TPDOs needs the values before the first change
        )
        self.node.set_application(self)

    def make_node(self, out: Outbox, node_id: int, dictionary: ObjectDictionary) -> LocalNode:
        """Return the node of the device. A device with a program that can be written (0x1F50) returns a `BootLoader`."""
        return LocalNode(out, node_id, dictionary)

    # ---- what a device overrides ----

    def start(self) -> None:
        """Begin, after power-on and each reset of the node: all values are those of power-on."""

    def step(self) -> None:
        """Do a step of the device's own work, every `period`."""

    def sync(self) -> None:
        """Act on a SYNC: what the synchronous RPDOs brought has been written, the TPDOs of this SYNC are sent."""

    def stop(self, error_code: int) -> None:
        """Bring the outputs to their safe state. error_code: why: the connection is lost (0x8130); Operational was left, or
        Pre-operational by a stop or a reset (0x8100); an RPDO did not come within its event time (0x8250); or the device's own
        work failed (0x6200)."""

    # ---- what a device does ----

    @property
    def is_operational(self) -> bool:
        """Whether PDOs are exchanged."""
        return self.node.state is NmtState.OPERATIONAL

    def set_value(self, variable: Variable, value: Value) -> None:
        """Set a value of the device's own, as an assignment does. Does nothing if it is the present one.

        Raises ValueRangeError if the object cannot hold it.
        """
        store = self.node.values.store
        if store[variable.mux] != value or type(store[variable.mux]) is not type(value):
            self.node.set_value(variable.index, variable.subindex, value, self.now)

    def send(self, variable: Variable) -> None:
        """Send the event-driven TPDOs that carry a value, though nothing was assigned to it: `self.send(Station.levels[1])`."""
        self.node.pdos.trigger(variable.mux, self.now)

    def raise_error(self, code: int, vendor_data: bytes = b"") -> None:
        """Report an error: EMCY, 0x1001, 0x1003. code: 0x0100..0xFFFF. vendor_data: up to 5 bytes. Else as
        `EmcyProducer.raise_error`."""
        self.node.communication.emcy.raise_error(code, int(register_bits_of(code)), vendor_data, self.now)

    def clear_error(self, code: int) -> None:
        """Report that an error is gone. code: as it was raised. See `EmcyProducer.clear`."""
        self.node.communication.emcy.clear(code, self.now)

    def acting(self, now: Time) -> Settling:
        """Return a context manager for a change that comes from outside of the device's methods: `with device.acting(now): ...`.
        At its end the node does what follows from the change. Drain the network then.

        now: the time of the network's clock, ns.
        """
        self.now = now
        return self.node._settling(now)

    # ---- what the node calls ----

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        declared = self._declared.get(mux(index, subindex))
        if declared is None or not declared.checks:
            return None
        refusal = self._call(declared.checks, *declared.arguments_for(subindex), value)
        return refusal if isinstance(refusal, AbortCode) else None

    def written(self, index: int, subindex: int, now: Time) -> AbortCode | None:
        self.now = now
        key = mux(index, subindex)
        declared = self._declared.get(key)
        if declared is None or not declared.acts:
            return None
        failure = self._call(declared.acts, *declared.arguments_for(subindex), self.node.values.store[key])
        return failure if isinstance(failure, AbortCode) else None

    def refresh(self, now: Time, index: int | None = None, subindex: int = 0) -> AbortCode | None:
        self.now = now
        if index is not None:
            key = mux(index, subindex)
            declared = self._declared.get(key)
            return None if declared is None or not declared.reads else self._read(declared, key)
        for each in self._shown:
            self._read(self._declared[each], each)
        return None

    def on_sync(self, now: Time) -> None:
        self.now = now
        self._call("sync")

    def connection_lost(self, now: Time, error_code: int) -> None:
        self.now = now
        self._call("stop", error_code)

    def reset(self, now: Time) -> None:
        self.now = now
        self._arm(now + self.period if self.period else NEVER)
        self._call("start")

    def handle_timeout(self, now: Time) -> None:
        """Make one step, however late. Missed ones are skipped."""
        if now < self.deadline:
            return
        self.now = now
        self._arm(now + self.period - (now - self.deadline) % self.period)
        self._call("step")

    def _read(self, declared: Declared, key: Mux) -> AbortCode | None:
        """Take the value that a device's method shows."""
        index, subindex = split_mux(key)
        value = self._call(declared.reads, *declared.arguments_for(subindex))
        if isinstance(value, AbortCode):
            return value
        variable = self.dictionary.variable((index, subindex))
        try:
            variable.encode(value)
        except LocalProtocolError as error:
            return self._failed(declared.reads, error)
        self.node.values.store[key] = value
        return None

    def _call(self, name: str, *arguments: Any) -> Any:
        """Call a method of the device. Returns its result; after an exception an abort code."""
        function: Callable[..., Any] = getattr(self, name)
        try:
            return function(*arguments)
        except Exception as error:  # noqa: BLE001 - the device's own code, which must not end its node
            return self._failed(name, error)

    def _failed(self, name: str, error: Exception) -> AbortCode:
        self.out.events.append(DeviceCodeFailed(self.node.node_id, name, error))
        self.raise_error(SOFTWARE_ERROR)
        if name in _OWN_WORK:
            self._call("stop", SOFTWARE_ERROR)
        return AbortCode.CANNOT_TRANSFER


def _refuse_reserved(device: str, named: dict[str, Declared]) -> None:
    """Refuse objects that would stand in place of what a device is made of. device: the class's name."""
    reserved = {*dir(DeclaredDevice), *DeclaredDevice.__annotations__}
    for name, declared in named.items():
        if name in reserved:
            own = ", ".join(sorted(each for each in reserved if not each.startswith("__")))
            message = f"{device}.{name}: 0x{declared.index:04X} {declared.record!r} needs another attribute"
            raise LocalProtocolError(f"{message}: a device has these names itself: {own}")
