"""For tests of devices and programs: a world in virtual time, faults as values, assertions that explain.

    world.py      `World`: buses, devices, masters, hosts; how time passes
    bus.py        `WorldBus`: how a frame goes from sender to receivers, past the faults
    faults.py     what goes wrong, and when
    patterns.py   which frames are meant
    seen.py       `bus.saw(...)`, `bus.never(...)`; judge.py: `bus.observer.clean()`

`__tracebackhide__` keeps the inside of an assertion out of pytest's reports.

Files of devices, bit timing, programs in trio and asyncio, and the pytest fixtures are in the package canopen_testing.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.testing.bus import WorldBus as WorldBus
    from canopen_proto.testing.faults import BusOff as BusOff
    from canopen_proto.testing.faults import Copy as Copy
    from canopen_proto.testing.faults import Corrupt as Corrupt
    from canopen_proto.testing.faults import Delay as Delay
    from canopen_proto.testing.faults import Fault as Fault
    from canopen_proto.testing.faults import Lie as Lie
    from canopen_proto.testing.faults import Lose as Lose
    from canopen_proto.testing.faults import Pause as Pause
    from canopen_proto.testing.faults import Refuse as Refuse
    from canopen_proto.testing.faults import Reorder as Reorder
    from canopen_proto.testing.faults import Replace as Replace
    from canopen_proto.testing.faults import Reset as Reset
    from canopen_proto.testing.faults import SecondMaster as SecondMaster
    from canopen_proto.testing.master import WorldMaster as WorldMaster
    from canopen_proto.testing.member import WorldMember as WorldMember
    from canopen_proto.testing.patterns import Pattern as Pattern
    from canopen_proto.testing.patterns import any_frame as any_frame
    from canopen_proto.testing.patterns import boot_up as boot_up
    from canopen_proto.testing.patterns import can_frame as can_frame
    from canopen_proto.testing.patterns import emcy as emcy
    from canopen_proto.testing.patterns import heartbeat as heartbeat
    from canopen_proto.testing.patterns import nmt as nmt
    from canopen_proto.testing.patterns import rpdo as rpdo
    from canopen_proto.testing.patterns import sdo_abort as sdo_abort
    from canopen_proto.testing.patterns import sdo_answer as sdo_answer
    from canopen_proto.testing.patterns import sdo_read as sdo_read
    from canopen_proto.testing.patterns import sdo_request as sdo_request
    from canopen_proto.testing.patterns import sdo_write as sdo_write
    from canopen_proto.testing.patterns import sync as sync
    from canopen_proto.testing.patterns import tpdo as tpdo
    from canopen_proto.testing.world import DidNotHappenError as DidNotHappenError
    from canopen_proto.testing.world import World as World
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
