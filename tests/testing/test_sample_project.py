"""tests/sample_project, a user's project: its tests find each of twenty bugs that users write, and nothing in the right programs.

Each bug is planted in a copy of the project, by a piece of source that is replaced. Its tests run there as a user runs them: by
`pytest`, with what is installed, without our settings and our conftest. Each test runs with SEEDS seeds.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.examples import takes_all

PROJECT = Path(__file__).parents[1] / "sample_project"
SEEDS = 50 if takes_all() else 2
pytestmark = [
    pytest.mark.timeout(7200 if takes_all() else 600),  # the first test waits for all runs
    pytest.mark.skipif(not hasattr(os, "fork"), reason="copies a process, which this system does not"),
]


class Bug(NamedTuple):
    """In a file of the package `plant`: old becomes new."""

    file: str
    old: str
    new: str


BUGS = {
    "it is started before it is configured": Bug(
        "configure",
        "    await map_temperature(node)\n    await node.start()\n",
        "    await node.start()\n    await map_temperature(node)\n",
    ),
    "a PDO is mapped while it is enabled": Bug("configure", "    await node.write((0x1800, 1), cob_id | OFF)\n", ""),
    "a PDO is left disabled": Bug("configure", "    await node.write((0x1800, 1), cob_id)\n", ""),
    "whatever answers is taken for the device": Bug("configure", "    if vendor != VENDOR:\n", "    if not vendor:\n"),
    "a heartbeat in seconds": Bug("configure", "HEARTBEAT = 200  # ms", "HEARTBEAT = 2  # s"),
    "an emergency is lost between two reads": Bug("supervisor", "self.errors.append(code)", "self.errors[:] = [code]"),
    "the end of an error is taken for an error": Bug(
        "supervisor", "case EmcyReceived(code=code) if code:", "case EmcyReceived(code=code):"
    ),
    "the heartbeat consumer is shorter than the producer": Bug("supervisor", "PATIENCE = 0.5  # s", "PATIENCE = 0.15  # s"),
    "a node that boots again is not started": Bug(
        "supervisor", "                        await self.prepare()\n", "                        pass\n"
    ),
    "a segment does not toggle": Bug("thermometer", "        self.toggle ^= 0x10\n", ""),
    "wrong byte order": Bug(
        "thermometer", 'self.tenths.to_bytes(2, "little", signed=True)', 'self.tenths.to_bytes(2, "big", signed=True)'
    ),
    "stopped, it answers SDO": Bug("thermometer", " and self.state != STOPPED:", ":"),
    "no abort for an object that is not there": Bug(
        "thermometer",
        'return b"\\x80" + request[1:4] + NO_SUCH_OBJECT.to_bytes(4, "little")',
        'return b"\\x43" + request[1:4] + bytes(4)',
    ),
    "no boot-up after a reset": Bug("thermometer", "            self.reset()\n", "            self.state = PRE_OPERATIONAL\n"),
    "a PDO in pre-operational": Bug("thermometer", "if self.state == OPERATIONAL:", "if self.state != STOPPED:"),
    "a set-point without a look at its acknowledgement": Bug(
        "mover", "    await wait_for(node, ACKNOWLEDGED, ACKNOWLEDGED, 2)\n", ""
    ),
    "the new set-point bit stays": Bug(
        "mover", '    await node.write("controlword", 0x0F)\n    await wait_for(node, ACKNOWLEDGED, 0, 2)\n', ""
    ),
    "a fault is not looked at": Bug("mover", "if status & FAULT:", "if False:"),
    "the drive keeps its power": Bug("mover", '            await node.write("controlword", 0x00)\n', "            pass\n"),
    "a wait without a time-out": Bug("mover", "    with trio.fail_after(timeout):\n", "    if timeout:\n"),
    "no time-out of SDO": Bug("reader", "self.bus.recv(TIMEOUT)", "self.bus.recv()"),
    "an abort is taken for data": Bug("reader", "if answer[0] == 0x80:", "if False:"),
    "the toggle bit is ignored": Bug("reader", "if answer[0] & 0x10 != toggle:", "if False:"),
}
NAMES = [*BUGS][:: 1 if takes_all() else 3]
"""Every day each third bug."""
RIGHT, AGAIN = "the right programs", "the right programs, with another hash seed"


class Run(NamedTuple):
    """What pytest said, and the traffic of each test: the name of a file and its bytes."""

    status: int
    said: str
    traffic: dict[str, bytes]


STARTED = """
import gc, json, os, sys
from pathlib import Path
import pytest

