"""The manual's blocking API, for scripts and notebooks: plain functions over one connection.

    from canopen_master import direct as canopen

    if not canopen.open_connection("/dev/pcan32"):
        raise SystemExit(canopen.last_error())
    canopen.init_listener_thread()
    canopen.fault_reset(12)
    canopen.init_nmt()
    if canopen.init_device(12) and canopen.homing(12) and canopen.enable_ip_mode(12):
        position = canopen.get_pos(12)
        for _ in range(500):
            position += 100
            canopen.send_pos(12, position)  # millidegrees
            canopen.send_sync(10)  # SYNC, then 10 ms
    canopen.enable_brake(12)
    canopen.shutdown_device(12)
    canopen.close_connection()

Functions that take time return True or False; `last_error()` says why. The others raise. However a script ends, its drives are
halted and the connection is closed. See `session` for details, and for `Session`, the same without globals.

With the master's thread: set `using_master_thread = True` in this module, `init_chain_map(file)`, open the connection as above,
then `init_master_thread()`; the chains in `chain_map` then take commands from any thread: `chain_map["chain1"].init()`.
"""

from canopen_master.direct.chain import ChainCalls
from canopen_master.direct.connection import AlreadyConnectedError, NotConnectedError
from canopen_master.direct.incoming import IncomingPdos
from canopen_master.direct.session import Session

using_master_thread: bool = False
"""Whether to use a master's thread: set it to True before `init_master_thread`, as in the manual."""


class _ModuleSession(Session):
    """The one session behind this module's functions."""

    def _uses_master_thread(self) -> bool:
        return using_master_thread or self.using_master_thread


_session = _ModuleSession()

chain_map = _session.chain_map
incoming_pdos = _session.incoming_pdos

open_connection = _session.open_connection
init_listener_thread = _session.init_listener_thread
close_connection = _session.close_connection
last_error = _session.last_error
simulated = _session.simulated

init_nmt = _session.init_nmt
send_nmt = _session.send_nmt
send_sync = _session.send_sync
send_sdo = _session.send_sdo
define_pdo = _session.define_pdo

fault_reset = _session.fault_reset
init_device = _session.init_device
homing = _session.homing
enable_ip_mode = _session.enable_ip_mode
send_pos = _session.send_pos
get_pos = _session.get_pos
move_until_user_interrupt = _session.move_until_user_interrupt
interactive_homing = _session.interactive_homing
drive_mode = _session.drive_mode
halt = _session.halt
enable_brake = _session.enable_brake
enable_break = _session.enable_break
release_brake = _session.release_brake
release_break = _session.release_break
shutdown_device = _session.shutdown_device
set_sync_interval = _session.set_sync_interval
set_max_speed = _session.set_max_speed
wait_for_status = _session.wait_for_status
set_motor_state = _session.set_motor_state

init_chain_map = _session.init_chain_map
init_incoming_pdo_processor_thread = _session.init_incoming_pdo_processor_thread
init_master_thread = _session.init_master_thread

__all__ = [
    "AlreadyConnectedError",
    "ChainCalls",
    "IncomingPdos",
    "NotConnectedError",
    "Session",
    "chain_map",
    "close_connection",
    "define_pdo",
    "drive_mode",
    "enable_brake",
    "enable_break",
    "enable_ip_mode",
    "fault_reset",
    "get_pos",
    "halt",
    "homing",
    "incoming_pdos",
    "init_chain_map",
    "init_device",
    "init_incoming_pdo_processor_thread",
    "init_listener_thread",
    "init_master_thread",
    "init_nmt",
    "interactive_homing",
    "last_error",
    "move_until_user_interrupt",
    "open_connection",
    "release_brake",
    "release_break",
    "send_nmt",
    "send_pos",
    "send_sdo",
    "send_sync",
    "set_max_speed",
    "set_motor_state",
    "set_sync_interval",
    "shutdown_device",
    "simulated",
    "using_master_thread",
    "wait_for_status",
]
