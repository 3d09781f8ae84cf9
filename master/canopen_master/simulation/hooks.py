"""Scripts that animate a simulated device: a plain Python file beside its EDS.

    OBJECTS = ["temperature", "2001:02"]        # the objects that the script serves

    def setup(device):                          # power-on, and after each NMT reset of the node
        device["serial_number"] = 4711

    def on_read(device, index, subindex):       # a client reads one of OBJECTS; None: the stored value
        return 20 + index % 5

    def on_write(device, index, subindex, value):       # one of OBJECTS is written; then it is stored
        if value > 100:
            device.abort(0x06090031)            # refused

    def step(device, t):                        # every PERIOD seconds (0.01), t seconds after power-on
        device["position actual value"] = round(1000 * math.sin(t))

    async def run(device):                      # or as a task, from power-on
        await trio.sleep(2)
        device.raise_error(0x4210)

Each of these may be left out. Without OBJECTS, on_read and on_write serve all objects from 0x2000 on. `device` is a
`ScriptDevice`: `device[name]` reads and writes an object by name, index or (index, subindex). A value that is set is sent by the
event-driven TPDOs that carry it.

Objects that a script serves are `LocalNode.deferred`: the core reports ObjectAccessPending, and the script's answer is given by
`complete`. on_read and on_write may be `async`; the client waits, up to 5 s. PDOs do not ask the script: a TPDO carries the
stored values, and those of an RPDO are stored before on_write is called, which cannot refuse them.

A script is foreign code, and its errors must not end the simulation: an error in on_read or on_write is answered with 0x08000020,
and every error is reported with file and line. After MAX_FAILURES errors in a row `step` is no longer called; `run` is not called
again once it ends. No function may block: work that takes time belongs into `run`.
"""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Awaitable, Callable, Coroutine
from pathlib import Path
from typing import Any, Final, NoReturn, Protocol

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Key, NotInDictionaryError, ObjectDictionary
from canopen_proto.error_codes import register_bits_of
from canopen_proto.explained import Explained
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import SECOND, Event, LocalProtocolError, Time
from canopen_proto.nmt import NmtCommand, NmtResetRequested, NmtState
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.multiplexed import MpdoReceived
from canopen_proto.sdo.server import ObjectAccessPending
from canopen_transports.loop import TASK_STATUS_IGNORED, Nursery, TaskStatus, current_loop

PERIOD: Final = 0.01
"""Seconds between two calls of `step`, unless the script says otherwise."""
MIN_PERIOD: Final = 0.001
MAX_FAILURES: Final = 10
"""Errors of `step` in a row after which it is no longer called."""
FIRST_SERVED: Final = 0x2000
"""The first index that a script may serve. Those below are the protocol's own."""

FUNCTIONS: Final = {"setup": 1, "run": 1, "step": 2, "on_read": 3, "on_write": 4}
"""The functions that a script may have, and how many arguments each takes."""


class ScriptError(Explained, Exception):
    """A script cannot be used. place: file and line. message: for people."""

    def __init__(self, place: str, message: str) -> None:
        super().__init__("CO331", f"{place}: {message}", cause="a mistake in the script")


class _HookAbort(Exception):
    """Raised by `ScriptDevice.abort`."""

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


class DeviceHost(Protocol):
    """Drives the device: `simulation.Host`."""

    def now(self) -> Time:
        """Return the devices' time, ns."""

    def pump(self) -> None:
        """Send the frames and report the events of the devices."""


class Script:
    """A script's text. Each device runs it separately, so that two devices with the same script share nothing.

    path: for messages. Raises ScriptError if the text is not Python.
    """

    def __init__(self, text: str, path: str | Path = "script") -> None:
        self.path = str(path)
        try:
            self._code = compile(text, self.path, "exec")
        except (SyntaxError, ValueError) as error:  # ValueError: a NUL in it
            line = getattr(error, "lineno", None)
            message = error.msg if isinstance(error, SyntaxError) else str(error)
            raise ScriptError(f"{self.path}:{line}" if line else self.path, str(message)) from None

    def run(self) -> dict[str, Any]:
        """Run the script, and return its names. Raises ScriptError for every error in it."""
        names: dict[str, Any] = {"__name__": Path(self.path).stem, "__file__": self.path}
        try:
            exec(self._code, names)
        except Exception as error:
            raise ScriptError(*self.describe(error)) from error
        return names

    def load(self) -> dict[str, Any]:
        """Run the script, and return its names. Raises ScriptError also for a function with other arguments than FUNCTIONS."""
        names = self.run()
        for name, count in FUNCTIONS.items():
            function = names.get(name)
            if function is not None and not _takes(function, count):
                raise ScriptError(self.path, f"{name} must be a function of {count} argument{'s' if count > 1 else ''}")
        return names

    def describe(self, error: BaseException) -> tuple[str, str]:
        """Return the place of an error in the script, and its text."""
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == self.path]
        return f"{self.path}:{lines[-1]}" if lines else self.path, f"{type(error).__name__}: {error}"


