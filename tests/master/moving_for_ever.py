"""A program of tests that end in their own way: a simulated drive, and a master that moves it for ever.

`until` waits for something, with an end that says for what.
"""

LIMIT = 60.0
"""Seconds for one wait, on a busy computer."""

SERVE_AND_WORK = f"""
import asyncio, time
from canopen_master import open_master
from canopen_master.simulation import simulated_drives

async def until(is_so, what):
    end = time.monotonic() + {LIMIT}
    while not is_so():
        assert time.monotonic() < end, f"not within {LIMIT:g} s: {{what}}"
        await asyncio.sleep(0.01)

async def serve(served):
    async with simulated_drives([("virtual:cell", 3)]) as drives:
        served.set_result(drives)
        await asyncio.sleep(1000)

async def work():
    async with open_master("virtual:cell") as master:
        arm = master.load_chains(text="arm joint1 can0 3\\n")["arm"]
        await arm.initialise()
        await arm.home()
        while True:
            await arm.move([1.0])
            await arm.move([0.0])
"""
