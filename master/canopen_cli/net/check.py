"""`canopen net check`: compare each node of the network with the machine file. Nothing is written, no NMT command is sent."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, TypeAlias

import click

from canopen_cli.net.support import ChosenNetwork, choose_network, open_network
from canopen_cli.shared.named_machine import machine_argument
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_master.machine_file.boot_entries import BusNetwork
from canopen_proto.abort import text_of
from canopen_proto.manager.boot.comparison import Compared, NodeComparison, compare_node
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.steps import all_of

COLUMNS: Final = ("bus", "node", "name", "NMT state", "is", "settings")
WRONG: Final = ("node", "name", "object", "expected", "found")
MAX_SHOWN: Final = 16
"""Bytes of a value that are shown."""


class Checked:
    """A node that was compared. state: the last one that was heard; None if none was."""

    def __init__(self, network: BusNetwork, result: NodeComparison, state: NmtState | None) -> None:
        self.network = network
        self.result = result
        self.state = state

    @property
    def is_another(self) -> bool:
        """Whether it answers, and is not the device of the file."""
        return self.result.answers and any(not each.is_setting for each in self.result.wrong)

    @property
    def name(self) -> str:
        """The node's name in the machine file."""
        return self.network.names[self.result.node_id]


Strangers: TypeAlias = list[tuple[str, int]]
"""Nodes that were heard and are in no list, by bus."""


@command()
@machine_argument
@click.option("--identity", is_flag=True, help="Only who the nodes are, not their settings.")
def check(settings: Settings, screen: Screen, file: Path | None, identity: bool) -> int:
    """Compare each node with the machine file; nothing is written.

    Read are device type, identity, program and each setting that a boot would write. Exit status: 0 all is as in the file,
    1 something differs or a node does not answer, 5 no node answers.

    \b
    canopen net check cell.toml
    canopen net check cell.toml --identity -b can0
    """
    chosen = choose_network(settings, screen, file)
    nodes, strangers = run(settings, screen, lambda: _compare(settings, screen, chosen, settings_too=not identity))
    if settings.json:
        screen.json([_as_json(each) for each in nodes])
    else:
        _show(screen, chosen, nodes)
    for bus, node_id in strangers:
        screen.say(f"[yellow]node {node_id} on {escape(bus)} was heard, and is not in {escape(chosen.machine.source)}[/]")
    headline, status = verdict(nodes)
    if status is ExitCode.NO_ANSWER:
        raise CommandError(
            status,
            "CO201",
            f"no node of {chosen.machine.source} answers",
            cause="no power, another bit rate, or another bus",
            tries=("canopen scan", "canopen doctor"),
        )
    screen.say(headline)
    return status


def verdict(nodes: list[Checked]) -> tuple[str, ExitCode]:
    """Return the headline of a table of nodes, and the exit status."""
    right = sum(each.result.is_right for each in nodes)
    headline = f"{right} of {counted(len(nodes), 'node')} as in the file{_others(nodes)}"
    if not any(each.result.answers for each in nodes):
        return headline, ExitCode.NO_ANSWER
    return headline, ExitCode.OK if right == len(nodes) else ExitCode.DIFFERENT


def _others(nodes: list[Checked]) -> str:
    """Say what the nodes are that are not as in the file."""
    silent = sum(not each.result.answers for each in nodes)
    another = sum(each.is_another for each in nodes)
    settings = sum(each.result.answers and not each.is_another and not each.result.is_right for each in nodes)
    kinds = ((silent, "silent"), (another, "another device"), (settings, "with other settings"))
    return "".join(f", {count} {kind}" for count, kind in kinds if count)


async def _compare(
    settings: Settings, screen: Screen, chosen: ChosenNetwork, *, settings_too: bool
) -> tuple[list[Checked], Strangers]:
    async with open_network(settings, screen, chosen) as opened:
        jobs = [(network, node_id) for network in chosen.networks for node_id in network.names]
        results = await opened.master.run(
            all_of(
                *(
                    compare_node(opened.nodes[network.bus, node_id], network.entry.nodes[node_id], settings=settings_too)
                    for network, node_id in jobs
                )
            )
        )
        checked = [
            Checked(network, result, opened.nodes[network.bus, node_id].nmt_state)
            for (network, node_id), result in zip(jobs, results, strict=True)
        ]
        strangers = [
            (network.bus, node_id)
            for network in chosen.networks
            for node_id in opened.master.bus(network.bus).network.heard_nodes()
            if node_id not in network.names
        ]
        return checked, strangers


def _show(screen: Screen, chosen: ChosenNetwork, nodes: list[Checked]) -> None:
    hidden = ("bus",) if len(chosen.networks) == 1 else ()
    columns = [name for name in COLUMNS if name not in hidden]
    rows = [dict(zip(COLUMNS, _row(each), strict=True)) for each in nodes]
    screen.table(columns, [[row[name] for name in columns] for row in rows], right=("node",))
    wrong = [row for each in nodes for row in _wrong_rows(chosen, each)]
    if wrong:
        screen.data("")
        screen.table(WRONG, wrong, right=("node",))


def _row(node: Checked) -> tuple[str, ...]:
    result = node.result
    settings = [each for each in result.objects if each.is_setting]
    right = sum(each.is_right for each in settings)
    who = "[yellow]silent[/]"
    if result.answers:
        who = "[yellow]another[/]" if node.is_another else "right"
    state = "" if node.state is None else node.state.name.lower().replace("_", "-")
    shown = f"{right} of {len(settings)} right" if settings else ""
    if right < len(settings):
        shown = f"[yellow]{shown}[/]"
    return escape(node.network.bus), str(result.node_id), escape(node.name), state, who, shown


def _wrong_rows(chosen: ChosenNetwork, node: Checked) -> Iterator[tuple[str, ...]]:
    dictionary = chosen.dictionary_of(node.network, node.result.node_id)
    for each in node.result.wrong:
        variable = dictionary.get(each.index, each.subindex)
        name = "" if variable is None else f" {variable.name}"
        expected = _shown(each.expected) if each.expected is not None else ""
        place = f"0x{each.index:04X}:{each.subindex:02X}{name}"
        yield str(node.result.node_id), escape(node.name), escape(place), expected, _found(each)


def _found(each: Compared) -> str:
    if each.found is not None:
        return _shown(each.found)
    return "not readable" if each.abort_code is None else f"abort 0x{each.abort_code:08X}, {text_of(each.abort_code)}"


def _shown(data: bytes) -> str:
    """Return a value for people: as a number, or as its bytes."""
    if 0 < len(data) <= 8 and len(data) in (1, 2, 4, 8):
        return f"0x{int.from_bytes(data, 'little'):0{2 * len(data)}X}"
    return data[:MAX_SHOWN].hex(" ") + (f" ... ({len(data)} bytes)" if len(data) > MAX_SHOWN else "")


def _as_json(node: Checked) -> dict[str, Any]:
    return {
        "bus": node.network.bus,
        "node": node.result.node_id,
        "name": node.name,
        "state": None if node.state is None else node.state.name,
        "answers": node.result.answers,
        "right": node.result.is_right,
        "objects": [
            {
                "index": each.index,
                "sub": each.subindex,
                "setting": each.is_setting,
                "expected": None if each.expected is None else each.expected.hex(),
                "found": None if each.found is None else each.found.hex(),
                "abort": each.abort_code,
                "right": each.is_right,
            }
            for each in node.result.objects
        ],
    }
