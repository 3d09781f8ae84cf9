"""The table of a network's nodes after a boot, and every headline, summary and exit status, derived from that table alone.

What a mandatory node that is not ready leaves running is decided by `start` of the machine file (0x1F80, bits 1 and 3; from
memory of CiA 302-2, and as Lely's master does it):

    "each"    the default, bit 1 = 0: each node is started as soon as it is ready, so the others run
    "all"     bit 1 = 1: nobody is started before every mandatory node is ready, so nobody runs
    "none"    bit 3 = 1: the master starts nobody in any case

A node that is kept alive and was Operational before runs on with each of them, even if it is the wrong one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.screen import counted
from canopen_proto.manager.boot.assignment import Startup
from canopen_proto.manager.boot.entry import NetworkEntry
from canopen_proto.manager.boot.network_boot import BootReport
from canopen_proto.manager.boot.outcome import BootLetter, BootOutcome

SILENT: Final = (BootLetter.SILENT, BootLetter.NO_HEARTBEAT, BootLetter.NO_GUARDING, BootLetter.NO_ERROR_CONTROL)
"""Results of nodes that do not answer, or fall silent."""
MAX_NAMED: Final = 4
"""Nodes that a headline names."""
_NEXT: Final = {
    BootLetter.SILENT: "canopen scan    (which nodes are there?)",
    BootLetter.OTHER_PROGRAM: 'program = "FILE" in the machine file, or canopen flash',
    BootLetter.NOT_CONFIGURED: "canopen net check -v    (each setting beside that of the node)",
    BootLetter.NO_ERROR_CONTROL: 'heartbeat = "200ms" in the machine file',
}
"""Advice by result; for the others `canopen net check`."""
_ALL_FIRST: Final = 'start = "all" in [network], if no node may run without this one'


class NodeState(StrEnum):
    """What is known of a node, for people."""

    RUNNING = "running"
    UNWATCHED = "was started, and is not supervised, so whether it still runs is not known"
    IDLE = "was started, and shows that it does not run"
    READY = "ready, not started"
    FAILED = "failed"
    RUNS_ON = "failed, and runs on: it is kept alive"
    MAY_RUN = "failed; it is kept alive, and whether it runs is not known"
    GONE = "was ready, and is lost or has booted again"
    STOPPED = "was stopped, since a mandatory node of its bus was lost"
    UNFINISHED = "not finished: reset, perhaps configured, or its program written, in part; not started"

    @property
    def is_good(self) -> bool:
        """Whether the node is as a good boot-up has left it, as far as is known."""
        return self in (NodeState.RUNNING, NodeState.UNWATCHED, NodeState.READY)


_SHORT: Final = {
    NodeState.IDLE: "started and not running",
    NodeState.READY: "ready and not started",
    NodeState.FAILED: "failed",
    NodeState.RUNS_ON: "failed and runs on, since it is kept alive",
    NodeState.MAY_RUN: "failed and may run, since it is kept alive",
    NodeState.GONE: "lost or booted again",
    NodeState.STOPPED: "stopped",
    NodeState.UNFINISHED: "not finished",
}
"""What a headline says of the nodes that do not run."""


@dataclass(frozen=True, slots=True)
class NodeRow:
    """A node in the table. place: its name for people. outcome: None as long as there is none."""

    bus: str
    node_id: int
    place: str
    is_mandatory: bool
    state: NodeState
    outcome: BootOutcome | None = None

    @property
    def is_running(self) -> bool:
        """Whether it was started, or left running, and nothing is known against that it still runs."""
        return self.state in (NodeState.RUNNING, NodeState.UNWATCHED)

    @property
    def is_silent(self) -> bool:
        """Whether it does not answer, or fell silent."""
        return not self.state.is_good and self.outcome is not None and self.outcome.letter in SILENT

    @property
    def text(self) -> str:
        """All that is known, in one line."""
        if self.outcome is not None and not self.state.is_good and self.state not in (NodeState.GONE, NodeState.IDLE):
            return f"{self.place}: {self.outcome}"
        return f"{self.place}: {self.state}"


def rows_of(bus: str, entry: NetworkEntry, report: BootReport, places: dict[int, str], *, stopped: bool = False) -> list[NodeRow]:
    """Return a row for each listed node of a bus. stopped: all of its nodes were stopped, also those that are kept alive."""
    rows = []
    for node_id, place in places.items():
        assignment = entry.nodes[node_id].assignment
        state = _state(report, node_id, stopped)
        if state is NodeState.FAILED and assignment.keep_alive:  # no command was sent to it
            state = NodeState.RUNS_ON if node_id in report.left_running else NodeState.MAY_RUN
        rows.append(NodeRow(bus, node_id, place, assignment.is_mandatory, state, report.outcomes.get(node_id)))
    return rows


def _state(report: BootReport, node_id: int, stopped: bool) -> NodeState:
    outcome = report.outcomes.get(node_id)
    if node_id in report.gone:
        return NodeState.GONE
    if stopped:
        return NodeState.STOPPED
    if node_id in report.running:
        return NodeState.UNWATCHED if node_id in report.unsupervised else NodeState.RUNNING
    if node_id in report.idle:
        return NodeState.IDLE
    if outcome is None:
        return NodeState.UNFINISHED
    return NodeState.FAILED if outcome.is_failure else NodeState.READY


def tally(rows: Sequence[NodeRow]) -> str:
    """Say how many nodes run, and what became of the others: "11 of 12 nodes run, 1 failed"."""
    running = sum(row.is_running for row in rows)
    if not running:
        is_sure = not any(row.state in (NodeState.RUNS_ON, NodeState.MAY_RUN) for row in rows)
        text = "no node runs" if is_sure else "no node was started"
    else:
        text = f"{running} of {counted(len(rows), 'node')} {'runs' if running == 1 else 'run'}"
    others = Counter(row.state for row in rows if not row.is_running)
    return ", ".join((text, *(f"{others[state]} {words}" for state, words in _SHORT.items() if others[state])))


def success(rows: Sequence[NodeRow]) -> str:
    """Return the headline of a network whose nodes are all ready."""
    return f"{counted(len(rows), 'node')} ready: {tally(rows)}"


def problem_of(rows: Sequence[NodeRow], startup: Startup) -> CommandError | None:
    """Return the CommandError of nodes that are not ready; None if all are."""
    bad = [row for row in rows if not row.state.is_good]
    if not bad:
        return None
    missing = [row for row in bad if row.is_mandatory]
    first = min(missing or bad, key=lambda row: (not row.is_silent, row.outcome is None))
    advice = _NEXT.get(first.outcome.letter, "canopen net check") if first.outcome is not None else "canopen net check"
    if first.state is NodeState.IDLE:
        advice = f"canopen nmt start {first.node_id}    (if no other master has stopped it)"
    if not missing:
        what = f"{counted(len(bad), 'node')} not ready ({_names(bad)}): {tally(rows)}"
        return CommandError(ExitCode.PARTIAL, "CO216", what, seen=first.text, tries=(advice,), node=first.node_id)
    what = f"{counted(len(missing), 'mandatory node')} not ready ({_names(missing)}): {tally(rows)}"
    others_run = any(row.is_running for row in rows)
    tries = (advice, _ALL_FIRST) if others_run and not startup.start_all and not startup.application_starts else (advice,)
    told: dict[str, Any] = {"seen": first.text, "also": (policy(startup),), "tries": tries, "node": first.node_id}
    if any(row.is_silent for row in missing):
        return CommandError(ExitCode.NO_ANSWER, "CO215", what, **told)
    return CommandError(ExitCode.PARTIAL, "CO215", what, **told)


def policy(startup: Startup) -> str:
    """Say what a mandatory node that is not ready leaves running, by 0x1F80."""
    if startup.application_starts:
        return 'start = "none" in [network]: this master starts no node'
    if startup.start_all:
        return 'start = "all" in [network]: nobody is started before every mandatory node of the bus is ready'
    return 'start = "each" in [network], the default: each node that is ready runs, also while a mandatory one is not ready'


def _names(rows: Sequence[NodeRow]) -> str:
    more = len(rows) - MAX_NAMED
    return ", ".join((*(row.place for row in rows[:MAX_NAMED]), *((f"and {more} more",) if more > 0 else ())))


def by_state(rows: Iterable[NodeRow]) -> list[str]:
    """Return a line for each state that a node has, with the nodes that have it."""
    names: dict[NodeState, list[str]] = {state: [] for state in NodeState}
    for row in rows:
        names[row.state].append(row.place)
    return [f"{state}: {', '.join(places)}" for state, places in names.items() if places]
