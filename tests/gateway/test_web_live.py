"""The live channel of the web door: values, events, the hand on the machine, and clients that hang. In virtual time."""

from __future__ import annotations

import itertools
import random

import pytest
import trio

from canopen_gateway import Limits
from canopen_gateway.lease import LEASE_TIME
from canopen_gateway.traffic.feed import MOST_ROWS
from canopen_gateway.web.live import FLUSH, MAX_MESSAGE, WAITING
from canopen_master import ChainState
from canopen_proto.frame import Frame
from canopen_transports import open_transport
from tests.gateway.test_lease import is_moving
from tests.gateway.web_world import BEARER, COOKIE, PageClient, WebWorld, web
from tests.master.world import BUS, arm_of, assert_all_halted, assert_all_stand, drives, position_of, virtual_time

PLACE = [1, 3, "6064:00"]


@virtual_time
async def test_a_page_is_told_what_is_there_and_what_happens() -> None:
    async with web(3, 4) as world, world.page() as page:
        hello = await page.heard("hello")
        assert (hello["mode"], hello["allow"], [node["node"] for node in hello["nets"][0]["nodes"]]) == ("read-only", [], [3, 4])
        wire = await open_transport(BUS)
        await wire.send(Frame(0x84, b"\x10\x23\x03\x01\x02\0\0\0"))
        told = await page.heard("event", lambda each: each["kind"] == "emergency")
        assert (told["node"], told["code"], told["register"], told["vendor"]) == (4, "0x2310", 3, "01 02 00 00 00")
        assert "current" in told["text"]
        await wire.send(Frame(0x84, bytes(8)))
        assert (await page.heard("event", lambda each: each["kind"] == "emergency"))["text"] == "no error any more"
        await wire.send(Frame(0x703, b"\0"))
        assert (await page.heard("event", lambda each: each["kind"] == "boot-up"))["node"] == 3
        await wire.aclose()
        await world.service.node(BUS, 4).write("producer_heartbeat_time", 0)
        lost = await page.heard("event", lambda each: each["kind"] == "lost")
        assert (lost["node"], lost["text"]) == (4, "its heartbeat is lost")
        async with world.page() as late:
            assert (await late.heard("hello"))["events"][-1]["text"] == "its heartbeat is lost"


@virtual_time
async def test_a_message_of_bytes_is_told_that_messages_are_text() -> None:
    async with web(3) as world, world.page() as page:
        page.say_bytes(b"\x00\x01")
        assert "as text, not bytes" in (await page.heard("error"))["text"]
        page.say("halt")
        assert (await page.heard("halted"))["problems"] == []  # and the page goes on


async def moving(world: WebWorld) -> None:
    """An arm that follows set-points, so that PDOs come each 10 ms."""
    arm = arm_of(world.service.master, 3, 4)
    await arm.initialise()
    await arm.follow()


@virtual_time
async def test_each_value_that_a_pdo_brings_arrives_a_hundred_a_second() -> None:
    async with web(3, 4) as world:
        await moving(world)
        async with world.page() as page:
            page.say("watch", objects=[PLACE, [1, 4, "position_actual_value"], [1, 3, "1008"]], period=0.1)
            await page.heard("values")
            began, rows, messages = trio.current_time(), [], 0
            while trio.current_time() - began < 2:
                rows += (await page.heard("values"))["values"]
                messages += 1
            for number in (0, 1):
                times = [row[1] for row in rows if row[0] == number]
                assert len(times) == pytest.approx(200, abs=8)
                steps = {round(later - sooner, 3) for sooner, later in itertools.pairwise(times)}
                assert steps == {0.01}  # none is left out, none comes twice
            assert {row[2] for row in rows if row[0] == 2} == {"Simulated Schunk Powerball joint"}
            assert messages <= 2 / FLUSH + 2
            page.say("watch", objects=[[1, 3, "1017"]], period=0.5)
            assert (await page.heard("values", lambda each: each["values"][0][2] == 500))["values"][0][0] == 0


@virtual_time
async def test_values_say_which_choice_they_are_of() -> None:
    """A page that chooses anew gets some of what it chose before, and their numbers mean other objects."""
    async with web(3, 4) as world:
        await moving(world)
        async with world.page() as page:
            page.say("watch", objects=[PLACE, [1, 3, "1008"]], mark=1)
            assert (await page.heard("values"))["mark"] == 1
            page.say("watch", objects=[[1, 3, "1008"]], mark=2)
            for _ in range(20):
                message = await page.heard("values")
                names = {row[2] for row in message["values"] if row[0] == 0}
                assert message["mark"] == 1 or names == {"Simulated Schunk Powerball joint"}
            assert message["mark"] == 2
            page.say("monitor", mark=3)
            assert (await page.heard("frames"))["mark"] == 3
            page.say("watch", objects=[PLACE], mark="new")
            assert "needs a number, mark" in (await page.heard("error"))["text"]


