"""Planted bugs, and who finds them: the kept inputs of the fuzz targets, and the tests.

    python -m fuzz.mutants [NAME ...]         each planted in a copy of the project; run it by hand, and once a week

A NAME is that of a bug, or of a wing of the house (`WINGS`): all its bugs. A bug is a piece of source that is replaced. The tests
that it names have to find it; in the wing `sdo` the corpus has to find it too. Both run first in the copy without a bug, where
both have to pass: else a failure would say nothing. The exit status is 0 if both find every bug; 1 if one of them misses a bug,
or does not end; 2 for an unknown name; 3 if something fails without a bug.
tests/core/test_fuzz_mutants.py checks that each bug can still be planted.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from enum import Enum
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from fuzz.boot_mutants import BOOT_MUTANTS
from fuzz.data_mutants import DATA_MUTANTS
from fuzz.drive_mutants import DRIVE_MUTANTS
from fuzz.flash_mutants import FLASH_MUTANTS
from fuzz.gateway_mutants import GATEWAY_MUTANTS
from fuzz.lss_mutants import LSS_MUTANTS
from fuzz.master_mutants import MASTER_MUTANTS
from fuzz.mutant import Mutant
from fuzz.observer_mutants import OBSERVER_MUTANTS
from fuzz.ros_mutants import ROS_MUTANTS
from fuzz.service_mutants import SERVICE_MUTANTS
from fuzz.trajectory_mutants import TRAJECTORY_MUTANTS
from fuzz.transport_mutants import TRANSPORT_MUTANTS

ROOT: Final = Path(__file__).parent.parent
TARGETS: Final = ("heartbeat", "sdo_pair")
"""The fuzz targets that know the truth."""
MOST_SECONDS: Final = 300
"""For one run of the corpus, or of tests."""
MOST_SECONDS_A_TEST: Final = 30
"""A test that a bug keeps from ending fails after this time: it found the bug."""
REPLAY: Final = ("fuzz.mutants", "--replay")
PYTEST: Final = ("pytest", "-q", "-x", "-n0", "-p", "no:cacheprovider", f"--timeout={MOST_SECONDS_A_TEST}")
CORE: Final = "canopen_proto"
FOLDERS: Final = {
    "canopen_data": "data",
    "canopen_transports": "transports",
    "canopen_master": "master",
    "canopen_check": "master",
    "canopen_ros": "master",
    "canopen_gateway": "master",
    "canopen_cli": "master",
}
"""The folder of the repository that each package but the core is in."""
BLOCKS: Final = ("tests/core/test_sdo_block_client.py", "tests/core/test_sdo_block_server.py")
PIECES: Final = ("tests/core/test_sdo_block_server_pieces.py",)
FAULTS: Final = ("tests/core/test_sdo_single_faults.py", "tests/core/test_sdo_block_pauses.py")
PLAIN: Final = ("tests/core/test_sdo_client.py", "tests/core/test_sdo_client_faults.py", "tests/core/test_sdo_server.py")
STREAMS: Final = ("tests/core/test_sdo_block_streams.py",)
FALL_BACK: Final = ("tests/core/test_sdo_block_fall_back.py",)
FATE: Final = ("tests/core/test_sdo_not_confirmed.py",)
LATE: Final = ("tests/core/test_sdo_late_answers.py",)
HEARTBEAT: Final = ("tests/core/test_heartbeat.py",)


_RECEIVER: Final = "sdo/block_receiver.py"
_SENDER: Final = "sdo/block_sender.py"
_CLIENT: Final = "sdo/client.py"
_SERVER: Final = "sdo/server.py"
_BLOCK_CLIENT: Final = "sdo/block_client.py"
_PLAIN_CLIENT: Final = "sdo/segmented_client.py"
_BLOCK_SERVER: Final = "sdo/block_server.py"
_QUEUE: Final = "sdo/request_queue.py"

SDO_MUTANTS: Final = (
    Mutant(
        "paused_unnoticed",
        _RECEIVER,
        " or (not self._received and 0 < self._paused_behind < sequence)",
        "",
        "a sender that paused too long goes on, and its segments are taken for others",
        BLOCKS[:1],
    ),
    Mutant(
        "short_silence",
        _RECEIVER,
        "self._silence = silence_limit(self.timeout)",
        "self._silence = self.timeout // 5",
        "a pause is taken for a loss",
        BLOCKS,
    ),
    Mutant(
        "least_silence",
        "sdo/block.py",
        "LEAST_SILENCE: Final = 1 * SECOND",
        "LEAST_SILENCE: Final = 700 * MILLISECOND",
        "a pause of a second is taken for a loss",
        FAULTS,
    ),
    Mutant(
        "early_as_usual",
        _RECEIVER,
        "self._end_sub_block(0, now, is_early=True)",
        "self._end_sub_block(0, now)",
        "nothing is expected of a sender that paused",
        BLOCKS[:1],
    ),
    Mutant(
        "impatient_sender",
        "sdo/transfer.py",
        "return 2 * silence_limit(self.timeout)",
        "return silence_limit(self.timeout)",
        "the sender gives up before the receiver asks again",
        FAULTS,
    ),
    Mutant(
        "zero_crc_guard",
        _RECEIVER,
        "if not self._with_crc or self._size is None:\n            return",
        "if not self._with_crc:\n            return",
        "zeros do not count in a CRC that begins with 0: without a size they may be repeated",
        BLOCKS[1:],
    ),
    Mutant(
        "reminder_of_a_segment",
        _RECEIVER,
        "remaining <= SEGMENT_SIZE:",
        "remaining < SEGMENT_SIZE:",
        "a last segment of seven bytes is not asked for",
        FAULTS[:1],
    ),
    Mutant("no_reminder", _RECEIVER, "            self._remind()\n", "", "a lost acknowledgement is not repeated", BLOCKS),
    Mutant(
        "size_unchecked",
        _RECEIVER,
        "elif self._size is not None and self.offset + end != self._size:",
        "elif self._size is None and end < 0:",
        "fewer or more bytes than were announced",
        BLOCKS,
    ),
    Mutant(
        "crc_unchecked", _RECEIVER, "if self._with_crc and crc != data[1] | data[2] << 8:", "if crc < 0:", "damaged bytes", BLOCKS
    ),
    Mutant(
        "crc_high_byte", _RECEIVER, "crc != data[1] | data[2] << 8:", "crc & 0xFF != data[1]:", "one in 256 faults passes", BLOCKS
    ),
    Mutant(
        "crc_of_pieces",
        _RECEIVER,
        "            self._check(len(self._buffer))\n            self.state = HELD",
        "            self.state = HELD",
        "the CRC of a stream misses what was handed on",
        STREAMS,
    ),
    Mutant(
        "limit_forgotten",
        _RECEIVER,
        "elif self.offset + end > self._limit:",
        "elif end < 0:",
        "more is taken than may be",
        BLOCKS[:1],
    ),
    Mutant(
        "copied_last_segment",
        _RECEIVER,
        "if data == self.end.last:",
        "if state is INITIATED:",
        "the second copy of a last segment is taken for a request",
        BLOCKS[1:],
    ),
    Mutant(
        "block_size_of_1",
        "sdo/block.py",
        "return max(2, min(block_size",
        "return max(1, min(block_size",
        "the second copy of a segment has the number that is due",
        BLOCKS[1:],
    ),
    Mutant(
        "gap_acknowledged_whole",
        _RECEIVER,
        "        received = self._received\n",
        "        received = max(self._received, self._heard)\n",
        "lost segments are acknowledged",
        BLOCKS,
    ),
    Mutant(
        "copied_acknowledgement",
        _SENDER,
        "if not self._sent or acknowledged > self._sent:",
        "if acknowledged > MAX_BLOCK_SIZE:",
        "the second copy of an acknowledgement counts for the next sub-block",
        BLOCKS,
    ),
    Mutant(
        "sub_block_guard",
        _SENDER,
        "self.deadline = now + self.end.copy_guard",
        "self.deadline = now",
        "a copy of the acknowledgement that comes a moment later counts for the next sub-block",
        BLOCKS[:1],
    ),
    Mutant(
        "empty_has_no_segment",
        _SENDER,
        " or 1  # no data at all is one segment",
        " or 0  # no data at all is one segment",
        "an empty object has nothing to acknowledge",
        BLOCKS,
    ),
    Mutant(
        "crc_of_what_was_sent",
        _SENDER,
        "        end = self._base + size\n        self._acknowledged",
        "        end = self._base + self._sent * SEGMENT_SIZE\n        self._acknowledged",
        "what has to be sent again is dropped",
        BLOCKS,
    ),
    Mutant(
        "fall_back_order",
        _CLIENT,
        "self._queue.urgent.appendleft(plain)",
        "self._queue.urgent.append(plain)",
        "a request that falls back loses its turn",
        FALL_BACK,
    ),
    Mutant(
        "fall_back_guard",
        _CLIENT,
        "    transfer.is_given_up = True  # a second copy",
        "    transfer.is_given_up = False  # a second copy",
        "the second copy of the refusal refuses the plain transfer too",
        FALL_BACK,
        in_corpus=False,  # without a copy_guard it changes nothing: the plain transfer is made again
    ),
    Mutant(
        "size_unheard",
        _BLOCK_CLIENT,
        "[0] if command & BLOCK_SIZE_BIT else None",
        "[0] if command & 0x10 else None",
        "an announced size guards nothing",
        BLOCKS[:1],
    ),
    Mutant(
        "crc_on_our_side_alone",
        _BLOCK_CLIENT,
        "self._crc_offered and bool(command & CRC_BIT)",
        "self._crc_offered",
        "a server without CRC seems to send wrong ones",
        BLOCKS[:1],
    ),
    Mutant(
        "largest_refused",
        _BLOCK_CLIENT,
        "if size is not None and size > self._most:",
        "if size is not None and size >= self._most:",
        "max_upload bytes are too many",
        BLOCKS[:1],
    ),
    Mutant(
        "crc_of_the_server_alone",
        _BLOCK_SERVER,
        "self._start(size, limit, end.crc and bool(first[0] & CRC_BIT), now)",
        "self._start(size, limit, end.crc, now)",
        "a client without CRC is refused",
        BLOCKS[1:],
    ),
    Mutant(
        "initiate_is_a_segment",
        _BLOCK_SERVER,
        "if has_heard or is_copy or not is_initiate(command):",
        "if has_heard or is_copy or command:",
        "a server whose answer was lost does not hear the next request",
        BLOCKS[1:],
    ),
    Mutant(
        "pieces_limited",
        _BLOCK_SERVER,
        "MAX_SIZE if door.takes_pieces else most",
        "most",
        "what goes in pieces is limited like what is held whole",
        PIECES,
    ),
    Mutant(
        "stragglers_unknown",
        _SERVER,
        "self._straggler = transfer.straggler",
        "self._straggler = 0",
        "the rest of a paused client's queue is taken for requests",
        FAULTS[1:],
    ),
    Mutant(
        "overtaken_stays",
        _RECEIVER,
        "            self._forget_sub_block()\n",
        "",
        "a segment that others overtook stays where another belongs",
        FAULTS[:1],
    ),
    Mutant(
        "straggler_behind_an_abort",
        _SERVER,
        "        self._straggler = 0  # the client sends nothing behind its abort\n",
        "",
        "a request whose command byte is the next number is ignored",
        BLOCKS[1:],
    ),
    Mutant(
        "copied_segment",
        _SERVER,
        "if data == self.last and self._transfer is not None:",
        "if data == self.last and self._transfer is None:",
        "the second copy of a segment ends the transfer",
        PLAIN[2:],
    ),
    Mutant(
        "executed_is_refused",
        _CLIENT,
        "not is_refusal and transfer.is_all_sent",
        "False",
        "an abort for the second copy of the last segment ends a write that was executed",
        FATE,
    ),
    Mutant(
        "stray_abort_counts",
        _CLIENT,
        "(transfer.has_begun and is_nameless)",
        "((transfer.has_begun or transfer.in_blocks) and is_nameless)",
        "the abort for a copy of the last segment ends the next block transfer",
        BLOCKS[:1],
    ),
    Mutant(
        "expedited_is_certain",
        _PLAIN_CLIENT,
        "            return bool(self.first[0] & EXPEDITED_BIT)\n        return self._offset",
        "            return False\n        return self._offset",
        "an expedited write whose answer was lost is called refused",
        FATE,
    ),
    Mutant(
        "segments_are_certain",
        _PLAIN_CLIENT,
        "return self._offset >= len(self._content)",
        "return self._offset < 0",
        "a segmented write whose last answer was lost is called refused",
        FATE,
    ),
    Mutant(
        "plain_limit",
        _PLAIN_CLIENT,
        "if size > self._most:",
        "if size >= self._most:",
        "max_upload bytes are too many",
        PLAIN[:2],
    ),
    Mutant(
        "copied_response",
        _CLIENT,
        "data[:4] == self.last[:4]:",
        'data[:4] == b"":',
        "the second copy of an initiate response ends the transfer",
        PLAIN[:2],
    ),
    Mutant(
        "copy_guard",
        _QUEUE,
        "if self.unsettled or (first[1:4] == before[1:4] and first[0] >> 5 == before[0] >> 5):",
        "if self.unsettled:",
        "the second copy of an answer is taken for that of the next request",
        PLAIN[:1],
    ),
    Mutant(
        "late_guard",
        _CLIENT,
        "expect_late(transfer.name, now, now + self.late_guard)",
        "expect_late(transfer.name, now, now)",
        "a late answer is taken for that of the next request",
        LATE,
    ),
    Mutant(
        "last_bit",
        "sdo/codec.py",
        "    if unused < 0:\n        return",
        "    if unused <= 0:\n        return",
        "a last segment of seven bytes is not the last",
        PLAIN[:1],
    ),
    Mutant(
        "heartbeat_at_boot_up",
        "heartbeat.py",
        "        if self.timeout and self._begun and not self.lost:",
        "        if data[0] and self.timeout and self._begun and not self.lost:",
        "a node that boots is lost before its time",
        HEARTBEAT,
    ),
    Mutant(
        "watched_from_boot_up",
        "heartbeat.py",
        "self._begun = False  # a heartbeat was heard",
        "self._begun = True  # a heartbeat was heard",
        "a node without a heartbeat is lost",
        HEARTBEAT,
    ),
)
"""Of SDO and of the heartbeat: what the fuzz targets know the truth about."""

WINGS: Final = {
    "sdo": SDO_MUTANTS,
    "boot": BOOT_MUTANTS,
    "flash": FLASH_MUTANTS,
    "lss": LSS_MUTANTS,
    "drives": DRIVE_MUTANTS,
    "trajectories": TRAJECTORY_MUTANTS,
    "services": SERVICE_MUTANTS,
    "transports": TRANSPORT_MUTANTS,
    "master": MASTER_MUTANTS,
    "data": DATA_MUTANTS,
    "observer": OBSERVER_MUTANTS,
    "ros": ROS_MUTANTS,
    "gateway": GATEWAY_MUTANTS,
}
MUTANTS: Final = tuple(mutant for wing in WINGS.values() for mutant in wing)


def _package_and_rest(file: str) -> tuple[str, str]:
    """Take a mutant's file apart: the package, and the path inside it."""
    package, _, rest = file.partition("/")
    return (package, rest) if package in FOLDERS else (CORE, file)


