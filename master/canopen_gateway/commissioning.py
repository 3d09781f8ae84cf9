"""Commissioning of a drive by a client: the dialogue of `canopen drive commission`, word for word, over messages.

The client holds the lease from its beginning to its end. If the lease ends, the step is cancelled, and the drive halted. What the
drive held before, and the machine file that comes out, go to the client as files: nothing is written on this computer. The
settings are those of the dialogue alone: a chain that this master has keeps its own.
"""

from __future__ import annotations

import base64
import itertools
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeVar

import trio

from canopen_gateway.errors import LeaseError
from canopen_gateway.places import number_said
from canopen_gateway.service import GatewayService
from canopen_gateway.traffic.trace import plain_name
from canopen_master import Master, Node
from canopen_master.commissioning import DriveCommissioning, commissioned_machine, commissioned_name
from canopen_master.commissioning_dialogue import CommissioningDialogue, renamed_text
from canopen_master.machine_file import machine_text
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.plain_text import clean
from canopen_master.way_back import bit_rate_for_dcf, counts_text, dcf_of
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.machine import MILLISECOND
from canopen_proto.manager.parameters.backup import back_up
from canopen_proto.manager.parameters.walk import back_up_by_names
from canopen_proto.procedures.steps import Procedure, sleep

T = TypeVar("T")

AGAIN: Final = 1.0
"""Seconds after which a question is sent again: a slow client may have missed it."""
MANY: Final = 16
PAUSE: Final = MILLISECOND
MOST_TEXT: Final = 2000
"""Characters of a text that is sent."""


class ClientConversation:
    """A `Conversation` with a client. tell: takes each message, as plain data; it must not block."""

    agrees = False
    halted_by = '"Halt all"'

    def __init__(self, tell: Callable[[dict[str, Any]], None]) -> None:
        self._tell = tell
        self._number = 0
        self._answered = trio.Event()
        self._answer: Any = None

    def heading(self, text: str) -> None:
        """See Conversation."""
        self._say("heading", text)

    def fact(self, name: str, text: str) -> None:
        """See Conversation."""
        self._tell({"what": "fact", "name": clean(name, MOST_TEXT), "text": clean(text, MOST_TEXT)})

    def say(self, text: str) -> None:
        """See Conversation."""
        self._say("say", text)

    def remark(self, text: str) -> None:
        """See Conversation."""
        self._say("remark", text)

    def warn(self, text: str, more: str = "") -> None:
        """See Conversation."""
        self._say("warn", f"{text} {more}".rstrip())

    def file(self, name: str, data: bytes) -> None:
        """Give the client a file."""
        self._tell({"what": "file", "name": name, "data": base64.b64encode(data).decode()})

    def end(self, text: str, *, is_confirmed: bool) -> None:
        """Say that it is over."""
        self._tell({"what": "end", "text": clean(text, MOST_TEXT), "confirmed": is_confirmed})

    async def may(self, question: str) -> bool:
        """See Conversation."""
        return await self._ask(kind="may", text=question) is True

    async def number(self, question: str, default: float | None, unit: str = "", *, above_zero: bool = False) -> float | None:
        """See Conversation."""
        while True:
            answer = await self._ask(kind="number", text=question, default=default, unit=unit)
            if answer is None:
                return default
            number = number_said(answer)
            if number is not None and (number > 0 or not above_zero):
                return number
            self.warn(f"{str(answer)[:20]!r} is no number{' above 0' * above_zero}")

    async def choice(self, question: str, choices: Sequence[str], default: str) -> str:
        """See Conversation."""
        while True:
            answer = await self._ask(kind="choice", text=question, choices=list(choices), default=default)
            if answer is None:
                return default
            if isinstance(answer, str) and answer in choices:
                return answer
            self.warn(f"{str(answer)[:20]!r} is none of {', '.join(choices)}")

    def answer(self, question: int, value: Any) -> None:
        """Take the answer to a question; None: its default. One to an earlier question counts nothing."""
        if question == self._number and not self._answered.is_set():
            self._answer = value
            self._answered.set()

    async def _ask(self, *, text: str, **fields: Any) -> Any:
        """Ask until there is an answer."""
        self._number += 1
        self._answered = trio.Event()
        question = {"what": "ask", "question": self._number, "text": clean(text, MOST_TEXT), **fields}
        while not self._answered.is_set():
            self._tell(question)
            with trio.move_on_after(AGAIN):
                await self._answered.wait()
        return self._answer

    def _say(self, what: str, text: str) -> None:
        self._tell({"what": what, "text": clean(text, MOST_TEXT)})


