"""The page in a real browser: headless Chromium, led by selenium. Real time, so nothing here is judged by how long it takes.

Skipped where there is no chromium with its driver, and `selenium`. Accessibility is judged by axe-core, if CANOPEN_AXE names its
axe.min.js (`npm pack axe-core` has it).
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_data.configured import configure
from canopen_gateway import GatewayService, open_gateway
from canopen_gateway.web import WebDoor, bind_web_door
from canopen_master import open_master
from canopen_master.simulation.serving import SimulatedDevices, drive_maker, simulated_drives
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.multiplexer import mux
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import Shape

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
if CHROMIUM is None or DRIVER is None:
    pytest.skip("no chromium with chromium-driver here", allow_module_level=True)
webdriver = pytest.importorskip("selenium.webdriver")
from selenium.webdriver.chrome.options import Options  # noqa: E402 - only where it is
from selenium.webdriver.chrome.service import Service  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402

LOCATOR = "virtual:behind a page"
EVIL = "<img src=x onerror=\"document.title='taken over'\">"
PATIENCE = 60
"""Seconds until a condition that does not come is a failure."""


def until(fits: Callable[[], Any]) -> Any:
    """Wait until something is there, and return it."""
    end = time.monotonic() + PATIENCE
    while not (found := fits()):
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.05)
    return found


def new_browser() -> Any:
    options = Options()
    options.binary_location = CHROMIUM
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1400,1600", "--disable-gpu"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    driver.set_script_timeout(PATIENCE)
    return driver


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    driver = new_browser()
    yield driver
    driver.quit()


def visit(browser: Any, url: str) -> None:
    """Open a page; what the page before left in the console is forgotten."""
    browser.get("about:blank")
    browser.get_log("browser")
    browser.get(url)


def silent(browser: Any) -> None:
    """Nothing stands in the browser's console."""
    assert [each for each in browser.get_log("browser") if each["level"] in ("SEVERE", "WARNING")] == []


def one(browser: Any, selector: str) -> Any:
    return until(lambda: browser.find_elements(By.CSS_SELECTOR, selector))[0]


def text(browser: Any, selector: str) -> str:
    """What an element says, read in the page: an element may be another one a moment later."""
    found = browser.execute_script("return document.querySelector(arguments[0])?.innerText ?? ''", selector)
    return str(found)


def labelled(browser: Any, label: str) -> Any:
    return one(browser, f'[aria-label="{label}"]')


def click(browser: Any, element: Any) -> None:
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'}); arguments[0].click()", element)


class ReadOnlyDoor:
    """A door over two drives, in a thread of its own. The name of drive 4 is markup."""

    def __init__(self) -> None:
        self.door: WebDoor
        self.service: GatewayService
        self.drives: SimulatedDevices
        self._started = threading.Event()
        self._thread = threading.Thread(target=trio.run, args=(self._serve,))

    async def _serve(self) -> None:
        self._token, self._over = trio.lowlevel.current_trio_token(), trio.Event()
        self.door = await bind_web_door(port=0)

        def make(number: int, node_id: int) -> Any:
            if node_id == 3:
                return drive_maker(number, node_id)
            named = drive_dictionary(Shape.SCHUNK_POWERBALL).with_objects([standard_object(0x1017, 500)])
            return drive_maker(number, node_id, dictionary=configure(named, {mux(0x1008, 0): EVIL}, node_id))

        async with (
            self.door,
            simulated_drives([(LOCATOR, 3), (LOCATOR, 4)], make=make) as self.drives,
            open_master(LOCATOR) as master,
            open_gateway(master) as self.service,
            trio.open_nursery() as nursery,
        ):
            nursery.start_soon(self.door.serve, self.service)
            self._started.set()
            await self._over.wait()
            nursery.cancel_scope.cancel()

    def call(self, function: Callable[[], object]) -> None:
        """Call something in the thread of the door."""
        trio.from_thread.run_sync(function, trio_token=self._token)

    @contextmanager
    def running(self) -> Iterator[ReadOnlyDoor]:
        self._thread.start()
        assert self._started.wait(30)
        try:
            yield self
        finally:
            self.call(self._over.set)
            self._thread.join(30)


