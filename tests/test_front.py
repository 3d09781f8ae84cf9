"""What each package offers to those who import it; that it loads no more than what was asked for; and a user's example."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import trio
import trio.testing

from canopen_proto.drives import axis as drive
from tests import type_checkers, user_example, user_mistakes
from tests.testing import typed_strategies, typed_suite

LAZY = [
    importlib.import_module(name)
    for name in (
        *("canopen_proto", "canopen_proto.dictionary", "canopen_proto.drives", "canopen_proto.lss", "canopen_proto.manager"),
        *(
            "canopen_proto.observer",
            "canopen_proto.pdo",
            "canopen_proto.procedures",
            "canopen_proto.sdo",
            "canopen_proto.simulation",
        ),
        *("canopen_check", "canopen_proto.testing", "canopen_testing", "canopen_transports"),
        *("canopen_master", "canopen_master.demonstration", "canopen_master.machine_file", "canopen_master.simulation"),
    )
]


def seen_by_type_checkers(package: ModuleType) -> dict[str, str]:
    """By the name, the module that it is imported from under TYPE_CHECKING."""
    for statement in ast.parse(inspect.getsource(package)).body:
        if isinstance(statement, ast.If) and ast.unparse(statement.test) == "TYPE_CHECKING":
            imports = [each for each in statement.body if isinstance(each, ast.ImportFrom)]
            homes: dict[str, str] = {}
            for each in imports:
                if each.names[0].name == "*":  # all of the front of a room below
                    homes |= seen_by_type_checkers(importlib.import_module(str(each.module)))
                else:
                    homes |= {name.asname or name.name: str(each.module) for name in each.names}
            return homes
    raise AssertionError(f"{package.__name__} imports nothing under TYPE_CHECKING")


@pytest.mark.parametrize("package", LAZY, ids=lambda package: package.__name__)
def test_each_name_is_what_type_checkers_take_it_for(package: ModuleType) -> None:
    homes = seen_by_type_checkers(package)
    assert set(package.__all__) == set(homes)
    for name, home in homes.items():
        assert getattr(package, name) is getattr(importlib.import_module(home), name)
    assert set(homes) <= set(dir(package))


@pytest.mark.parametrize("package", LAZY, ids=lambda package: package.__name__)
def test_no_name_is_that_of_a_module(package: ModuleType) -> None:
    """Or the one would take the place of the other, whichever was imported last."""
    assert {each.name for each in pkgutil.iter_modules(package.__path__)}.isdisjoint(package.__all__)


@pytest.mark.parametrize("package", LAZY, ids=lambda package: package.__name__)
def test_a_name_that_is_not_there(package: ModuleType) -> None:
    with pytest.raises(AttributeError, match=f"module '{package.__name__}' has no attribute 'Nonsense'"):
        package.Nonsense  # noqa: B018 - the look is what is tested
    with pytest.raises(ImportError):
        exec(f"from {package.__name__} import Nonsense")


@pytest.mark.parametrize(
    ("statement", "absent"),
    [
        ("import canopen_proto", {"canopen_proto.frame", "canopen_proto.machine"}),
        (
            "from canopen_proto import Frame, Outbox",
            {"canopen_proto.network", "canopen_proto.sdo", "canopen_proto.drives.cia402"},
        ),
        (
            "from canopen_proto import LocalNode",
            {"canopen_proto.drives.cia402", "canopen_proto.drives.axis", "canopen_proto.remote_node"},
        ),
        ("from canopen_transports import Transport, TransportError", {"can", "trio"}),
        ("import canopen_master.plain_text", {"canopen_master.master", "trio", "can"}),
    ],
)
def test_only_what_was_asked_for_is_loaded(statement: str, absent: set[str]) -> None:
    program = f"import sys; sys.path[:] = {sys.path!r}; {statement}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert absent.isdisjoint(done.stdout.split())


def test_an_embedding_of_ones_own() -> None:
    assert user_example.embedded() == ["a device of profile 402, 127", "41.5 degrees", "the sensor is silent"]


def test_a_script_for_the_master() -> None:
    told = trio.run(user_example.scripted, clock=trio.testing.MockClock(autojump_threshold=0))
    assert told == ["Simulated Schunk Powerball joint", "joint1 at 0.01"]


@pytest.mark.thorough
@type_checkers.LONG
@pytest.mark.parametrize("checker", [type_checkers.MYPY, type_checkers.PYRIGHT])
def test_type_checkers_take_what_a_user_writes_and_refuse_mistakes(
    checker: str, pytestconfig: pytest.Config, tmp_path: Path
) -> None:
    modules = (user_example, user_mistakes, typed_suite, typed_strategies)
    type_checkers.check(checker, [Path(str(module.__file__)) for module in modules], pytestconfig, tmp_path)


def test_each_procedure_that_the_text_of_drive_lists_is_there() -> None:
    rows = re.findall(r"^    ([a-z_]+(?:, [a-z_]+)*)", drive.__doc__ or "", re.MULTILINE)
    listed = [name for row in rows for name in row.split(", ")]
    assert "shut_down" in listed
    assert [name for name in listed if not hasattr(drive, name)] == []
