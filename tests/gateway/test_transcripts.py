"""The recorded sessions of canopend and coctl, replayed to ours: the differences are those of docs/gateway.md, with reasons."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import trio

from canopen_master import open_master
from canopen_master.simulation.serving import DEMO_NODES, simulated_drives
from canopen_proto.gateway import (
    LELY,
    GatewayAnswer,
    GatewayAnswered,
    GatewayClient,
    GatewayCommand,
    GatewayEvent,
    GatewayNews,
    GatewayOddLine,
    GatewayRequest,
)
from tests.gateway.gateway_world import TextClient
from tests.gateway.transcripts import differences, text_of
from tests.master.world import virtual_time

PAGE = (Path(__file__).parents[2] / "docs" / "gateway.md").read_text(encoding="utf-8")


def rows(name: str) -> list[tuple[str, str, str, str]]:
    """The table of differences to a gateway: line, its answer, ours, why."""
    section = PAGE.partition(f"### Where ours answers something else than {name}\n")[2].partition("\n##")[0]
    found = re.findall(r"^\| `(.*?)` \| `(.*?)` \| `(.*?)` \| (.*?) \|$", section, re.MULTILINE)
    return [(line, theirs, own, why) for line, theirs, own, why in found]


def without_number(line: str, answer: str) -> str:
    """An answer without its number, unless that is not the line's."""
    number = re.match(r"\[[0-9]+\]", line)
    return answer.removeprefix(f"{number[0]} ") if number is not None else answer


@pytest.mark.parametrize("name", ["canopend", "coctl"])
def test_the_differences_are_those_of_the_page(name: str) -> None:
    seen = [(line, without_number(line, theirs), without_number(line, own)) for line, theirs, own in differences(name)]
    written = rows(name)
    assert [row[:3] for row in written] == seen
    assert all(row[3] for row in written)


def test_our_client_tells_answers_and_events_of_coctl_apart() -> None:
    client = GatewayClient(LELY)
    for _ in range(25):
        client.send(GatewayRequest(GatewayCommand.READ, node=3, numbers=(0x1000, 0)), 0)
    client.receive(text_of("coctl").encode(), 0)
    messages = client.take_messages()
    answers = {each.request.sequence: each.answer for each in messages if isinstance(each, GatewayAnswered)}
    assert sorted(set(range(1, 26)) - answers.keys()) == [2, 15]  # lines that coctl could not parse, and did not answer
    assert answers[1] == GatewayAnswer(1, code=104, remark="No default net set")
    assert answers[12] == GatewayAnswer(12, '"Simulated Schunk Powerball joint"')
    aborted = answers[14]
    assert aborted is not None
    assert aborted.abort_code == 0x06020000
    kinds = [each.kind for each in messages if isinstance(each, GatewayEvent)]
    assert kinds.count(GatewayNews.BOOT_UP) == 7
    assert kinds.count(GatewayNews.OTHER) == 7  # USER BOOT
    assert kinds.count(GatewayNews.READ_SO_FAR) == 4
    assert kinds.count(GatewayNews.STATE) == 3
    odd = [each.text for each in messages if isinstance(each, GatewayOddLine)]
    assert "[17] 0x92" in odd  # the second answer to one request
    assert all(line.startswith(("<stdin>", "coctl:", "(coctl", "[17]", "obj.c", "gw.c")) for line in odd), odd


@virtual_time
async def test_the_first_minute_of_the_page() -> None:
    block = re.search(r"```text\n(> .*?)```", PAGE, re.DOTALL)
    assert block is not None
    async with (
        simulated_drives(("virtual:minute", node_id) for node_id in DEMO_NODES),
        open_master("virtual:minute") as master,
    ):
        from canopen_gateway import open_gateway, parse_permissions

        async with open_gateway(master, allow=parse_permissions("nmt")) as service:
            with service.open_session("nc") as session:
                client = TextClient(session)
                expected: list[str] = []
                for line in block[1].splitlines():
                    kind, text = line[0], line[2:]
                    if kind == ">":
                        assert expected == []
                        expected = [await client.say(text)]
                    else:
                        assert text == (expected.pop() if expected else await client.event())
    assert trio.current_time() < 60


def test_the_page_has_every_command_once() -> None:
    table = PAGE[PAGE.index("## Commands") : PAGE.index("Types: ")].replace("\\|", "|")
    for command in GatewayCommand:
        words = command.syntax.words
        first = words[0][0] if words[0][0] not in ("r", "w") else f"{words[0][0]}[{words[0][1][1:]}]"
        assert first in table or first == "preop", command
