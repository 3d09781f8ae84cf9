"""The demonstration: the joints of a chain, simulated or real, boot, home and swing; `canopen demo` shows it.

task.py       `DemonstrationTask`: which chain moves, on which buses, with which drives and settings
run.py        `Demonstration`: one run of it, and the events by which it tells how far it is
swing.py      `SwingPath`: the path of the joints
recording.py  `Recording`: where the joints were, for a picture
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_master.demonstration.run import BootBegun as BootBegun
    from canopen_master.demonstration.run import CycleCounts as CycleCounts
    from canopen_master.demonstration.run import Demonstration as Demonstration
    from canopen_master.demonstration.run import HomingBegun as HomingBegun
    from canopen_master.demonstration.run import HomingDone as HomingDone
    from canopen_master.demonstration.run import JointResult as JointResult
    from canopen_master.demonstration.run import JointsEnabled as JointsEnabled
    from canopen_master.demonstration.run import MovesSoon as MovesSoon
    from canopen_master.demonstration.run import PlannedMoveBegun as PlannedMoveBegun
    from canopen_master.demonstration.run import PlannedMoveDone as PlannedMoveDone
    from canopen_master.demonstration.run import SwingCycle as SwingCycle
    from canopen_master.demonstration.run import SwingDone as SwingDone
    from canopen_master.demonstration.task import DemonstrationTask as DemonstrationTask
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
