"""A package's public names, each imported from its module at its first use (PEP 562).

So `from canopen_proto import Frame` loads frame.py and no drive, and `import canopen_proto.network` only what a network needs.
Type checkers see plain imports under TYPE_CHECKING; a test compares the two lists.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping


def lazy_names(
    namespace: dict[str, object], homes: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package. namespace: its globals. homes: module -> its names."""
    home_of = {name: module for module, names in homes.items() for name in names.split()}

    def get(name: str) -> object:
        if name not in home_of:
            raise AttributeError(f"module {namespace['__name__']!r} has no attribute {name!r}")
        from importlib import import_module

        value: object = getattr(import_module(home_of[name]), name)
        namespace[name] = value  # found here from now on, without this function
        return value

    def names() -> list[str]:
        return sorted({*namespace, *home_of})

    return get, names, [*home_of]
