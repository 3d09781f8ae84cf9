"""A simulated drive on a bench: written to as a node would, with time that runs as fast as one likes."""

from __future__ import annotations

from typing import TypeVar

from canopen_proto.dictionary.model import ObjectDictionary
from canopen_proto.dictionary.values import Values
from canopen_proto.drives.cia402.states import State, state_of
from canopen_proto.machine import MILLISECOND, SECOND, Event, Outbox, Time
from canopen_proto.multiplexer import mux
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.drive import Drive, LateDrive
from canopen_proto.simulation.drive.events import DriveStateChanged, InputsChanged, ModeChanged, StatuswordChanged
from canopen_proto.simulation.drive.settings import DriveSettings, Shape

E = TypeVar("E", bound=Event)

NODE_ID = 12
DICTIONARIES = {shape: drive_dictionary(shape) for shape in Shape}


class Bench:
    """One drive, powered on at `now` = 1 s. Objects by index (and subindex); times in ms."""

    def __init__(self, settings: DriveSettings | None = None, dictionary: ObjectDictionary | None = None) -> None:
        settings = settings or DriveSettings()
        self.out = Outbox()
        self.values = Values(dictionary or DICTIONARIES[settings.shape], NODE_ID)
        kind = LateDrive if settings.reaction else Drive
        self.drive: Drive = kind(self.out, NODE_ID, self.values, settings)
        self.now: Time = SECOND
        self.drive.reset(self.now)

    def write(self, index: int, value: int, subindex: int = 0) -> None:
        """As an SDO download: checked, stored, told. The drive must take it."""
        assert self.drive.check_write(index, subindex, value) is None
        self.put(index, value, subindex)

    def put(self, index: int, value: int, subindex: int = 0) -> None:
        """As an RPDO: stored and told, whatever it is."""
        self.values.store[mux(index, subindex)] = value
        self.drive.written(index, subindex, self.now)

    def preset(self, index: int, value: int, subindex: int = 0) -> None:
        """Stored only, before it matters."""
        self.values.store[mux(index, subindex)] = value

    def control(self, *words: int) -> State:
        """Write control words one after the other; the state that the drive then shows."""
        for word in words:
            self.write(0x6040, word)
        return self.state

    def enable(self, mode: int) -> None:
        """Into Operation enabled in a mode."""
        self.write(0x6060, mode)
        assert self.control(0x06, 0x07, 0x0F) is State.OPERATION_ENABLED
        assert self.read(0x6061) == mode

    def bring_to(self, state: State) -> None:
        """By commands and faults into a state; into Fault reaction active and Quick stop active while the axis still brakes."""
        words: dict[State, list[int]] = {
            State.SWITCH_ON_DISABLED: [],
            State.READY_TO_SWITCH_ON: [0x06],
            State.SWITCHED_ON: [0x06, 0x07],
            State.FAULT: [],
        }
        if state in words:
            self.control(*words[state])
        else:
            self.preset(0x60FF, 20_000)
            self.enable(3)
            self.run(500)
        if state is State.QUICK_STOP_ACTIVE:
            self.control(0x02)
        if state in (State.FAULT, State.FAULT_REACTION_ACTIVE):
            self.drive.raise_fault(0x5000, self.now)
        assert self.state is state

    def run(self, milliseconds: float) -> None:
        """Let time pass, waking the drive when it asks for it."""
        until = self.now + round(milliseconds * MILLISECOND)
        while self.drive.deadline <= until:
            self.now = max(self.now, self.drive.deadline)
            self.drive.handle_timeout(self.now)
        self.now = until
        self.drive.refresh(self.now)

    def sync(self, period: float = 10) -> None:
        """Let `period` pass, then a SYNC as a node handles it."""
        self.run(period)
        self.drive.on_sync(self.now)

    def read(self, index: int, subindex: int = 0) -> int:
        value = self.values.store[mux(index, subindex)]
        assert isinstance(value, int)
        return value

    @property
    def state(self) -> State:
        """As the statusword shows it, which must be the drive's own opinion."""
        state = state_of(self.read(0x6041))
        assert state is self.drive.state
        return state

    @property
    def position(self) -> int:
        return self.read(0x6064)

    def has(self, *bits: int) -> bool:
        """Whether the statusword has all these bits."""
        return all(self.read(0x6041) >> bit & 1 for bit in bits)

    def events(self) -> list[Event]:
        """The events since the last call, but for changes of the statusword and of the mode."""
        events = [each for each in self.out.events if not isinstance(each, StatuswordChanged | ModeChanged | InputsChanged)]
        self.out.events.clear()
        return events

    def reported(self, kind: type[E]) -> list[E]:
        """Those of one kind; the others are forgotten."""
        return [each for each in self.events() if isinstance(each, kind)]

    def transitions(self) -> list[int]:
        """The numbers of the transitions since the last look at the events."""
        return [each.transition for each in self.reported(DriveStateChanged)]
