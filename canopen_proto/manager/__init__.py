"""The NMT master's work on a network, by CiA 302: boot-up, PDO linking, programs, parameters.

scan.py        find the nodes of a bus
boot/          boot nodes, start the network, supervise it (CiA 302-2)
linking/       PDOs for "this object feeds that one"
programs/      read and write the programs of a device (CiA 302-3)
parameters/    read all values of a node (backup), write them back (restore)
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.manager.boot.comparison import compare_node as compare_node
    from canopen_proto.manager.boot.entry import BootEntry as BootEntry
    from canopen_proto.manager.boot.entry import entries_of as entries_of
    from canopen_proto.manager.boot.network_boot import BootReport as BootReport
    from canopen_proto.manager.boot.network_boot import NetworkBoot as NetworkBoot
    from canopen_proto.manager.boot.network_boot import NetworkStarted as NetworkStarted
    from canopen_proto.manager.boot.network_boot import NodeLost as NodeLost
    from canopen_proto.manager.boot.network_boot import NodeSupervised as NodeSupervised
    from canopen_proto.manager.boot.node_boot import BootTimes as BootTimes
    from canopen_proto.manager.boot.node_boot import boot_node as boot_node
    from canopen_proto.manager.boot.outcome import BootEnded as BootEnded
    from canopen_proto.manager.boot.outcome import BootLetter as BootLetter
    from canopen_proto.manager.boot.outcome import BootOutcome as BootOutcome
    from canopen_proto.manager.linking.model import End as End
    from canopen_proto.manager.linking.model import KnownNode as KnownNode
    from canopen_proto.manager.linking.model import Link as Link
    from canopen_proto.manager.linking.model import LinkError as LinkError
    from canopen_proto.manager.linking.model import LinkPlan as LinkPlan
    from canopen_proto.manager.linking.model import LinkProblem as LinkProblem
    from canopen_proto.manager.linking.plan import plan_links as plan_links
    from canopen_proto.manager.parameters.backup import Backup as Backup
    from canopen_proto.manager.parameters.backup import ObjectRead as ObjectRead
    from canopen_proto.manager.parameters.backup import Reading as Reading
    from canopen_proto.manager.parameters.backup import ReadResult as ReadResult
    from canopen_proto.manager.parameters.backup import back_up as back_up
    from canopen_proto.manager.parameters.restore import ObjectRestored as ObjectRestored
    from canopen_proto.manager.parameters.restore import Restoration as Restoration
    from canopen_proto.manager.parameters.restore import RestoreError as RestoreError
    from canopen_proto.manager.parameters.restore import RestorePlan as RestorePlan
    from canopen_proto.manager.parameters.restore import VerifyMismatchError as VerifyMismatchError
    from canopen_proto.manager.parameters.restore import plan_restore as plan_restore
    from canopen_proto.manager.parameters.restore import restore as restore
    from canopen_proto.manager.parameters.walk import WalkProgress as WalkProgress
    from canopen_proto.manager.parameters.walk import walk as walk
    from canopen_proto.manager.programs.download import DownloadLimits as DownloadLimits
    from canopen_proto.manager.programs.download import ProgramDownload as ProgramDownload
    from canopen_proto.manager.programs.download import ProgramDownloadError as ProgramDownloadError
    from canopen_proto.manager.programs.download import ProgramProgress as ProgramProgress
    from canopen_proto.manager.programs.download import ProgramStep as ProgramStep
    from canopen_proto.manager.programs.download import download_program as download_program
    from canopen_proto.manager.programs.objects import NotReachedError as NotReachedError
    from canopen_proto.manager.scan import NodeFound as NodeFound
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
