"""The file of a device that is declared in code (`canopen_proto.declared`): its description, for `write_eds` and `write_xdd`."""

from __future__ import annotations

from dataclasses import replace

from canopen_data.describing import EDS_VERSION, describe
from canopen_data.description import DeviceDescription, DeviceInfo, FileInfo, FileKind
from canopen_proto.declared import DeclaredDevice

__all__ = ["describe_device"]


def describe_device(device: type[DeclaredDevice], file_info: FileInfo | None = None) -> DeviceDescription:
    """Return the description of a device. file_info: of the new file (name, author, date: the core has no clock)."""
    plate = device.nameplate
    info = DeviceInfo(
        vendor_name=plate.vendor_name,
        product_name=plate.product_name,
        order_code=plate.order_code,
        bit_rates=plate.bit_rates,
        simple_boot_up_slave=True,
        lss_supported=True,
    )
    file_info = file_info or FileInfo(file_version=1, eds_version=EDS_VERSION, description=plate.description)
    return replace(describe(device.dictionary, device_info=info, file_info=file_info), kind=FileKind.EDS)
