"""Layer setting services: give devices their node-ID and bit rate over the bus itself (CiA 305).

messages.py: the frames and tables that both roles share, and frames in words; slave.py: `LssSlave`, the device's side;
master.py: `LssMaster`. Sequences of many services are procedures: scan.py finds devices, by fastscan or by their addresses;
assign.py gives them node-IDs; bit_rate.py changes the bit rate of a bus.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.lss.assign import Given as Given
    from canopen_proto.lss.assign import LssAssignment as LssAssignment
    from canopen_proto.lss.assign import LssGiven as LssGiven
    from canopen_proto.lss.assign import LssNotSelectedError as LssNotSelectedError
    from canopen_proto.lss.assign import Planned as Planned
    from canopen_proto.lss.assign import assign_all as assign_all
    from canopen_proto.lss.assign import by_table as by_table
    from canopen_proto.lss.assign import give as give
    from canopen_proto.lss.assign import in_order as in_order
    from canopen_proto.lss.assign import select_only as select_only
    from canopen_proto.lss.master import LssAnswerUnexpected as LssAnswerUnexpected
    from canopen_proto.lss.master import LssMaster as LssMaster
    from canopen_proto.lss.master import LssReply as LssReply
    from canopen_proto.lss.messages import LssAddress as LssAddress
    from canopen_proto.lss.messages import LssConfiguration as LssConfiguration
    from canopen_proto.lss.messages import LssService as LssService
    from canopen_proto.lss.messages import LssState as LssState
    from canopen_proto.lss.scan import BootUpHeard as BootUpHeard
    from canopen_proto.lss.scan import LssError as LssError
    from canopen_proto.lss.scan import LssFound as LssFound
    from canopen_proto.lss.scan import LssProgress as LssProgress
    from canopen_proto.lss.scan import LssTimeoutError as LssTimeoutError
    from canopen_proto.lss.scan import LssTool as LssTool
    from canopen_proto.lss.scan import Pace as Pace
    from canopen_proto.lss.scan import Survey as Survey
    from canopen_proto.lss.scan import fastscan as fastscan
    from canopen_proto.lss.scan import survey as survey
    from canopen_proto.lss.slave import LssBitRateSwitched as LssBitRateSwitched
    from canopen_proto.lss.slave import LssNodeIdSet as LssNodeIdSet
    from canopen_proto.lss.slave import LssResetNeeded as LssResetNeeded
    from canopen_proto.lss.slave import LssSilenceBegan as LssSilenceBegan
    from canopen_proto.lss.slave import LssSilenceEnded as LssSilenceEnded
    from canopen_proto.lss.slave import LssSlave as LssSlave
    from canopen_proto.lss.slave import LssStoreRequested as LssStoreRequested
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