def place_of(file: str, tree: Path) -> Path:
    """Return the path of a mutant's file in a copy of the project."""
    package, rest = _package_and_rest(file)
    return tree / FOLDERS.get(package, "") / package / rest


def source_of(file: str) -> Path:
    """Return the path of a mutant's file where Python imports its package from."""
    package, rest = _package_and_rest(file)
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise LookupError(f"the package {package} is not installed")
    return Path(spec.origin).parent / rest


def planted(mutant: Mutant, source: str) -> str:
    """Return a source with a bug. Raises ValueError where its place is not there exactly once."""
    if source.count(mutant.old) != 1:
        raise ValueError(f"{mutant.name}: its place is {source.count(mutant.old)} times in {mutant.file}")
    return source.replace(mutant.old, mutant.new)


def plant(mutant: Mutant, tree: Path) -> None:
    """Put a bug into a copy. Raises ValueError where its place is not there exactly once."""
    path = place_of(mutant.file, tree)
    path.write_text(planted(mutant, path.read_text(encoding="utf-8")), encoding="utf-8")


def copy_of_the_project(tree: Path) -> None:
    """A copy of what the corpus and the tests need."""
    for folder in (
        source_of("__init__.py").parent,
        *(ROOT / name for name in ("fuzz", "tests", "data", "transports", "master", "docs")),
    ):
        shutil.copytree(folder, tree / folder.name, ignore=shutil.ignore_patterns("__pycache__", "found", "*.egg-info"))
    for file in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / file, tree)


