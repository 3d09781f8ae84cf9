"""Commissioning of a drive over the live channel: the dialogue of `canopen drive commission`, behind the lease for motion."""

from __future__ import annotations

import base64
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

import pytest
import trio

from canopen_data.eds.reader import read_eds
from canopen_gateway import LeaseError
from canopen_gateway import commissioning as commissioning_of_the_door
from canopen_gateway.commissioning import MANY, PAUSE, paced
from canopen_gateway.lease import HALT_TIME, LEASE_TIME
from canopen_master import Host
from canopen_master.machine_file import parse_machine
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402.objects import PROFILE_DECELERATION, QUICK_STOP_DECELERATION
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import SECOND
from canopen_proto.manager.parameters.backup import back_up
from canopen_proto.procedures.objects import read
from tests.gateway.test_lease import is_moving
from tests.gateway.web_world import PageClient, WebWorld, web
from tests.master.world import BUS, arm_of, drives, virtual_time

ANSWERS: dict[str, Any] = {
    "Its positions are to be in": "degree",
    "Counts in one degree": 1000,
    "Lowest position": -90,
    "Highest position": 90,
    "Greatest speed": 20,
    "How far, from where it stands": None,
    "It moves by 5 degrees": True,
    "Did it go by 5 degrees": "y",
    "It homes as Schunk's joints do": True,
    "To which position": 3,
    "How fast": None,
    "It moves to 3 degrees": True,
}


class Person:
    """Answers the questions of a dialogue, and holds the lease. told: all that was said. asked: the questions, in order."""

    def __init__(self, page: PageClient, answers: dict[str, Any]) -> None:
        self.page = page
        self.answers = answers
        self.told: list[dict[str, Any]] = []
        self.asked: list[str] = []
        self.lives = True

    async def hold(self) -> None:
        while self.lives:
            self.page.move("renew")
            await trio.sleep(0.1)

    async def talk(self, until: Callable[[dict[str, Any]], bool] = lambda said: said["what"] == "end") -> dict[str, Any]:
        """Answer until something is said; return it."""
        answered = 0
        while True:
            said = await self.page.heard("commission")
            if until(said):
                self.told.append(said)
                return said
            if said["what"] != "ask":
                self.told.append(said)
            elif said["question"] > answered:
                answered = said["question"]
                self.asked.append(said["text"])
                found = [value for text, value in self.answers.items() if said["text"].startswith(text)]
                assert found, said
                self.page.move("answer", question=answered, value=found[0])

    def file(self, ending: str) -> bytes:
        return next(
            base64.b64decode(each["data"]) for each in self.told if each["what"] == "file" and each["name"].endswith(ending)
        )

    def texts(self, *kinds: str) -> list[str]:
        return [each["text"] for each in self.told if each["what"] in kinds]


@asynccontextmanager
async def commissioning(
    world: WebWorld, node_id: int = 3, answers: dict[str, Any] = ANSWERS, **fields: Any
) -> AsyncIterator[Person]:
    async with world.page() as page, trio.open_nursery() as nursery:
        person = Person(page, answers)
        page.say("take")
        page.move("commission", net=1, node=node_id, **fields)
        nursery.start_soon(person.hold)
        yield person
        person.lives = False


@pytest.fixture
def short_reading(monkeypatch: pytest.MonkeyPatch) -> None:
    """Little of what the drive holds is read before it moves: to ask for all objects takes longer than what is tested here."""
    monkeypatch.setattr(
        commissioning_of_the_door, "back_up_by_names", lambda node, names: back_up(node, names, only=[*names][:20])
    )


def has_power(host: Host, node_id: int = 3) -> bool:
    drive = next(each for each in drives(host) if each.node_id == node_id).drive
    return drive.state in (State.OPERATION_ENABLED, State.SWITCHED_ON, State.QUICK_STOP_ACTIVE)