WHOLE = """
const done = arguments[arguments.length - 1];
import("/whole.js").then(({ shown, bodyOf }) => {
  const told = (text, type, size, hex) => shown({ value: JSON.parse(text), type, size, hex });
  done([
    told("9007199254740993", "UNSIGNED64", 8, "01 00 00 00 00 00 20 00"),
    told("-9223372036854775807", "INTEGER64", 8, "01 00 00 00 00 00 00 80"),
    told("-5", "INTEGER16", 2, "fb ff"),
    told("1e300", "REAL64", 8, "9c 75 00 88 3c e4 37 7e"),
    told('"01 02"', "UNSIGNED64", 2, "01 02"),
    bodyOf("9007199254740993", "UNSIGNED64"),
    bodyOf(" 0xFFFFFFFFFFFFFFFF", "UNSIGNED64"),
    bodyOf("-7", "INTEGER8"),
    bodyOf("1.5", "REAL32"),
    bodyOf("7", "VISIBLE_STRING"),
    bodyOf("halt", "UNSIGNED16"),
  ]);
});
"""


@pytest.mark.thorough
def test_whole_numbers_are_shown_and_written_exactly_whatever_their_size(browser: Any) -> None:
    with ReadOnlyDoor().running() as machine:
        visit(browser, machine.door.url)
        assert browser.execute_async_script(WHOLE) == [
            "9007199254740993",
            "-9223372036854775807",
            "-5",
            "1e+300",
            "01 02",
            '{"value": 9007199254740993}',
            '{"value": 18446744073709551615}',
            '{"value": -7}',
            '{"value":1.5}',
            '{"value":"7"}',
            '{"value":"halt"}',
        ]


@pytest.mark.thorough
def test_a_page_that_may_only_read(browser: Any) -> None:
    """Nodes, objects, emergencies; what a device says is text; a write is refused; and nothing stands in the console."""
    with ReadOnlyDoor().running() as machine:
        visit(browser, machine.door.url)
        assert "token" not in browser.current_url
        until(lambda: text(browser, "#link") == "live")
        assert text(browser, "#mode") == "read-only"
        until(lambda: "switch on disabled" in text(browser, "#nodes"))
        # A device whose name is markup
        until(lambda: EVIL in text(browser, "#nodes"))
        assert browser.execute_script("return document.querySelectorAll('img').length") == 0
        assert browser.title == "CANopen"
        assert "it is not enabled" in text(browser, "#drive")
        # The object browser
        search = one(browser, "#search")
        search.send_keys("device_name")
        read = labelled(browser, "Read manufacturer_device_name (1008:00)")
        click(browser, read)
        until(lambda: "Simulated Schunk Powerball joint" in text(browser, "#objects"))
        click(browser, labelled(browser, "Show node 4"))
        until(lambda: not browser.find_elements(By.CSS_SELECTOR, "td.shown:not(:empty)"))
        click(browser, labelled(browser, "Read manufacturer_device_name (1008:00)"))
        until(lambda: EVIL in text(browser, "#objects"))
        search.clear()
        search.send_keys("1017")
        labelled(browser, "Watch producer_heartbeat_time (1017:00)")
        assert browser.find_elements(By.CSS_SELECTOR, '[aria-label^="Write"]') == []
        # NMT commands are shown, and why they cannot be sent
        buttons = browser.execute_script("return [...document.querySelectorAll('[data-nmt]')].map((each) => each.disabled)")
        assert buttons == [True] * 5
        assert "without --allow nmt" in text(browser, "#nmt-why")
        assert "without --allow motion" in text(browser, "#commission-why")
        assert browser.execute_script("return document.getElementById('commission-begin').disabled")
        # Who sends what to whom: the devices are asked
        browser.execute_script("document.getElementById('network-section').scrollIntoView()")
        click(browser, one(browser, "#network-read"))
        until(lambda: "4, TPDO 1" in text(browser, "#network"))
        assert "statusword" in text(browser, "#network")
        # The monitor: frames in words, of a service, until it is paused
        browser.execute_script("arguments[0].value = 'heartbeat'", one(browser, "#monitor-service"))
        click(browser, one(browser, "#monitor-on"))
        until(lambda: "pre-operational" in text(browser, "#monitor-rows"))
        assert "SDO" not in text(browser, "#monitor-rows")
        click(browser, one(browser, "#monitor-on"))
        assert text(browser, "#monitor-on") == "Show frames"
        # What a device says is text there, too
        browser.execute_script("arguments[0].value = 'sdo'", one(browser, "#monitor-service"))
        click(browser, one(browser, "#monitor-on"))
        browser.execute_script("setTimeout(() => fetch('/api/v1/1/4/objects/1008'), 500)")
        until(lambda: EVIL[:20] in text(browser, "#monitor-rows"))
        assert browser.execute_script("return document.querySelectorAll('img').length") == 0
        click(browser, one(browser, "#monitor-on"))
        # A trace, by the link of the page
        traced = browser.execute_async_script(
            """const done = arguments[0]; const link = document.getElementById("trace");
            fetch(link.href).then((answer) => answer.text().then((body) => done([link.hasAttribute("download"),
              answer.headers.get("content-disposition"), body])));"""
        )
        assert traced[0]
        assert traced[1].endswith('.log"')
        assert " 703#7F R" in traced[2]
        # An emergency, with its text
        machine.call(lambda: machine.drives.raise_fault(4, 0x2310))
        until(lambda: "0x2310" in text(browser, "#events"))
        assert "current" in text(browser, "#events").lower()
        until(lambda: "emergency" in text(browser, "#nodes"))
        silent(browser)
        # Whoever writes in spite of that is refused, and the console says so
        written = browser.execute_async_script(
            """const done = arguments[0];
            fetch("/api/v1/1/3/objects/1017", {method: "PUT", headers: {"x-canopen": "1"}, body: '{"value": 7}'})
              .then((answer) => answer.json().then((body) => done([answer.status, body.error.code])));"""
        )
        assert written == [403, "CO150"]
        browser.get_log("browser")
        assert browser.execute_script("return document.title") == "CANopen"


