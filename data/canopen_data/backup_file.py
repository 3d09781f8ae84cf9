"""A backup as a DCF.

The file holds exactly what was read. An object without a value in the backup has none in the file, even if the description (an
old backup, say) configures one. Its section says why (`_NotRead`, see `Variable.not_read`).

The finished file is checked: its bytes are read as `restore` will read them, and each value is compared with the bytes that the
device sent. Values that differ are in `BackupFile.lost`. This happens with bytes that are no value of the object's type (a
BOOLEAN of 0xFF, a REAL32 that is a signalling NaN), and with files larger than the reader accepts.

If another SDO client used the device's channel meanwhile, the file says so at the beginning of its Description ([FileInfo]):
`disturbance_of` returns what.

Source: CiA 306-1 v1.4.0, 5 (device configuration file).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

from canopen_data.configured import with_configured
from canopen_data.describing import describe
from canopen_data.description import Commissioning, DeviceDescription, FileInfo, FileKind
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer import encode_eds, write_eds
from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary.download_order import settings_of
from canopen_proto.dictionary.model import Object, ObjectDictionary, Variable
from canopen_proto.manager.parameters.backup import Backup, Reading, ReadResult
from canopen_proto.multiplexer import Mux, split_mux

__all__ = ["BackupFile", "backup_file"]

MAX_DESCRIPTION: Final = 243
"""Characters; CiA 306-1."""
_DISTURBED: Final = "DISTURBED: another SDO client "
_END: Final = " during this backup"


@dataclass(frozen=True, slots=True)
class BackupFile:
    """A DCF made of a backup. data: its bytes. lost: readings that the file holds as another value, or not at all."""

    data: bytes
    lost: tuple[Reading, ...]


def backup_file(
    backup: Backup, description: DeviceDescription | None, file_info: FileInfo | None = None, bit_rate: int | None = None
) -> BackupFile:
    """Make a DCF of a backup.

    description: from the device's own file; None if there is none: the objects are then those that the device answered for.
    file_info: for the new file; None: that of the description. bit_rate: kbit/s, if it is known.
    """
    whole = describe(_shown(backup)) if description is None else description
    commissioning = whole.commissioning or Commissioning()
    if commissioning.node_id != backup.node_id:
        commissioning = Commissioning(node_id=backup.node_id)
    if bit_rate is not None:
        commissioning = replace(commissioning, bit_rate=bit_rate)
    bare = replace(whole, dictionary=_without_others(whole.dictionary, backup))
    info = file_info or whole.file_info
    before = info.description.partition(_END)[2].strip() if disturbance_of(info) else info.description  # of an older backup
    said = f"{_DISTURBED}{backup.others_doing}{_END} {before}".strip() if backup.others_doing else before
    info = replace(info, description=said[:MAX_DESCRIPTION])
    configured = with_configured(bare, backup.values, commissioning, file_info=info)
    text = write_eds(configured, FileKind.DCF)
    file = _encoded(backup, text, whole.encoding)
    return _encoded(backup, text, "utf-8") if file.lost else file  # a reader may not be able to guess the description's encoding


def disturbance_of(info: FileInfo) -> str:
    """Return what another SDO client did while a backup was made, as its DCF says; "" if it says nothing of that."""
    found = info.description.startswith(_DISTURBED) and _END in info.description
    return info.description.removeprefix(_DISTURBED).partition(_END)[0] if found else ""


def _encoded(backup: Backup, text: str, encoding: str) -> BackupFile:
    data = encode_eds(text, encoding)
    return BackupFile(data, _lost(backup, data))


def _shown(backup: Backup) -> ObjectDictionary:
    """Return the objects that the device has shown to exist: the data files describe more than one device has."""
    by_index: dict[int, dict[int, Variable]] = {}
    for each in backup.readings:
        if each.data is not None or each.result.is_missing:
            by_index.setdefault(each.variable.index, {})[each.variable.subindex] = each.variable
    objects = backup.dictionary.objects
    return ObjectDictionary(replace(objects[index], variables=variables) for index, variables in by_index.items())


def _without_others(dictionary: ObjectDictionary, backup: Backup) -> ObjectDictionary:
    """Return the dictionary without the configured values that the backup lacks, with the reason for each."""
    results = {each.variable.mux: each.result for each in backup.readings}

    def renewed(each: Object) -> Object:
        variables = {
            variable.subindex: replace(
                variable, configured=None, configured_adds_node_id=False, not_read=str(results.get(variable.mux, "not asked for"))
            )
            if results.get(variable.mux) is not ReadResult.READ
            else variable
            for variable in each.variables.values()
        }
        return replace(each, variables=MappingProxyType(variables))

    return dictionary.with_objects(map(renewed, dictionary.objects.values()))


def _lost(backup: Backup, data: bytes) -> tuple[Reading, ...]:
    dictionary = read_eds(data).dictionary
    held = settings_of(dictionary, backup.node_id)
    read = (each for each in backup.readings if each.result is ReadResult.READ)
    return tuple(each for each in read if _bytes_in(dictionary, held, each.variable.mux) != each.data)


def _bytes_in(dictionary: ObjectDictionary, held: Mapping[Mux, Value], key: Mux) -> bytes | None:
    try:
        return dictionary.variable(split_mux(key)).encode(held[key]) if key in held else None
    except ValueRangeError:
        return None