def replay() -> int:
    """Run the inputs of the targets that know the truth; whatever they find is raised."""
    from fuzz.kept import HERE, kept
    from fuzz.targets import TARGETS as BODIES

    for target in TARGETS:
        for data in [*(path.read_bytes() for path in sorted((HERE / "corpus" / target).iterdir())), *kept(target)]:
            BODIES[target](data)
    return 0


class Outcome(Enum):
    """What a run says about a planted bug."""

    PASSED = "MISSED"
    FAILED = "found"
    ENDLESS = "NO END"
    """It says nothing: the run may have been slow only."""


def outcome_of(tree: Path, *command: str) -> tuple[Outcome, str]:
    """Run a Python module in a copy: how that ended, and the end of what it printed."""
    try:
        ended = subprocess.run(
            [sys.executable, "-m", *command], cwd=tree, capture_output=True, text=True, timeout=MOST_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return Outcome.ENDLESS, f"it did not end within {MOST_SECONDS} s"
    return Outcome.FAILED if ended.returncode else Outcome.PASSED, (ended.stdout + ended.stderr)[-2000:]


def main(names: list[str]) -> int:
    """Plant the bugs of these names, or all, and print who finds them; the exit status is that of the module's docstring."""
    if {"-h", "--help"} & set(names):
        print(__doc__)
        return 0
    wings = {name: {mutant.name for mutant in wing} for name, wing in WINGS.items()}
    wanted = set().union(*(wings.get(name, {name}) for name in names))
    if unknown := wanted - {mutant.name for mutant in MUTANTS}:
        print(f"there is no bug {', '.join(sorted(unknown))}; there are {', '.join(mutant.name for mutant in MUTANTS)}")
        print(f"nor is that a wing; there are {', '.join(WINGS)}")
        return 2
    chosen = [mutant for mutant in MUTANTS if not names or mutant.name in wanted]
    ended: Counter[tuple[str, Outcome]] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        copy_of_the_project(tree)
        for command in (REPLAY, (*PYTEST, *sorted({test for mutant in chosen for test in mutant.tests}))):
            outcome, printed = outcome_of(tree, *command)
            if outcome is not Outcome.PASSED:
                print(f"No bug was planted, and this failed: python -m {' '.join(command)}\n{printed}")
                return 3
        for mutant in chosen:
            original = place_of(mutant.file, tree).read_bytes()
            plant(mutant, tree)
            in_corpus = outcome_of(tree, *REPLAY)[0] if mutant.in_corpus else None
            in_tests, _ = outcome_of(tree, *PYTEST, *mutant.tests)
            place_of(mutant.file, tree).write_bytes(original)
            if in_corpus is not None:
                ended["corpus", in_corpus] += 1
            ended["tests", in_tests] += 1
            corpus = "-" if in_corpus is None else in_corpus.value
            print(f"{mutant.name:28} corpus {corpus:7} tests {in_tests.value:7} {mutant.why}", flush=True)
    for who in ("corpus", "tests"):
        found, missed, endless = (ended[who, outcome] for outcome in (Outcome.FAILED, Outcome.PASSED, Outcome.ENDLESS))
        print(f"{len(chosen)} bugs: the {who} found {found}, missed {missed}, and did not end with {endless}")
    return int(any(count and outcome is not Outcome.FAILED for (_, outcome), count in ended.items()))


if __name__ == "__main__":
    sys.exit(replay() if sys.argv[1:] == ["--replay"] else main(sys.argv[1:]))
