"""The blocking classes against the async ones: the file is what would be written today, and nothing public is missing in it."""

from __future__ import annotations

import importlib.util
import inspect
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from canopen_master import blocking
from canopen_master.blocking import classes

SCRIPT = Path(__file__).parents[2] / "docs" / "blocking_classes.py"


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    """docs/blocking_classes.py."""
    return loaded(SCRIPT)


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"docs_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_file_is_what_the_async_classes_say(maker: ModuleType) -> None:
    written = Path(str(classes.__file__)).read_text(encoding="utf-8")
    assert written == maker.text(), "the blocking classes are older than the async ones: python docs/blocking_classes.py"


def public(cls: type) -> set[str]:
    return {name for name in dir(cls) if not name.startswith("_")}


def pairs(maker: ModuleType) -> list[tuple[str, type, type]]:
    found = []
    for owner, spec in maker.CLASSES.items():
        module, _, name = spec.source.partition(":")
        found.append((owner, getattr(importlib.import_module(module), name), getattr(classes, f"Blocking{owner}")))
    return found


def plain(member: Any) -> Any:
    """The function behind a member."""
    member = member.fget if isinstance(member, property) else member
    return inspect.unwrap(member) if callable(member) else member


def is_async(function: Any) -> bool:
    return inspect.iscoroutinefunction(function) or inspect.isasyncgenfunction(function)


def test_each_public_name_has_its_twin_with_the_same_parameters_and_text(maker: ModuleType) -> None:
    compared = 0
    for owner, inner, twin in pairs(maker):
        for name in public(inner):
            key = next((f"{each}.{name}" for each in (owner, "Moving") if f"{each}.{name}" in maker.LEFT_OUT), "")
            if key:
                assert not hasattr(twin, name), key
                continue
            if f"{owner}.{name}" in maker.RENAMED:
                assert hasattr(twin, maker.RENAMED[f"{owner}.{name}"])
                continue
            assert hasattr(twin, name), f"{owner}.{name} has no twin, and LEFT_OUT has no reason"
            ours, theirs = getattr(twin, name), inspect.getattr_static(inner, name)
            assert isinstance(ours, property) == isinstance(theirs, property), f"{owner}.{name}"
            assert not is_async(plain(ours)), f"{owner}.{name}"
            compare_parameters(f"{owner}.{name}", plain(theirs), plain(ours))
            if plain(theirs).__doc__:
                assert said_alike(maker, plain(theirs).__doc__, plain(ours).__doc__), f"{owner}.{name}"
            if isinstance(theirs, property):
                assert (theirs.fset is None) == (ours.fset is None), f"{owner}.{name}"
            compared += 1
    assert compared > 150


def compare_parameters(where: str, theirs: Callable[..., Any], ours: Callable[..., Any]) -> None:
    wanted, has = dict(inspect.signature(theirs).parameters), dict(inspect.signature(ours).parameters)
    wanted = {name: each for name, each in wanted.items() if name != "self"}
    has.pop("self", None)
    takes_timeout = inspect.iscoroutinefunction(theirs) and "timeout" not in wanted
    if takes_timeout:
        limit = has.pop("timeout")
        assert (limit.kind, limit.default) == (inspect.Parameter.KEYWORD_ONLY, None), where
    assert [shown(each) for each in has.values()] == [shown(each) for each in wanted.values()], where


def shown(parameter: inspect.Parameter) -> tuple[object, ...]:
    default = parameter.default
    return parameter.name, parameter.kind, default.__code__.co_code if inspect.isfunction(default) else default


def said_alike(maker: ModuleType, theirs: str, ours: str) -> bool:
    for pattern, replacement in maker.WORDS:
        theirs = re.sub(pattern, replacement, inspect.cleandoc(theirs))
    return theirs.split() == inspect.cleandoc(ours).split()


def test_each_function_has_the_same_parameters_and_text(maker: ModuleType) -> None:
    for name, source in maker.FUNCTIONS.items():
        theirs = inspect.unwrap(getattr(importlib.import_module(source.partition(":")[0]), name))
        ours = getattr(blocking, name)
        compare_parameters(name, theirs, ours)
        assert said_alike(maker, theirs.__doc__, ours.__doc__), name
        assert not is_async(ours)


def asynchronous(value: Any) -> bool:
    """Whether something public of the master is awaited, or gives what is."""
    if inspect.isclass(value):
        members = [inspect.getattr_static(value, name) for name in dir(value)]
        return any(is_async(inspect.unwrap(each)) for each in members if inspect.isfunction(each))
    return inspect.isfunction(value) and is_async(inspect.unwrap(value))


def test_all_that_is_awaited_in_the_master_has_a_blocking_form_or_a_reason(maker: ModuleType) -> None:
    reference = loaded(SCRIPT.with_name("reference.py"))
    missing: list[str] = []
    known = maker.CLASSES | maker.FUNCTIONS | maker.LEFT_OUT
    for module, room in reference.public_modules().items():
        if module.split(".")[0] == "canopen_master" and module not in ("canopen_master.blocking", "canopen_master.direct"):
            missing += [f"{module}.{name}" for name in room.__all__ if asynchronous(getattr(room, name)) and name not in known]
    assert missing == []


def test_nothing_is_left_out_that_is_not_there(maker: ModuleType) -> None:
    names = {f"{owner}.{name}" for owner, inner, _ in pairs(maker) for name in public(inner)}
    attributes = {"Master.runner", "Master.watchdogs", "Chain.begun", "Chain.changed", "SimulatedDevices.hosts"}
    left = {key for key in maker.LEFT_OUT if "." in key}
    assert left - attributes <= names
    assert all(maker.LEFT_OUT.values())


def test_what_is_public_is_all_that_is_made(maker: ModuleType) -> None:
    made = {f"Blocking{owner}" for owner in maker.CLASSES} | {*maker.FUNCTIONS}
    assert made | {"Handler"} == {*blocking.__all__}
