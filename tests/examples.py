"""How many examples a property gets."""

from __future__ import annotations

from hypothesis import settings

SAME = "same"
"""The profile of tests/conftest.py for every day: the same examples each time, and few of them."""


def examples(count: int, *, steps: int = 50) -> settings:
    """Settings for so many examples (of so many steps, where each is a run of a state machine).

    Under another profile, such as `search`, the number is that of the profile: nothing here keeps a search small.
    """
    if settings.get_current_profile_name() == SAME:
        return settings(max_examples=count, stateful_step_count=steps)
    return settings(stateful_step_count=steps)
