"""Random programs of eight threads on one blocking master, over a bus that loses frames: what they do, and the judge.

Each thread reads constants, writes and reads an object of its own, moves and halts the arm, waits for PDOs, listens. Calls get
short timeouts, and KeyboardInterrupt is thrown into threads that wait: a real Ctrl-C into the main thread, which is one of the
eight, and an asynchronous exception into the others. A program is known by its number: what the threads want to do is the same
each time; how it mixes is not.

The judge: each thread comes to its end. A read that succeeds gives the value of its object. An object of a thread has a value
that this thread has written. All errors are those that a user is told of. In the end the master is closed, and all drives stand.
"""

from __future__ import annotations

import ctypes
import faulthandler
import random
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import pytest
import trio

from canopen_master import DeviceModel, MasterError, PatientClock, ProcedureTakenBackError
from canopen_master.blocking import (
    BlockingChain,
    BlockingMaster,
    BlockingNode,
    BlockingSimulatedDevices,
    background,
    loop_thread,
    open_master,
    simulated_devices,
)
from canopen_proto import PdoReceived, ProcedureError
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_transports import Received, Report, VirtualTransport
from tests.master.direct_world import LIMIT, near_home, until

THREADS: Final = 8
CONSTANTS: Final = 40
STATION: Final = 10
DRIVES: Final = (3, 4)
TEXT: Final = "a text of more than one segment, which is read in several frames"
_OWN: Final = 0x2100


def constant(number: int) -> int:
    """The value of a constant object."""
    return 0x0101_0101 * (number % 200) + 7


def dictionary() -> ObjectDictionary:
    """Constants from 0x2000 on, an object for each thread from 0x2100 on, and a text."""
    variables = [
        *(
            Variable(0x2000 + each, 0, f"constant_{each}", DataType.UNSIGNED32, default=constant(each))
            for each in range(CONSTANTS)
        ),
        *(Variable(_OWN + each, 0, f"own_{each}", DataType.UNSIGNED32, default=0) for each in range(THREADS)),
        Variable(0x2200, 0, "text", DataType.VISIBLE_STRING, default=TEXT),
    ]
    return ObjectDictionary([Object.of(each.name, [each]) for each in variables])


@dataclass(frozen=True)
class Step:
    """One thing that a thread wants to do. number: chooses what exactly. timeout: seconds for a call, or None."""

    name: str
    number: int
    timeout: float | None


@dataclass(frozen=True)
class Program:
    """What the threads want to do. loss: the share of frames that the bus loses. ends_early: the master is closed once the main
    thread is done, whatever the others do then. pauses: seconds between two interrupts."""

    number: int
    loss: float
    ends_early: bool
    steps: tuple[tuple[Step, ...], ...]
    pauses: tuple[float, ...]


OF_THE_ARM: Final = {"move": 6, "jog": 3, "recover": 4, "halt": 1, "look": 1}
"""What the first two threads do, each with a drive of its own, and how often. One is the main thread, where Ctrl-C comes."""
OF_OTHERS: Final = {"constant": 8, "own": 8, "text": 2, "look": 3, "pdo": 3, "on": 2, "silent": 1, "halt": 0.2, "move": 0.2}
SHORT: Final = (None, None, 0.0, 0.002, 0.02)
LONGER: Final = (None, None, None, 0.02, 0.1)


def program(number: int, steps: int = 20) -> Program:
    """Return the program of a number."""
    chance = random.Random(number)

    def step(weights: Mapping[str, float]) -> Step:
        name = chance.choices([*weights], [*weights.values()])[0]
        return Step(name, chance.randrange(1000), chance.choice(LONGER if name in OF_THE_ARM else SHORT))

    plans = tuple(tuple(step(OF_THE_ARM if place < 2 else OF_OTHERS) for _ in range(steps)) for place in range(THREADS))
    pauses = tuple(chance.uniform(0.0, 0.08) for _ in range(100))
    return Program(number, chance.choice((0.0, 0.001, 0.005)), number % 2 == 1, plans, pauses)


