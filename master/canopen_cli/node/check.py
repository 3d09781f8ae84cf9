"""`canopen check`: the conformance cases, run against a node, or against its file alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

import click
import trio
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from canopen_check.bench import Bench
from canopen_check.case import Case
from canopen_check.catalogue import BY_NUMBER, CASES
from canopen_cli.node.check_report import CaseRun, CheckReport, list_cases, write_junit
from canopen_cli.shared.new_files import check_new_file
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import DEMO, Settings, command, without_dry_run
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.questions import confirm
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape, node_text
from canopen_cli.shared.session import BusSession, open_session
from canopen_data.named_files import open_description
from canopen_master.errors import MasterError, SdoRefusedError
from canopen_master.simulation.serving import drive_maker
from canopen_proto import indices
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.machine import Outbox
from canopen_proto.network import Network
from canopen_proto.procedures.runner import ProcedureFinished
from canopen_proto.procedures.steps import ProcedureError
from canopen_proto.verdict import Result, Verdict

if TYPE_CHECKING:
    from canopen_data.description import DeviceDescription

ANY_NODE: Final = 1
"""The node-ID of a device whose file is checked alone. No case that runs without the device uses it."""


@command()
@click.argument("target", metavar="NODE|FILE", required=False)
@click.option("--case", "numbers", metavar="NUMBER", multiple=True, help="Only this case (2.1) or chapter (3); may be repeated.")
@click.option("--storing", is_flag=True, help="Also the cases that change what the device stores (1010, 1011).")
@click.option("--strict", is_flag=True, help="Ask for more than CiA's own tool does.")
@click.option("--junit", metavar="F.xml", default="", help="Write the results to a file too, as JUnit does.")
@click.option("--list", "only_list", is_flag=True, help="List the cases, and end.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@without_dry_run("a case is judged by what the node answers to its writes", "canopen check --list", "canopen check FILE.eds")
def check(
    settings: Settings,
    screen: Screen,
    target: str | None,
    numbers: tuple[str, ...],
    storing: bool,
    strict: bool,
    junit: str,
    only_list: bool,
    yes: bool,
) -> int:
    """Run the 127 cases of a conformance test against a node, by its file (-e); or check a file alone.

    The node is reset, started and stopped, all of its objects are written (outputs and set-points too), and some commands go to
    all nodes: it should be alone on its bus, with nothing at its outputs that could move. At the end it is reset. Its stored
    parameters are not changed without --storing. Its values are compared with the defaults of its EDS, or with those that its DCF
    configures.

    A case fails if the node does what the standard forbids. Points that the standard leaves open, or that CiA's own conformance
    tool does not check, are remarks; --strict turns the latter into failures, and checks more.

    Exit status: 0 all could be judged and none failed (remarks do not count), 1 not so, 5 the node does not answer.

    \b
    canopen check 5 -b can0 -e drive.eds --junit report.xml --yes
    canopen check 5 -b can0 -e drive.eds --case 2 --case 4.2
    canopen check drive.eds
    """
    cases, left_out = _chosen(numbers, storing)
    if only_list:
        list_cases(screen, cases)
        return ExitCode.OK
    if target is None:
        raise click.UsageError("Missing argument 'NODE|FILE'.")
    if junit:
        check_new_file(settings, screen, junit)
    failure: Exception | None = None
    if not settings.is_node(target):
        report = _check_file(settings, target, cases)
    else:
        report = CheckReport(settings.node_id(target), len(cases), tuple(left_out))
        try:
            _check_node(settings, screen, report, cases, strict, yes)
        except Exception as error:  # noqa: BLE001 - raised below, after the report so far
            failure = error
    if report.runs or failure is None:
        report.show(screen)
    if failure is not None:
        raise failure
    if junit:
        write_junit(junit, report)
        screen.say(f"{escape(junit)} was written")
    return ExitCode.DIFFERENT if report.counts[Result.FAILED] or report.counts[Result.NOT_JUDGED] else ExitCode.OK


def _chosen(numbers: Sequence[str], storing: bool) -> tuple[list[Case], list[Case]]:
    """Return the named cases in their order, or all; and the cases that are left out because they store. Raises CommandError."""
    wanted: set[str] = set()
    for number in numbers:
        found = [case.number for case in CASES if number in (case.number, case.number.partition(".")[0])]
        if not found:
            raise usage("CO133", f"there is no case {number!r}", tries=("canopen check --list",))
        if number in BY_NUMBER and BY_NUMBER[number].stores and not storing:
            failed = f"case {number} changes what the device stores"
            raise usage("CO133", failed, seen="nothing was sent", tries=("the same with --storing",))
        wanted.update(found)
    cases = [case for case in CASES if case.number in wanted or not numbers]
    return [case for case in cases if storing or not case.stores], [case for case in cases if case.stores and not storing]


# ---- without the device ----


def _check_file(settings: Settings, path: str, cases: Sequence[Case]) -> CheckReport:
    """Run the cases that need a file and no device."""
    if settings.eds:
        raise usage("CO001", "there are two files: the argument, and that of -e", tries=(f"canopen check {path}",))
    alone = [case for case in cases if not case.uses_device]
    if not alone:
        raise usage("CO133", "these cases are for a node", tries=(f"canopen check NODE -e {path}", f"canopen check {path}"))
    report = CheckReport(None, len(alone), file=path)
    _run_alone(report, alone, open_description(path, settings.encoding).description, ANY_NODE)
    return report


def _run_alone(report: CheckReport, cases: Sequence[Case], description: DeviceDescription, node_id: int) -> None:
    """Run cases that ask nothing of a device, on a network without a bus."""
    network = Network()
    bench = Bench(network, node_id, description.dictionary, description=description)
    for case in cases:
        network.run(case.run(bench), 0)
        _, (ended,) = network.drain(0)
        assert isinstance(ended, ProcedureFinished)
        report.runs.append(CaseRun(case, ended.result, 0.0))


# ---- a node ----


def _check_node(settings: Settings, screen: Screen, report: CheckReport, cases: Sequence[Case], strict: bool, yes: bool) -> None:
    """Run the cases and add each result to the report. If an error is raised, the report keeps the results so far."""
    node_id = report.node_id
    assert node_id is not None
    if not any(case.uses_device for case in cases):
        description = NodeFiles(settings, screen).description_of(node_id)
        if description is None:
            raise _without_file(node_id)
        report.file = description.source
        _run_alone(report, cases, description, node_id)
        return
    bus = settings.required_bus()
    if bus != DEMO and NodeFiles(settings, screen).description_of(node_id) is None:
        raise _without_file(node_id)
    effect = "it is reset and all of its objects are written, outputs and set-points too; commands go to ALL nodes of the bus"
    confirm(screen, f"check {node_text(node_id)}: {effect}", yes, needed=True)
    run(settings, screen, lambda: _run_cases(settings, screen, report, cases, strict), story=lambda confirmed: [_story(report)])


def _without_file(node_id: int) -> Exception:
    return usage(
        "CO134",
        f"the file of {node_text(node_id)} is needed",
        seen="no file was given for it",
        cause="the cases compare the device with its file",
        tries=(f"canopen check {node_id} -e FILE.eds", "canopen check 3 -b demo    (a simulated drive)"),
    )


def _story(report: CheckReport) -> str:
    stored = "; what it stores may not be what it was" if any(each.stores for each in report.begun) else ""
    return f"{len(report.runs)} of {counted(report.total, 'case')} run; the node was reset{stored}"


async def _run_cases(settings: Settings, screen: Screen, report: CheckReport, cases: Sequence[Case], strict: bool) -> None:
    node_id = report.node_id
    assert node_id is not None
    async with open_session(settings, screen) as session:
        description = session.description_of(node_id)
        if description is None and settings.named_bus() != DEMO:
            raise _without_file(node_id)  # the files that were named are of other nodes
        dictionary = _demo_dictionary(node_id) if description is None else description.dictionary
        report.file = "" if description is None else description.source
        bench = Bench(session.network, node_id, dictionary, description=description, strict=strict)
        if settings.timeout is not None:
            bench.sdo.timeout = settings.timeout
        try:
            await _find(session, bench)
            with _progress(screen, report) as show:
                for case in cases:
                    show(case)
                    report.begun.append(case)
                    start = trio.current_time()
                    verdict: Verdict = await session.master.run(case.run(bench))
                    report.runs.append(CaseRun(case, verdict, trio.current_time() - start))
                    if verdict.result is Result.FAILED and case.uses_device:
                        await _find(session, bench)  # if it is gone, each case that follows would wait for it in vain
        finally:
            with trio.CancelScope(shield=True), suppress(MasterError):
                await session.master.nmt_reset_node(node_id)


def _demo_dictionary(node_id: int) -> ObjectDictionary:
    """Describe the drives of `-b demo`."""
    return drive_maker(0, node_id)(Outbox()).dictionary


async def _find(session: BusSession, bench: Bench) -> None:
    """Reset the device. Raises SdoTimeoutError if it shows no sign of life."""
    try:
        await session.master.run(bench.reset())
    except ProcedureError:  # no boot-up: a case will report that
        with suppress(SdoRefusedError):
            await session.node(bench.node_id).read_bytes(indices.DEVICE_TYPE)


@contextmanager
def _progress(screen: Screen, report: CheckReport) -> Iterator[Callable[[Case], None]]:
    """Return the function to call when a case begins. It shows the case on a terminal, and does nothing elsewhere."""
    if not screen.draws:
        yield lambda case: None
        return
    what = TextColumn(f"checking node {report.node_id}")
    columns = (what, BarColumn(30), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=screen.err, transient=True, auto_refresh=False, get_time=trio.current_time) as progress:
        task = progress.add_task("", total=report.total)

        def show(case: Case) -> None:
            failed = report.counts[Result.FAILED]
            text = f"{case.number} {case.title}" + (f"  [red]{failed} failed[/]" if failed else "")
            progress.update(task, completed=len(report.runs), description=text)
            progress.refresh()

        yield show