@virtual_time
async def test_what_cannot_be_watched() -> None:
    async with web(3, limits=Limits(subscriptions=4)) as world, world.page() as page:
        for objects in ([[1, 3]], "x", [[9, 3, "1000"]], [[1, 200, "1000"]], [[1, 3, "nothing"]], [PLACE, PLACE, PLACE]):
            page.say("watch", objects=objects)
            assert (await page.heard("error"))["about"] == "watch"
        page.say("watch", objects=[[1, 3, "2FFF:00"]])
        problem = (await page.heard("values"))["values"][0]
        assert problem[2] is None
        assert problem[3].startswith("CO202")
        for _ in range(30):
            page.say("watch", objects=[PLACE, [1, 3, "1017"]])  # in place of what was watched: there is room for no more
        page.say("watch", objects=[PLACE])
        await page.heard("values")
        await trio.sleep(1)
        assert [each for each in page.messages if each["k"] == "error"] == []


@virtual_time
async def test_messages_that_are_none() -> None:
    async with web(3, allow="motion") as world, world.page() as page:
        texts = (
            "",
            "{",
            "[]",
            "1",
            '{"k": 3}',
            '{"k": "fly"}',
            "[" * 5000,
            '{"k": "monitor", "k": "halt"}',
            '{"k": "watch", "objects": [[1, 3, "6064:00"]], "period": 1e-999}',
            '{"k": "jog", "chain": "arm"}',
            '{"k": "move", "n": true}',
            '{"k": "watch", "objects": [[1, 3, "6064:00"]], "period": NaN}',
            '{"k": "watch", "objects": [[1, 3, "6064:00"]], "period": Infinity}',
            '{"k": "watch", "objects": [[1, 3, "6064:00"]], "period": 1' + "0" * 400 + "}",
            '{"k": "jog", "n": 1, "chain": "arm", "velocities": [1' + "0" * 400 + "]}",
        )
        for text in texts:
            page.say_text(text)
            assert (await page.heard("error"))["text"]
        page.say_text('{"k": "halt", "x": "' + "x" * MAX_MESSAGE + '"}')
        assert await page.heard("error")
        page.say("halt")
        assert (await page.heard("halted"))["problems"] == []
        page.say("halt", net=1, node=3)
        assert await page.heard("halted")
        page.say("halt", net=9)
        assert (await page.heard("error"))["about"] == "halt"


class Hand:
    """Moves the machine through a page, as page.js does it."""

    def __init__(self, page: PageClient) -> None:
        self.page = page

    async def ready(self) -> None:
        self.page.say("take")
        self.page.move("enable", chain="arm")
        while self.page.pulse.get("chains", [{}])[0].get("state") != "following":
            await trio.sleep(0.1)
            self.page.move("renew")

    async def jog(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.1)):
            self.page.move("jog", chain="arm", velocities=[3000, 0])
            await trio.sleep(0.1)


@virtual_time
async def test_a_jog_moves_while_it_is_held_and_stops_when_the_page_hangs() -> None:
    async with web(3, 4, allow="motion") as world:
        arm = arm_of(world.service.master, 3, 4)
        async with world.page() as page:
            hand = Hand(page)
            await hand.ready()
            before = position_of(world.host, drives(world.host)[0])
            await hand.jog(1)
            assert is_moving(world.host)
            assert position_of(world.host, drives(world.host)[0]) > before
            assert page.pulse["lease"]["owner"] == (await page.heard("hello"))["you"]
            async with world.page() as other:
                other.say("take")
                assert "moves this machine" in (await other.heard("error"))["text"]
                await hand.jog(0.1)
            await trio.sleep(LEASE_TIME + 2)  # no message any more: a hidden page, a hung browser
            assert arm.state is ChainState.HALTED
            assert_all_halted(world.host)
            await assert_all_stand(world.host)
            assert page.pulse["lease"] == {"owner": None, "left": 0.0, "doing": "", "problem": "the lease is over"}


