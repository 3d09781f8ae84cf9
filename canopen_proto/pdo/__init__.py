"""Process data: what a PDO's bits mean (`mapping`), receiving and sending one (`consumer`, `producer`), a device's own PDOs
(`parameters`) and how they are set up anew (`settings`)."""

from canopen_proto.pdo.consumer import PdoConsumer, PdoLengthError, PdoOverdue, PdoReceived
from canopen_proto.pdo.mapping import MappedEntry, Mapping, MappingError
from canopen_proto.pdo.parameters import DevicePdos
from canopen_proto.pdo.producer import PdoNotSent, PdoPeriodsSkipped, PdoProducer
from canopen_proto.pdo.settings import PdoSettings, RemapStep, communication_index, mapping_index, objects_to_read, remap_steps

__all__ = [
    "DevicePdos",
    "MappedEntry",
    "Mapping",
    "MappingError",
    "PdoConsumer",
    "PdoLengthError",
    "PdoNotSent",
    "PdoOverdue",
    "PdoPeriodsSkipped",
    "PdoProducer",
    "PdoReceived",
    "PdoSettings",
    "RemapStep",
    "communication_index",
    "mapping_index",
    "objects_to_read",
    "remap_steps",
]
