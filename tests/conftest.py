"""For all tests: hypothesis takes the same examples each time, so that a run tells about the change and not about luck.

Every day, and in .ci/run, they are few. All that the tests name: `pytest --hypothesis-profile=full`.
To search further: `pytest --hypothesis-profile=search --timeout=0 tests/core/test_group.py`. The number of examples is then
that of the profile, in every test (tests/examples.py).
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Iterator

import hypothesis
import pytest
from hypothesis.internal.conjecture import providers

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


MEASURED = 0.2
"""Seconds of the processor for which coverage looks at a test. It then takes four times as long, and what a long test does
later it has mostly done before."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # so a shell starts what it runs in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # and `nohup` what it runs
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_xdist_auto_num_workers() -> int:
    """One process more than there are processors: a quarter of the time goes to waiting for commands, terminals and sockets."""
    return (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1) + 1


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of the tests that lack the same thing (a kernel with vcan, tshark ...) keep one: it is skipped, and says why."""
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
    config.hook.pytest_deselected(items=[*left_out])
    items[:] = [item for item in items if item not in left_out]


def pytest_collection_finish() -> None:
    """What thousands of collected tests hold stays to the end: the garbage collector need not look at it again and again."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol() -> Iterator[None]:
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
