"""`beside`: tasks that serve a block while it runs, and end with it: a bar that is drawn, events that are told."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any, Protocol, TypeVar


class _HasScope(Protocol):
    """A nursery, of trio or of a `Loop`."""

    @property
    def cancel_scope(self) -> Any: ...


N = TypeVar("N", bound=_HasScope)


@asynccontextmanager
async def beside(nursery: AbstractAsyncContextManager[N]) -> AsyncIterator[N]:
    """Run tasks beside the block, and cancel them at its end, however it ends. nursery: a new one, for these tasks.

    An exception of the block comes out as it is, with its cause: the nursery would put it into a group. So do a Ctrl-C and
    SystemExit, whose status is that of the program. One of a task cancels the block, and comes out in a group, as from a nursery.
    """
    failure: BaseException | None = None
    async with nursery as tasks:
        try:
            yield tasks
        except (Exception, SystemExit, KeyboardInterrupt) as error:  # noqa: BLE001 - raised below, outside of the nursery
            failure = error
        tasks.cancel_scope.cancel()
    if failure is not None:
        raise failure