def paced(procedure: Procedure[T]) -> Procedure[T]:
    """Run a procedure of many steps with a pause of PAUSE after each MANY of them: a simulated device of this process answers at
    once, and nobody else would have his turn until the end, not even the client's next sign of life."""
    try:
        step = next(procedure)
        for count in itertools.count(1):
            try:
                result = yield step
                if count % MANY == 0:
                    yield from sleep(PAUSE)
            except BaseException as error:  # noqa: BLE001 - whatever it is, it is the procedure's
                step = procedure.throw(error)
            else:
                step = procedure.send(result)
    except StopIteration as end:
        value: T = end.value
    return value


def check_commissioning(service: GatewayService, node: Node) -> None:
    """Raise LeaseError if a chain uses this drive at present."""
    if service.is_moved(node):
        raise LeaseError("the drive cannot be commissioned", seen="a chain uses it", tries=("take the power of the chain away",))


async def commission(service: GatewayService, node: Node, talk: ClientConversation, name: str) -> None:
    """Lead a client through the commissioning of a drive. IT MOVES, where the client agrees. name: of the joint; "": that of the
    machine, or driveNODE. Raises what the steps raise, after the client was told."""
    master = service.master
    device = master.devices.get((node, 0))
    asked = plain_name(name or ("" if device is None else device.name) or f"drive{node.node_id}").replace(".", "-")
    name = commissioned_name(master.machine, node.bus, node.node_id, asked)
    if name != asked:
        talk.remark(renamed_text(asked, name))
    work = DriveCommissioning(master, node, AxisSettings() if device is None else device.axis.settings)
    dialogue = _dialogue(master, work, talk, name)
    text = "it was ended before its end: the drive was told to halt"
    try:
        try:
            await dialogue.run()
        finally:
            work.leave()  # what was found goes into a file; no chain here changes its units
        if dialogue.is_confirmed:
            talk.file(f"{name}.toml", _machine_of(master, work, name).encode())
            text = f"{name}.toml: {name} with its unit and limits. Next: canopen machine check {name}.toml"
        else:
            text = f"No machine file was made: its scale is not proven. {name}.dcf has its values as they were"
    except Exception as error:
        talk.warn(str(error))
        text = "it was ended by an error: the drive was told to halt"
        raise
    finally:
        if work.done and not dialogue.is_confirmed:
            talk.say(f"Done so far: {'; '.join(work.done)}")
        talk.end(text, is_confirmed=dialogue.is_confirmed)


def _dialogue(master: Master, work: DriveCommissioning, talk: ClientConversation, name: str) -> CommissioningDialogue:
    node = work.node
    machine = master.machine
    entry = None if machine is None else machine.node_at(node.bus, node.node_id)
    description = None
    if machine is not None and entry is not None:
        description = Dictionaries(machine, master.dictionary).description_of(entry)

    async def save() -> tuple[str, str]:
        reading = back_up(node.remote) if description is not None else back_up_by_names(node.remote, node.dictionary)
        found = await master.run(paced(reading))
        bit_rate = bit_rate_for_dcf(master.bus(node.bus).bitrate)
        file = f"{name}.dcf"
        made = await trio.to_thread.run_sync(dcf_of, found, description, file, bit_rate, "canopen serve web")
        talk.file(file, made.data)
        return file, counts_text(found)

    dialogue = CommissioningDialogue(talk, work, description, save)
    dialogue.no_file = "no file of it is named in a machine file (-m): names and PDOs are those of the data files"
    return dialogue


def _machine_of(master: Master, work: DriveCommissioning, name: str) -> str:
    node, machine = work.node, master.machine
    bus = node.bus
    if machine is None:
        bus = getattr(master.bus(bus).transport, "locator", bus)
    return machine_text(commissioned_machine(machine, bus, node.node_id, name, work.settings))