AXE = os.environ.get("CANOPEN_AXE")


def faults(browser: Any, source: str) -> list[str]:
    """What axe-core finds, by the rules of WCAG 2.2 AA and good practice."""
    # By the protocol of the developer tools: the page's own policy lets no foreign program in
    browser.execute_cdp_cmd("Runtime.evaluate", {"expression": source})
    found = browser.execute_async_script("const done = arguments[0]; axe.run().then((result) => done(result.violations))")
    return [f"{each['id']}: {[node['html'][:90] for node in each['nodes']][:3]}" for each in found]


@contextmanager
def demonstration(browser: Any) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`canopen demo --web` in a process of its own, and the address of its page."""
    start = "import sys; from canopen_cli.entry import main; sys.exit(main())"
    command = [sys.executable, "-c", start, "demo", "--web", "--port", "0", "--json"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment) as process:
        try:
            assert process.stdout is not None
            document = ""
            while not document.endswith("\n}\n"):
                line = process.stdout.readline()
                assert line, document
                document += line
            yield process, json.loads(document)["url"]
        except AssertionError as failed:
            failed.add_note(f"the page says: {text(browser, 'body')[:600]}")
            raise
        finally:
            process.send_signal(signal.SIGCONT)
            process.terminate()
            process.wait(30)


POSITION = ".joint .number"


def position(browser: Any) -> float:
    return float(text(browser, POSITION).removesuffix("°"))


def stands(browser: Any) -> bool:
    """Whether the joint stands: ten pulses later it is where it was."""
    before = position(browser)
    time.sleep(1)
    return position(browser) == before


def press(browser: Any, kind: str) -> None:
    """Let a finger go down on the first joint's `+`, or up again, as the browser itself would."""
    where = """const button = document.querySelector('[aria-label="Hold to move joint1 forward"]');
        button.scrollIntoView({block: "center"}); const box = button.getBoundingClientRect();
        const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
        return !button.disabled && document.elementFromPoint(x, y) === button ? [x, y] : null;"""
    box = browser.execute_script(where) or (5, 5)
    event = {"type": kind, "x": box[0], "y": box[1], "button": "left", "clickCount": 1}
    browser.execute_cdp_cmd("Input.dispatchMouseEvent", event)


def take(browser: Any) -> None:
    until(lambda: "Take the machine" in text(browser, "#jog"))
    click(browser, one(browser, "#jog .row button"))
    until(lambda: browser.find_elements(By.CSS_SELECTOR, ".joint button:enabled"))


def key(browser: Any, kind: str) -> None:
    """The space bar on the first joint's `+` goes down, or up."""
    browser.execute_script("arguments[0].focus()", labelled(browser, "Hold to move joint1 forward"))
    browser.execute_cdp_cmd("Input.dispatchKeyEvent", {"type": kind, "key": " ", "code": "Space"})


