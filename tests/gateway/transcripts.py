"""The recorded sessions of two foreign text gateways, and what ours answers to the same lines.

They are not part of the repository: see tests/interop/recorded.py. Of canopend (CANopenNode) the lines are recorded; of coctl
(Lely) only the answers, so the lines are those that these answers must have had.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

import pytest
import trio
import trio.testing

from canopen_gateway import open_gateway, parse_permissions
from canopen_master import open_master
from canopen_master.simulation.serving import DEMO_NODES, simulated_drives
from canopen_proto.gateway import CANOPENNODE, LELY, Dialect
from tests.gateway.gateway_world import EVERYTHING, TextClient
from tests.interop.recorded import FOLDER, VARIABLE

BUS = "virtual:transcripts"
LELY_LINES = {
    8: "r 0x1000 0 u32",
    9: "r 0x1018 1 u32",
    10: "r 0x6041 0 u16",
    11: "r 0x6064 0 i32",
    12: "r 0x1008 0 vs",
    13: "w 0x1017 0 u16 200",
    14: "r 0x2FFF 0 u8",
    17: "r 0x1000 0 u8",
    18: "r 0x1008 0 d",
    19: "w 0x6060 0 i8 300",
    20: "start",
    21: "stop",
    22: "preop",
}
"""Requests to node 3 of net 1, by the numbers of their answers."""


class Exchange(NamedTuple):
    """A line, and what a gateway has answered."""

    line: str
    answer: str


def text_of(name: str) -> str:
    """A transcript; the test is skipped where there is none."""
    path = FOLDER / f"gw309-{name}-transcript.txt"
    if not path.exists():
        pytest.skip(f"no recorded session of {name}: {FOLDER} has none (${VARIABLE} names another folder)")
    return path.read_text(encoding="utf-8")


def of_canopend() -> list[Exchange]:
    """The exchanges with canopend, in order."""
    found = re.findall(r"^'(.*?)' +-> b'(.*?)'  [0-9.]+ ms$", text_of("canopend"), re.MULTILINE)
    return [Exchange(line, answer.encode().decode("unicode_escape")) for line, answer in found]


def of_coctl() -> list[Exchange]:
    """The exchanges with coctl whose lines are known. Two answers with one number stand one behind the other."""
    answers: dict[int, str] = {}
    for line in text_of("coctl").splitlines():
        match = re.match(r"\[([0-9]+)\] ", line)
        if match is not None:
            number = int(match[1])
            answers[number] = f"{meaning(answers[number])}, {line}" if number in answers else line
    return [Exchange(f"[{number}] 1 3 {line}", answers[number]) for number, line in LELY_LINES.items()]


def ours(exchanges: Iterable[Exchange], dialect: Dialect) -> list[Exchange]:
    """What our gateway answers, with the drives of the demonstration behind it. With its permissions, it may do everything."""
    answered = []

    async def replay() -> None:
        async with (
            simulated_drives((BUS, node_id) for node_id in DEMO_NODES),
            open_master(BUS) as master,
            open_gateway(master, allow=parse_permissions(EVERYTHING)) as service,
        ):
            with service.open_session("a transcript") as session:
                client = TextClient(session, dialect)
                for line, _ in exchanges:
                    answered.append(Exchange(line, await client.say(line)))

    trio.run(replay, clock=trio.testing.MockClock(autojump_threshold=0))
    return answered


def meaning(answer: str) -> str:
    """An answer without the words for people behind an error, and without the end of its line."""
    return re.sub(r" #.*| \(.*\)$", "", answer.strip())


def differences(name: str) -> list[tuple[str, str, str]]:
    """The lines to which our gateway answers something else: the line, their answer, ours."""
    exchanges, dialect = (of_canopend(), CANOPENNODE) if name == "canopend" else (of_coctl(), LELY)
    answers = ours(exchanges, dialect)
    return [
        (line, meaning(theirs), meaning(own))
        for (line, theirs), (_, own) in zip(exchanges, answers, strict=True)
        if meaning(theirs) != meaning(own)
    ]
