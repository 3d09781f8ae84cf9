"""Process data: the bits of a PDO (`mapping`), receiving and sending one (`consumer`, `producer`), a device's own PDOs
(`parameters`, by the `rules`), and multiplexed PDOs (`multiplexed`).

The PDOs of another node: `settings` says what one carries and when it is sent, `slots` reads and chooses them from the node's
file, `configure` has the procedures that bring the node to them and exchange them."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.pdo.configure import InvalidPdoError as InvalidPdoError
    from canopen_proto.pdo.configure import PdoRefusedError as PdoRefusedError
    from canopen_proto.pdo.configure import configure_pdo as configure_pdo
    from canopen_proto.pdo.configure import define_pdo as define_pdo
    from canopen_proto.pdo.configure import exchange_device_pdos as exchange_device_pdos
    from canopen_proto.pdo.configure import exchange_pdos as exchange_pdos
    from canopen_proto.pdo.configure import read_pdo as read_pdo
    from canopen_proto.pdo.consumer import PdoConsumer as PdoConsumer
    from canopen_proto.pdo.consumer import PdoLengthUnexpected as PdoLengthUnexpected
    from canopen_proto.pdo.consumer import PdoOverdue as PdoOverdue
    from canopen_proto.pdo.consumer import PdoReceived as PdoReceived
    from canopen_proto.pdo.consumer import PdoTooLate as PdoTooLate
    from canopen_proto.pdo.mapping import MappedEntry as MappedEntry
    from canopen_proto.pdo.mapping import Mapping as Mapping
    from canopen_proto.pdo.mapping import MappingError as MappingError
    from canopen_proto.pdo.multiplexed import MpdoConsumer as MpdoConsumer
    from canopen_proto.pdo.multiplexed import MpdoMode as MpdoMode
    from canopen_proto.pdo.multiplexed import MpdoNotProcessed as MpdoNotProcessed
    from canopen_proto.pdo.multiplexed import MpdoProducer as MpdoProducer
    from canopen_proto.pdo.multiplexed import MpdoReceived as MpdoReceived
    from canopen_proto.pdo.parameters import DevicePdos as DevicePdos
    from canopen_proto.pdo.producer import PdoNotSent as PdoNotSent
    from canopen_proto.pdo.producer import PdoPeriodsSkipped as PdoPeriodsSkipped
    from canopen_proto.pdo.producer import PdoProducer as PdoProducer
    from canopen_proto.pdo.settings import PdoSettings as PdoSettings
    from canopen_proto.pdo.settings import communication_index as communication_index
    from canopen_proto.pdo.settings import mapping_index as mapping_index
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
