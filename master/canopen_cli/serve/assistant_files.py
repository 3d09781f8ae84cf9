"""What an assistant may ask about files: recordings of a folder, and the plan of the machine file's buses.

Each question is a command of this command line in a process of its own, of low priority: a recording of a gigabyte takes no time
from the bus, and its end is a kill. What it prints is read up to a bound. An assistant names a recording by a name of
`list_logs`, never by a path; so it reads no other file.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import aclosing
from pathlib import Path
from typing import Any, Final

import trio

from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_gateway.assistant.bounds import MAX_OUTPUT, bounded, from_device
from canopen_master.monitor_words import SERVICES
from canopen_master.plain_text import json_text
from canopen_transports.log_files import LogFileError, kind_of

LONGEST: Final = 60.0
"""Seconds that a question may take."""
MOST_ROWS: Final = 500
MOST_LINE: Final = 1 << 20
"""Bytes of a line that is looked at."""
MOST_LOGS: Final = 200
_TIME: Final = re.compile(r"[0-9]{1,9}(\.[0-9]{1,6})?(us|ms|s)\Z")
_RATE: Final = re.compile(r"[0-9]{1,7}(\.[0-9]{1,3})?[kM]?\Z")
_OF_DEVICES: Final = ("text", "value", "name")
"""Fields of a row that may have words of a device in them."""
_PROGRAM: Final = "import sys; from canopen_cli.entry import main; sys.exit(main())"


class FileQuestionError(CommandError, ValueError):
    """A question about files cannot be answered. For the fields see CommandError."""


class FileTools:
    """See this module's text. The docstrings of its tools are what an assistant reads."""

    def __init__(self, settings: Settings, logs: Path | None) -> None:
        """logs: the folder with recordings; None: there are none."""
        self._settings = settings
        self._logs = logs

    async def list_logs(self) -> str:
        """List the recordings of bus traffic that can be looked at, with their sizes in bytes."""
        return bounded([{"log": name, "bytes": path.stat().st_size} for name, path in self._found().items()])

    async def decode_log(self, log: str, start: int = 0, count: int = 100, node: int = 0, service: str = "") -> str:
        """Say what the frames of a recording mean. log: a name of list_logs. start, count: which rows, from 0 on. node: only of
        this one; service: only of it: nmt, sync, emcy, sdo, heartbeat, pdo, lss."""
        words = ["log", "decode", str(self._path(log))]
        if node:
            if not 1 <= node <= 127:
                raise ValueError("a node is 1 to 127; 0: all")
            words += ["--node", str(node)]
        if service:
            if service not in (*SERVICES, "pdo", "tpdo", "rpdo"):
                raise ValueError(f"{service[:40]!r} is no service: {', '.join((*SERVICES, 'pdo', 'tpdo', 'rpdo'))}")
            words += ["--service", service]
        rows, has_more, _ = await self._rows(words, start, count)
        return _fitting({"log": log, "start": start}, rows, start, has_more)

    async def check_log(self, log: str, start: int = 0, count: int = 100) -> str:
        """Tell what happened in a recording, and what was against the standard there: emergencies, faults, nodes that fell
        silent, aborts, findings. log: a name of list_logs. start, count: which rows, from 0 on. "totals" sums up all."""
        rows, has_more, notes = await self._rows(["log", "check", str(self._path(log))], start, count)
        return _fitting({"log": log, "start": start, "totals": notes}, rows, start, has_more)

    async def plan_bus(self, cycle: str = "", bitrate: str = "") -> str:
        """Calculate whether the buses of the machine file carry their traffic: load, worst latency of each PDO, the shortest
        cycle that fits. cycle: as 10ms, bitrate: as 500k; those of the file if left out. Opens no bus."""
        words = ["plan"]
        for option, text, form in (("--cycle", cycle, _TIME), ("--bitrate", bitrate, _RATE)):
            if text:
                if form.match(text) is None:
                    raise ValueError(
                        f"{option[2:]} {text[:40]!r}: it is a number with its unit, as {'10ms' if form is _TIME else '500k'}"
                    )
                words += [option, text]
        if self._settings.machine is None:
            raise _refused("there is no machine file to plan", tries=("canopen serve mcp -m cell.toml",))
        document = await self._document([*words, "-m", str(self._settings.machine)])
        return bounded(document)

    async def machine_file(self) -> str:
        """Return the text of the machine file."""
        if self._settings.machine is None:
            raise _refused("there is no machine file", tries=("canopen serve mcp -m cell.toml",))
        text = await trio.Path(self._settings.machine).read_text(encoding="utf-8", errors="replace")
        return (
            text
            if len(text) <= MAX_OUTPUT
            else f"{text[: MAX_OUTPUT - 100]}\n# ... and {len(text) - MAX_OUTPUT + 100} characters more"
        )

    # ---- inside ----

    def _found(self) -> Mapping[str, Path]:
        """Return the recordings by their names: files of the folder itself, of a kind that can be read, and no links."""
        if self._logs is None:
            raise _refused("there is no folder with recordings", tries=("canopen serve mcp --logs DIR",))
        found: dict[str, Path] = {}
        for path in sorted(self._logs.iterdir()):
            if path.is_file() and not path.is_symlink() and _is_log(path) and len(found) < MOST_LOGS:
                found[path.name] = path
        return found

    def _path(self, log: str) -> Path:
        found = self._found()
        if log not in found:
            known = ", ".join(found) or "none"
            raise _refused(
                f"there is no recording {log[:80]!r}",
                seen=f"there are {known}"[:1000],
                tries=("list_logs",),
            )
        return found[log]

    async def _rows(self, words: Sequence[str], start: int, count: int) -> tuple[list[Any], bool, list[str]]:
        """Return rows that a command prints, one in each line; whether there are more; and its notes, if it came to its end."""
        if start < 0 or not 1 <= count <= MOST_ROWS:
            raise ValueError(f"start is 0 or more, count 1 to {MOST_ROWS}")
        rows: list[Any] = []
        number = 0
        async with _Question(self._words(words)) as question:
            async with aclosing(question.lines()) as lines:
                async for line in lines:
                    number += 1
                    if number > start + count:
                        return rows, True, []
                    if number > start:
                        rows.append(_marked(json.loads(line)))
            notes = await question.end()
        return rows, False, notes

    async def _document(self, words: Sequence[str]) -> Any:
        async with _Question(self._words(words)) as question:
            text = b"\n".join([line async for line in question.lines()])
            await question.end()
        return json.loads(text)

    def _words(self, words: Sequence[str]) -> list[str]:
        files = [word for each in self._settings.eds for word in ("-e", each)]
        return [*words, *(files if words[0] == "log" else ()), "--json"]


