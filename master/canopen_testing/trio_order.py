"""What a world needs of trio's scheduler. `seed_order`: the order of tasks, drawn with a seed; `waits_for_idle`.

trio shuffles the tasks that are ready, by a generator of its own, so that nobody relies on an order. It has no public way to seed
it. Hypothesis uses what is used here, by the entry point that trio has for it (`trio._core._run._hypothesis_plugin_setup`).
"""

from __future__ import annotations

from collections.abc import Callable

from trio._core import _run


def seed_order(seed: int) -> Callable[[], None]:
    """Let trio choose the order of its tasks by this seed. Returns the function that gives trio its own order back. Raises
    RuntimeError for a version of trio with another scheduler."""
    generator = getattr(_run, "_r", None)
    if generator is None or not hasattr(_run, "_ALLOW_DETERMINISTIC_SCHEDULING"):
        raise RuntimeError("this version of trio has another scheduler, whose order no seed decides: use trio 0.33 to 0.35")
    state, before = generator.getstate(), _run._ALLOW_DETERMINISTIC_SCHEDULING
    generator.seed(seed)
    _run._ALLOW_DETERMINISTIC_SCHEDULING = True  # type: ignore[misc]

    def give_back() -> None:
        generator.setstate(state)
        _run._ALLOW_DETERMINISTIC_SCHEDULING = before  # type: ignore[misc]

    return give_back


def waits_for_idle() -> bool:
    """Whether a task waits for all others to be blocked (`trio.testing.wait_all_tasks_blocked`). True where trio does not say."""
    runner = getattr(_run.GLOBAL_RUN_CONTEXT, "runner", None)
    return bool(getattr(runner, "waiting_for_idle", True))
