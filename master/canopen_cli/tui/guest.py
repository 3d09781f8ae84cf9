"""Trio as the guest of asyncio, in one thread: the view is a program of asyncio (textual), the gateway's service one of trio.

A thread for each would need a lock around all that the view looks at, and the view's library sets signal handlers, which only the
main thread may do; so may trio's receiver of Ctrl-C. As a guest, trio runs between two turns of asyncio: nobody sees anything
half done. The view asks trio's side by `trio.lowlevel.TrioToken.run_sync_soon`, and never calls it outside of it.

The guest ends before the host does, whatever happens: only then its master has halted what moved (docs/asyncio.md).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

import trio


def run_beside(host: Callable[[asyncio.Future[Any]], Awaitable[None]], end: Callable[[], None]) -> Callable[..., Any]:
    """Return what runs trio as `trio.run` does, as the guest of asyncio, where `host` runs.

    host: is given the future that is done when the guest has ended; it returns when its user has ended it, or the guest ended.
    end: asks the guest to end, once the host has returned.
    """

    def run(main: Callable[..., Awaitable[Any]], *arguments: Any, clock: trio.abc.Clock | None = None) -> Any:
        async def beside() -> Any:
            loop = asyncio.get_running_loop()
            ended: asyncio.Future[Any] = loop.create_future()
            trio.lowlevel.start_guest_run(
                main,
                *arguments,
                clock=clock,
                run_sync_soon_threadsafe=loop.call_soon_threadsafe,
                run_sync_soon_not_threadsafe=loop.call_soon,
                done_callback=ended.set_result,
                host_uses_signal_set_wakeup_fd=True,
            )
            try:
                await host(ended)
            finally:
                end()
                while not ended.done():
                    with suppress(asyncio.CancelledError):  # the drives are halted first
                        await asyncio.wait((ended,))
            return ended.result().unwrap()

        return asyncio.run(beside())

    return run
