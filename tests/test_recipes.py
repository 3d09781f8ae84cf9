"""docs/cookbook.md and docs/services: each recipe runs in a world of its own, in virtual time, and prints what the page says.

A recipe is a Python block behind which a block of text follows. Its last function takes an open master, or nothing.
"""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from canopen_data.descriptions import load_description
from canopen_master import open_master
from canopen_master.simulation.serving import drive_maker
from canopen_proto import SECOND, DataType, LocalNode
from canopen_proto.dictionary.model import Access, Object, ObjectType, Variable
from canopen_proto.testing import Lose, Pause, sdo_answer
from canopen_testing import ProgramWorld
from tests.docs_build import DOCS

RECIPE = re.compile(r"```python\n((?:(?!```).)*)```\n\n```text\n(.*?)```", re.DOTALL)


class Recipe(NamedTuple):
    """A Python block of a page, and what it prints."""

    page: Path
    number: int
    code: str
    printed: str

    def __str__(self) -> str:
        return f"{self.page.stem}-{self.number}"


RECIPES = [
    Recipe(page, number, *found)
    for page in (DOCS / "cookbook.md", *sorted((DOCS / "services").glob("*.md")))
    for number, found in enumerate(RECIPE.findall(page.read_text(encoding="utf-8")), start=1)
]
LOG = """\
(1700000000.000000) can0 705#00
(1700000000.100000) can0 605#4000100000000000
(1700000000.101000) can0 585#4300100091010700
(1700000000.200000) can0 000#0105
(1700000000.300000) can0 185#A5D204F0FF
(1700000000.400000) can0 085#2082110000000000
"""


def make_world(world: ProgramWorld, recipe: str) -> None:
    """Switch the devices on, and plan what happens in a recipe. recipe: the name of its function."""
    dictionary = load_description("sample_io.eds").dictionary
    large = Variable(0x2100, 0, "large", DataType.DOMAIN, Access.RW)
    dictionary = dictionary.with_objects([Object(0x2100, "large", ObjectType.DOMAIN, {0: large})])
    device = world.device(lambda out: LocalNode(out, 5, dictionary))
    device.set_value(0x6000, 1, 0xA5, world.now)
    drive = world.drive(6)
    world.device(drive_maker(0, 255))
    match recipe:
        case "why_it_does_not_move":
            world.after(SECOND // 10, lambda: drive.raise_fault(0x3210, world.now))
        case "show_emergencies":
            world.after(SECOND, lambda: device.raise_error(0x8220, 0x10, b"", world.now))
            world.after(2 * SECOND, lambda: device.clear_error(0x8220, world.now))
        case "slow_write":
            world.add_faults(Lose(sdo_answer(5)))
        case "watch_over":
            world.add_faults(Pause(5, at=3 * SECOND, lasts=2 * SECOND))


def run_recipe(world: ProgramWorld, recipe: Recipe) -> None:
    """Run a recipe in a world. It prints."""
    scope: dict[str, Any] = {}
    exec(compile(recipe.code, str(recipe), "exec"), scope)
    function = [each for each in scope.values() if inspect.isfunction(each) and each.__module__ is None][-1]
    if not inspect.iscoroutinefunction(function):
        function()
        return
    make_world(world, function.__name__)

    async def main() -> None:
        async with open_master("socketcan:can0") as master:
            await function(master)

    world.run(main)


@pytest.mark.parametrize("recipe", RECIPES, ids=str)
def test_a_recipe_prints_what_the_page_says(
    recipe: Recipe,
    canopen_world: ProgramWorld,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("customer.log").write_text(LOG, encoding="ascii")
    run_recipe(canopen_world, recipe)
    printed = "\n".join(line.rstrip() for line in capsys.readouterr().out.splitlines()) + "\n"
    assert printed == recipe.printed


def test_the_cookbook_has_twenty_recipes() -> None:
    titles = re.findall(r"^## (\d+)\. ", (DOCS / "cookbook.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert titles == [str(number) for number in range(1, 21)]
    assert len([each for each in RECIPES if each.page.stem == "cookbook"]) == 20
