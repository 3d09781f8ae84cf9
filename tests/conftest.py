"""For all tests: hypothesis takes the same examples each time, so that a run tells about the change and not about luck.

To search further: `pytest --hypothesis-profile=search --timeout=0 tests/proto/test_group.py`. The number of examples is then
that of the profile, in every test (tests/examples.py).
"""

from __future__ import annotations

import gc
import signal

import hypothesis

# On a build server hypothesis takes its own profile `ci` for the parent of what is registered, and that one never looks further
everyday = hypothesis.settings.get_profile("default")
hypothesis.settings.register_profile("same", everyday, derandomize=True, database=None, deadline=None)
hypothesis.settings.register_profile("search", everyday, max_examples=2000, deadline=None, print_blob=True)
hypothesis.settings.load_profile("same")


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # so a shell starts what it runs in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """What thousands of collected tests hold stays to the end: the garbage collector need not look at it again and again."""
    gc.collect()
    gc.freeze()
