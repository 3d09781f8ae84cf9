"""For all tests: hypothesis takes the same examples each time, so that a run tells about the change and not about luck.

Every day they are few, and of the cases of a test marked `thorough` only some are taken. All that the tests name:
`pytest --hypothesis-profile=full`.
To search further: `pytest --hypothesis-profile=search --timeout=0 tests/core/test_group.py`. The number of examples is then
that of the profile, in every test (tests/examples.py).
The tests of each file in an order drawn from a number, files too: `pytest --shuffle=7`.
The tasks of trio in another order, where several are ready at the same time: `pytest --order=7`.
The tests of the master on asyncio: `pytest --loop=asyncio tests/master`.
"""

from __future__ import annotations

import atexit
import compileall
import gc
import importlib
import math
import os
import random
import signal
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest
from _pytest.runner import runtestprotocol
from hypothesis.internal.conjecture import providers
from trio._core import _run
from trio.testing import MockClock

from canopen_testing.trio_order import seed_order
from tests.examples import SAME, of_every_day

try:  # these are pytest's own: without them each worker compiles for itself
    from _pytest.assertion.rewrite import PYC_TAIL, _rewrite_test, _write_pyc, assertstate_key, get_cache_dir, try_makedirs
except ImportError:
    PYC_TAIL = ""

# On a build server hypothesis takes its own profile `ci` for the parent of what is registered, and that one never looks further
everyday = hypothesis.settings.get_profile("default")
hypothesis.settings.register_profile("full", everyday, derandomize=True, database=None, deadline=None)
hypothesis.settings.register_profile("same", hypothesis.settings.get_profile("full"), max_examples=20)
hypothesis.settings.register_profile("search", everyday, max_examples=2000, deadline=None, print_blob=True)
hypothesis.settings.load_profile("same")

# It also draws the constants of the modules that are loaded, and these depend on which tests ran before in this process
if hasattr(providers, "_get_local_constants"):  # there is no setting for it
    NO_CONSTANTS = providers.Constants()
    providers._get_local_constants = lambda: NO_CONSTANTS


def time_of(clock: MockClock) -> float:
    """As trio's own, which looks at the real time also where that does not count."""
    return clock._real_to_virtual(clock._real_clock()) if clock._rate else clock._virtual_base


def jump_to_next_deadline(clock: MockClock) -> None:
    """As trio's own, which makes the statistics of the whole loop for it."""
    jump = _run.GLOBAL_RUN_CONTEXT.runner.deadlines.next_deadline() - time_of(clock)
    if 0 < jump < math.inf:
        clock.jump(jump)


# Most of what a loop does in virtual time is to jump: these need a fifth less for it
if hasattr(MockClock, "_autojump") and hasattr(MockClock, "_virtual_base") and hasattr(_run.Deadlines, "next_deadline"):
    MockClock.current_time, MockClock._autojump = time_of, jump_to_next_deadline


collect_ignore = ["sample_project"]
"""A project of its own: tests/testing/test_sample_project.py runs it."""
FEW = 10
"""So many new files are compiled by each worker sooner than by a process that does nothing else."""
MEASURED = 0.2
"""Seconds of the processor for which coverage looks at a test. It then takes four times as long, and what a long test does
later it has mostly done before."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # so a shell starts what it runs in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # and `nohup` what it runs
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


# One process writes down what it makes of a source, and the others read it: the workers, and the commands that tests start.
# They need a tenth of the time. It goes to __pycache__, which git ignores, also where a container sets this variable for all.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Commands that tests start keep their output back until they flush it, as they do for a user, also where a container sets this
os.environ.pop("PYTHONUNBUFFERED", None)


def processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def pytest_addoption(parser: pytest.Parser, pluginmanager: pytest.PytestPluginManager) -> None:
    parser.addoption("--shuffle", type=int, metavar="SEED", help="files, and the tests of each, in an order of their own")
    parser.addoption("--order", type=int, default=0, metavar="SEED", help="the order of trio's tasks: it is drawn for each test")
    parser.addoption("--loop", choices=["trio", "asyncio"], help="of the tests of the master: see tests/loops.py")
    if not pluginmanager.hasplugin("xdist"):  # `-p no:xdist`: then what pyproject.toml tells it means nothing
        for option in ("--numprocesses", "--dist"):
            parser.addoption(option, help="of pytest-xdist, which is not there")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Four processes more than there are processors: half of the time goes to waiting for commands, terminals and sockets."""
    return processors() + 4


