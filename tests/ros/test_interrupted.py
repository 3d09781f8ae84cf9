"""Services that are interrupted at every step of theirs: by a cancel, a halt, a shutdown, and the end of the node."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import trio
from trio.lowlevel import Task

from canopen_proto.drives.cia402.states import POWERED
from canopen_ros.reply import Reply
from tests.examples import takes_all
from tests.master.world import virtual_time
from tests.ros.ros_world import cell
from tests.ros.test_services import fault, halted, moving


class AtStep(trio.abc.Instrument):
    """Acts at a certain step of a task: each await that waits for something ends a step. steps: so many were there."""

    def __init__(self, number: int, act: Callable[[], object]) -> None:
        self.task: Task | None = None
        self.steps = 0
        self._number = number
        self._act = act
        self._token = trio.lowlevel.current_trio_token()

    def before_task_step(self, task: Task) -> None:
        if task is self.task:
            self.steps += 1
            if self.steps == self._number:
                self._token.run_sync_soon(self._act)


INTERRUPTS = ("cancel", "halt", "shutdown", "close")
STARTS = {"init": moving, "home": moving, "recover": fault, "IPmode": halted, "halt": moving, "shutdown": moving}
"""From which state each service is interrupted: one in which it has most to do."""


@pytest.mark.thorough(6)
@pytest.mark.parametrize("how", INTERRUPTS)
@pytest.mark.parametrize("service", STARTS)
def test_a_service_that_is_interrupted_at_any_step_leaves_all_joints_at_rest(service: str, how: str) -> None:
    number, was_over = 0, False
    while not was_over:
        number += 1 + (number // 2 if number < 4 or takes_all() else 2 * number)  # the many behind wait for joints that brake
        was_over = interrupted(service, how, number)
    assert number > 3  # it had some steps


def interrupted(service: str, how: str, number: int) -> bool:
    """Interrupt a service at a step; return whether it was over before. All joints have to stand behind it."""
    over: list[bool] = []

    @virtual_time
    async def run() -> None:
        async with cell(sync_interval=40) as world:
            await STARTS[service](world)
            scope = trio.CancelScope()
            interrupter: list[Reply] = []

            async def ask() -> None:
                instrument.task = trio.lowlevel.current_task()
                with scope:
                    await world.arm.call(service)
                instrument.task = None

            async def interrupt() -> None:
                interrupter.append(await world.arm.call(how))

            def act() -> None:
                if how == "cancel":
                    scope.cancel()
                elif how == "close":
                    world.leave()
                else:
                    world.nursery.start_soon(interrupt)

            instrument = AtStep(number, act)
            trio.lowlevel.add_instrument(instrument)
            world.nursery.start_soon(ask)
            await trio.sleep(2.0)
            over.append(instrument.steps < number)
            while how in ("halt", "shutdown") and not over[0] and not interrupter:  # its step may be the last of these
                await trio.sleep(0.1)
            assert not world.is_moving
            if how in ("halt", "shutdown") and not over[0]:
                assert interrupter[0].success or service in ("halt", "shutdown"), interrupter[0].message
                assert world.arm.state in ("halted", "off", "fault")
            if how == "shutdown" and not over[0]:
                assert not any(node.drive.state in POWERED for node in world.drives)
            await world.assert_all_stand()

    run()
    return over[0] if over else False
