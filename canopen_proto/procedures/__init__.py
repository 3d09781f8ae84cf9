"""Procedures: sequences of requests over the machines, without I/O.

    steps.py     the steps of a procedure: upload, download, sleep, wait_for_event, all_of
    runner.py    `Runner`, which runs procedures; usually called through `Network.run`
    streams.py   read and write large objects piece by piece: firmware images, recordings
    objects.py   read and write a node's objects by name and value

Import from here what your own procedures need; import a procedure of the product from its room: pdo, lss,
manager, drives.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.procedures.objects import UnexpectedLengthError as UnexpectedLengthError
    from canopen_proto.procedures.objects import read as read
    from canopen_proto.procedures.objects import read_if_present as read_if_present
    from canopen_proto.procedures.objects import read_int as read_int
    from canopen_proto.procedures.objects import write as write
    from canopen_proto.procedures.runner import CleanUpTimeoutError as CleanUpTimeoutError
    from canopen_proto.procedures.runner import ProcedureCancelled as ProcedureCancelled
    from canopen_proto.procedures.runner import ProcedureFailed as ProcedureFailed
    from canopen_proto.procedures.runner import ProcedureFinished as ProcedureFinished
    from canopen_proto.procedures.runner import Runner as Runner
    from canopen_proto.procedures.steps import Cancelled as Cancelled
    from canopen_proto.procedures.steps import Procedure as Procedure
    from canopen_proto.procedures.steps import ProcedureError as ProcedureError
    from canopen_proto.procedures.steps import SdoTransferError as SdoTransferError
    from canopen_proto.procedures.steps import StepTimeoutError as StepTimeoutError
    from canopen_proto.procedures.steps import act as act
    from canopen_proto.procedures.steps import all_of as all_of
    from canopen_proto.procedures.steps import ask_for_time as ask_for_time
    from canopen_proto.procedures.steps import current_time as current_time
    from canopen_proto.procedures.steps import sleep as sleep
    from canopen_proto.procedures.steps import wait_for_event as wait_for_event
    from canopen_proto.procedures.streams import download_stream as download_stream
    from canopen_proto.procedures.streams import upload_stream as upload_stream
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
