"""A device declared in code: its objects, its PDOs, and what it does. See device.py."""

from canopen_proto.declared.device import DeclaredDevice, DeviceCodeFailed
from canopen_proto.declared.nameplate import Nameplate
from canopen_proto.declared.objects import array, variable
from canopen_proto.declared.pdos import Rpdo, Tpdo

__all__ = ["DeclaredDevice", "DeviceCodeFailed", "Nameplate", "Rpdo", "Tpdo", "array", "variable"]