def _takes(function: object, count: int) -> bool:
    if not callable(function):
        return False
    try:
        inspect.signature(function).bind(*range(count))
    except TypeError:
        return False
    return True


class ScriptDevice:
    """A device as its script sees it. node: the `LocalNode`, for everything that is not here."""

    def __init__(self, node: LocalNode, owner: DeviceHost, say: Callable[[str], object]) -> None:
        self.node = node
        self._owner = owner
        self._say = say

    @property
    def node_id(self) -> int:
        """The node-ID, 1..127."""
        return self.node.node_id

    @property
    def dictionary(self) -> ObjectDictionary:
        """The device's objects."""
        return self.node.dictionary

    @property
    def is_operational(self) -> bool:
        """Whether the node is Operational: PDOs are exchanged."""
        return self.node.state is NmtState.OPERATIONAL

    def __getitem__(self, key: Key) -> Value:
        """Return the present value of an object. Raises ObjectNotFoundError."""
        self.node.application.refresh(self._owner.now())
        return self.node.values.read(key)

    def __setitem__(self, key: Key, value: Value) -> None:
        """Set an object as the device itself. The name of a constant stands for its value.

        Event-driven TPDOs that carry it are sent. Raises ObjectNotFoundError, or ValueRangeError if it cannot hold the value.
        """
        variable = self.dictionary.variable(key)
        value = self.dictionary.value_from(variable, value)
        self.node.set_value(variable.index, variable.subindex, value, self._owner.now())
        self._owner.pump()

    def raise_error(self, code: int, vendor_data: bytes = b"") -> None:
        """Raise an error: sends EMCY, sets 0x1001 and 0x1003. code: 0x0100..0xFFFF. vendor_data: up to 5 bytes."""
        self.node.raise_error(code, int(register_bits_of(code)), vendor_data, self._owner.now())
        self._owner.pump()

    def clear_error(self, code: int) -> None:
        """Clear an error. code: as it was raised."""
        self.node.clear_error(code, self._owner.now())
        self._owner.pump()

    def abort(self, code: int = AbortCode.CANNOT_TRANSFER) -> NoReturn:
        """Refuse the access with an SDO abort code; for on_read and on_write."""
        raise _HookAbort(code)

    def say(self, text: str) -> None:
        """Show a text to the user of the simulation."""
        self._say(text)


