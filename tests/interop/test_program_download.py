"""Our boot loader under the steps of Zephyr's tool, by the SDO client of canopen 2.4.1, which that tool uses."""

from __future__ import annotations

from binascii import crc32
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import canopen
import pytest

from canopen_proto.machine import MILLISECOND
from canopen_proto.manager.programs.identity import ProgramControl
from canopen_proto.simulation.boot_loader import BootLoader, BootLoaderSettings
from tests.core.block_pair import pattern
from tests.interop.device_rig import NODE, Rig
from tests.interop.driver import Driver
from tests.interop.peer import new_channel, peer_network

DATA, CONTROL, IDENTIFICATION, STATUS = 0x1F50, 0x1F51, 0x1F56, 0x1F57
IMAGE = pattern(1000)


@pytest.fixture
def rig_of() -> Iterator[Callable[[BootLoaderSettings], Rig]]:
    with ExitStack() as stack:

        def make(settings: BootLoaderSettings) -> Rig:
            channel = new_channel()
            driver = Driver(channel)
            peer = stack.enter_context(peer_network(channel))
            stack.enter_context(driver)
            return Rig(driver, peer, lambda out: BootLoader(out, NODE, settings), canopen.RemoteNode)

        yield make


@pytest.mark.parametrize("block", [False, True])
def test_the_steps_of_zephyrs_tool(rig_of: Callable[[BootLoaderSettings], Rig], block: bool) -> None:
    settings = BootLoaderSettings(
        trial=True, erase_time=20 * MILLISECOND, program_time=20 * MILLISECOND, boot_time=10 * MILLISECOND
    )
    rig = rig_of(settings)
    sdo = rig.remote.sdo

    def is_settled() -> bool:
        return int(sdo[STATUS][1].raw) == 0

    rig.wait(is_settled)
    old = sdo[IDENTIFICATION][1].raw
    rig.remote.nmt.state = "PRE-OPERATIONAL"
    sdo[CONTROL][1].raw = ProgramControl.STOP
    sdo[CONTROL][1].raw = ProgramControl.CLEAR
    rig.wait(is_settled)
    with sdo[DATA][1].open("wb", size=len(IMAGE), block_transfer=block) as file:
        file.write(IMAGE)
    rig.wait(is_settled)
    assert sdo[IDENTIFICATION][1].raw == crc32(IMAGE) != old
    sdo[CONTROL][1].raw = ProgramControl.START
    rig.wait(lambda: rig.device.runs)  # type: ignore[attr-defined]
    assert sdo[CONTROL][1].raw == ProgramControl.CONFIRM
    sdo[CONTROL][1].raw = ProgramControl.CONFIRM
    assert (sdo[CONTROL][1].raw, sdo[IDENTIFICATION][1].raw) == (ProgramControl.START, crc32(IMAGE))


def test_data_without_a_clear_are_refused(rig_of: Callable[[BootLoaderSettings], Rig]) -> None:
    sdo = rig_of(BootLoaderSettings()).remote.sdo
    sdo[CONTROL][1].raw = ProgramControl.STOP
    with pytest.raises(canopen.SdoAbortedError) as caught:
        sdo.download(DATA, 1, IMAGE)
    assert (caught.value.code, sdo[STATUS][1].raw) == (0x08000022, 4 << 1)
