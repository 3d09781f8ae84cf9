"""A package's public names, each imported from its module at its first use (PEP 562).

So `from canopen_proto import Frame` loads frame.py and no drive, and `import canopen_proto.network` only what a network needs.

The table of the names is the package's plain imports under TYPE_CHECKING, which type checkers read. They never run, but the
interpreter has compiled them: the code of the package names each module, and behind it what is imported from there. Nothing is
named behind a module whose names are all imported (`*`): it is the front of a room below, with a table of its own.
That code is there in .py and .pyc files, in zip files and in frozen programs; a translation to C, as Nuitka's, has none, and has
to import each name from its module.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def lazy_names(namespace: dict[str, Any]) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package. namespace: its globals, whose `__all__` is found by `__getattr__`."""
    home_of: dict[str, str] = {}

    def homes() -> dict[str, str]:
        if not home_of:  # the code is fetched for the first name, not for `import canopen_proto.network`
            from importlib import import_module

            spec, module = namespace["__spec__"], ""
            loader = spec.loader
            if not hasattr(loader, "get_code"):  # pytest's, which rewrites the assertions of a package that has a plugin
                from importlib.machinery import SourceFileLoader

                loader = SourceFileLoader(spec.name, spec.origin)
            starred = ""  # a module, until one of its names comes
            for name in loader.get_code(spec.name).co_names:
                if "." in name and starred:
                    home_of.update(dict.fromkeys(import_module(starred).__all__, starred))
                if name == __name__:  # the imports under TYPE_CHECKING end here
                    break
                if "." in name:
                    module = starred = name
                elif module:
                    home_of[name], starred = module, ""
        return home_of

    def get(name: str) -> object:
        if name == "__all__":
            return [*homes()]
        if name not in homes():
            raise AttributeError(f"module {namespace['__name__']!r} has no attribute {name!r}")
        from importlib import import_module

        value: object = getattr(import_module(home_of[name]), name)
        namespace[name] = value  # found here from now on, without this function
        return value

    def names() -> list[str]:
        return sorted({*namespace, *homes()})

    return get, names