def run(folder, words):
    os.chdir(folder)
    os.dup2(os.open("said", os.O_CREAT | os.O_WRONLY), 1)
    status = pytest.main(words)
    sys.stdout.flush()
    Path(folder, "status").write_text(str(int(status)))

right, *others = json.loads(sys.argv[1])
run(*right)
for name, module in list(sys.modules.items()):
    if (getattr(module, "__file__", None) or "").startswith(right[0]):
        del sys.modules[name]
gc.freeze()  # what was imported, pytest need not look at again
for other in others:
    child = os.fork()
    if not child:
        try:
            run(*other)
        finally:
            os._exit(0)
    os.waitpid(child, 0)
"""
"""Runs pytest for the first folder, as its user does. For each other one a copy of that process does, with all it has imported:
a tenth of the time."""


def planted(folder: Path, bug: Bug | None) -> tuple[str, list[str]]:
    """Make a copy; return it with the words for pytest: the tests of the program with the bug, or all."""
    shutil.copytree(PROJECT, folder)
    tests = "tests"
    if bug is not None:
        source = folder / "plant" / f"{bug.file}.py"
        text = source.read_text(encoding="utf-8")
        assert text.count(bug.old) == 1, bug
        source.write_text(text.replace(bug.old, bug.new), encoding="utf-8")
        tests = f"tests/test_{bug.file}.py"
    return str(folder), ["-q", "-p", "no:cacheprovider", "--tb=short", f"--seeds={SEEDS}", "--canopen-trace=traffic", tests]


def started(hash_seed: int, plans: list[tuple[str, list[str]]]) -> list[Run]:
    user = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "COV", "HYPOTHESIS"))}
    user["PYTHONHASHSEED"] = str(hash_seed)
    subprocess.run([sys.executable, "-c", STARTED, json.dumps(plans)], env=user, check=True)
    return [ended(Path(folder)) for folder, _ in plans]


def ended(folder: Path) -> Run:
    status, said = ((folder / name).read_text(encoding="utf-8") for name in ("status", "said"))
    return Run(int(status), said, {path.name: path.read_bytes() for path in (folder / "traffic").glob("*.log")})


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    """Of each bug, and of the right programs."""
    folder = tmp_path_factory.mktemp("plants")
    plans = {
        name: planted(folder / f"plant{number}", bug)
        for number, (name, bug) in enumerate({RIGHT: None, AGAIN: None, **{name: BUGS[name] for name in NAMES}}.items())
    }
    again = plans.pop(AGAIN)
    with ThreadPoolExecutor() as pool:
        others = pool.submit(started, 1, [again])
        return {**dict(zip(plans, started(0, [*plans.values()]), strict=True)), AGAIN: others.result()[0]}


def test_the_right_programs_pass_with_each_seed(runs: dict[str, Run]) -> None:
    for done in (runs[RIGHT], runs[AGAIN]):
        assert done.status == 0, done.said
        passed = re.search(r"^(\d+) passed in", done.said, re.MULTILINE)
        assert passed is not None
        assert int(passed[1]) % SEEDS == 0


def test_each_seed_gives_the_same_traffic_in_each_process_and_with_any_hash_seed(runs: dict[str, Run]) -> None:
    traffic = runs[RIGHT].traffic
    assert len(traffic) >= 19 * SEEDS
    assert sum(map(len, traffic.values())) > 100_000
    assert traffic == runs[AGAIN].traffic


@pytest.mark.parametrize("name", NAMES)
def test_a_bug_is_found_with_each_seed(name: str, runs: dict[str, Run]) -> None:
    done = runs[name]
    assert done.status == 1, done.said  # tests failed; not: nothing was collected
    found = {int(seed) for seed in re.findall(r"^FAILED \S*\[(\d+)\]", done.said, re.MULTILINE)}
    assert found == {*range(SEEDS)}, done.said


def test_there_are_twenty_bugs_in_five_programs_and_tests_of_a_few_lines() -> None:
    assert len(BUGS) >= 20
    assert {bug.file for bug in BUGS.values()} == {path.stem for path in (PROJECT / "plant").glob("[a-z]*.py")}
    for path in (PROJECT / "tests").glob("test_*.py"):
        for test in re.split(r"\n(?=(?:async )?def test_|@pytest.mark)", path.read_text(encoding="utf-8")):
            assert test.startswith(("import", "@", '"')) or len([line for line in test.splitlines() if line.strip()]) <= 15, test


def test_the_project_has_nothing_of_our_tests() -> None:
    for path in PROJECT.rglob("*.py"):
        assert not re.search(r"^(from|import) (tests|fuzz)\b", path.read_text(encoding="utf-8"), re.MULTILINE)