@virtual_time
async def test_nobody_else_keeps_the_lease_of_a_page_that_hangs() -> None:
    async with web(3, 4, allow="motion") as world:
        arm = arm_of(world.service.master, 3, 4)
        async with world.page() as page, world.page() as other:
            hand = Hand(page)
            await hand.ready()
            await hand.jog(0.5)
            for number in range(1000, 1030):
                other.say("renew", n=number)
                assert (await other.heard("error"))["code"] == "CO152"
                await trio.sleep(0.1)
            assert world.service.lease.owner is None
            assert arm.state is ChainState.HALTED


@virtual_time
async def test_a_page_that_is_gone_moves_nothing_any_more() -> None:
    async with web(3, 4, allow="motion") as world:
        arm = arm_of(world.service.master, 3, 4)
        async with world.page() as page:
            hand = Hand(page)
            await hand.ready()
            await hand.jog(1)
            assert is_moving(world.host)
        await trio.sleep(2)
        assert arm.state is ChainState.HALTED
        await assert_all_stand(world.host)
        assert world.service.lease.owner is None


@virtual_time
async def test_another_page_halts_it_also_where_it_may_only_read() -> None:
    async with web(3, 4, allow="motion") as world:
        arm = arm_of(world.service.master, 3, 4)
        async with world.page() as page, world.page() as other:
            hand = Hand(page)
            await hand.ready()
            await hand.jog(0.5)
            other.say("halt")
            assert (await other.heard("halted"))["problems"] == []
            assert arm.state is ChainState.HALTED
            await assert_all_stand(world.host)


@virtual_time
async def test_nothing_moves_without_its_permission() -> None:
    async with web(3, 4, allow="write,nmt,store,program,lss") as world:
        arm_of(world.service.master, 3, 4)
        async with world.page() as page:
            page.say("take")
            assert (await page.heard("error"))["code"] == "CO150"
            for kind in ("enable", "jog", "move", "renew", "stop", "disable"):
                page.move(kind, chain="arm", velocities=[1, 1], targets=[1, 1])
                assert (await page.heard("error"))["code"] == "CO152"


@virtual_time
async def test_a_page_that_hangs_is_cut_off_and_no_cycle_waits_for_it() -> None:
    """Five pages, one of them hung, while a chain follows set-points each 10 ms: not one SYNC is missed."""
    async with web(3, 4, limits=Limits(send_seconds=5)) as world:
        await moving(world)
        arm = world.service.master.chains["arm"]
        before = arm.sync_cycles, trio.current_time()
        async with world.page(reads=False) as hung, world.page() as one, world.page() as two, world.page() as three, world.page():
            for page in (hung, one, two, three):
                page.say("watch", objects=[PLACE, [1, 4, "6064:00"]], period=0.05)
            count = 0
            while trio.current_time() - before[1] < 6:
                count += len((await one.heard("values"))["values"])
            assert hung.ended.is_set()
            assert count == pytest.approx(1200, abs=30)
            assert one.pulse["k"] == "pulse"
        passed = trio.current_time() - before[1]
        assert arm.sync_cycles - before[0] == pytest.approx(passed / 0.01, abs=1)
        assert (arm.missed_cycles, arm.skipped_cycles) == (0, 0)


@virtual_time
async def test_a_page_that_is_slow_misses_messages_and_is_told() -> None:
    async with web(3, 4) as world:
        await moving(world)
        async with world.page() as page:
            page.say("watch", objects=[PLACE])
            await page.heard("values")
            await page._came.acquire()  # it takes nothing for a while
            await trio.sleep(3)
            page._came.release()
            told = await page.heard("dropped")
            assert told["messages"] > WAITING / 2


@virtual_time
async def test_who_may_open_it() -> None:
    async with web(3, limits=Limits(sessions=3)) as world:
        for headers in ({}, COOKIE, {**COOKIE, "origin": "http://evil.example"}, {**BEARER, "host": "evil.example:8402"}):
            async with world.page(headers) as page:
                assert page.closed == 1008
        async with world.page({**COOKIE, "origin": "http://localhost:8402"}) as page:
            assert (await page.heard("hello"))["mode"] == "read-only"
            async with world.page() as one_too_many:
                assert one_too_many.closed == 1013
        async with world.page() as again:
            await again.heard("hello")


