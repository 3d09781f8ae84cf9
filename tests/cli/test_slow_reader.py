"""`LineWriter`: a reader that is slow, or goes away. The pipe and the thread are real, and waited for; no time is measured."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from typing import IO

import pytest
import trio

from canopen_cli.live import slow_reader
from canopen_cli.live.slow_reader import LineWriter, open_line_writer
from canopen_cli.shared.screen import Screen

LINE = "x" * 99
MANY = 3000
"""More than a pipe and FULL lines hold together."""


@pytest.fixture
def stdout(monkeypatch: pytest.MonkeyPatch) -> Iterator[IO[str]]:
    """The end of a pipe, to which writers write. Few lines wait for its reader."""
    ours, theirs = os.pipe()
    monkeypatch.setattr(slow_reader, "FULL", 100)
    monkeypatch.setattr(slow_reader, "CHUNK", 10)
    monkeypatch.setattr(slow_reader, "_descriptor_of", lambda stream: theirs)
    with os.fdopen(theirs, "w") as stdout, os.fdopen(ours, "r") as stdout.reader:  # type: ignore[attr-defined]
        yield stdout


@pytest.fixture
def reading(stdout: IO[str]) -> IO[str]:
    """The other end of the pipe."""
    reader: IO[str] = stdout.reader  # type: ignore[attr-defined]
    return reader


def missing(number: int) -> str:
    return f"{number} missing\n"


async def put_all(lines: LineWriter, number: int) -> None:
    for each in range(number):
        await lines.put(f"{each:<5} {LINE}\n")
        if each % 10 == 0:
            await trio.lowlevel.checkpoint()


async def read_all(reading: IO[str], found: list[str]) -> None:
    """Read until the last line, which is `end`."""

    def read() -> None:
        while (line := reading.readline().strip()) != "end":
            found.append(line)

    await trio.to_thread.run_sync(read, abandon_on_cancel=True)


def test_a_recording_waits_for_its_reader(reading: IO[str]) -> None:
    found: list[str] = []

    async def body() -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(read_all, reading, found)
            async with open_line_writer(Screen(), missing, waits=True) as lines:
                await put_all(lines, MANY)
                await lines.put("end\n")
        assert lines.left_out == 0

    trio.run(body)
    assert [line.split()[0] for line in found] == [str(each) for each in range(MANY)]


def test_a_bus_does_not_wait_and_says_what_is_missing(reading: IO[str]) -> None:
    found: list[str] = []

    async def body() -> int:
        async with open_line_writer(Screen(), missing, waits=False) as lines:
            await put_all(lines, MANY)  # nobody reads
            assert lines.left_out > 0
            async with trio.open_nursery() as nursery:
                nursery.start_soon(read_all, reading, found)
                while lines.waiting:
                    await trio.sleep(0)
                await lines.put("after\n")
                await lines.put("end\n")
        return lines.left_out

    left_out = trio.run(body)
    due = 0
    for line in found[:-1]:
        number = int(line.split()[0])
        if line.endswith("missing"):
            left_out -= number
            due += number
        else:
            assert number == due
            due += 1
    assert (due, left_out, found[-1]) == (MANY, 0, "after")


def test_an_interruption_does_not_wait_for_a_reader_who_does_not_read(
    stdout: IO[str], reading: IO[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slow_reader, "LAST_WORDS", 0.01)
    os.set_blocking(stdout.fileno(), False)
    with suppress(BlockingIOError):
        while True:
            os.write(stdout.fileno(), b"full")
    os.set_blocking(stdout.fileno(), True)

    async def body() -> int:
        with trio.CancelScope() as scope:
            async with open_line_writer(Screen(), missing, waits=True) as lines, trio.open_nursery() as nursery:
                nursery.start_soon(put_all, lines, MANY)
                while lines.waiting < slow_reader.FULL + 1:  # one is in the hands of the thread
                    await trio.sleep(0)
                scope.cancel()
        return lines.left_out

    assert trio.run(body) > slow_reader.FULL
    reading.close()  # the thread ends


def test_an_interruption_lets_a_reader_have_the_last_lines(reading: IO[str]) -> None:
    async def body() -> None:
        with trio.CancelScope() as scope:
            async with open_line_writer(Screen(), missing, waits=False) as lines:
                await lines.put("one\n")
                await lines.put("two\n")
                scope.cancel()
                await trio.lowlevel.checkpoint()
        assert lines.left_out == 0

    trio.run(body)
    assert [reading.readline(), reading.readline()] == ["one\n", "two\n"]


@pytest.mark.parametrize("waits", [True, False])
def test_a_reader_who_has_gone(stdout: IO[str], reading: IO[str], monkeypatch: pytest.MonkeyPatch, waits: bool) -> None:
    monkeypatch.setattr(sys, "stdout", stdout)

    async def body() -> None:
        async with open_line_writer(Screen(), missing, waits=waits) as lines:
            reading.close()
            if waits:
                await lines.put("one\n")
            await trio.sleep_forever()

    with pytest.raises(ExceptionGroup) as failed:
        trio.run(body)
    assert failed.group_contains(BrokenPipeError)


def test_what_was_shown_before_an_error_is_written(reading: IO[str]) -> None:
    async def body() -> None:
        async with open_line_writer(Screen(), missing, waits=True) as lines:
            await lines.put("one\n")
            raise ValueError

    with pytest.raises(ExceptionGroup) as failed:
        trio.run(body)
    assert failed.group_contains(ValueError)
    assert reading.readline() == "one\n"
