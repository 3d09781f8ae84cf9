"""The two records of a PDO, for code that builds a device: its communication parameter and its mapping.

Source: CiA 301 v4.2.0, 7.5.2.33 to 7.5.2.38.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from canopen_proto.datatypes import Value
from canopen_proto.dictionary.objects import Object, Variable
from canopen_proto.dictionary.standard import standard_object, standard_variable
from canopen_proto.multiplexer import mapping_entry

MAPPED_OBJECTS: Final = 8
"""Entries of a mapping record: as many as there are bytes in a frame. A PDO of single bits has more."""
_TO_MAPPING: Final = 0x200


def pdo_records(index: int, cob_id: int, fields: Mapping[int, Value | None], entries: Sequence[Variable]) -> list[Object]:
    """Return the communication record of a PDO and its mapping record.

    index: of the communication record, 0x1400 to 0x15FF or 0x1800 to 0x19FF. cob_id: the node-ID is added to it. fields: the
    defaults of the further subindices that the record has, from 2 on; None = that of the standard. entries: what it carries.
    """
    communication = standard_object(index, highest=2)
    variables = [standard_variable(index, 1, default=cob_id, adds_node_id=True)]
    variables += [
        standard_variable(index, subindex) if value is None else standard_variable(index, subindex, default=value)
        for subindex, value in fields.items()
    ]
    count = replace(communication.variables[0], default=max(fields))
    mapped: dict[int, Value] = {0: len(entries)}
    for place, variable in enumerate(entries, start=1):
        assert variable.bit_length is not None, variable.label
        mapped[place] = mapping_entry(variable.mux, variable.bit_length)
    return [
        Object.of(communication.name, [count, *variables], communication.object_type),
        standard_object(index + _TO_MAPPING, highest=max(MAPPED_OBJECTS, len(entries)), defaults=mapped),
    ]