def hold(browser: Any, begin: Callable[[], None]) -> None:
    """Take the machine if need be, begin to move the first joint, and wait until it moves. A computer that is so busy that the
    lease ends meanwhile has halted the machine, rightly; then it is taken again."""
    for _ in range(10):
        if "Let go" in text(browser, "#jog") and "halted" in text(browser, "#jog"):
            click(browser, one(browser, "#jog .row button"))
        if not browser.find_elements(By.CSS_SELECTOR, ".joint button:enabled"):
            take(browser)
        goal = position(browser) + 0.5
        begin()
        until(lambda goal=goal: position(browser) > goal or "Take the machine" in text(browser, "#jog"))
        if position(browser) > goal:
            return
    raise AssertionError("the lease never lasts")


@pytest.mark.thorough
def test_a_hand_on_the_machine(browser: Any) -> None:
    """Samples arrive, a joint moves while it is held, and stands when it is let go, the page is hidden, or all is halted."""
    with demonstration(browser) as (process, url):
        visit(browser, url)
        take(browser)
        one(browser, "#search").send_keys("6064")
        click(browser, labelled(browser, "Watch position_actual_value (6064:00)"))
        until(lambda: browser.execute_script("return canopenPage.samples") > 0)
        counted = browser.execute_async_script(
            """const done = arguments[0]; const begun = performance.now(); const samples = canopenPage.samples;
            setTimeout(() => done([canopenPage.samples - samples, (performance.now() - begun) / 1000]), 1500);"""
        )
        assert counted[0] / counted[1] > 50  # of 100 a second, on a computer that does much else
        assert browser.execute_script("return canopenPage.frames") > 10

        hold(browser, lambda: press(browser, "mousePressed"))
        press(browser, "mouseReleased")
        until(lambda: stands(browser))
        hold(browser, lambda: key(browser, "keyDown"))
        key(browser, "keyUp")
        until(lambda: stands(browser))
        # "Halt all", while it is held
        hold(browser, lambda: press(browser, "mousePressed"))
        click(browser, one(browser, "#halt"))
        until(lambda: "halted" in text(browser, "#jog"))
        until(lambda: stands(browser))
        press(browser, "mouseReleased")
        # A page that is hidden lets go of the machine
        hold(browser, lambda: press(browser, "mousePressed"))
        browser.execute_script(
            "Object.defineProperty(document, 'hidden', {get: () => true}); document.dispatchEvent(new Event('visibilitychange'))"
        )
        until(lambda: "halted" in text(browser, "#jog") and "Take the machine" in text(browser, "#jog"))
        until(lambda: stands(browser))
        silent(browser)
        # A server that hangs: the page says so; one that is gone, too
        process.send_signal(signal.SIGSTOP)
        until(lambda: text(browser, "#link") == "no news")
        assert "last value" in text(browser, "#age")
        process.send_signal(signal.SIGCONT)
        until(lambda: text(browser, "#link") == "live")
        process.kill()
        until(lambda: text(browser, "#link") == "connection lost")
        browser.get_log("browser")


NEXT = """const form = document.querySelector("#commission-question form");
    if (form === null) return false;
    const [input, select] = [form.querySelector("input"), form.querySelector("select")];
    if (select !== null && select.options[0].value === "y") select.value = "y";
    const yes = [...form.querySelectorAll("button")].find((each) => each.textContent === "Yes");
    if (yes === undefined) form.requestSubmit(); else yes.click();
    return true;"""
"""Answers a question of the dialogue: yes, or its default."""


@pytest.mark.thorough
def test_a_drive_is_commissioned_and_a_reset_asks_before(browser: Any) -> None:
    """From its identity to its homing, and two files to keep; then NMT, where "Cancel" sends nothing."""
    with demonstration(browser) as (_, url):
        visit(browser, url)
        until(lambda: browser.find_elements(By.CSS_SELECTOR, "#commission-begin:enabled"))
        for _ in range(5):  # a computer that is so busy that the lease ends has ended it, rightly
            click(browser, one(browser, "#commission-begin:enabled"))
            until(
                lambda: (
                    browser.execute_script(NEXT) is False and browser.find_elements(By.CSS_SELECTOR, "#commission-begin:enabled")
                )
            )
            if "joint1.toml" in text(browser, "#commission-said"):
                break
        said = text(browser, "#commission-said")
        assert "8. The first move" in said
        assert {"Keep joint1.dcf", "Keep joint1.toml"} <= set(said.splitlines())
        until(lambda: browser.find_elements(By.CSS_SELECTOR, "#jog .row button:enabled"))

        def is_operational() -> bool:
            return "operational" in text(browser, "#nodes tbody tr").split()

        click(browser, one(browser, "[data-nmt=start]"))
        until(is_operational)
        click(browser, one(browser, "[data-nmt=stop]"))
        assert "all nodes" in text(browser, "dialog h2")
        click(browser, one(browser, "dialog button"))  # Cancel
        until(lambda: not browser.find_elements(By.CSS_SELECTOR, "dialog"))
        time.sleep(1)
        assert is_operational()
        click(browser, one(browser, "[data-nmt=reset-node]"))
        click(browser, one(browser, "dialog button.warning"))
        until(lambda: not is_operational())
        silent(browser)


