"""Which event loop a test of the master runs on: see loops.py."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests import loops


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "both_loops: runs on asyncio too, every day")
    config.addinivalue_line("markers", "trio_only(reason): is about what only trio has")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    definition = metafunc.definition
    if not hasattr(metafunc.module, "virtual_time") or definition.get_closest_marker("trio_only") is not None:
        return
    if metafunc.config.getoption("loop") is not None:
        metafunc.parametrize("on_loop", [metafunc.config.getoption("loop")], indirect=True)
    elif definition.get_closest_marker("both_loops") is not None:
        metafunc.parametrize("on_loop", [loops.TRIO, loops.ASYNCIO], indirect=True)


@pytest.fixture(autouse=True)
def on_loop(request: pytest.FixtureRequest) -> Iterator[None]:
    """Choose the loop of this test."""
    loops.chosen = getattr(request, "param", loops.TRIO)
    yield
    loops.chosen = loops.TRIO
