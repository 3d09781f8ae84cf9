"""The way back: what a node holds, as a DCF that `canopen restore` writes back."""

from __future__ import annotations

import datetime
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_data.describing import EDS_VERSION
from canopen_proto.manager.parameters.backup import Backup, ReadResult

if TYPE_CHECKING:
    from canopen_data.backup_file import BackupFile
    from canopen_data.description import DeviceDescription


def dcf_of(found: Backup, description: DeviceDescription | None, name: str, bit_rate: int | None, by: str) -> BackupFile:
    """Return what was read as a DCF, with what it could not hold as it was read.

    description: the one used for reading; None: the data files, or a walk. name: of the file. bit_rate: kbit/s, None: not known.
    by: who has made it.
    """
    from canopen_data.backup_file import backup_file
    from canopen_data.description import FileInfo

    old = FileInfo(file_version=1, eds_version=EDS_VERSION) if description is None else description.file_info
    now = datetime.datetime.now().astimezone()
    file_info = replace(
        old,
        file_name=name,
        last_eds=old.last_eds or old.file_name,
        modification_time=now.strftime("%I:%M%p"),
        modification_date=now.strftime("%m-%d-%Y"),
        modified_by=by,
    )
    return backup_file(found, description, file_info, bit_rate)


def bit_rate_for_dcf(bitrate: int | None) -> int | None:
    """Return a bit rate in kbit/s if a DCF can hold it, else None. bitrate: bit/s; None: not known."""
    from canopen_data.description import BIT_RATES

    return bitrate // 1000 if bitrate is not None and bitrate // 1000 in BIT_RATES else None


def counts_text(backup: Backup) -> str:
    """Return a text such as "112 objects read; 3 write-only, 1 refused"."""
    counts = backup.counts
    read = counts.pop(ReadResult.READ, 0)
    rest = ", ".join(f"{number} {RESULT_WORDS.get(result, str(result))}" for result, number in counts.items())
    return f"{read} object{'' if read == 1 else 's'} read" + (f"; {rest}" if rest else "")


RESULT_WORDS: Final = {
    ReadResult.KEPT_OUT: "kept out by ObjFlags",
    ReadResult.DOMAIN: "DOMAIN (not read without --domains)",
    ReadResult.ABSENT: "not in the device",
    ReadResult.NO_ANSWER: "without an answer",
    ReadResult.WRONG_LENGTH: "of a wrong length",
    ReadResult.CONTESTED: "disturbed by another SDO client",
}