def pytest_configure(config: pytest.Config) -> None:
    """Declare the mark of examples.py.

    Leave the assertions of the packages as they are. Where a wheel is installed, pytest takes all their modules for parts of a
    plugin, and each worker compiles them once more. It has their fronts, as a pytest that a test runs in this process wants."""
    config.addinivalue_line("markers", "thorough(n): every day an n-th of its cases, or none: see tests/examples.py")
    hook = getattr(config.pluginmanager, "rewrite_hook", None)
    if hasattr(hook, "_must_rewrite"):  # there is no setting for it
        ours = {name for name in hook._must_rewrite if name.startswith("canopen_")}
        for name in ours:
            importlib.import_module(name)
        hook._must_rewrite -= ours
        hook._marked_for_rewrite_cache.clear()


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile what is new before the workers start: else each of them, beside the others, compiles all of it."""
    config = session.config
    is_worker_or_alone = hasattr(config, "workerinput") or len(config.getoption("tx", None) or ()) < 2
    if is_worker_or_alone or not PYC_TAIL or not hasattr(os, "fork"):
        return
    new = []
    for argument in config.args:
        path = Path(argument.partition("::")[0])
        for source in sorted(path.rglob("test_*.py")) if path.is_dir() else [path]:
            made = get_cache_dir(source) / (source.stem + PYC_TAIL)
            if not made.exists() or made.stat().st_mtime < source.stat().st_mtime:
                new.append((source, made))
    count = min(processors(), len(new) // FEW)
    children = []
    for first in range(count):
        child = os.fork()
        if not child:
            gc.disable()  # trees of syntax are no garbage: a fourth of the time
            try:
                if first == 0:
                    for package in ("canopen_proto", "transports", "master", "data"):
                        compileall.compile_dir(config.rootpath / package, quiet=2)
                compile_tests(config, new[first::count])
            finally:
                os._exit(0)  # what is wrong with a file, the workers tell
        children.append(child)
    for child in children:
        os.waitpid(child, 0)


def compile_tests(config: pytest.Config, files: list[tuple[Path, Path]]) -> None:
    """Compile test files, with their assertions rewritten, to where pytest looks for them: pairs of a source and a target."""
    for source, made in files:
        try_makedirs(made.parent)
        stamp, code = _rewrite_test(source, config)
        _write_pyc(config.stash[assertstate_key], code, stamp, made)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    if config.getoption("dist") != "loadfile":
        return None
    from tests.workers import LongestFirst  # not without pytest-xdist

    return LongestFirst(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """A worker tells of a test's set-up and tear-down only where they did not pass, and not when a test begins and ends: a fourth
    of what it has to say."""
    if not hasattr(item.config, "workerinput"):
        return None
    for report in runtestprotocol(item, nextitem=nextitem, log=False):
        if report.when == "call" or not report.passed:
            report.keywords = {}  # which nobody reads
            item.ihook.pytest_runtest_logreport(report=report)
    return True


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is not for every day. Of the tests that lack the same thing (a kernel with vcan, tshark ...) keep one: it is
    skipped, and says why."""
    is_named = any("::" in argument for argument in config.args)
    if hypothesis.settings.get_current_profile_name() == SAME and not is_named:
        leave_out(config, set(items) - set(of_every_day(items)), items)
    lacking: dict[str, list[pytest.Item]] = {}
    for item in items:
        reason = next((mark.kwargs["reason"] for mark in item.iter_markers("skipif") if mark.args[0]), None)
        if reason is not None:
            lacking.setdefault(reason, []).append(item)
    left_out = set()
    for reason, (first, *others) in lacking.items():
        if others:
            more = pytest.mark.skipif(True, reason=f"{reason}; {len(others)} more tests need it")
            first.add_marker(more, append=False)
            left_out.update(others)
    leave_out(config, left_out, items)
    seed = config.getoption("shuffle")
    if seed is None and hasattr(config, "workerinput"):
        from tests.workers import longest_first

        items[:] = longest_first(items)
    if seed is not None:
        files: dict[Path, list[pytest.Item]] = {}
        for item in items:
            files.setdefault(item.path, []).append(item)
        shuffled = [*files.values()]
        draw = random.Random(seed)
        draw.shuffle(shuffled)
        for tests in shuffled:
            draw.shuffle(tests)
        items[:] = [item for tests in shuffled for item in tests]


def leave_out(config: pytest.Config, left_out: set[pytest.Item], items: list[pytest.Item]) -> None:
    config.hook.pytest_deselected(items=[item for item in items if item in left_out])
    items[:] = [item for item in items if item not in left_out]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What thousands of collected tests hold stays to the end: the garbage collector need not look at it, then or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()
        gc.set_threshold(100_000, 20, 50)  # simulated drives make many rings of objects: a tenth of the time


def pytest_unconfigure(config: pytest.Config) -> None:
    """pytest collects five times at the end, so that what was left open is told: the first time finds it.

    A worker then ends at once. Python would take all its objects apart, which needs more than a second of each worker."""
    gc.collect()
    gc.freeze()
    if hasattr(config, "workerinput") and "coverage" not in sys.modules:
        atexit.register(end_at_once, os.getpid())
    else:
        atexit.register(gc.unfreeze)  # else nanobind tells of what Python did not clear


def end_at_once(process: int) -> None:
    if os.getpid() == process:  # and no fork of it
        sys.stderr.flush()
        os._exit(0)  # what it found, it has told


@pytest.hookimpl(wrapper=True, specname="pytest_runtest_protocol")
def pytest_order_tasks(item: pytest.Item) -> Iterator[None]:
    """Give the tasks of trio an order that is the same in each run. Else a test of two things at one time passes by chance."""
    give_back = seed_order(zlib.crc32(f"{item.nodeid} {item.config.getoption('order')}".encode()))
    try:
        return (yield)
    finally:
        give_back()


@pytest.hookimpl(wrapper=True, specname="pytest_runtest_protocol")
def pytest_measure() -> Iterator[None]:  # pytest passes over a hook whose name does not begin with `pytest_`
    """Measure the first MEASURED seconds of each test, where this run is measured (.ci/run)."""
    coverage = sys.modules.get("coverage")
    measured = coverage and coverage.Coverage.current()
    if not measured:
        return (yield)
    is_over = False

    def stop(*_: object) -> None:
        nonlocal is_over
        is_over = True
        measured.stop()

    signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, MEASURED)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        if is_over:
            measured.start()