class Worker:
    """One thread. mistakes: what the judge found. interrupted: how often."""

    def __init__(self, place: int, steps: tuple[Step, ...], master: BlockingMaster) -> None:
        self.place = place
        self.todo = list(reversed(steps))
        self.master = master
        self.chain: BlockingChain = master.chains[f"chain{place % 2}"]
        self.station: BlockingNode = master.node(STATION)
        self.mistakes: list[str] = []
        self.interrupted = self.answers = 0
        self.ident = 0
        self.is_inside = False  # a call, which may be interrupted
        self.is_done = False
        self._possible = {0}  # values of its own object
        self._lock = threading.Lock()

    def run(self) -> None:
        self.ident = threading.get_ident()
        while not self.is_done:
            try:
                while self.todo:
                    self._do(self.todo.pop())
                with self._lock:
                    self.is_inside = False
                for _ in range(100):
                    time.sleep(0)  # one that was thrown before arrives here
                self.is_done = True
            except KeyboardInterrupt:
                self.interrupted += 1

    def interrupt(self) -> None:
        """Throw KeyboardInterrupt into it if it is in a call."""
        with self._lock:
            if not self.is_inside:
                return
            self.is_inside = False  # none comes before the next call
            if self.ident == threading.main_thread().ident:
                signal.pthread_kill(self.ident, signal.SIGINT)
            else:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self.ident), ctypes.py_object(KeyboardInterrupt))

    def _do(self, step: Step) -> None:
        self.is_inside = True
        try:
            getattr(self, step.name)(step)
        except (MasterError, ProcedureError, ProcedureTakenBackError):
            pass  # the bus loses frames, time is short, and others command the arm, too
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - whatever it is
            self.mistakes.append(f"{step}: {error!r}")
        finally:
            self.is_inside = False

    def _expect(self, step: Step, value: object, *possible: object) -> None:
        self.answers += 1
        if value not in possible:
            self.mistakes.append(f"{step}: {value!r}, not {possible!r}")

    # ---- steps ----

    def constant(self, step: Step) -> None:
        number = step.number % CONSTANTS
        if step.timeout is None:
            value = self.station[0x2000 + number]
        else:
            value = self.station.read(f"constant_{number}", timeout=step.timeout)
        self._expect(step, value, constant(number))

    def text(self, step: Step) -> None:
        self._expect(step, self.station.read_str("text", timeout=step.timeout), TEXT)

    def own(self, step: Step) -> None:
        before, key = self._possible, _OWN + self.place
        self._possible = before | {step.number}  # from now on: an interrupted write may be executed
        self.station.write(key, step.number, timeout=step.timeout)
        self._possible = {step.number}
        value = self.station.read_int(key, timeout=step.timeout)
        self._expect(step, value, step.number)

    def look(self, step: Step) -> None:
        value = self.station.read_int(_OWN + self.place)
        self._expect(step, value, *self._possible)
        self._possible = {value}
        _ = self.chain.state, self.chain.positions, self.chain.devices[0].node.nmt_state

    def pdo(self, step: Step) -> None:
        with self.chain.devices[0].events(PdoReceived) as pdos:
            found = pdos.receive(timeout=step.timeout or 0.05)
            self._expect(step, found.node_id, DRIVES[self.place % 2])
            pdos.take()

    def on(self, step: Step) -> None:
        node = self.chain.devices[0].node
        wrong: list[object] = []

        def look(pdo: PdoReceived) -> None:
            if pdo.node_id != node.node_id:
                wrong.append(pdo)
            _ = node.nmt_state  # calls back

        with node.on(PdoReceived, look):
            time.sleep(0.01)
        self._expect(step, wrong, [])

    def move(self, step: Step) -> None:
        self.chain.move([step.number / 40_000], timeout=step.timeout)
        self.answers += 1

    def jog(self, step: Step) -> None:
        with self.chain.jog() as jog:
            for _ in range(3):
                jog.velocity([0.1])
                time.sleep(0.005)
        self.answers += 1

    def halt(self, step: Step) -> None:
        self.chain.halt(timeout=step.timeout)

    def recover(self, step: Step) -> None:
        self.chain.recover(timeout=step.timeout)
        self.chain.follow(timeout=step.timeout)

    def silent(self, step: Step) -> None:
        self.master.node(77).read("device_type", timeout=step.timeout)
        self._expect(step, "an answer")


