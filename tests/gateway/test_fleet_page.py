"""The page over a fleet in a real browser: two sites; one is killed, and returns. Real time, so nothing here is judged by how
long it takes. Skipped as tests/gateway/test_web_page.py is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_data.configured import configure
from canopen_gateway import Permission
from canopen_gateway.fleet import open_fleet
from canopen_gateway.web import WebDoor, bind_web_door
from canopen_master.simulation.serving import drive_maker
from canopen_proto.multiplexer import mux
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import Shape
from tests.gateway.fleet_world import free_endpoint
from tests.gateway.test_web_page import AXE, EVIL, browser, click, faults, labelled, one, silent, text, until, visit

pytest.importorskip("zenoh", reason="the extra fleet is not installed")
from tests.gateway.test_fleet_web import Site, site

__all__ = ["browser"]
HALL, YARD = "hall/virtual-hall/3", "yard/virtual-demo/3"


class FleetPageThread:
    """A site with one drive whose name is markup, and a page over it and another site, in a thread of its own."""

    def __init__(self, yard: str) -> None:
        self.door: WebDoor
        self.hall: Site
        self._yard = yard
        self._started = threading.Event()
        self._thread = threading.Thread(target=trio.run, args=(self._serve,))

    async def _serve(self) -> None:
        self._token, self._over = trio.lowlevel.current_trio_token(), trio.Event()

        def make(number: int, node_id: int) -> Any:
            named = configure(drive_dictionary(Shape.SCHUNK_POWERBALL), {mux(0x1008, 0): EVIL}, node_id)
            return drive_maker(number, node_id, dictionary=named)

        async with (
            site("hall", 3, allow="write", make=make) as self.hall,
            await bind_web_door(port=0) as self.door,
            open_fleet(connect=[self.hall.endpoint, self._yard]) as fleet,
            trio.open_nursery() as nursery,
        ):
            nursery.start_soon(self.door.serve_fleet, fleet, {Permission.WRITE, Permission.NMT})
            self._started.set()
            await self._over.wait()
            nursery.cancel_scope.cancel()

    def raise_fault(self, code: int) -> None:
        trio.from_thread.run_sync(self.hall.drives.raise_fault, 3, code, trio_token=self._token)

    @contextmanager
    def running(self) -> Iterator[FleetPageThread]:
        self._thread.start()
        assert self._started.wait(30)
        try:
            yield self
        finally:
            trio.from_thread.run_sync(self._over.set, trio_token=self._token)
            self._thread.join(30)


@contextmanager
def yard(endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    """A site with the six simulated drives, in a process of its own."""
    start = "import sys; from canopen_cli.entry import main; sys.exit(main())"
    command = [sys.executable, "-c", start, "serve", "zenoh", "--site", "yard", "-b", "demo", "--listen", endpoint]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment) as process:
        try:
            yield process
        finally:
            process.kill()


def choose(browser: Any, place: str) -> None:
    """Choose a node; the table may be drawn anew meanwhile."""
    script = "document.querySelector(`[aria-label='Show ${arguments[0]}']`)?.click()"
    until(lambda: browser.execute_script(script, place) or f"{place}" in chosen(browser))


def chosen(browser: Any) -> str:
    script = "return document.querySelector('#object-node').selectedOptions[0]?.textContent ?? ''"
    return str(browser.execute_script(script))


@pytest.mark.thorough
def test_a_page_over_two_sites_of_which_one_is_killed_and_returns(browser: Any) -> None:
    endpoint = free_endpoint()
    with yard(endpoint) as process, FleetPageThread(endpoint).running() as machine:
        visit(browser, machine.door.url)
        until(lambda: text(browser, "#link") == "live")
        for name in ("hall/virtual-hall", "yard/virtual-demo"):
            until(lambda name=name: name in text(browser, "#nodes"))
        # What a device says is text, here too
        choose(browser, HALL)
        until(lambda: EVIL in text(browser, "#nodes"))
        assert browser.execute_script("return document.querySelectorAll('img').length") == 0
        until(lambda: "it is not enabled" in text(browser, "#drive"))
        # What is not there is said in words
        assert "dead man" in text(browser, "#absent")
        for hidden in ("#network-section", "#monitor-section", "#jog-section", "#commission", "#scan"):
            assert not one(browser, hidden).is_displayed(), hidden
        # A value arrives; one is written where both allow it, and only there
        one(browser, "#search").send_keys("1017")
        click(browser, labelled(browser, "Watch producer_heartbeat_time (1017:00)"))
        until(lambda: browser.execute_script("return canopenPage.samples") > 1)
        assert f"producer_heartbeat_time of {HALL}" in text(browser, "#legend")
        field = labelled(browser, "New value of producer_heartbeat_time (1017:00)")
        field.send_keys("700")
        click(browser, labelled(browser, "Write producer_heartbeat_time (1017:00)"))
        until(lambda: "700" in text(browser, "#legend"))
        assert "bridge of this site" in text(browser, "#nmt-why")  # the page allows nmt, the bridge does not
        assert browser.execute_script("return [...document.querySelectorAll('[data-nmt]')].every((each) => each.disabled)")
        choose(browser, YARD)
        until(lambda: "switch on disabled" in text(browser, "#nodes"))
        labelled(browser, "Read producer_heartbeat_time (1017:00)")
        until(lambda: browser.find_elements("css selector", '[aria-label^="Write"]') == [])
        # Emergencies, by place
        machine.raise_fault(0x2310)
        until(lambda: f"{HALL}: 0x2310" in text(browser, "#events"))
        silent(browser)
        # A site is killed
        process.send_signal(signal.SIGKILL)
        until(lambda: "lost" in text(browser, "#nodes"))
        until(lambda: "yard/virtual-demo: its bridge is away" in text(browser, "#events"))
        assert "ago" in text(browser, "#nodes h3:has(.bad)")
        click(browser, one(browser, "#halt"))
        until(lambda: "yard/virtual-demo is lost: nobody knows whether it stands" in text(browser, "#notice"))
        until(lambda: "700" in text(browser, "#legend"))  # the other site goes on
        silent(browser)
        if AXE is not None:
            for scheme in ("light", "dark"):
                features = [{"name": "prefers-color-scheme", "value": scheme}]
                browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
                assert faults(browser, Path(AXE).read_text(encoding="utf-8")) == [], scheme
        # It returns
        with yard(endpoint):
            until(lambda: "lost" not in text(browser, "#nodes"))
            until(lambda: "yard/virtual-demo: its bridge is there again" in text(browser, "#events"))
