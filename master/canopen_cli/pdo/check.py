"""`canopen pdo check`: the PDOs of several nodes compared; see canopen_proto/pdo/consistency.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import click

from canopen_cli.bus.scan import find_nodes
from canopen_cli.pdo.reading import read_all_pdos
from canopen_cli.shared.options import NodeIds, Settings, command
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.session import open_session
from canopen_master.pdo_reading import object_name
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import ALL_NODE_IDS, can_id_of
from canopen_proto.machine import SECOND
from canopen_proto.multiplexer import mapped
from canopen_proto.pdo.consistency import PdoEnd, PdoFinding, PdoFlow, check_pdos, flows_of
from canopen_proto.pdo.settings import PdoSettings

COLUMNS: Final = ("CAN-ID", "bytes", "from", "to", "objects")
LISTEN: Final = 3 * SECOND // 2


@command()
@click.option("--ids", "node_ids", type=NodeIds(), help="Of which nodes: 3-8,12. By default of all that a scan finds.")
def check(settings: Settings, screen: Screen, node_ids: tuple[int, ...] | None) -> int:
    """Compare the PDOs of nodes: who sends to whom, lengths, CAN-IDs with two senders, PDOs nobody takes.

    The devices are only read. What has to be wrong is an error; what may be meant, such as a PDO that only a master takes, is a
    remark. Exit status: 1 with errors.

    \b
    canopen pdo check -b demo
    canopen pdo check --ids 3,5 -b can0
    """
    asked = node_ids
    if asked is None:
        found, _ = run(settings, screen, lambda: find_nodes(settings, screen, tuple(ALL_NODE_IDS), LISTEN))
        asked = tuple(each.node_id for each in found)
        if not asked:
            raise CommandError(ExitCode.NO_ANSWER, "CO201", "no node was found", tries=("canopen scan", "--ids 5"))
    pdos, dictionaries = run(settings, screen, lambda: _read(settings, screen, asked))
    findings = check_pdos(pdos)
    errors = [each for each in findings if each.is_error]
    if settings.json:
        screen.json(
            {
                "nodes": list(asked),
                "flows": [_flow_json(each, dictionaries) for each in flows_of(pdos)],
                "findings": [_finding_json(each) for each in findings],
            }
        )
        return ExitCode.DIFFERENT if errors else ExitCode.OK
    rows = [_row(each, dictionaries) for each in flows_of(pdos)]
    if rows:
        screen.table(COLUMNS, rows, right=("bytes",))
    for each in sorted(findings, key=lambda finding: not finding.is_error):
        mark = "[bold red]error[/]" if each.is_error else "[dim]remark[/]"
        screen.data(f"{mark} {escape(each.rule)}: {escape(each.text)}")
    told = counted(len(errors), "error"), counted(len(findings) - len(errors), "remark")
    screen.say(f"{counted(len(rows), 'PDO')} of {counted(len(asked), 'node')}: {', '.join(told)}")
    return ExitCode.DIFFERENT if errors else ExitCode.OK


async def _read(
    settings: Settings, screen: Screen, node_ids: Sequence[int]
) -> tuple[dict[int, list[PdoSettings]], dict[int, ObjectDictionary]]:
    pdos: dict[int, list[PdoSettings]] = {}
    dictionaries: dict[int, ObjectDictionary] = {}
    async with open_session(settings, screen) as session:
        for node_id in node_ids:
            async with session.turn(node_id):
                node = session.node(node_id)
                read = await read_all_pdos(session, node)
            for each in read:
                if each.settings is None:
                    screen.say(f"[yellow]left out: {escape(each.remark)}[/]")
            pdos[node_id] = [each.settings for each in read if each.settings is not None]
            dictionaries[node_id] = node.dictionary
    return pdos, dictionaries


def _row(flow: PdoFlow, dictionaries: Mapping[int, ObjectDictionary]) -> tuple[str, ...]:
    first = (flow.senders or flow.receivers)[0]
    names = [object_name(dictionaries[first.node_id], index, sub) for index, sub, _ in map(mapped, first.pdo.entries)]
    return first.pdo.can_id_text, str(first.pdo.size), _ends(flow.senders), _ends(flow.receivers), escape(", ".join(names))


def _ends(ends: Sequence[PdoEnd]) -> str:
    return ", ".join(f"node {each.node_id} {each.pdo.name}" for each in ends) or "nobody here"


def _flow_json(flow: PdoFlow, dictionaries: Mapping[int, ObjectDictionary]) -> dict[str, Any]:
    return {
        "can_id": can_id_of(flow.key),
        "senders": [_end_json(each, dictionaries) for each in flow.senders],
        "receivers": [_end_json(each, dictionaries) for each in flow.receivers],
    }


def _end_json(end: PdoEnd, dictionaries: Mapping[int, ObjectDictionary]) -> dict[str, Any]:
    objects = [object_name(dictionaries[end.node_id], index, sub) for index, sub, _ in map(mapped, end.pdo.entries)]
    return {"node": end.node_id, "pdo": end.pdo.name, "bytes": end.pdo.size, "objects": objects}


def _finding_json(finding: PdoFinding) -> dict[str, Any]:
    ends = [{"node": each.node_id, "pdo": each.pdo.name} for each in finding.ends]
    return {"rule": finding.rule, "error": finding.is_error, "text": finding.text, "pdos": ends}
