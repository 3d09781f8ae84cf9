"""The page of licences names each library that an extra of the package needs, with the licence that the library itself tells."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OURS = ("test", "docs", "dev", "all")
"""Extras for those who work on the project, and one of others."""
ROWS = re.findall(
    r"^\| ([\w.-]+) \| `([\w-]+)` \| (.+) \|$", (ROOT / "docs" / "licences.md").read_text(encoding="utf-8"), re.MULTILINE
)


def test_each_library_is_named_with_its_extra() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    wanted = {
        (re.split(r"[><=\[]", each)[0], extra)
        for extra, needed in extras.items()
        if extra not in OURS
        for each in needed
        if not each.startswith("canopen-proto")
    }
    assert {(name, extra) for name, extra, _ in ROWS} == wanted


@pytest.mark.parametrize(("name", "licence"), [(name, licence) for name, _, licence in ROWS])
def test_the_licence_is_the_one_that_the_library_tells(name: str, licence: str) -> None:
    try:
        told = distribution(name).metadata
    except PackageNotFoundError:
        pytest.skip(f"{name} is not installed")
    texts = [told.get("License-Expression") or "", told.get("License") or "", *(told.get_all("Classifier") or [])]
    word = licence.split(" (")[0].split(" or ")[0]
    assert any(word.lower() in each.lower() for each in texts), texts
