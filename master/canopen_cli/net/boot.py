"""`canopen net boot` and `net watch`: boot the network of a machine file, and look after it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import click
import trio

from canopen_cli.net.boot_summary import NodeRow, by_state, problem_of, rows_of, success, tally
from canopen_cli.net.support import ChosenNetwork, OpenNetwork, choose_network, open_network
from canopen_cli.shared.named_machine import machine_argument
from canopen_cli.shared.options import Settings, command, commanding, without_dry_run
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.questions import confirm
from canopen_cli.shared.running import first_error, run, run_until_interrupted
from canopen_cli.shared.screen import Screen, escape
from canopen_cli.shared.withholding import show_unsent
from canopen_master.claims.channel_claim import state_claim
from canopen_master.machine_file.boot_entries import BusNetwork
from canopen_master.network_booting import network_boot
from canopen_master.participant.subscription import Subscription
from canopen_master.plain_text import json_text
from canopen_proto.machine import SECOND, Event
from canopen_proto.manager.boot.network_boot import BootReport, NetworkBoot, NetworkStarted, NodeLost, NodeSupervised
from canopen_proto.manager.boot.outcome import BootEnded, BootOutcome
from canopen_proto.network import OutageChanged
from canopen_proto.procedures.steps import Procedure, all_of

COLUMNS: Final = ("bus", "node", "name", "result", "code", "seconds", "state")
_TOLD: Final = (BootEnded, NetworkStarted, NodeLost, NodeSupervised, OutageChanged)


@dataclass
class Booted:
    """The boots of a command, by bus. stopped: the buses whose nodes were all stopped, each with the loss that did it."""

    chosen: ChosenNetwork
    boots: dict[str, NetworkBoot] = field(default_factory=dict)
    stopped: dict[str, NodeLost] = field(default_factory=dict)

    def report(self, network: BusNetwork) -> BootReport:
        """Return how the boot of a bus went so far."""
        return self.boots[network.bus].report(0)

    def story(self) -> list[str]:
        """Tell the state of each node, for an interruption."""
        if not self.boots:
            return ["nothing was sent"]
        outages = filter(None, (each.network.outage for each in self.boots.values()))
        return [*(f"{outage}: what its nodes do is not known; before that:" for outage in outages), *by_state(self.rows())]

    def rows(self) -> list[NodeRow]:
        """Return the table of all nodes, as they are now."""
        return [row for network in self.chosen.networks for row in self.rows_of(network)]

    def rows_of(self, network: BusNetwork) -> list[NodeRow]:
        """Return the table of a bus."""
        places = {node_id: self.chosen.place(network, node_id) for node_id in network.names}
        return rows_of(network.bus, network.entry, self.report(network), places, stopped=network.bus in self.stopped)

    def problem(self) -> CommandError | None:
        """Return the CommandError of nodes that are not ready; None if all are."""
        return problem_of(self.rows(), self.chosen.networks[0].entry.startup)


@command()
@machine_argument
@click.option("--yes", is_flag=True, help="Do not ask.")
@commanding
def boot(settings: Settings, screen: Screen, file: Path | None, yes: bool) -> int:
    """Reset, check, configure and start the nodes of a machine file.

    No node that failed is started. The others run, also if a mandatory one failed, unless [network] has start = "all". Exit
    status: 0 all nodes are ready, 7 some are not, 5 a mandatory one does not answer.

    \b
    canopen net boot cell.toml -b demo --yes     simulated
    canopen net boot cell.toml
    canopen net boot cell.toml --dry-run         what would be written, and in which order
    """
    booted = Booted(choose_network(settings, screen, file))
    if settings.dry_run:
        show_unsent(settings, screen, lambda: _boot(settings, screen, booted))
        return ExitCode.OK
    _confirm(screen, booted.chosen, yes)
    run(settings, screen, lambda: _boot(settings, screen, booted), story=lambda confirmed: booted.story())
    _show(settings, screen, booted)
    _warn_of_guarding(screen, booted.chosen)
    problem = booted.problem()
    if problem is not None:
        raise problem
    screen.say(f"[green]{success(booted.rows())}[/]")
    return ExitCode.OK


@command()
@machine_argument
@click.option("--yes", is_flag=True, help="Do not ask.")
@without_dry_run("it goes on until Ctrl-C, by what the nodes do", "canopen net boot --dry-run")
def watch(settings: Settings, screen: Screen, file: Path | None, yes: bool) -> None:
    """Boot the nodes, then boot those that come back, and react to lost ones, until Ctrl-C.

    Reactions are those of the machine file: mandatory_lost in [network]. With --json each event is a line.

    \b
    canopen net watch cell.toml -b demo --yes
    """
    booted = Booted(choose_network(settings, screen, file))
    _confirm(screen, booted.chosen, yes)
    run_until_interrupted(settings, screen, lambda: _watch(settings, screen, booted))
    for line in booted.story():
        screen.say(escape(line))
    screen.say("the nodes are left as they are, and nobody watches them now")
    if booted.stopped:
        places = [
            booted.chosen.place(network, lost.node_id)
            for network in booted.chosen.networks
            if (lost := booted.stopped.get(network.bus))
        ]
        first = next(iter(booted.stopped.values()))
        raise CommandError(
            ExitCode.NO_ANSWER,
            "CO217",
            f"node {first.node_id} is mandatory and was lost; all nodes of its bus were stopped: {tally(booted.rows())}",
            seen=f"lost: {', '.join(places)}",
            cause="no power, or a cable",
            tries=("canopen net watch, once it is back",),
            node=first.node_id,
        )
    problem = booted.problem() if booted.boots else None
    if problem is not None and problem.code == "CO215":
        raise problem


def _confirm(screen: Screen, chosen: ChosenNetwork, yes: bool) -> None:
    kept = [node for network in chosen.networks for node in network.entry.nodes.values() if node.assignment.keep_alive]
    whom = f"reset {'all nodes' if not kept else 'the nodes that are not kept alive'} of {' and '.join(chosen.locators)}"
    programs = [chosen.place(network, node_id) for network in chosen.networks for node_id in network.programs]
    written = f"; {', '.join(programs)} may get another program" if programs else ""
    question = f"{whom}, configure and start them: drives that move stop, or coast; PDOs go live{written}"
    confirm(screen, question, yes, needed=True)


@asynccontextmanager
async def _opened(
    settings: Settings, screen: Screen, booted: Booted, tell: Callable[[BusNetwork, Event], None]
) -> AsyncIterator[OpenNetwork]:
    """Open the buses, and tell events of their nodes while the block runs, and at its end those that came last."""
    chosen = booted.chosen
    async with AsyncExitStack() as stack:
        if not settings.dry_run:
            for network in chosen.networks:
                await stack.enter_async_context(state_claim(chosen.locators[network.bus], network.names))
        await stack.enter_async_context(first_error())
        opened = await stack.enter_async_context(open_network(settings, screen, chosen))
        nursery = await stack.enter_async_context(trio.open_nursery())
        heard: list[tuple[BusNetwork, Subscription[Any]]] = []
        for network in chosen.networks:
            booted.boots[network.bus] = network_boot(opened.master, chosen.machine, network, chosen.dictionaries)
            events = opened.master.events(*_TOLD, bus=network.bus)
            heard.append((network, events))
            nursery.start_soon(_tell_all, network, events, tell)
        yield opened
        for network, events in heard:
            for event in events.take():
                tell(network, event)
        nursery.cancel_scope.cancel()


async def _tell_all(network: BusNetwork, events: Subscription[Any], tell: Callable[[BusNetwork, Event], None]) -> None:
    async for event in events:
        tell(network, event)


async def _boot(settings: Settings, screen: Screen, booted: Booted) -> None:
    def tell(network: BusNetwork, event: Event) -> None:
        if isinstance(event, BootEnded):
            screen.say(escape(_line(booted.chosen, network, event.outcome)))

    async with _opened(settings, screen, booted, tell) as opened:
        await opened.master.run(all_of(*(each.start() for each in booted.boots.values())))


async def _watch(settings: Settings, screen: Screen, booted: Booted) -> None:
    begun = trio.current_time()

    def tell(network: BusNetwork, event: Event) -> None:
        seconds = trio.current_time() - begun
        if settings.json:
            document = {"seconds": round(seconds, 6), "bus": network.bus, **_event_as_json(event)}
            screen.out.out(json_text(document), highlight=False)
        else:
            screen.data(f"{seconds:9.3f}  {escape(_event_text(booted.chosen, network, event))}")

    async with _opened(settings, screen, booted, tell) as opened:
        await opened.master.run(all_of(*(each.start() for each in booted.boots.values())))
        problem = booted.problem()
        if problem is not None:
            screen.say(f"[yellow]{escape(problem.failed)}; going on: they are booted when they come[/]")
        _tell_unsupervised(settings, screen, booted)

        def supervised(bus: str, each: NetworkBoot) -> Procedure[None]:
            booted.stopped[bus] = yield from each.supervise()  # at once: other buses go on

        await opened.master.run(all_of(*(supervised(bus, each) for bus, each in booted.boots.items())))


def _tell_unsupervised(settings: Settings, screen: Screen, booted: Booted) -> None:
    """Say at the start which nodes nobody would miss."""
    for network in booted.chosen.networks:
        nodes = booted.report(network).unsupervised
        if nodes and settings.json:
            document = {"event": "unsupervised", "bus": network.bus, "nodes": list(nodes)}
            screen.out.out(json_text(document), highlight=False)
        elif nodes:
            names = ", ".join(booted.chosen.place(network, node_id) for node_id in nodes)
            screen.say(
                f"[yellow]not supervised: {escape(names)}. No heartbeat and no guarding: a loss is not noticed. "
                'Try: heartbeat = "500ms" in the machine file[/]'
            )


def _line(chosen: ChosenNetwork, network: BusNetwork, outcome: BootOutcome) -> str:
    return f"{chosen.place(network, outcome.node_id)}: {outcome}"


def _event_text(chosen: ChosenNetwork, network: BusNetwork, event: Event) -> str:
    match event:
        case BootEnded(outcome=outcome):
            return _line(chosen, network, outcome)
        case NodeLost(node_id=node_id, reaction=reaction):
            return f"{chosen.place(network, node_id)}: node {node_id} has shown no sign of life in time, and is lost; {reaction}"
        case NodeSupervised(node_id=node_id, timeout=0):
            return f"{chosen.place(network, node_id)}: it answers, but sends no heartbeats: it is not supervised now"
        case NodeSupervised(node_id=node_id, timeout=timeout):
            return f"{chosen.place(network, node_id)}: its heartbeats are watched from now on ({timeout / SECOND:g} s)"
        case OutageChanged(outage=outage):
            if outage:
                return f"{outage}. No node is taken for lost meanwhile"
            return f"{network.bus}: the bus is back; each node has its full time again"
        case NetworkStarted(running=running):
            mandatory = any(node.assignment.is_mandatory for node in network.entry.nodes.values())
            why = "all mandatory nodes are ready" if mandatory else "all nodes have booted or failed, and none is mandatory"
            return f"{network.bus}: {why}; running: {', '.join(map(str, running)) or 'none'}"
    return repr(event)


def _event_as_json(event: Event) -> dict[str, Any]:
    match event:
        case BootEnded(outcome=outcome):
            return {"event": "booted", **_as_json(outcome)}
        case NodeLost(node_id=node_id, reaction=reaction):
            return {"event": "lost", "node": node_id, "reaction": reaction.value}
        case NodeSupervised(node_id=node_id, timeout=timeout):
            return {"event": "supervised", "node": node_id, "consumer_time": timeout / SECOND}
        case OutageChanged(outage=outage):
            return {"event": "outage" if outage else "back", "reason": outage or None}
        case NetworkStarted(running=running):
            return {"event": "started", "running": list(running)}
    return {"event": repr(event)}


def _as_json(outcome: BootOutcome) -> dict[str, Any]:
    return {
        "node": outcome.node_id,
        "letter": outcome.letter.value,
        "meaning": outcome.meaning,
        "failed": outcome.is_failure,
        "step": outcome.step.value,
        "index": None if outcome.object is None else outcome.object[0],
        "sub": None if outcome.object is None else outcome.object[1],
        "expected": outcome.expected,
        "found": outcome.found,
        "abort": outcome.abort_code,
        "elapsed": outcome.elapsed / SECOND,
        "remark": outcome.remark or None,
    }


def _show(settings: Settings, screen: Screen, booted: Booted) -> None:
    """Show the table of all nodes, also of those without a result."""
    shown: list[dict[str, str]] = []
    documents: list[dict[str, Any]] = []
    for network in booted.chosen.networks:
        for row in booted.rows_of(network):
            name, outcome = network.names[row.node_id], row.outcome
            told = _as_json(outcome) if outcome is not None else {"node": row.node_id, "letter": None, "failed": True}
            documents.append(
                {
                    "bus": row.bus, "name": name, **told, "mandatory": row.is_mandatory, "running": row.is_running,
                    "ready": row.state.is_good, "state": row.state.value,
                }
            )  # fmt: skip
            style = "" if row.state.is_good else "[red]"
            result = "" if outcome is None else f"{style}{escape(outcome.meaning)}{'[/]' if style else ''}"
            code, seconds = ("", "") if outcome is None else (str(outcome.letter), f"{outcome.elapsed / SECOND:.3f}")
            cells = (escape(row.bus), str(row.node_id), escape(name), result, code, seconds, escape(row.state))
            shown.append(dict(zip(COLUMNS, cells, strict=True)))
    if settings.json:
        screen.json(documents)
        return
    columns = [name for name in COLUMNS if name != "bus" or len(booted.chosen.networks) > 1]
    screen.table(columns, [[row[name] for name in columns] for row in shown], right=("node", "seconds"))


def _warn_of_guarding(screen: Screen, chosen: ChosenNetwork) -> None:
    guarded = ", ".join(
        chosen.place(network, node_id)
        for network in chosen.networks
        for node_id, entry in network.entry.nodes.items()
        if entry.assignment.guards
    )
    if guarded:
        screen.say(f"[yellow]nobody guards {escape(guarded)} any more: `canopen net watch` does, as long as it runs[/]")
