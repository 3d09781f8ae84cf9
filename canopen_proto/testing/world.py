"""`World`: buses, devices, masters and hosts in virtual time, with a seeded scheduler and faults.

    world = World(seed=7, faults=[Lose(sdo_answer(5), nth=3)])
    drive = world.drive(5)
    master = world.master()
    master.write(5, "producer_heartbeat_time", 100)
    world.advance(2 * SECOND)
    world.bus().saw(heartbeat(5)).within(200 * MILLISECOND)

Time passes only where the test lets it: in `advance`, `run_until`, and where a master waits for an answer. Then the world goes
from one happening to the next: a frame that comes, a deadline of a participant, a fault. An hour takes as long as its frames.

**The same seed gives the same frames**, in any process. The seed draws how long each frame takes on its way, which participant
acts first where several would at one time, and what the faults hit. Nothing else is drawn, and no order comes from a hash.

A device is on from the moment when it is made, and its boot-up has been on the bus then: whoever joins later, as a rule a master,
does not take it for a reset. It has a host, which stores what it shall store (0x1010, LSS), in memory.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from functools import partial
from typing import Final, NamedTuple, TypeAlias, TypeVar, cast

from canopen_proto.declared import DeclaredDevice
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import UNCONFIGURED, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.lss.messages import OK
from canopen_proto.lss.slave import LssStoreRequested
from canopen_proto.machine import MICROSECOND, NEVER, SECOND, Event, LocalProtocolError, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.parameter_storage import SIGNATURES
from canopen_proto.sdo.server import ObjectAccessPending
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_proto.testing import patterns
from canopen_proto.testing.armed_fault import ArmedFault
from canopen_proto.testing.bus import WorldBus
from canopen_proto.testing.draws import Draws
from canopen_proto.testing.faults import BusOff, Fault, NodeFault, Pause, Reset, SecondMaster, Sudden
from canopen_proto.testing.master import WorldMaster
from canopen_proto.testing.member import OnEvent, OnFrame, WorldMember
from canopen_proto.testing.patterns import Pattern, as_pattern
from canopen_proto.testing.times import nanoseconds

P = TypeVar("P", bound=WorldMember)

NodeMaker: TypeAlias = Callable[[Outbox], LocalNode | DeclaredDevice]
"""Makes a device with the outbox of the network that it will be attached to."""

TRANSMISSION: Final = (60 * MICROSECOND, 240 * MICROSECOND)
"""How long a frame takes on the bus, least and most: about that of one on a bus of 500 kbit/s to 1 Mbit/s."""
LIMIT: Final = 60 * SECOND
"""How long `run_until` waits unless it is told."""
MAX_STEPS: Final = 100_000
"""Happenings at one time: two participants that chat without end stop here."""


class _Moment(NamedTuple):
    at: Time
    number: int
    act: Callable[[], object]


class DidNotHappenError(AssertionError):
    """What a test waited for did not happen in time. The text shows the last frames."""


class World:
    """See this module's text. now: ns since the world began. nodes: the devices, by the node-ID with which they were made; those
    without one (LSS) by 255, 256 ...

    seed: of the faults and times that are left to chance. faults: what goes wrong; more with `add_faults`. transmission: how long
    a frame takes on the bus, least and most, ns.
    """

    def __init__(self, seed: int = 0, faults: Iterable[Fault] = (), *, transmission: tuple[Time, Time] = TRANSMISSION) -> None:
        self.now: Time = 0
        self.seed = seed
        self.nodes: dict[int, LocalNode] = {}
        self.buses: dict[str, WorldBus] = {}
        self._transmission = (nanoseconds(transmission[0], "transmission"), nanoseconds(transmission[1], "transmission"))
        self._draws = Draws("world", seed)
        self._faults: list[ArmedFault] = []
        self._moments: list[_Moment] = []
        self._count = 0
        self._at_this_time = 0
        self._participants: list[tuple[WorldMember, WorldBus]] = []
        self._is_stepping = False
        self.add_faults(*faults)

    # ---- what is in it ----

    def bus(self, name: str = "can0") -> WorldBus:
        """Return the bus of this name; it is made when it is first asked for."""
        if name not in self.buses:
            draws = Draws(f"bus {name}", self.seed)
            self.buses[name] = WorldBus(
                name, lambda: self.now, self._dictionary_of, self._faults, self._happen, draws, self._transmission
            )
        return self.buses[name]

    def device(
        self, made_of: ObjectDictionary | type[DeclaredDevice] | NodeMaker, node_id: int = 0, *, bus: str = "can0"
    ) -> LocalNode:
        """Switch on a device of a dictionary, of a class that is written in Python, or of your own making; return it.

        node_id: 1..127; needed with a dictionary or a class. Raises LocalProtocolError if a device of the world has this node-ID,
        ObjectNotFoundError if a fault names an object that it has not.
        """
        __tracebackhide__ = True
        network = Network()
        node = _made(made_of, network.out, node_id)
        place = node.node_id
        while place >= UNCONFIGURED and place in self.nodes:
            place += 1
        if place in self.nodes:
            raise LocalProtocolError(f"there is a node {node.node_id} in this world already")
        network.attach(node)
        node.pdos.sends_on_start = True
        participant = WorldMember(f"node {node.node_id}", network=network, device=node)
        participant.on_event = partial(self._host, node)
        self.nodes[place] = node
        self._join(participant, bus)
        for each in self.buses.values():
            each.observer.forget()
        node.boot(self.now)
        for frame in participant.drain(self.now):
            self._guarded(partial(self.buses[bus].arrive, frame, participant, self.now))
        self._check_faults()
        return node

    def drive(
        self,
        node_id: int,
        settings: DriveSettings | None = None,
        *,
        dictionary: ObjectDictionary | None = None,
        bus: str = "can0",
    ) -> DriveNode:
        """Switch on a simulated drive of CiA 402; return it. settings: its shape and its mechanics; by default to the letter.

        dictionary: by default that of its shape.
        """
        __tracebackhide__ = True
        if not isinstance(node_id, int):
            raise LocalProtocolError(f"{node_id!r} is no node-ID; a drive of a file is a device: sim_node(file, node_id=5)")
        make = partial(DriveNode, node_id=node_id, settings=settings or DriveSettings(), dictionary=dictionary)
        node = self.device(make, bus=bus)
        assert isinstance(node, DriveNode)
        return node

    def master(self, bus: str = "can0", *, network: Network | None = None) -> WorldMaster:
        """Return a master on a bus, for a test without async: its calls let the world run until they have their result.

        network: that it runs; by default one of its own.
        """
        master = WorldMaster(self.run_until, lambda: self.now, self._dictionary_of, network)
        self._join(master, bus)
        return master

    def host(
        self, network: Network, *, on_event: OnEvent = lambda event: None, name: str = "host", bus: str = "can0"
    ) -> WorldMember:
        """Run machines of your own on a bus: all those of a Network are one participant. on_event: called with its events."""
        return self._join(WorldMember(name, network=network, on_event=on_event), bus)

    def listener(self, on_frame: OnFrame, *, name: str = "program", bus: str = "can0") -> WorldMember:
        """Join a bus with code that handles frames itself: on_frame(frame, now) gets all frames but its own; `send` sends."""
        return self._join(WorldMember(name, on_frame=on_frame), bus)

    def send(self, sender: WorldMember, frame: Frame) -> None:
        """Put a frame of a participant on its bus."""
        for participant, bus in self._participants:
            if participant is sender:
                bus.put(frame, sender)
                return
        raise LocalProtocolError(f"{sender.name} is not in this world")

    def leave(self, participant: WorldMember) -> None:
        """Take a participant out of the world."""
        for place, (each, bus) in enumerate(self._participants):
            if each is participant:
                bus.leave(participant)
                del self._participants[place]
                return

    def add_faults(self, *faults: Fault) -> None:
        """Let these go wrong too, from now on. Raises ObjectNotFoundError for an object that a device has not."""
        __tracebackhide__ = True
        for fault in faults:
            if not isinstance(fault, Fault):
                if isinstance(fault, list | tuple):
                    raise LocalProtocolError("give faults one by one: add_faults(*faults)")
                raise LocalProtocolError(f"{fault!r} is no fault, such as Lose(sdo_answer(5), nth=3)")
            armed = ArmedFault(fault, Draws(f"fault {len(self._faults)}", self.seed))
            self._faults.append(armed)
            if isinstance(fault, Sudden) and fault.on is None:
                self._at(self.now if fault.at is None else fault.at, partial(self._happen, armed))
        self._check_faults()

    @property
    def fault_lines(self) -> list[str]:
        """What each fault has done so far: how often it has hit, and when last. Those that never hit come first."""
        return [str(armed) for armed in sorted(self._faults, key=lambda armed: armed.hits > 0)]

    def _check_faults(self) -> None:
        __tracebackhide__ = True
        for armed in self._faults:
            armed.check(self._dictionary_of)

    def after(self, duration: Time | float, act: Callable[[], object]) -> None:
        """Call a function when so many ns have passed: `world.after(SECOND, lambda: drive.raise_fault(0x7300, world.now))`."""
        __tracebackhide__ = True
        self._at(self.now + nanoseconds(duration, "after"), act)

    # ---- time ----

    def advance(self, duration: Time | float) -> None:
        """Let so many ns pass."""
        __tracebackhide__ = True
        end = self.now + nanoseconds(duration, "advance")
        while self.step(end):
            pass
        self.now = max(self.now, end)

    def run_until(
        self, condition: Callable[[], object] | Pattern | Frame | str, limit: Time | float = LIMIT, *, told: str = ""
    ) -> None:
        """Let time pass until a condition holds, or until a frame comes that fits a pattern, on any bus.

        told: what is waited for, for the error; by default its name. Raises DidNotHappenError if that takes longer than `limit`
        (ns), or if nothing more will happen.
        """
        __tracebackhide__ = True
        if isinstance(condition, bool):
            raise LocalProtocolError("a condition is a function, which is asked again and again: run_until(lambda: ...)")
        if not callable(condition) or getattr(condition, "__module__", "") == patterns.__name__:
            condition = as_pattern(condition)
            condition.check(self._dictionary_of)
        met = self._comes(condition) if isinstance(condition, Pattern) else condition
        limit = nanoseconds(limit, "limit")
        began, end = self.now, self.now + limit
        self._pump()
        while not met():
            if self.step(end):
                continue
            why = "nothing more will happen in this world"
            if self.next_time() < NEVER:
                self.now, why = end, f"{limit / SECOND:g} s are over"
            tails = [bus.observer.tail(self.now) for bus in self.buses.values()]
            what = f"{told or _name(condition)} since {began / SECOND:.6f} s: {why}."
            raise DidNotHappenError("\n".join([what, *tails]))

    def next_time(self) -> Time:
        """Return when the next thing happens; NEVER if nothing will."""
        self._pump()
        return self._next()

    def step(self, end: Time = NEVER) -> bool:
        """Let the next thing happen, if it does by `end`. Returns whether it did. For drivers; a test calls `advance`."""
        if self._is_stepping:
            raise LocalProtocolError("time is passing already: a function that the world calls cannot let it pass")
        self._pump()
        due = self._next()
        if due > end or due >= NEVER:
            return False
        if due > self.now:
            self.now, self._at_this_time = due, 0
        self._at_this_time += 1
        if self._at_this_time > MAX_STEPS:
            raise DidNotHappenError(
                f"more than {MAX_STEPS} things happen at {self.now / SECOND:.6f} s: some deadline does not move"
            )
        self._guarded(self._step)
        self._pump()
        return True

    # ---- inside ----

    def _guarded(self, act: Callable[[], object]) -> None:
        """Let something happen. What it calls cannot let time pass."""
        self._is_stepping = True
        try:
            act()
        finally:
            self._is_stepping = False

    def _join(self, participant: P, bus: str) -> P:
        there = self.bus(bus)
        there.join(participant)
        self._participants.append((participant, there))
        return participant

    def _dictionary_of(self, node_id: int) -> ObjectDictionary | None:
        node = self.nodes.get(node_id)
        return None if node is None else node.dictionary

    def _next(self) -> Time:
        due = self._moments[0].at if self._moments else NEVER
        for bus in self.buses.values():
            due = min(due, bus.next_time())
        for participant, _ in self._participants:
            due = min(due, participant.next_deadline())
        return due

    def _step(self) -> None:
        now = self.now
        if self._moments and self._moments[0].at <= now:
            heapq.heappop(self._moments).act()
            return
        for bus in self.buses.values():
            if bus.next_time() <= now:
                bus.step(now)
                return
        due = [participant for participant, _ in self._participants if participant.next_deadline() <= now]
        first = due[0] if len(due) == 1 else self._draws.choice(due)
        first.wake(now)

    def _pump(self) -> None:
        """Take up what the participants have to say, until nothing is left."""
        is_busy = True
        while is_busy:
            is_busy = False
            for participant, bus in tuple(self._participants):
                network = participant.network
                if network is None or not (network.out.frames or network.out.events) or self.now < participant.paused_until:
                    continue
                is_busy = True
                for frame in participant.drain(self.now):
                    bus.put(frame, participant)

    def _at(self, time: Time, act: Callable[[], object]) -> None:
        self._count += 1
        heapq.heappush(self._moments, _Moment(max(time, self.now), self._count, act))

    def _comes(self, pattern: Pattern) -> Callable[[], bool]:
        """Whether a frame that fits has come since now."""
        looked = {name: len(bus.trace) for name, bus in self.buses.items()}

        def has_come() -> bool:
            for name, bus in self.buses.items():
                first, looked[name] = looked.get(name, 0), len(bus.trace)
                if any(each.was_heard and pattern.fits(each.frame, bus.names) for each in bus.trace[first:]):
                    return True
            return False

        return has_come

    def _host(self, node: LocalNode, event: Event) -> None:
        """Do what the host of a device does: store at once."""
        if isinstance(event, ObjectAccessPending) and event.index in SIGNATURES and event.index not in node.deferred:
            node.complete(event.access_id, None, self.now)
        elif isinstance(event, LssStoreRequested) and node.lss.is_storing:
            node.lss.complete_store(OK, self.now)

    def _happen(self, armed: ArmedFault) -> None:
        """Let a sudden fault happen now."""
        fault = armed.fault
        if isinstance(fault, SecondMaster):
            armed.hit(self.now)
            for number, text in enumerate(fault.texts):
                self._at(self.now + number * fault.apart, partial(self.bus(fault.bus or "can0").intrude, text))
            return
        assert isinstance(fault, NodeFault)
        participant = next((each for each, _ in self._participants if each.node_id == fault.node_id), None)
        if participant is None or participant.device is None:
            return  # it has another node-ID now, or is not there yet
        armed.hit(self.now)
        node = participant.device
        if isinstance(fault, Pause):
            participant.paused_until = min(self.now + fault.lasts, NEVER)
            if participant.paused_until < NEVER:
                self._at(participant.paused_until, partial(self._resume, participant))
        elif isinstance(fault, Reset):
            if node.state is not NmtState.INITIALISING:
                node.execute(NmtCommand.RESET_NODE, self.now)
        elif isinstance(fault, BusOff):
            participant.off_until = min(self.now + fault.lasts, NEVER)
            node.bus_off(self.now)
            if participant.off_until < NEVER:
                self._at(participant.off_until, partial(self._recover, participant))
        else:
            raise LocalProtocolError(f"{fault} is no fault that a World knows")

    def _resume(self, participant: WorldMember) -> None:
        if self.now >= participant.paused_until:
            participant.wake(self.now)

    def _recover(self, participant: WorldMember) -> None:
        if self.now >= participant.off_until and participant.device is not None:
            participant.device.bus_recovered(self.now)


def _made(made_of: ObjectDictionary | type[DeclaredDevice] | NodeMaker, out: Outbox, node_id: int) -> LocalNode:
    """Make a device."""
    __tracebackhide__ = True
    is_class = isinstance(made_of, type) and issubclass(made_of, LocalNode | DeclaredDevice)
    if (is_class or isinstance(made_of, ObjectDictionary)) and not node_id:
        raise LocalProtocolError("which node-ID is the device to have? Give it as the second argument: device(..., 5)")
    node: object
    if isinstance(made_of, ObjectDictionary):
        return LocalNode(out, node_id, made_of)
    if isinstance(made_of, type) and issubclass(made_of, DeclaredDevice):
        device: type[DeclaredDevice] = made_of
        node = device(out, node_id)
    elif callable(made_of) and not is_class:
        node = cast("NodeMaker", made_of)(out)
    else:
        raise LocalProtocolError(
            f"{made_of!r} is no dictionary, no class of a DeclaredDevice, and no function that makes a device with an outbox: "
            "lambda out: MyDevice(out, 5, dictionary)"
        )
    if isinstance(node, DeclaredDevice):
        return node.node
    if not isinstance(node, LocalNode):
        raise LocalProtocolError(
            f"the function that makes a device returned {node!r}, which is no LocalNode and no DeclaredDevice"
        )
    return node


def _name(condition: Callable[[], object] | Pattern) -> str:
    if isinstance(condition, Pattern):
        return f"{condition} did not come"
    return f"{getattr(condition, '__qualname__', repr(condition))} did not come true"
