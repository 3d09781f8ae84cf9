"""Skeleton: a CANopen device.

canopen sim skeleton.py --id 5 -b udp_multicast      serves it
canopen device describe skeleton.py -o skeleton.eds  writes its file
canopen check 5 -e skeleton.eds -b udp_multicast     compares the one with the other
"""

from canopen_proto import MILLISECOND, AbortCode, DataType
from canopen_proto.declared import DeclaredDevice, Nameplate, Rpdo, Tpdo, array, variable
from canopen_proto.dictionary import Access


class Skeleton(DeclaredDevice):
    """Copies its outputs to its inputs."""

    nameplate = Nameplate("Skeleton", vendor_name="My company", vendor_id=0, product_code=1, revision=0x0001_0000)
    period = 10 * MILLISECOND

    inputs = array(0x2000, "Input", DataType.UNSIGNED8, 2, access=Access.RO, pdo=True)
    outputs = array(0x2001, "Output", DataType.UNSIGNED8, 2, access=Access.RWW)
    filter_time = variable(0x2002, "Filter time", DataType.UNSIGNED16, 10, high_limit=1000, unit="ms")

    pdos = (Rpdo(1, outputs), Tpdo(1, inputs))

    def step(self) -> None:
        """Every `period`: read the inputs. A value that changes is sent."""
        self.inputs[1] = self.outputs[1]

    def stop(self, error_code: int) -> None:
        """The connection is lost: bring the outputs to their safe state."""
        for subindex in (1, 2):
            self.outputs[subindex] = 0

    @outputs.on_write
    def switch(self, subindex: int, value: int) -> None:
        """A master has written an output, by PDO or SDO."""

    @filter_time.check
    def check_filter_time(self, value: int) -> AbortCode | None:
        """A master writes the filter time: refuse what the device cannot do."""
        return AbortCode.INVALID_VALUE if value % 2 else None