@pytest.mark.thorough
def test_a_browser_that_hangs_or_is_killed_moves_nothing() -> None:
    """SIGSTOP to all of it, then SIGKILL, while a joint is held: it stands, and the lease is over."""
    driver = new_browser()
    processes: list[int] = []
    try:
        with demonstration(driver) as (_, url):
            visit(driver, url)
            hold(driver, lambda: press(driver, "mousePressed"))
            processes = family(driver.service.process.pid)
            send(signal.SIGSTOP, processes)
            until(lambda: asked(url, "/lease")["owner"] is None)
            until(lambda: asked(url, "/chains")[0]["state"] == "halted")
            before = [joint["position"] for joint in asked(url, "/chains")[0]["joints"]]
            time.sleep(1)
            assert [joint["position"] for joint in asked(url, "/chains")[0]["joints"]] == before
            send(signal.SIGCONT, processes)
            until(lambda: text(driver, "#link") == "live")
            hold(driver, lambda: press(driver, "mousePressed"))
            processes = family(driver.service.process.pid)  # some have come meanwhile
            send(signal.SIGKILL, processes)
            until(lambda: asked(url, "/lease")["owner"] is None)
            until(lambda: asked(url, "/chains")[0]["state"] == "halted")
            processes = []
    finally:
        send(signal.SIGCONT, processes)
        if processes:
            driver.quit()
        else:
            driver.service.process.wait(10)


def asked(url: str, path: str) -> Any:
    """What the door answers a program."""
    address, _, token = url.partition("/?token=")
    request = urllib.request.Request(f"{address}/api/v1{path}", headers={"authorization": f"Bearer {token}"})
    with urllib.request.urlopen(request, timeout=30) as answer:
        return json.load(answer)


def send(number: signal.Signals, processes: list[int]) -> None:
    """Send a signal to each of these that is still there."""
    for process in processes:
        with suppress(ProcessLookupError):
            os.kill(process, number)


def family(pid: int) -> list[int]:
    """A process and all that it has started, the eldest first."""
    children = Path(f"/proc/{pid}/task").glob("*/children")
    found = [int(each) for file in children for each in file.read_text(encoding="ascii").split()]
    return [pid, *(each for child in found for each in family(child))]


@pytest.mark.thorough
@pytest.mark.skipif(AXE is None, reason="no axe-core here: CANOPEN_AXE names none")
def test_axe_finds_no_fault(browser: Any) -> None:
    """On a wide window and a phone, light and dark, with a curve, a drive, reasons, and events."""
    assert AXE is not None
    source = Path(AXE).read_text(encoding="utf-8")
    with demonstration(browser) as (_, url):
        visit(browser, url)
        until(lambda: "it is not enabled" in text(browser, "#drive"))
        one(browser, "#search").send_keys("6064")
        click(browser, labelled(browser, "Watch position_actual_value (6064:00)"))
        until(lambda: "position_actual_value" in text(browser, "#legend"))
        until(lambda: browser.find_elements(By.CSS_SELECTOR, "#events li"))
        browser.execute_script("document.getElementById('network-section').scrollIntoView()")
        click(browser, one(browser, "#network-read"))
        until(lambda: "TPDO 1" in text(browser, "#network"))
        click(browser, one(browser, "#monitor-on"))
        until(lambda: "pre-operational" in text(browser, "#monitor-rows"))
        click(browser, one(browser, "#monitor-on"))
        for scheme in ("light", "dark"):
            features = [{"name": "prefers-color-scheme", "value": scheme}]
            browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
            assert faults(browser, source) == [], scheme
        phone = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
        assert faults(browser, source) == []
        width, inner = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
        assert width <= inner  # nothing sticks out, so "Halt all" stays where it is
        browser.execute_script("scrollTo(0, document.documentElement.scrollHeight)")
        top = browser.execute_script("return document.getElementById('halt').getBoundingClientRect().top")
        assert 0 <= top < 100
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
