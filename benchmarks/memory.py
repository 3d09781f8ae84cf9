"""Memory: what a node takes, and what an object of a device's file takes, of ours and of the peer's.

    python benchmarks/memory.py          # some seconds; run.py has the same table

- A node: a master's view of one of a hundred drives, with one TPDO of four objects. Ours share one dictionary, as nodes of one
  kind do; the peer's have one each, which holds their PDO parameters.
- An object: the dictionary that is read from the generated EDS of eds_import.py, divided by the objects in it (a record or an
  array is one). The text itself does not count.

tracemalloc counts what Python's allocator hands out. Memory of the C library is not counted, neither is what the import took.
"""

from __future__ import annotations

import gc
import logging
import tracemalloc
from collections.abc import Callable

import eds_import
import many_nodes
from direct import VERSION
from measure import said

NODES = 100


def taken(make: Callable[[], object]) -> int:
    """Return the bytes that a thing keeps, once it is made."""
    make()  # what is made once for all, such as tables, stays out
    gc.collect()
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        thing = make()
        gc.collect()
        after, _ = tracemalloc.get_traced_memory()
        del thing
        return after - before
    finally:
        tracemalloc.stop()


def of_a_node(make: Callable[[int], object]) -> float:
    """Return the KiB of one node: what each of NODES - 1 more takes."""
    return (taken(lambda: make(NODES)) - taken(lambda: make(1))) / (NODES - 1) / 1024


def of_an_object(read: Callable[[str], object]) -> float:
    """Return the bytes of one object of a file."""
    text = eds_import.generated()
    return taken(lambda: read(text)) / eds_import.OBJECTS


def _row(title: str, unit: str, ours: Callable[[], float], theirs: Callable[[], float]) -> str:
    try:
        mine, peers = ours(), theirs()
    except Exception as error:  # noqa: BLE001 - the other rows go on
        return f"| {title} | {said(error)} | | |"
    return f"| {title} | {mine:.3g} {unit} | {peers:.3g} {unit} | **{peers / mine:.1f}** |"


def table() -> str:
    """Return the table as Markdown."""
    logging.getLogger("canopen").setLevel(logging.ERROR)
    return "\n".join([
        f"| memory | canopen-proto | canopen {VERSION} | ratio |",
        "|---|---:|---:|---:|",
        _row(
            "a node with a TPDO (RemoteNode)", "KiB",
            lambda: of_a_node(many_nodes.ours), lambda: of_a_node(many_nodes.theirs),
        ),
        _row(
            f"an object of an EDS, of {eds_import.OBJECTS}", "bytes",
            lambda: of_an_object(lambda text: eds_import.read_eds(text.encode()).dictionary),
            lambda: of_an_object(eds_import.their_dictionary),
        ),
    ])  # fmt: skip


if __name__ == "__main__":
    print(table())
