"""Simulated devices on a bus, for demonstrations and tests without hardware.

host.py              `simulate`, `Host`, `DeviceModel`: devices on a bus, driven by the same pump as a master
serving.py             several simulated drives for as long as a block runs
plant.py             plant files: the devices of a bus in TOML
hooks.py             scripts that animate a device
parameter_keeper.py  what devices store by 0x1010 and LSS, in memory or in a file
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_master.simulation.device_files import models_of as models_of
    from canopen_master.simulation.hooks import ScriptError as ScriptError
    from canopen_master.simulation.host import DeviceModel as DeviceModel
    from canopen_master.simulation.host import Host as Host
    from canopen_master.simulation.host import powerballs as powerballs
    from canopen_master.simulation.host import simulate as simulate
    from canopen_master.simulation.host import standard_drives as standard_drives
    from canopen_master.simulation.parameter_keeper import ParameterKeeper as ParameterKeeper
    from canopen_master.simulation.parameter_keeper import StateFileError as StateFileError
    from canopen_master.simulation.plant import DeviceEntry as DeviceEntry
    from canopen_master.simulation.plant import PlantFile as PlantFile
    from canopen_master.simulation.plant import parse_plant as parse_plant
    from canopen_master.simulation.serving import SimulatedDevices as SimulatedDevices
    from canopen_master.simulation.serving import simulated_devices as simulated_devices
    from canopen_master.simulation.serving import simulated_drives as simulated_drives
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
