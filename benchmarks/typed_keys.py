"""Typed keys (`canopen eds stubs`) against names: the same reads through whole nodes on both sides, in one run.

    python benchmarks/typed_keys.py

A ratio of 1.0 or more means that a typed key is not slower than the name of the object. No bus and no event loop is in between,
so the look-up of an object weighs more here than anywhere else.
"""

from __future__ import annotations

from measure import Case, measure
from read_by_name import OurNodes, our_dictionary

from canopen_proto.dictionary import ReadOnly, ReadWrite

KEYS = {"Statusword": ReadOnly[int](0x6041_00), "Software position limit:Min position limit": ReadWrite[int](0x607D_01)}
ROUNDS = 15
SECONDS = 0.2


def main() -> None:
    """Measure and print."""
    nodes = OurNodes(our_dictionary())
    look_up = nodes.remote.dictionary.variable
    for name, key in KEYS.items():

        def check(name: str = name, key: object = key) -> None:
            assert nodes.read(name, 2) == nodes.read(key, 2)  # type: ignore[arg-type]

        def looked_up(count: int, key: object) -> None:
            for _ in range(count):
                look_up(key)  # type: ignore[arg-type]

        reads = Case(f"read {name!r}", lambda n, k=key: nodes.read(k, n), lambda n, k=name: nodes.read(k, n), check)
        look_ups = Case("  its look-up alone", lambda n, k=key: looked_up(n, k), lambda n, k=name: looked_up(n, k), check)
        for case in (reads, look_ups):
            result = measure(case, ROUNDS, SECONDS)
            typed, named = min(result.ours) / 1000, min(result.theirs) / 1000
            ratios = f"ratio {result.ratio:.2f} (least {result.least_ratio:.2f})"
            print(f"{case.title}: typed {typed:.2f} us, by name {named:.2f} us, {ratios}")


if __name__ == "__main__":
    main()