class _Question:
    """A command in a process of its own, while the block runs; then it is killed, if it has not ended. Raises FileQuestionError
    if it fails, or takes too long."""

    def __init__(self, words: Sequence[str]) -> None:
        self._words = words

    async def __aenter__(self) -> _Question:
        self._scope = trio.move_on_after(LONGEST)
        self._scope.__enter__()
        self._told = tempfile.TemporaryFile()  # noqa: SIM115 - until the process has ended
        self._process = await trio.lowlevel.open_process(
            [sys.executable, "-c", _PROGRAM, *self._words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._told,  # no pipe: nobody reads it meanwhile
        )
        if hasattr(os, "setpriority"):
            with contextlib.suppress(OSError):  # it has ended already
                os.setpriority(os.PRIO_PROCESS, self._process.pid, 10)
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> bool:
        with trio.CancelScope(shield=True):
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
            await self._process.wait()
            if self._process.stdout is not None:
                await self._process.stdout.aclose()
            self._told.close()
        is_handled = self._scope.__exit__(kind, error, trace)
        if self._scope.cancelled_caught:
            raise _refused(f"this took more than {LONGEST:g} s, and was ended", tries=("a smaller recording",))
        return bool(is_handled)

    async def lines(self) -> AsyncGenerator[bytes, None]:
        """Yield what it prints, line by line."""
        assert self._process.stdout is not None
        held = b""
        async for chunk in self._process.stdout:
            *lines, held = (held + chunk).split(b"\n")
            for line in lines:
                if line.strip():
                    yield line
            if len(held) > MOST_LINE:
                raise ValueError("a line of the answer is too long")
        if held.strip():
            yield held

    async def end(self) -> list[str]:
        """Wait for its end, and return its notes."""
        status = await self._process.wait()
        self._told.seek(0)
        told = self._told.read(MOST_LINE)
        try:
            said = json.loads(told) if told.strip() else {}
        except ValueError:
            said = {"message": told[-500:].decode("utf-8", "replace")}
        if status not in (ExitCode.OK, ExitCode.DIFFERENT, ExitCode.PARTIAL):
            failed = str(said.get("message", f"the command ended with status {status}"))
            raise FileQuestionError(
                ExitCode.BAD_FILE, str(said.get("code", "")), failed[:500], seen=str(said.get("seen", ""))[:500]
            )
        return [str(each)[:500] for each in said.get("notes", ())]


def _refused(failed: str, *, seen: str = "", tries: Sequence[str] = ()) -> FileQuestionError:
    return FileQuestionError(ExitCode.USAGE, "CO123", failed, seen=seen, tries=tries)


def _is_log(path: Path) -> bool:
    try:
        kind_of(path)
    except LogFileError:
        return path.suffix.lower() == ".txt"
    return True


def _marked(row: Any, key: str = "") -> Any:
    """Mark what may be words of a device."""
    if isinstance(row, dict):
        return {name: _marked(each, name) for name, each in row.items()}
    if isinstance(row, list):
        return [_marked(each, key) for each in row]
    return from_device(row) if isinstance(row, str) and row and key in _OF_DEVICES else row


def _fitting(head: dict[str, Any], rows: list[Any], start: int, has_more: bool) -> str:
    """Return rows as an answer that is bounded; "next_start" says where it goes on."""
    room = MAX_OUTPUT - len(json_text(head)) - 100
    kept = 0
    for row in rows:
        room -= len(json_text(row)) + 2
        if room < 0:
            break
        kept += 1
    goes_on = has_more or kept < len(rows)
    return bounded({**head, "rows": rows[:kept], "next_start": start + kept if goes_on else None})