@virtual_time
async def test_from_the_box_to_the_first_move_and_two_files() -> None:
    async with web(3, allow="motion", beats=False) as world, commissioning(world, name="el<b>ow") as person:
        end = await person.talk()
        assert end["confirmed"], person.told
        assert [text[:2] for text in person.texts("heading")] == [f"{number}." for number in range(1, 9)]
        machine = parse_machine(person.file(".toml").decode())
        joint = machine.joints["el-b-ow"].settings
        assert (joint.unit, joint.counts_per_unit) == (Unit.DEGREE, 1000)
        assert (joint.min_position, joint.max_position, joint.max_speed) == (-90, 90, 20)
        dcf = read_eds(person.file(".dcf"), "drive.dcf")
        assert dcf.dictionary.get(0x6081, 0) is not None
        assert "el-b-ow.dcf: " in " ".join(person.texts("say"))
        assert not has_power(world.host)
        pulse = await person.page.until(lambda each: each["lease"]["doing"] == "")
        assert pulse["lease"]["owner"] is not None


@pytest.mark.usefixtures("short_reading")
@virtual_time
async def test_a_name_that_is_taken_is_told_as_it_becomes(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = parse_machine(f'[buses."{BUS}"]\nlocator = "{BUS}"\n[nodes]\nelbow = {{ id = 9 }}\n')
    async with web(3, allow="motion", beats=False) as world:
        monkeypatch.setattr(world.service.master, "machine", machine)
        async with commissioning(world, name="elbow") as person:
            end = await person.talk()
            assert end["confirmed"], person.told
            files = {each["name"] for each in person.told if each["what"] == "file"}
            assert files == {"elbow-2.dcf", "elbow-2.toml"}
            assert set(parse_machine(person.file(".toml").decode()).joints) == {"elbow-2"}
            assert end["text"].startswith("elbow-2.toml: elbow-2 with")
            assert person.texts("remark")[0].startswith("the joint is elbow-2 in the machine file, not elbow")


@virtual_time
async def test_a_slow_client_gets_its_way_back_before_anything_moves() -> None:
    """Its line takes fewer messages than there are: some are dropped, the files are not."""
    async with web(3, allow="motion", beats=False) as world, commissioning(world, name="elbow") as person:
        person.page.delay = 0.12
        end = await person.talk()
        assert end["confirmed"], person.told
        assert person.file(".dcf")
        assert person.file(".toml")


@pytest.mark.thorough
@virtual_time
async def test_the_words_are_those_of_the_command() -> None:
    """The same class leads through it: what the terminal's person is asked, the client is asked."""
    from canopen_cli.drive.commissioning import CommissioningDialogue as OfTheCommand
    from canopen_gateway.commissioning import CommissioningDialogue as OfTheDoor

    assert OfTheCommand is OfTheDoor
    refused = {**ANSWERS, "It moves by 5 degrees": False}
    async with web(3, allow="motion", beats=False) as world, commissioning(world, answers=refused) as person:
        end = await person.talk()
        assert "It was not moved, so nothing else will be." in person.texts("say")
        assert not end["confirmed"]
        assert "its scale is not proven" in end["text"]
        assert [each["name"] for each in person.told if each["what"] == "file"] == ["drive3.dcf"]


@virtual_time
async def test_without_permission_or_lease_nothing_begins() -> None:
    async with web(3) as world, world.page() as page:
        page.say("take")
        assert (await page.heard("error"))["code"] == "CO150"
        page.move("commission", net=1, node=3)
        assert (await page.heard("error"))["about"] == "commission"
    async with web(3, 4, allow="motion") as world, world.page() as page, world.page() as other:
        page.move("commission", net=1, node=3)
        assert "lease" in (await page.heard("error"))["text"]
        page.say("take")
        for fields in ({"node": 0}, {"node": 128}, {"node": "x"}, {"net": 9, "node": 3}, {}):
            page.move("commission", **fields)
            assert (await page.heard("error"))["about"] == "commission"
        page.move("renew")
        other.move("commission", net=1, node=3)
        assert "lease" in (await other.heard("error"))["text"]


@pytest.mark.usefixtures("short_reading")
@virtual_time
async def test_a_drive_that_a_chain_uses_is_not_commissioned_and_its_units_stay() -> None:
    async with web(3, 4, allow="motion", beats=False) as world:
        arm = arm_of(world.service.master, 3, 4)
        before = [device.axis.settings for device in arm.devices]
        names = [device.name for device in arm.devices]
        async with commissioning(world) as person:
            assert (await person.talk())["confirmed"]
        assert [device.axis.settings.unit for device in arm.devices] == [each.unit for each in before]
        assert [device.axis.settings.counts_per_unit for device in arm.devices] == [each.counts_per_unit for each in before]
        assert [device.name for device in arm.devices] == names
        await arm.initialise()
        async with world.page() as page:
            page.say("take")
            page.move("commission", net=1, node=3)
            assert "chain" in str((await page.heard("error"))["details"])


async def moving(world: WebWorld, person: Person) -> None:
    """Go on until the first move moves."""
    await person.talk(lambda said: said["what"] == "ask" and said["text"].startswith("It moves to 60"))
    person.page.move("answer", question=len(person.asked) + 1, value=True)
    while not is_moving(world.host):
        await trio.sleep(0.05)


FAR = {**ANSWERS, "To which position": 60}


@pytest.mark.usefixtures("short_reading")
@virtual_time
async def test_a_hung_client_halts_what_it_has_begun() -> None:
    async with web(3, allow="motion", beats=False) as world, commissioning(world, answers=FAR) as person:
        await moving(world, person)
        person.lives = False  # no sign of life any more
        await trio.sleep(LEASE_TIME + 0.2)
        assert (await person.talk())["text"].startswith("it was ended before its end")
        await trio.sleep(2)
        assert not is_moving(world.host)
        assert not has_power(world.host)
        assert (await world.get("/lease"))["owner"] is None


@pytest.mark.usefixtures("short_reading")
@virtual_time
@pytest.mark.parametrize("by", ["the client", "somebody's halt"])
async def test_nobody_takes_the_lease_while_the_drive_still_brakes(by: str) -> None:
    async with web(3, allow="motion", beats=False) as world, commissioning(world, answers=FAR) as person:
        await moving(world, person)
        await trio.sleep(0.5)
        drives(world.host)[0].values.store.update({PROFILE_DECELERATION: 3000, QUICK_STOP_DECELERATION: 3000})  # of some 5000 / s
        lease = world.service.lease
        with world.service.open_session("other") as other:
            person.lives = False
            if by == "the client":
                await trio.sleep(LEASE_TIME)
            else:
                world.nursery.start_soon(world.service.halt)
            braked = 0.0
            while True:
                with suppress(LeaseError):
                    lease.take(other)
                if lease.owner is other:
                    break
                braked += 0.02
                await trio.sleep(0.02)
            assert not is_moving(world.host)
            assert braked > 1
            assert not lease.doing
            assert not has_power(world.host)


@pytest.mark.usefixtures("short_reading")
@virtual_time
async def test_a_drive_that_does_not_brake_keeps_the_lease_for_a_time_only_and_is_told() -> None:
    async with web(3, allow="motion", beats=False) as world, commissioning(world, answers=FAR) as person:
        await moving(world, person)
        await trio.sleep(0.5)
        drives(world.host)[0].values.store.update({PROFILE_DECELERATION: 300, QUICK_STOP_DECELERATION: 300})
        person.lives = False
        lease = world.service.lease
        began = trio.current_time()
        while lease.owner is not None:
            await trio.sleep(0.1)
        assert trio.current_time() - began == pytest.approx(LEASE_TIME + HALT_TIME, abs=0.2)
        assert is_moving(world.host)
        assert "node 3 on" in lease.problem
        assert "did not confirm within 5 s that it stands" in lease.problem


@pytest.mark.usefixtures("short_reading")
@virtual_time
async def test_a_drive_that_falls_silent_behind_a_stop_is_told_to_whoever_takes_the_lease_next() -> None:
    async with web(3, allow="motion", beats=False) as world, commissioning(world, answers=FAR) as person:
        await moving(world, person)
        network = world.host._pump.buses[0].network
        network.detach(drives(world.host)[0])
        person.page.move("stop")
        await person.talk()
        await trio.sleep(2 * HALT_TIME)
        lease = world.service.lease
        assert lease.owner is not None  # he has stopped, and lives
        person.lives = False
        while lease.owner is not None:
            await trio.sleep(0.1)
        assert "node 3 on" in lease.problem
        with world.service.open_session("other") as other:
            for _ in range(2):  # who only takes it and gives it back changes nothing
                lease.take(other)
                assert "node 3 on" in lease.problem
                lease.leave(other)
                await trio.sleep(0.1)
            lease.take(other)
            lease.commission(other, 1, world.service.node(world.service.nets[0], 3), trio.sleep_forever)
            assert lease.problem == ""
        network.attach(drives(world.host)[0])


@pytest.mark.usefixtures("short_reading")
@virtual_time
async def test_anybody_halts_it_and_the_lease_ends() -> None:
    async with web(3, allow="motion", beats=False) as world, commissioning(world, answers=FAR) as person:
        await moving(world, person)
        status, answer = await world.post("/1/halt")
        assert (status, answer["problems"]) == (200, [])
        await person.talk()
        assert not is_moving(world.host)
        assert not has_power(world.host)
        await trio.sleep(1)
        assert "halted" in (await world.get("/lease"))["problem"]


@pytest.mark.thorough
@virtual_time
async def test_odd_answers_are_asked_again_and_old_ones_count_nothing() -> None:
    odd: list[Any] = [True, "x", [], {}, -5, 0, "1000", 1e308 * 10]
    async with web(3, allow="motion", beats=False) as world, commissioning(world) as person:
        asked = await person.talk(lambda said: said["what"] == "ask" and said["text"].startswith("Its positions"))
        person.page.move("answer", question=asked["question"] - 1, value="degree")  # late
        person.page.move("answer", question="x", value="degree")
        person.page.move("answer", question=asked["question"], value="furlong")
        again = await person.talk(lambda said: said["what"] == "ask" and said["question"] > asked["question"])
        assert "'furlong' is none of" in person.texts("warn")[-1]
        person.page.move("answer", question=again["question"], value="degree")
        number = again["question"] + 1
        for value in odd:
            await person.talk(lambda said, number=number: said["what"] == "ask" and said["question"] == number)
            person.page.move("answer", question=number, value=value)
            number += 1
        asked = await person.talk(lambda said, number=number: said["what"] == "ask" and said["question"] == number)
        assert asked["text"] == "Counts in one degree"
        assert sum("is no number above 0" in text for text in person.texts("warn")) == len(odd)


@virtual_time
async def test_what_is_no_drive_says_so() -> None:
    async with web(3, allow="motion", beats=False) as world, commissioning(world, node_id=99) as person:
        end = await person.talk()
        assert "ended by an error" in end["text"]
        assert "node 99" in person.texts("warn")[-1]
        assert (await person.page.until(lambda each: each["lease"]["doing"] == ""))["lease"]["problem"]


@virtual_time
async def test_a_long_reading_lets_others_have_their_turn() -> None:
    """A device of this process answers at once: without pauses nobody would hear the client's signs of life meanwhile."""
    steps = 10 * MANY

    def reading(node: Any) -> Any:
        for _ in range(steps):
            yield from read(node, "device_type")
        return "done"

    async with web(3) as world:
        node = world.service.node(BUS, 3).remote
        began = trio.current_time()
        assert await world.service.master.run(paced(reading(node))) == "done"
        assert trio.current_time() - began >= 10 * PAUSE / SECOND

        def failing(node: Any) -> Any:
            yield from read(node, "device_type")
            yield from read(node, 0x2FFF)

        with pytest.raises(Exception, match="2FFF"):
            await world.service.master.run(paced(failing(node)))
