"""How the tests are shared out to the workers of pytest-xdist: a file at a time, those that take longest first.

By itself it takes those with most tests first. So the last ones, with one long test, run while other workers have nothing left.
"""

from __future__ import annotations

from itertools import islice
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

WAITING = (
    "gateway/test_assistant.py",
    "gateway/test_fleet.py",
    "gateway/test_fleet_web.py",
    "gateway/test_mqtt.py",
    "cli/test_tui.py",
    "master/test_blocking_threads.py",
    "master/test_blocking.py",
    "master/test_direct_motion.py",
    "cli/test_live_screens.py",
    "master/test_direct_master.py",
    "gateway/test_serve_zenoh.py",
    "cli/test_key_demos.py",
    "master/test_direct_hold_to_run.py",
    "cli/test_problem.py",
    "testing/test_sample_project.py",
    "interop/test_from_canopen.py",
    "master/test_direct_script.py",
    "master/test_blocking_script.py",
    "master/test_left_loops.py",
    "cli/test_demos.py",
    "test_start_script_page.py",
    "gateway/test_fleet_twins.py",
    "master/test_direct.py",
    "test_blocking_page.py",
    "interop/test_wireshark_captures.py",
    "master/test_direct_stalls.py",
    "cli/test_live_terminal.py",
    "cli/test_screen.py",
    "test_platforms.py",
    "testing/test_programs.py",
    "gateway/test_fleet_access.py",
    "gateway/test_serve_web.py",
    "cli/test_start.py",
    "cli/test_scripting.py",
    "test_readme.py",
)
"""Files that mostly wait for processes, terminals, sockets and clocks; the longest first."""
FEW_BUT_LONG = (
    "master/test_twelve_joints.py",
    "cli/test_move.py",
    "ros/test_controllers.py",
    "master/test_stalls.py",
    "master/test_recovery.py",
    "cli/test_plot_file.py",
    "cli/test_drive_commission.py",
    "drives/test_homed_means_homed.py",
    "testing/test_state_machines.py",
    "test_house.py",
    "test_words.py",
    "master/test_path_motion.py",
    "ros/test_interrupted.py",
    "cli/test_page_commands.py",
    "master/test_bus_room.py",
    "cli/test_jog.py",
    "cli/test_stop.py",
    "simulation/test_drive_stateful.py",
    "master/test_motion_limits.py",
    "observer/test_observer_midlife.py",
    "master/test_one_process.py",
    "core/test_soak.py",
    "master/test_way_out.py",
    "test_arm_page.py",
    "testing/test_smallest_examples.py",
)
"""Files that compute for seconds and have few tests."""


class LongestFirst(LoadFileScheduling):  # type: ignore[misc] # it has no types of its own
    """Give each worker whole files, as they were ordered, and forget those that are over: the base class looks at all of a
    worker's files behind each of its tests."""

    def __init__(self, config: pytest.Config, log: Any = None) -> None:
        super().__init__(config, log)
        config.option.loadscopereorder = False
        self.places: dict[str, int] = {}

    def _assign_work_unit(self, node: Any) -> None:
        if not self.places:
            self.places = {nodeid: place for place, nodeid in enumerate(self.collection)}
        scope, tests = self.workqueue.popitem(last=False)
        left = {name: each for name, each in self.assigned_work.get(node, {}).items() if not all(each.values())}
        self.assigned_work[node] = {**left, scope: tests}
        node.send_runtest_some([self.places[nodeid] for nodeid, is_over in tests.items() if not is_over])


def longest_first(items: list[pytest.Item]) -> list[pytest.Item]:
    """Order files by how long they take; the tests of each stay as they are.

    A file that waits is followed by two that compute: so some workers wait while others compute, and no processor rests.
    A file that is not named above, or that is named and gone, costs nothing but time.
    """
    files: dict[str, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.nodeid.partition("::")[0].removeprefix("tests/"), []).append(item)
    waiting = [file for file in WAITING if file in files]
    others = sorted(files.keys() - {*waiting}, key=lambda file: (-len(files[file]), file))
    computing = iter(sorted(others, key=lambda file: file not in FEW_BUT_LONG))
    order = [each for file in waiting for each in (file, *islice(computing, 2))]
    return [item for file in (*order, *computing) for item in files[file]]