class Hooks:
    """One device's run of a script."""

    def __init__(self, script: Script, node: LocalNode, owner: DeviceHost, say: Callable[[str], object]) -> None:
        """say: called with each message. Raises ScriptError if the script fails, or names unknown objects."""
        self._script = script
        self._node = node
        self._owner = owner
        self._say = say
        self._names = script.load()
        self._device = ScriptDevice(node, owner, self._tell)
        self._served = self._find_served()
        self._nursery: Nursery | None = None
        if "on_read" in self._names or "on_write" in self._names:
            node.deferred |= self._served

    def _find_served(self) -> set[int]:
        dictionary = self._node.dictionary
        listed = self._names.get("OBJECTS")
        if listed is None:
            return {index for index in dictionary.objects if index >= FIRST_SERVED}
        try:
            served = {dictionary.variable(key).index for key in listed}
        except (NotInDictionaryError, TypeError, ValueError) as error:
            raise ScriptError(self._script.path, f"OBJECTS: {error}") from None
        if served and min(served) < FIRST_SERVED:
            raise ScriptError(
                self._script.path, f"OBJECTS: 0x{min(served):04X} is the protocol's own: from 0x2000 on they are free"
            )
        return served

    def set_up(self) -> None:
        """Call `setup`, after power-on or a reset: the values are the defaults."""
        self._guard("setup", self._device)

    async def run(self, task_status: TaskStatus[None] = TASK_STATUS_IGNORED) -> None:
        """Run `run` and `step`, from power-on until cancelled."""
        async with current_loop().open_nursery() as self._nursery:
            try:
                if "run" in self._names:
                    self._nursery.start_soon(self._run)
                if "step" in self._names:
                    self._nursery.start_soon(self._step)
                task_status.started()
                await current_loop().sleep_forever()
            finally:
                self._nursery = None

    async def _run(self) -> None:
        try:
            running = self._names["run"](self._device)
            if inspect.iscoroutine(running):
                await running
        except Exception as error:  # noqa: BLE001 - foreign code
            self._complain("run", error)

    async def _step(self) -> None:
        start, failures = self._owner.now(), 0
        period = self._period()
        wake = current_loop().current_time()
        while failures < MAX_FAILURES:
            done, _ = self._guard("step", self._device, (self._owner.now() - start) / SECOND)
            failures = 0 if done else failures + 1
            wake = max(wake + period, current_loop().current_time())
            await current_loop().sleep_until(wake)
        self._tell(f"{self._script.path}: step failed {MAX_FAILURES} times in a row and is no longer called")

    def _period(self) -> float:
        period = self._names.get("PERIOD", PERIOD)
        return max(MIN_PERIOD, float(period)) if isinstance(period, int | float) and period == period else PERIOD

    def on_event(self, event: Event) -> None:
        """Hand an event of the device to the script."""
        match event:
            case ObjectAccessPending(index=index) if index in self._served and index in self._node.deferred:
                self._answer(event)
            case PdoReceived():
                for entry, value in zip(event.mapping.components, event.components, strict=True):
                    self._written_by_pdo(entry.index, entry.subindex, value)
            case MpdoReceived():
                self._written_by_pdo(event.index, event.subindex, event.value)
            case NmtResetRequested(command=NmtCommand.RESET_NODE):
                self.set_up()

    def _written_by_pdo(self, index: int, subindex: int, value: Value) -> None:
        if index in self._served and "on_write" in self._names:
            done, result = self._guard("on_write", self._device, index, subindex, value)
            if done and inspect.iscoroutine(result):
                self._start(result, self._finish, "on_write", result)

    def _start(
        self, coroutine: Coroutine[object, object, object], task: Callable[..., Awaitable[object]], *arguments: object
    ) -> bool:
        """Run the coroutine of an async function of the script by `task`. If the device is ending, drop it and return False."""
        if self._nursery is None:
            coroutine.close()
            return False
        self._nursery.start_soon(task, *arguments)
        return True

    async def _finish(self, name: str, result: Awaitable[object]) -> tuple[bool, object]:
        try:
            return True, await result
        except _HookAbort as refusal:
            return False, refusal.code
        except Exception as error:  # noqa: BLE001 - foreign code
            self._complain(name, error)
            return False, AbortCode.CANNOT_TRANSFER

    def _answer(self, access: ObjectAccessPending) -> None:
        name = "on_read" if access.data is None else "on_write"
        done, result = True, None
        if name in self._names:
            place = (access.index, access.subindex)
            if access.data is None:
                done, result = self._guard(name, self._device, *place)
            else:
                value = self._node.dictionary.variable(place).decode(access.data)
                done, result = self._guard(name, self._device, *place, value)
        if not done or not inspect.iscoroutine(result):
            self._complete(access, name, done, result)
        elif not self._start(result, self._answer_later, access, name, result):
            self._complete(access, name, False, AbortCode.LOCAL_CONTROL)

    async def _answer_later(self, access: ObjectAccessPending, name: str, result: Awaitable[object]) -> None:
        self._complete(access, name, *await self._finish(name, result))

    def _complete(self, access: ObjectAccessPending, name: str, done: bool, result: object) -> None:
        """done: whether the script succeeded; result: its value, else the abort code."""
        now, node = self._owner.now(), self._node
        answer: bytes | AbortCode | None
        if not done:
            assert isinstance(result, int)
            answer = _abort_code(result)
        elif access.data is not None:
            answer = node.take_write(access.index, access.subindex, access.data, now)
        else:
            answer = self._bytes(access, name, result)
        node.complete(access.access_id, answer, now)
        self._owner.pump()

    def _bytes(self, access: ObjectAccessPending, name: str, result: object) -> bytes | AbortCode:
        """Return the answer to a read: the script's value, which is stored too, or the stored value."""
        variable = self._node.dictionary.variable((access.index, access.subindex))
        try:
            if result is not None:
                self._device[variable] = result  # type: ignore[assignment]
            return variable.encode(self._device[variable])
        except LocalProtocolError as error:
            self._complain(name, error)
            return AbortCode.CANNOT_TRANSFER

    def _guard(self, name: str, *arguments: object) -> tuple[bool, object]:
        """Call a function of the script, if it has one. Returns whether it succeeded, and its value, else the abort code."""
        function = self._names.get(name)
        if function is None:
            return True, None
        try:
            return True, function(*arguments)
        except _HookAbort as refusal:
            return False, refusal.code
        except Exception as error:  # noqa: BLE001 - foreign code
            self._complain(name, error)
            return False, AbortCode.CANNOT_TRANSFER

    def _complain(self, name: str, error: Exception) -> None:
        place, message = self._script.describe(error)
        self._tell(f"{place}: in {name}: {message}")

    def _tell(self, text: str) -> None:
        self._say(f"node {self._node.node_id}: {text}")


def _abort_code(code: int) -> AbortCode:
    """Return the code as an AbortCode; CANNOT_TRANSFER if CiA 301 has no such code."""
    try:
        return AbortCode(code)
    except ValueError:
        return AbortCode.CANNOT_TRANSFER
