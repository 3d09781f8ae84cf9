"""A device declared in code: its objects, its PDOs, and what it does. See device.py."""

from canopen_proto.declared.device import DeclaredDevice as DeclaredDevice
from canopen_proto.declared.device import DeviceCodeFailed as DeviceCodeFailed
from canopen_proto.declared.nameplate import Nameplate as Nameplate
from canopen_proto.declared.objects import array as array
from canopen_proto.declared.objects import variable as variable
from canopen_proto.declared.pdos import Rpdo as Rpdo
from canopen_proto.declared.pdos import Tpdo as Tpdo
