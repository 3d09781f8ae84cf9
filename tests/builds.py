"""Tests that hold for one build of the core only (docs/compiled.md)."""

from __future__ import annotations

import pytest

from canopen_proto import COMPILED

replaces_what_is_compiled = pytest.mark.skipif(
    COMPILED, reason="the compiled core: its constants and methods cannot be replaced by a test"
)
takes_any_type = pytest.mark.skipif(COMPILED, reason="the compiled core: an argument of a wrong type is a TypeError at the call")
loads_by_itself = pytest.mark.skipif(COMPILED, reason="the compiled core: all its modules are one library")
sees_inside = pytest.mark.skipif(COMPILED, reason="the compiled core: gc does not show what its objects hold")
