"""Simulated devices beyond a plain `LocalNode`.

drive/           a CiA 402 drive: its states, modes and mechanics
boot_loader.py   a device whose program can be written over the bus (CiA 302-3)
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.simulation.boot_loader import BootDone as BootDone
    from canopen_proto.simulation.boot_loader import BootLoader as BootLoader
    from canopen_proto.simulation.boot_loader import BootLoaderSettings as BootLoaderSettings
    from canopen_proto.simulation.boot_loader import FlashDone as FlashDone
    from canopen_proto.simulation.boot_loader import ProgramErased as ProgramErased
    from canopen_proto.simulation.boot_loader import ProgramMemory as ProgramMemory
    from canopen_proto.simulation.boot_loader import ProgramStarted as ProgramStarted
    from canopen_proto.simulation.boot_loader import ProgramWritten as ProgramWritten
    from canopen_proto.simulation.boot_loader import boot_loader_dictionary as boot_loader_dictionary
    from canopen_proto.simulation.drive.answers import Answer as Answer
    from canopen_proto.simulation.drive.answers import AnswerDue as AnswerDue
    from canopen_proto.simulation.drive.dictionary import drive_dictionary as drive_dictionary
    from canopen_proto.simulation.drive.events import DriveFault as DriveFault
    from canopen_proto.simulation.drive.events import DriveFaultCleared as DriveFaultCleared
    from canopen_proto.simulation.drive.events import DriveStateChanged as DriveStateChanged
    from canopen_proto.simulation.drive.events import InputsChanged as InputsChanged
    from canopen_proto.simulation.drive.events import ModeChanged as ModeChanged
    from canopen_proto.simulation.drive.events import StatuswordChanged as StatuswordChanged
    from canopen_proto.simulation.drive.homing import HomingFinished as HomingFinished
    from canopen_proto.simulation.drive.interpolated_position import SetPointLost as SetPointLost
    from canopen_proto.simulation.drive.interpolated_position import SetPointUnderrun as SetPointUnderrun
    from canopen_proto.simulation.drive.node import DriveNode as DriveNode
    from canopen_proto.simulation.drive.node import powerball as powerball
    from canopen_proto.simulation.drive.plant import Mechanics as Mechanics
    from canopen_proto.simulation.drive.settings import DriveSettings as DriveSettings
    from canopen_proto.simulation.drive.settings import Shape as Shape
    from canopen_proto.simulation.drive.settings import Track as Track
    from canopen_proto.simulation.drive.synchronous_modes import SyncOverdue as SyncOverdue
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
