"""Serial-line adapters that are none: they speak LAWICEL's protocol at the master's end of pseudo-terminals, all on one bus.

One thread serves all. A line ends in CR; the answer to a command that went well is CR, else BELL. Understood are `Sn` (bit rate),
`O` and `L` (open; to listen only), `C`, `V`, and the frames: `t` and `T` with data, `r` and `R` remote, 11 and 29 bit.
"""

from __future__ import annotations

import contextlib
import functools
import os
import pty
import selectors
import threading
import tty
from collections.abc import Callable
from pathlib import Path

OK, BELL = b"\r", b"\a"


class Adapter:
    """One adapter. path: of its end for the program. said: the commands that it was given, but for frames."""

    def __init__(self, bus: SimulatedBus, link: Path) -> None:
        self.bus = bus
        self.link = link
        self.fd, self._other = pty.openpty()
        tty.setraw(self._other)
        os.set_blocking(self.fd, False)
        link.unlink(missing_ok=True)
        self._name = os.ttyname(self._other)
        link.symlink_to(self._name)
        self.said: list[str] = []
        self.is_open = False
        self.is_silent = False
        self._line = b""
        self.unread = bytearray()

    def take(self, data: bytes) -> None:
        """What the program wrote."""
        *lines, self._line = (self._line + data).split(b"\r")
        for line in lines:
            self._obey(line.decode())

    def write(self, data: bytes) -> None:
        """What the program is to read. From any other thread."""
        self.bus.order(functools.partial(self.put, data))

    def put(self, data: bytes) -> None:
        """The same, in the thread, which waits for no program: one that closes reads nothing any more."""
        self.unread += data
        self.flush()

    def flush(self) -> None:
        """Hand over as much as the line takes now."""
        with contextlib.suppress(BlockingIOError):
            while self.unread:
                del self.unread[: os.write(self.fd, self.unread)]
        self.bus.listen(self)

    def _obey(self, line: str) -> None:
        match line[:1]:
            case "t" | "T" | "r" | "R" if self.is_open:
                self.put(b"z\r" if line[0] in "tr" else b"Z\r")
                self.bus.spread(self, line.encode() + OK)
                return
            case "S" | "C" | "V" | "O" | "L":
                self.said.append(line)
                if line[0] in "OLC":
                    self.is_open = line[0] != "C"
                if not self.is_silent:
                    self.put(b"V1013\r" if line[0] == "V" else OK)
            case "":
                pass
            case _:
                self.said.append(line)
                self.put(BELL)

    def pull(self) -> None:
        """Unplug it. Runs in the thread."""
        if self.link.is_symlink() and os.readlink(self.link) == self._name:  # another may have its place by now
            self.link.unlink()
        for fd in (self.fd, self._other):
            with contextlib.suppress(OSError):
                os.close(fd)


class SimulatedBus:
    """The bus, and the thread that serves its adapters."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._selector = selectors.DefaultSelector()
        self._adapters: dict[int, Adapter] = {}
        self._orders: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._wake, self._woken = os.pipe()
        self._selector.register(self._wake, selectors.EVENT_READ)
        self._is_over = False
        self._thread = threading.Thread(target=self._serve, name="serial adapters", daemon=True)
        self._thread.start()

    def plug(self, name: str) -> Adapter:
        """One more adapter, at FOLDER/name."""
        adapter = Adapter(self, self._folder / name)

        def register() -> None:
            self._adapters[adapter.fd] = adapter
            self._selector.register(adapter.fd, selectors.EVENT_READ)

        self.order(register)
        return adapter

    def unplug(self, adapter: Adapter) -> None:
        """The program's descriptor hangs up, and the name is gone."""

        def remove() -> None:
            self._selector.unregister(adapter.fd)
            del self._adapters[adapter.fd]
            adapter.pull()

        self.order(remove)

    def order(self, order: Callable[[], None]) -> None:
        """Run something in the thread, and wait for it."""
        done = threading.Event()
        with self._lock:
            self._orders += [order, done.set]
        os.write(self._woken, b"x")
        assert done.wait(10)

    def spread(self, sender: Adapter, line: bytes) -> None:
        """A frame, to all others."""
        for adapter in self._adapters.values():
            if adapter is not sender and adapter.is_open:
                adapter.put(line)

    def listen(self, adapter: Adapter) -> None:
        """Hear what a program says; and when its line has room, if it did not take all."""
        room = selectors.EVENT_WRITE if adapter.unread else 0
        self._selector.modify(adapter.fd, selectors.EVENT_READ | room)

    def close(self) -> None:
        """Unplug all."""
        for adapter in list(self._adapters.values()):
            self.unplug(adapter)

        def end() -> None:
            self._is_over = True

        self.order(end)
        self._thread.join(10)
        self._selector.close()
        os.close(self._wake)
        os.close(self._woken)

    def _serve(self) -> None:
        while not self._is_over:
            for key, ready in self._selector.select():
                if key.fd == self._wake:
                    os.read(self._wake, 100)
                    with self._lock:
                        orders, self._orders = self._orders, []
                    for order in orders:
                        order()
                elif key.fd in self._adapters:
                    adapter = self._adapters[key.fd]
                    with contextlib.suppress(OSError):
                        if ready & selectors.EVENT_WRITE:
                            adapter.flush()
                        if ready & selectors.EVENT_READ:
                            adapter.take(os.read(key.fd, 4096))
