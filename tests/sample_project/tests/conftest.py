"""`pytest --seeds 50`: each test of a world in 50 worlds."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--seeds", type=int, default=2, help="so many worlds for each test")


@pytest.fixture(autouse=True)
def seed(request: pytest.FixtureRequest) -> int:
    number: int = request.param
    return number


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    count = metafunc.config.getoption("seeds")
    worlds = [pytest.param(number, marks=pytest.mark.canopen_faults(seed=number)) for number in range(count)]
    metafunc.parametrize("seed", worlds, indirect=True)
