"""Two state machines of Hypothesis: a master against your device, and your master against devices. The observer judges.

    class MyDevice(MasterAgainstDevice):
        dictionary = my_dictionary

        def join(self, world):
            world.listener(my_device.on_frame)

    TestMyDevice = MyDevice.TestCase      # what pytest collects

Each step is a rule that Hypothesis chooses; what fails is shrunk to the fewest steps. The world is in virtual time.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import ClassVar, Final

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from hypothesis.strategies import SearchStrategy

from canopen_proto.abort import AbortOrigin
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.frame import EMCY, ERROR_CONTROL, MAX_NODE_ID, Frame
from canopen_proto.indices import NMT_STARTUP
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.nmt import NmtCommand, NmtState, target_of
from canopen_proto.observer.observer import RULES
from canopen_proto.procedures.objects import read
from canopen_proto.procedures.steps import Procedure, SdoTransferError, download
from canopen_proto.testing.faults import Fault, Pause, Reset
from canopen_proto.testing.patterns import boot_up
from canopen_proto.testing.world import World
from canopen_testing.strategies.devices import PlannedDevice, networks
from canopen_testing.strategies.objects import values

_PAUSES: Final = st.sampled_from([each * MILLISECOND for each in (1, 20, 100, 1000)])
_PLACES: Final = st.integers(0, 4)
"""Of a device in its network; from the first one again behind the last."""
_RESETS: Final = (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)
_STATIC: Final = range(0x1000, 0x2000)
BOOT_TIME: Final = 5 * SECOND
"""How long a device may take for a reset."""

MASTER_RULES: Final = frozenset(
    {"toggle", "crc", "size", "sdo", "two masters", "stopped", "pdo length", "nmt", "two sync", "sync counter"}
)
"""What a master can do wrong, of the observer's rules."""


