"""The pytest plugin: fixtures for tests of devices and programs, in virtual time. docs/testing.md shows them.

pytest loads this file at its start, whatever it tests. So it imports nothing but pytest; what a test uses is imported for that
test.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from os import PathLike

    from canopen_proto.declared import DeclaredDevice
    from canopen_proto.local_node import LocalNode
    from canopen_proto.testing import WorldBus
    from canopen_testing.conformance_fixture import RunCase
    from canopen_testing.fixture_types import SimDrive, SimNode
    from canopen_testing.program_world import ProgramWorld

_WORLD = pytest.StashKey["ProgramWorld"]()
_HOSTED = pytest.StashKey[Callable[..., Any]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("canopen", "CANopen: devices and programs in virtual time, conformance")
    group.addoption("--canopen-trace", metavar="DIR", help="keep the traffic of each test as DIR/TEST.log, as candump writes it")
    group.addoption("--canopen-seed", metavar="N", type=int, default=0, help="the seed of the worlds (default: 0)")
    group.addoption(
        "--canopen-limit",
        metavar="S",
        type=float,
        help="how long the program of an async test may run, seconds of its world (a day)",
    )
    group.addoption("--canopen-bus", metavar="LOCATOR", help="the bus of the device for canopen_check, such as socketcan:can0")
    group.addoption("--canopen-device", metavar="NODE", type=int, help="its node-ID; all cases RESET it and WRITE its objects")
    group.addoption("--canopen-storing", action="store_true", help="also the cases that change what the device stores")
    group.addoption("--canopen-strict", action="store_true", help="ask for more than CiA's own tool does")
    group.addoption("--eds", metavar="FILE", dest="canopen_eds", help="its file (EDS, DCF, XDD)")


def pytest_configure(config: pytest.Config) -> None:
    text = "canopen_faults(*faults, seed=N): what goes wrong in the world of this test (canopen_proto.testing), and its seed"
    config.addinivalue_line("markers", text)
    text = "canopen_limit(ns): how long the program of an async test may run, in the time of its world (default: --canopen-limit)"
    config.addinivalue_line("markers", text)
    for name in ("trio", "asyncio"):
        if not any(config.pluginmanager.hasplugin(each) for each in (name, f"pytest_{name}")):
            config.addinivalue_line("markers", f"{name}: an async test that uses canopen_world runs in {name}")


# ---- fixtures ----


@pytest.fixture
def canopen_world(request: pytest.FixtureRequest) -> Iterator[ProgramWorld]:
    """A world in virtual time: buses, devices, masters, programs. See canopen_testing.ProgramWorld."""
    __tracebackhide__ = True
    try:
        from canopen_testing import worlds
    except ModuleNotFoundError as error:
        raise pytest.UsageError(f"canopen_world needs {error.name}: pip install 'canopen-proto[test-tools]'") from error
    markers = [*request.node.iter_markers("canopen_faults")]
    for mark in markers:
        wrong = [f"{name}=" for name in mark.kwargs if name != "seed"]
        wrong += [repr(each) for each in mark.args if not isinstance(each, worlds.Fault)]
        wrong += [f"seed={seed!r}" for seed in [mark.kwargs.get("seed", 0)] if not isinstance(seed, int)]
        if wrong:
            raise pytest.UsageError(
                f"canopen_faults takes faults of canopen_proto.testing, one by one, and seed=, not {', '.join(wrong)}"
            )
    seed = next((mark.kwargs["seed"] for mark in markers if "seed" in mark.kwargs), request.config.getoption("canopen_seed"))
    world = request.node.stash[_WORLD] = worlds.ProgramWorld(seed, [fault for mark in markers for fault in mark.args])
    mark = request.node.get_closest_marker("canopen_limit")
    world.limit = worlds.limit_of(mark and (mark.args, mark.kwargs), request.config.getoption("canopen_limit"))
    with worlds.present(world):
        yield world
    folder = request.config.getoption("canopen_trace")
    if folder:
        worlds.write_trace(world, Path(folder), request.node.nodeid)


@pytest.fixture
def canopen_bus(canopen_world: ProgramWorld) -> WorldBus:
    """The bus `can0` of the world."""
    return canopen_world.bus()


@pytest.fixture
def sim_node(canopen_world: ProgramWorld) -> SimNode:
    """`sim_node("my.eds", node_id=5)` switches a simulated device of a file, or of a class, on, and returns it: see
    ProgramWorld.device."""

    def make(file: str | PathLike[str] | type[DeclaredDevice], node_id: int = 0, *, bus: str = "can0") -> LocalNode:
        __tracebackhide__ = True
        return canopen_world.device(file, node_id, bus=bus)

    return make


@pytest.fixture
def sim_drive(canopen_world: ProgramWorld) -> SimDrive:
    """`sim_drive(node_id=5)` switches a simulated CiA 402 drive on, and returns it: see World.drive."""
    return canopen_world.drive


@pytest.fixture
def canopen_master(request: pytest.FixtureRequest, canopen_world: ProgramWorld) -> Any:
    """A master on `can0`: a canopen_master.Master in an async test, of trio or asyncio; in a test without async a WorldMaster,
    whose calls let the world run."""
    if inspect.iscoroutinefunction(request.function):
        from canopen_testing.async_tests import MasterToOpen

        return MasterToOpen()
    return canopen_world.master()


@pytest.fixture
def canopen_device(request: pytest.FixtureRequest) -> Any:
    """The device for canopen_check: that of the options; override it to return a simulated one, of `sim_node` or the world."""
    from canopen_testing.conformance_fixture import device_of

    return device_of(request.config)


@pytest.fixture
def canopen_check(request: pytest.FixtureRequest, canopen_device: Any) -> RunCase:
    """One case of the conformance test: `canopen_check()` runs it against `canopen_device`. Its test runs for each case."""
    from canopen_testing.conformance_fixture import run_case

    return run_case(request, canopen_device)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "canopen_check" in metafunc.fixturenames:
        from canopen_check.catalogue import CASES

        names = [f"{case.number}-{case.name}" for case in CASES]
        metafunc.parametrize("canopen_check", CASES, ids=names, indirect=True)


# ---- async tests: with pytest-trio, pytest-asyncio, anyio, or none of them ----


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    __tracebackhide__ = True
    world = item.stash.get(_WORLD, None)
    if world is None or not isinstance(item, pytest.Function) or not inspect.iscoroutinefunction(item.obj):
        return (yield)
    from canopen_testing.async_tests import hosted

    test = item.obj
    item.obj = item.stash[_HOSTED] = hosted(test, world)
    try:
        return (yield)
    finally:
        item.obj = test
        del item.stash[_HOSTED]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> Generator[None, object, object]:
    __tracebackhide__ = True
    test = pyfuncitem.stash.get(_HOSTED, None)
    if test is None:
        return (yield)
    from canopen_testing.async_tests import CLOCK, run_in

    world, found = pyfuncitem.stash[_WORLD], pyfuncitem.obj
    if hasattr(found, "_trio_test_runner_wrapped"):  # by pytest-trio, which has fixtures of its own; it looks for a clock
        clock = {} if "canopen_world" in pyfuncitem._fixtureinfo.argnames else {CLOCK: world}
        pyfuncitem.obj = lambda **arguments: found(**arguments, **clock)
    else:
        in_trio = _is_for_trio(pyfuncitem)
        pyfuncitem.obj = functools.partial(run_in, world, test, in_trio)
    try:
        return (yield)
    finally:
        pyfuncitem.obj = found


def _is_for_trio(item: pytest.Function) -> bool:
    backend: Any = item.funcargs.get("anyio_backend")  # a name, or a name with options
    if backend is not None:
        return (backend if isinstance(backend, str) else backend[0]) == "trio"
    return item.get_closest_marker("trio") is not None or item.get_closest_marker("asyncio") is None


# ---- what a failure shows ----


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    world = item.stash.get(_WORLD, None)
    if world is not None and report.failed:
        from canopen_testing.worlds import sections_of

        report.sections += sections_of(world)
    return report
