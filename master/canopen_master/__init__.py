"""A CANopen master for trio: several buses, chains of CiA 402 drives, SYNC cycles, supervision; when left, it halts what moves.

    async with open_master("socketcan:can0") as master:
        arm = master.load_chains("single_device.csv")["chain1"]
        await arm.initialise()
        await arm.home()

For scripts, notebooks and threads there is `canopen_master.blocking`, the same in plain calls; `canopen_master.direct` is the
manual's blocking API.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_master.claims.channel_claim import ChannelTakenError as ChannelTakenError
    from canopen_master.commissioning import DriveCommissioning as DriveCommissioning
    from canopen_master.commissioning import commissioned_machine as commissioned_machine
    from canopen_master.commissioning import commissioned_name as commissioned_name
    from canopen_master.errors import BusError as BusError
    from canopen_master.errors import CallTimeoutError as CallTimeoutError
    from canopen_master.errors import ChainError as ChainError
    from canopen_master.errors import ChainFaultError as ChainFaultError
    from canopen_master.errors import ChainFileError as ChainFileError
    from canopen_master.errors import ChainHaltedError as ChainHaltedError
    from canopen_master.errors import DemonstrationRefusedError as DemonstrationRefusedError
    from canopen_master.errors import DeviceRefusedError as DeviceRefusedError
    from canopen_master.errors import HaltNotConfirmedError as HaltNotConfirmedError
    from canopen_master.errors import MasterClosedError as MasterClosedError
    from canopen_master.errors import MasterError as MasterError
    from canopen_master.errors import MotionReplacedError as MotionReplacedError
    from canopen_master.errors import NodeError as NodeError
    from canopen_master.errors import NodeIsNoDriveError as NodeIsNoDriveError
    from canopen_master.errors import NodeSilentError as NodeSilentError
    from canopen_master.errors import NoDriveInFileError as NoDriveInFileError
    from canopen_master.errors import PackageMissingError as PackageMissingError
    from canopen_master.errors import PathRefusedError as PathRefusedError
    from canopen_master.errors import PlanRefusedError as PlanRefusedError
    from canopen_master.errors import RealtimeRefusedError as RealtimeRefusedError
    from canopen_master.errors import SdoContestedError as SdoContestedError
    from canopen_master.errors import SdoError as SdoError
    from canopen_master.errors import SdoGivenUpError as SdoGivenUpError
    from canopen_master.errors import SdoNotConfirmedError as SdoNotConfirmedError
    from canopen_master.errors import SdoRefusedError as SdoRefusedError
    from canopen_master.errors import SdoTimeoutError as SdoTimeoutError
    from canopen_master.errors import SetPointRefusedError as SetPointRefusedError
    from canopen_master.errors import UnexpectedAnswerError as UnexpectedAnswerError
    from canopen_master.errors import UnknownChainError as UnknownChainError
    from canopen_master.master import Master as Master
    from canopen_master.motion.chain import Chain as Chain
    from canopen_master.motion.chain import ChainSettings as ChainSettings
    from canopen_master.motion.chain import ChainState as ChainState
    from canopen_master.motion.chain_file import ChainDescription as ChainDescription
    from canopen_master.motion.chain_file import JointDescription as JointDescription
    from canopen_master.motion.chain_file import parse_chains as parse_chains
    from canopen_master.motion.chain_file import read_chains as read_chains
    from canopen_master.motion.cycles import Cycle as Cycle
    from canopen_master.motion.cycles import Cycles as Cycles
    from canopen_master.motion.device import Device as Device
    from canopen_master.motion.moving import Progress as Progress
    from canopen_master.motion.moving import Together as Together
    from canopen_master.motion.moving import together as together
    from canopen_master.motion.record_files import RecordError as RecordError
    from canopen_master.motion.record_reader import MotionRecord as MotionRecord
    from canopen_master.motion.record_reader import read_record as read_record
    from canopen_master.motion.recording import Recorder as Recorder
    from canopen_master.motion.target_motion import Jog as Jog
    from canopen_master.motion.target_motion import Targets as Targets
    from canopen_master.network_booting import boot_network as boot_network
    from canopen_master.node import Node as Node
    from canopen_master.node_pdos import PdoDiffers as PdoDiffers
    from canopen_master.participant.bus import BusChanged as BusChanged
    from canopen_master.participant.bus import FramesLost as FramesLost
    from canopen_master.participant.bus import FramesNotSent as FramesNotSent
    from canopen_master.participant.dispatch import ProcedureTakenBackError as ProcedureTakenBackError
    from canopen_master.participant.patient_clock import PatientClock as PatientClock
    from canopen_master.participant.subscription import Subscription as Subscription
    from canopen_master.session import MasterSession as MasterSession
    from canopen_master.session import open_master as open_master
    from canopen_master.simulation.host import DeviceModel as DeviceModel
    from canopen_master.simulation.host import Host as Host
    from canopen_master.simulation.host import powerballs as powerballs
    from canopen_master.simulation.host import simulate as simulate
    from canopen_master.simulation.host import standard_drives as standard_drives
    from canopen_master.trajectories.point_to_point import point_to_point as point_to_point
    from canopen_master.trajectories.target_stream import TargetStream as TargetStream
    from canopen_master.trajectories.through_points import through_points as through_points
    from canopen_master.watchdog import NodeIdTakenError as NodeIdTakenError
    from canopen_master.watchdog import NotHeld as NotHeld
    from canopen_proto.drives.axis.axis import SCHUNK_POWERBALL as SCHUNK_POWERBALL
    from canopen_proto.drives.axis.axis import AxisSettings as AxisSettings
    from canopen_proto.drives.axis.axis import HomingStyle as HomingStyle
    from canopen_proto.drives.axis.watchdog import Watchdog as Watchdog
    from canopen_transports.realtime import Realtime as Realtime
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