class MasterAgainstDevice(RuleBasedStateMachine):
    """A master that keeps to the standard does what it likes with your device: NMT commands, reads, writes, right and wrong.

    Set `dictionary`, and put your device into the world in `join`; by default it is our own device of that dictionary. After each
    step nothing may be wrong on the bus (the observer's rules but `tolerated`). In pre-operational and operational each SDO
    request is answered. A reset ends with a boot-up. Its heartbeats show the NMT state that was commanded, until it sends an
    emergency; with 0x1F80 it may start by itself. What was written to one of `kept` is read again.
    Shrinks towards few steps, small values and objects that stand first in the dictionary.
    """

    dictionary: ClassVar[ObjectDictionary]
    """The objects of the device."""
    node_id: ClassVar[int] = 5
    untouched: ClassVar[Collection[int]] = _STATIC
    """Indices of the objects that are not written: those that change how the device communicates."""
    kept: ClassVar[Collection[int]] = ()
    """Indices of objects that hold what was written to them, until a reset."""
    tolerated: ClassVar[Collection[str]] = ("boot-up",)
    """Rules of the observer (`RULES`) that may be broken: here a reset is nothing special."""

    def join(self, world: World) -> None:
        """Put your device into the world: `world.device(...)`, `world.listener(...)`, `world.host(...)`."""
        world.device(self.dictionary, self.node_id)

    def __init__(self) -> None:
        super().__init__()
        self.world = World()
        self.state = NmtState.PRE_OPERATIONAL
        self._held: dict[int, bytes] = {}
        self._looked = 0  # so many frames of the trace were looked at for its state
        self._shows = not self.dictionary.has_index(NMT_STARTUP)  # whether its heartbeats have to show `state`
        self.join(self.world)
        self.master = self.world.master()
        self.master.node(self.node_id, self.dictionary)
        if not self.world.bus().trace:  # one that the world has made is on the bus already
            self.world.run_until(boot_up(self.node_id), BOOT_TIME)

    @rule(command=st.sampled_from(NmtCommand), to_all=st.booleans())
    def command(self, command: NmtCommand, to_all: bool) -> None:
        """Send an NMT command."""
        self.master.command(command, 0 if to_all else self.node_id)
        if command in _RESETS:
            self.world.run_until(boot_up(self.node_id), BOOT_TIME)
            self._held.clear()
            self.state = NmtState.PRE_OPERATIONAL
            self._shows = not self.dictionary.has_index(NMT_STARTUP)
        else:
            self.world.advance(10 * MILLISECOND)
            self.state = target_of(command)
            self._shows = True
        self._looked = len(self.world.bus().trace)

    @rule()
    def command_another_node(self) -> None:
        """Send each NMT command to the next node: they are not for the device."""
        before, other = len(self.world.bus().trace), self.node_id % MAX_NODE_ID + 1
        for command in NmtCommand:
            self.master.command(command, other)
        self.world.advance(10 * MILLISECOND)
        booted = [each for each in self.world.bus().trace[before:] if each.frame == Frame(ERROR_CONTROL + self.node_id, b"\x00")]
        assert not booted, f"a command for node {other} has reset the device"

    @precondition(lambda self: self.state is not NmtState.STOPPED)
    @rule(data=st.data())
    def read(self, data: st.DataObject) -> None:
        """Read an object that is there."""
        variable = self._drawn(data, [*self.dictionary])
        self._answer(read(self.master.node(self.node_id), variable))

    @precondition(lambda self: self.state is not NmtState.STOPPED and self._held)
    @rule(data=st.data())
    def read_back(self, data: st.DataObject) -> None:
        """Read one of `kept` that was written: it has what was written."""
        variable = self._drawn(data, [each for each in self.dictionary if each.mux in self._held])
        value = self._answer(read(self.master.node(self.node_id), variable))
        held = self._held[variable.mux]
        assert value == variable.decode(held), f"{variable} was written with {held.hex(' ')}, and is read as {value!r}"

    @precondition(lambda self: self.state is not NmtState.STOPPED and any(map(self._is_written, self.dictionary)))
    @rule(data=st.data())
    def write(self, data: st.DataObject) -> None:
        """Write an object with a value of its type."""
        variable = self._drawn(data, [each for each in self.dictionary if self._is_written(each)])
        content = variable.encode(data.draw(values(variable), "value"))
        if self._answer(self._download(variable.index, variable.subindex, content)) is _DONE and variable.index in self.kept:
            self._held[variable.mux] = content

    @precondition(lambda self: self.state is not NmtState.STOPPED)
    @rule(index=st.integers(0x2000, 0xFFFF), subindex=st.integers(0, 0xFF), content=st.binary(min_size=1, max_size=9))
    def write_what_is_not_there(self, index: int, subindex: int, content: bytes) -> None:
        """Write an object that the dictionary does not have: the device refuses it."""
        if self.dictionary.get(index, subindex) is None:
            assert self._answer(self._download(index, subindex, content)) is not _DONE, "it took an object that it does not have"

    @rule(duration=_PAUSES)
    def wait(self, duration: Time) -> None:
        """Let time pass."""
        self.world.advance(duration)

    @invariant()
    def nothing_is_wrong_on_the_bus(self) -> None:
        """Let the observer judge."""
        self.world.bus().observer.clean(but=self.tolerated)

    @invariant()
    def its_state_is_shown(self) -> None:
        """Look at its heartbeats since the last command."""
        trace = self.world.bus().trace
        for passed in trace[self._looked :] if self._shows else ():
            frame = passed.frame
            if frame.can_id == EMCY + self.node_id:
                self._shows = False  # an error may change the state (0x1029)
                break
            if frame.can_id == ERROR_CONTROL + self.node_id and len(frame.data) == 1 and frame.data[0]:
                is_right = frame.data[0] == self.state  # bit 7 too: nobody asks for guarding here
                assert is_right, f"the device was told to be {self.state.name}, and its heartbeat is {frame}"
        self._looked = len(trace)

    def _drawn(self, data: st.DataObject, of: list[Variable]) -> Variable:
        """Draw a variable; a failing example shows its place and name."""
        return {each.label: each for each in of}[data.draw(st.sampled_from([each.label for each in of]), "variable")]

    def _is_written(self, variable: Variable) -> bool:
        return variable.access.writable and variable.index not in self.untouched

    def _download(self, index: int, subindex: int, content: bytes) -> Procedure[object]:
        yield from download(self.master.node(self.node_id).sdo, index, subindex, content)
        return _DONE

    def _answer(self, procedure: Procedure[object]) -> object:
        """Return what a request brought, or the refusal of the device. Anything else is an error."""
        try:
            return self.master.run(procedure)
        except SdoTransferError as failure:
            assert failure.origin is AbortOrigin.PEER, f"{failure}"
            return failure