@virtual_time
async def test_a_monitor_shows_what_is_asked_for_counts_the_rest_and_ends_when_it_is_told_to() -> None:
    async with web(3, 4) as world, world.page() as page:
        page.say("monitor", net=1, nodes=[3], services=["sdo"])
        await trio.sleep(0.2)
        await world.get("/1/4/objects/1000")
        await world.get("/1/3/objects/1000")
        told = await page.heard("frames", lambda each: each["rows"])
        assert {(row[0], row[3], row[4]) for row in told["rows"]} == {("frame", "SDO", 3)}
        assert "device_type" in told["rows"][0][5]
        assert told["seen"] >= 4
        assert told["fitting"] == 2
        page.say("monitor", on=False)
        await trio.sleep(1)
        page.messages.clear()
        await world.get("/1/3/objects/1000")
        await trio.sleep(1)
        assert [each for each in page.messages if each["k"] == "frames"] == []
        await moving(world)
        page.say("monitor", net=BUS)
        await trio.sleep(3)
        frames = [each for each in page.messages if each["k"] == "frames"]
        assert 15 <= len(frames) <= 31  # ten a second
        assert max(len(each["rows"]) for each in frames) <= 2 * MOST_ROWS
        assert (
            frames[-1]["left_out"] + sum(len([row for row in each["rows"] if row[0] == "frame"]) for each in frames)
            == frames[-1]["fitting"]
        )
        assert frames[-1]["left_out"] > 0  # 500 frames a second are more than anybody reads


@virtual_time
async def test_what_no_monitor_shows() -> None:
    async with web(3) as world, world.page() as page:
        wrong: list[dict[str, object]] = [
            {"net": 9}, {"nodes": [0]}, {"nodes": [True]}, {"nodes": ["3"]}, {"nodes": 3}, {"services": ["fly"]},
            {"services": [1]}, {"services": "sdo"}, {"nodes": [1e9]}, {"services": ["x" * 3000]},
        ]  # fmt: skip
        for fields in wrong:
            page.say("monitor", **fields)
            assert (await page.heard("error"))["about"] == "monitor", fields
        for _ in range(50):
            page.say("monitor")  # each in place of the one before
        await trio.sleep(1)
        assert len(world.service.traffic(BUS)._feeds) == 1


@virtual_time
async def test_a_monitor_whose_observer_has_failed_says_so() -> None:
    async with web(3) as world, world.page() as page:
        page.say("monitor")
        await trio.sleep(0.5)
        world.service.traffic(BUS).failure = ZeroDivisionError()
        assert "not understood" in (await page.heard("error"))["text"]


@virtual_time
async def test_a_hung_page_with_a_monitor_delays_no_cycle() -> None:
    """Five clients of a moving arm, one of them hung, each with a monitor and values: each SYNC comes, and when it is due."""
    async with web(3, 4) as world:
        await moving(world)
        arm = world.service.master.chains["arm"]
        async with (
            world.page(reads=False) as hung,
            world.page() as one,
            world.page() as two,
            world.page() as three,
            world.page() as four,
        ):
            pages = [hung, one, two, three, four]
            for page in pages:
                page.say("monitor")
                page.say("watch", objects=[PLACE, [1, 4, "6064:00"]], period=0.1)
            before = arm.sync_cycles
            await trio.sleep(5)
            assert arm.sync_cycles - before == pytest.approx(500, abs=1)
            assert (arm.missed_cycles, arm.skipped_cycles) == (0, 0)
            for page in (one, two, three, four):
                assert [each for each in page.messages if each["k"] == "values"]
                assert [each for each in page.messages if each["k"] == "frames"]
                assert page.pulse["chains"][0]["missed"] == 0


KINDS = ("monitor", "commission", "answer", "watch", "jog", "move", "enable", "take", "renew", "halt", "fly", "")
FIELDS = ("net", "node", "nodes", "services", "n", "question", "value", "name", "objects", "period", "chain", "on")
VALUES: tuple[object, ...] = (
    None, True, -1, 0, 1, 3, 127, 128, 1 << 70, 1.5, 1e300, "", "1", "3", "sdo", "arm", "\u202e", "<b>", "x" * 300, [], [3],
    ["sdo"], [[1, 3, "6064:00"]], [None], {}, {"net": 1},
)  # fmt: skip


@virtual_time
async def test_a_page_that_says_anything_is_answered_and_moves_nothing() -> None:
    drawn = random.Random(27)
    async with web(3, 4, allow="motion") as world, world.page() as page:
        arm_of(world.service.master, 3, 4)
        for _ in range(400):
            fields = {name: drawn.choice(VALUES) for name in drawn.sample(FIELDS, drawn.randrange(6))}
            page.say(drawn.choice(KINDS), **fields)
            await trio.sleep(0.01)
        page.messages.clear()
        page.say("fly")
        assert (await page.heard("error"))["about"] == "fly"  # it is still served
        await trio.sleep(10)
        assert not is_moving(world.host)
        assert (await world.get("/lease"))["owner"] is None
