"""A CANopen master for trio: several buses, chains of CiA 402 drives, SYNC cycles, supervision; when left, it halts what moves.

    async with open_master("socketcan:can0") as master:
        arm = master.load_chains("single_device.csv")["chain1"]
        await arm.initialise()
        await arm.home()

For scripts without async there is `canopen_master.direct`, the manual's blocking API on top of this.
"""

from canopen_master.bus import BusChanged, FramesLost, FramesNotSent
from canopen_master.errors import (
    BusError,
    ChainError,
    ChainFault,
    ChainFileError,
    ChainHalted,
    HaltNotConfirmed,
    MasterClosed,
    MasterError,
    NodeError,
    NodeSilent,
    SdoError,
    SdoGivenUp,
    SdoNotConfirmed,
    SdoRefused,
    SdoTimeout,
    SetPointRefused,
    UnexpectedAnswer,
    UnknownChain,
)
from canopen_master.grip import NodeIdTaken, NotHeld
from canopen_master.master import Master
from canopen_master.motion.chain import Chain, ChainSettings, ChainState
from canopen_master.motion.chain_file import ChainDescription, JointDescription, parse_chains, read_chains
from canopen_master.motion.cycles import Cycle, Cycles
from canopen_master.motion.device import Device
from canopen_master.node import Node
from canopen_master.node_pdos import PdoDiffers
from canopen_master.session import MasterSession, open_master
from canopen_master.simulation import DeviceModel, Host, powerballs, simulate, standard_drives
from canopen_master.subscription import Subscription
from canopen_proto.drive.axis import SCHUNK_POWERBALL, AxisSettings, HomingStyle
from canopen_proto.procedures.grip import Grip

__all__ = [
    "SCHUNK_POWERBALL",
    "AxisSettings",
    "BusChanged",
    "BusError",
    "Chain",
    "ChainDescription",
    "ChainError",
    "ChainFault",
    "ChainFileError",
    "ChainHalted",
    "ChainSettings",
    "ChainState",
    "Cycle",
    "Cycles",
    "Device",
    "DeviceModel",
    "FramesLost",
    "FramesNotSent",
    "Grip",
    "HaltNotConfirmed",
    "HomingStyle",
    "Host",
    "JointDescription",
    "Master",
    "MasterClosed",
    "MasterError",
    "MasterSession",
    "Node",
    "NodeError",
    "NodeIdTaken",
    "NodeSilent",
    "NotHeld",
    "PdoDiffers",
    "SdoError",
    "SdoGivenUp",
    "SdoNotConfirmed",
    "SdoRefused",
    "SdoTimeout",
    "SetPointRefused",
    "Subscription",
    "UnexpectedAnswer",
    "UnknownChain",
    "open_master",
    "parse_chains",
    "powerballs",
    "read_chains",
    "simulate",
    "standard_drives",
]