class LossyLink:
    """A master's line to a virtual bus. It loses frames in both ways, drawn from a seed. loss: their share."""

    def __init__(self, name: str, loss: float, seed: int) -> None:
        self.locator = f"lossy:{name}"
        self._name = name
        self._loss = loss
        self._chance = random.Random(seed)

    @cached_property
    def _inner(self) -> VirtualTransport:
        return VirtualTransport(self._name)  # in the loop, where it is first used

    async def send(self, frame: Frame) -> None:
        if self._chance.random() >= self._loss:
            await self._inner.send(frame)
        else:
            await trio.lowlevel.checkpoint()

    async def receive(self) -> Received | Report:
        while True:
            received = await self._inner.receive()
            if self._chance.random() >= self._loss:
                return received

    async def aclose(self) -> None:
        await self._inner.aclose()


@contextmanager
def patient() -> Iterator[None]:
    """A computer that is busy delays the whole world, and nothing is late in it: all of it is in this process.

    An asynchronous exception arrives when the wait of a thread is over: here it waits for no longer than 10 ms at a time.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop_thread, "make_clock", PatientClock)
        patch.setattr(background, "LOOK_UP", 0.01)
        patch.setattr(loop_thread, "LOOK_UP", 0.01)
        yield


def judge(run: Program) -> tuple[int, int]:
    """Run a program; raise AssertionError if the judge finds a mistake. Return how many answers and interrupts there were."""
    makers = {"virtual:threads": [*near_home(*DRIVES), DeviceModel(dictionary(), STATION)]}
    with patient(), simulated_devices(makers) as devices:
        master = open_master(LossyLink("threads", run.loss, run.number), sdo_timeout=0.1)
        try:
            master.node(STATION, dictionary())
            workers = _work(run, master)
        finally:
            close(master)
        assert_stand(devices)
    mistakes = [each for worker in workers for each in worker.mistakes]
    assert mistakes == []
    return sum(each.answers for each in workers), sum(each.interrupted for each in workers)


def _work(run: Program, master: BlockingMaster) -> list[Worker]:
    text = "".join(f"chain{place} joint1 can0 {node_id}\n" for place, node_id in enumerate(DRIVES))
    for chain in master.load_chains(text=text).values():
        until(lambda: succeeds(chain.initialise) and succeeds(chain.follow))  # noqa: B023 - it is waited for here
    workers = [Worker(place, steps, master) for place, steps in enumerate(run.steps)]
    threads = [threading.Thread(target=each.run, name=f"worker {each.place}", daemon=True) for each in workers[1:]]
    interrupting = threading.Thread(target=interrupt_all, args=(run, workers), daemon=True)
    for thread in (*threads, interrupting):
        thread.start()
    workers[0].run()  # in the main thread, where the tests and the fuzzer run
    if run.ends_early:
        close(master)
    for thread in (*threads, interrupting):
        thread.join(LIMIT)
        if thread.is_alive():
            faulthandler.dump_traceback()
            raise AssertionError(f"{thread.name} hangs")
    return workers


def interrupt_all(run: Program, workers: list[Worker]) -> None:
    """Interrupt one after the other, until all are done."""
    chance = random.Random(run.number)
    while not all(each.is_done for each in workers):
        for pause in run.pauses:
            time.sleep(pause)
            chance.choice(workers).interrupt()


def succeeds(function: Callable[[], object]) -> bool:
    try:
        function()
    except (MasterError, ProcedureError):
        return False
    return True


def close(master: BlockingMaster) -> None:
    """Close it. On a bus that loses frames the end may have to say that a halt was not confirmed."""
    try:
        master.close()
    except MasterError as error:
        print(error)


def assert_stand(devices: BlockingSimulatedDevices) -> None:
    """No drive moves, nor will it, and one that has power was told to halt."""
    assert devices.moving == []
    for drive in devices.drives.values():
        word = drive.values.read("controlword")
        assert isinstance(word, int)
        assert drive.drive.state is not State.OPERATION_ENABLED or word & 0x100, f"node {drive.node_id} was not halted"
