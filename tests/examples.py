"""How many examples a property gets."""

from __future__ import annotations

from hypothesis import settings

SAME = "same"
"""The profile of tests/conftest.py for every day: the same examples each time, and few of them."""
BRIEF = "brief"
"""The same with fewer examples, for a run that is measured and so takes three times as long."""
PART = 5
"""By this `brief` divides the number of examples, down to PART of them."""


def examples(count: int, *, steps: int = 50) -> settings:
    """Settings for so many examples (of so many steps, where each is a run of a state machine).

    Under another profile, such as `search`, the number is that of the profile: nothing here keeps a search small.
    """
    profile = settings.get_current_profile_name()
    if profile == BRIEF:
        count = min(count, max(count // PART, PART))
    if profile in (SAME, BRIEF):
        return settings(max_examples=count, stateful_step_count=steps)
    return settings(stateful_step_count=steps)
