"""Process data: the bits of a PDO (`mapping`), receiving and sending one (`consumer`, `producer`), a device's own PDOs
(`parameters`, by the `rules`), setting one up (`settings`), and multiplexed PDOs (`multiplexed`)."""

from canopen_proto.pdo.consumer import PdoConsumer, PdoLengthError, PdoOverdue, PdoReceived, PdoTooLate
from canopen_proto.pdo.mapping import MappedEntry, Mapping, MappingError
from canopen_proto.pdo.multiplexed import MpdoConsumer, MpdoMode, MpdoNotProcessed, MpdoProducer, MpdoReceived
from canopen_proto.pdo.parameters import DevicePdos
from canopen_proto.pdo.producer import PdoNotSent, PdoPeriodsSkipped, PdoProducer
from canopen_proto.pdo.settings import PdoSettings, RemapStep, communication_index, mapping_index, objects_to_read, remap_steps

__all__ = [
    "DevicePdos",
    "MappedEntry",
    "Mapping",
    "MappingError",
    "MpdoConsumer",
    "MpdoMode",
    "MpdoNotProcessed",
    "MpdoProducer",
    "MpdoReceived",
    "PdoConsumer",
    "PdoLengthError",
    "PdoNotSent",
    "PdoOverdue",
    "PdoPeriodsSkipped",
    "PdoProducer",
    "PdoReceived",
    "PdoSettings",
    "PdoTooLate",
    "RemapStep",
    "communication_index",
    "mapping_index",
    "objects_to_read",
    "remap_steps",
]