_DONE: Final = object()


class MasterAgainstDevices(RuleBasedStateMachine):
    """Your master against a small network of devices that pause, reset, report errors and stop.

    Put your master into the world in `start`; `network` says which devices there are. After each step nothing may be wrong on the
    bus, of what a master can do wrong (the rules in `judged`), and `check` must not raise: what you promise.
    Shrinks towards few steps, and one device without faults.
    """

    judged: ClassVar[Collection[str]] = MASTER_RULES
    """The rules of the observer that count."""

    def network(self) -> SearchStrategy[tuple[PlannedDevice, ...]]:
        """Return a strategy for the devices."""
        return networks()

    def faults(self, nodes: Collection[int]) -> SearchStrategy[list[Fault]]:
        """Return a strategy for what goes wrong besides, such as `fault_plans(nodes)`; by default nothing."""
        return st.just([])

    def start(self, world: World, network: tuple[PlannedDevice, ...]) -> None:
        """Put your master into the world: `world.host(...)`, `world.listener(...)`, a program."""
        raise NotImplementedError("put your master into the world in start()")

    def check(self, world: World) -> None:
        """Raise AssertionError if what your master promises does not hold. Called after each step."""

    def __init__(self) -> None:
        super().__init__()
        self.world = World()
        self.devices: tuple[PlannedDevice, ...] = ()

    @initialize(data=st.data())
    def begin(self, data: st.DataObject) -> None:
        """Switch on the devices, then the master."""
        self.devices = data.draw(self.network(), "network")
        self.world.add_faults(*data.draw(self.faults([each.node_id for each in self.devices]), "faults"))
        for device in self.devices:
            self.world.device(device.make)
        self.start(self.world, self.devices)
        self.world.advance(SECOND)

    @rule(place=_PLACES)
    def reset(self, place: int) -> None:
        """Let a device start again, by itself. place: of the device among all, from 0."""
        self.world.add_faults(Reset(self._node_id(place), at=self.world.now))
        self.world.advance(0)

    @rule(place=_PLACES, lasts=_PAUSES)
    def pause(self, place: int, lasts: Time) -> None:
        """Let a device do nothing for a while."""
        self.world.add_faults(Pause(self._node_id(place), at=self.world.now, lasts=lasts))
        self.world.advance(0)

    @rule(place=_PLACES, code=st.sampled_from((0x1000, 0x2310, 0x8130)))
    def report(self, place: int, code: int) -> None:
        """Let a device report an error."""
        self.world.nodes[self._node_id(place)].raise_error(code, 0x01, bytes(5), self.world.now)
        self.world.advance(0)

    def _node_id(self, place: int) -> int:
        return self.devices[place % len(self.devices)].node_id

    @rule(duration=_PAUSES)
    def wait(self, duration: Time) -> None:
        """Let time pass."""
        self.world.advance(duration)

    @invariant()
    def the_master_did_nothing_wrong(self) -> None:
        """Let the observer judge, and your own check."""
        self.world.bus().observer.clean(but=[name for name in RULES if name not in self.judged])
        self.check(self.world)
