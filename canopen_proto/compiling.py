"""Tell mypyc what it cannot see, at no cost for the interpreter; this file is not compiled itself (see docs/compiled.md).

`@mypyc_attr(allow_interpreted_subclasses=True)`: classes outside the compiled files may inherit from this one.
`@mypyc_attr(native_class=False)`: an ordinary Python class, as one with bases that no compiled class may have.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mypy_extensions import mypyc_attr as mypyc_attr  # mypyc knows the decorator by this name; mypy brings it along
else:

    def mypyc_attr(**attributes):
        """Return a class decorator that returns the class unchanged."""
        return lambda decorated: decorated
