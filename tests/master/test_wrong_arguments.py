"""Wrong arguments of the master's calls: each is refused at the call, in words, and nothing is registered or sent."""

from __future__ import annotations

import functools
import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data import DataError, read_chain_file
from canopen_data.descriptions import load_description
from canopen_master import ChainSettings, open_master
from canopen_master.blocking import open_master as open_blocking
from canopen_master.seconds import check_seconds, nanoseconds
from canopen_proto.heartbeat import NodeBooted
from canopen_proto.machine import SECOND, Event, LocalProtocolError
from canopen_proto.sdo.events import SdoDownloaded, SdoUploaded
from tests.loops import loop
from tests.master.world import BUS, arm_of, simulated, virtual_time

WRONG_KINDS: list[Any] = ["PdoReceived", None, [NodeBooted], int, (NodeBooted,)]


async def coroutine(event: Event) -> None: ...


class Asynchronous:
    async def __call__(self, event: Event) -> None: ...


WRONG_CALLBACKS: list[Any] = [None, "print", coroutine, functools.partial(coroutine), Asynchronous()]


@virtual_time
async def test_whatever_is_given_as_a_kind_of_event_the_call_refuses_what_is_none_and_the_master_lives() -> None:
    async with simulated(3), open_master(BUS) as master:
        node = master.node(3)
        watchers = list(master._dispatcher._watchers)
        for wrong in WRONG_KINDS:
            for call in (master.events, node.events):
                with pytest.raises(LocalProtocolError, match="is no kind of event; give classes derived from Event"):
                    call(wrong)
                with pytest.raises(LocalProtocolError, match="is no kind of event"):
                    call(NodeBooted, wrong)
            for watch in (master.watch, node.watch):
                with pytest.raises(LocalProtocolError, match="is no kind of event"):
                    watch((wrong,), print)
        for watch in (master.watch, node.watch):
            with pytest.raises(LocalProtocolError, match="events of which kinds"):
                watch((), print)
        assert master._dispatcher._watchers == watchers
        assert not master._subscriptions
        await node.reset()


@pytest.mark.parametrize("wrong", WRONG_CALLBACKS)
@virtual_time
async def test_a_callback_that_nobody_could_call_or_await_is_refused_at_the_call(wrong: Any) -> None:
    async with simulated(3), open_master(BUS) as master:
        node = master.node(3)
        watchers = list(master._dispatcher._watchers)
        for watch in (master.watch, node.watch):
            with pytest.raises(LocalProtocolError, match="callback .* (cannot be called|is a coroutine function)"):
                watch((NodeBooted,), wrong)
        assert master._dispatcher._watchers == watchers
        await node.reset()


def test_on_of_a_blocking_master_and_node_refuses_the_same() -> None:
    with open_blocking("virtual:wrong") as master:
        ons: list[Callable[..., Any]] = [master.on, master.node(3).on]
        for on in ons:
            for kind in (*WRONG_KINDS[:4], ("x", NodeBooted), ()):
                with pytest.raises(LocalProtocolError, match="kind"):
                    on(kind, print)
            for callback in WRONG_CALLBACKS:
                with pytest.raises(LocalProtocolError, match="callback"):
                    on(NodeBooted, callback)


# ---- seconds ----

NO_NODES: list[Any] = [5, None, "node"]
NO_DICTIONARIES: list[Any] = [5, b"sample_io.eds", ["sample_io.eds"]]
NO_SECONDS: list[Any] = [-1, -0.001, math.nan, -math.inf, "2", b"2", None, True, [1.0]]


@pytest.mark.parametrize("wrong", [*NO_SECONDS, 0])
@virtual_time
async def test_a_time_limit_that_is_none_is_refused_by_its_name_and_nothing_is_sent(wrong: Any) -> None:
    async with simulated(3) as host, open_master(BUS) as master:
        node = master.node(3)
        arm = arm_of(master, 3)
        before = host.nodes[0].state
        sent: list[Any] = []
        for kind in (NodeBooted, SdoUploaded, SdoDownloaded):
            master.watch((kind,), sent.append)
        awaited: list[Callable[[], Awaitable[object]]] = [
            lambda: node.reset(wrong),
            lambda: node.wait_for_boot(wrong),
            lambda: node.wait_for_heartbeat(wrong),
        ]
        for wait in awaited:
            with pytest.raises(LocalProtocolError, match="^timeout is .*; give seconds, above 0"):
                await wait()
        with pytest.raises(LocalProtocolError, match="^guard_time is .*; give a finite number of seconds, above 0"):
            node.start_guarding(wrong)
        with pytest.raises(LocalProtocolError, match="^period is .*; give a finite number of seconds, above 0"):
            master.sync_start(wrong)
        with pytest.raises(LocalProtocolError, match="^cycle_time is"):
            ChainSettings(cycle_time=wrong)
        if wrong != 0:
            with pytest.raises(LocalProtocolError, match="^timeout is .*seconds, 0 or more"):
                node.supervise_heartbeat(wrong)
        if wrong not in (0, None):
            with pytest.raises(LocalProtocolError, match="^patience is"):
                await node.read_bytes(0x1000, 0, patience=wrong)
            with pytest.raises(LocalProtocolError, match="^patience is"):
                await node.write_bytes(0x1017, 0, bytes(2), patience=wrong)
            with pytest.raises(LocalProtocolError, match="^renew_within is"):
                async with arm.jog(renew_within=wrong):
                    pass
        if wrong is not None:
            with pytest.raises(LocalProtocolError, match="^sdo_timeout is"):
                open_master(BUS, sdo_timeout=wrong)
        if wrong not in (0, None):
            with pytest.raises(LocalProtocolError, match="^heartbeat_timeout is"):
                open_master(BUS, heartbeat_timeout=wrong)
        await loop.sleep(0.1)
        assert not sent
        assert host.nodes[0].state is before
        assert not master.sync_period
        await node.reset(math.inf)  # a wait may be without a limit


@pytest.mark.parametrize("wrong", [each for each in NO_SECONDS if each is not None])
def test_a_timeout_of_a_blocking_call_is_refused_by_its_name(wrong: Any) -> None:
    with open_blocking("virtual:wrong") as master:
        node = master.node(3)
        arm = master.load_chains(text="arm joint1 virtual:wrong 3")["arm"]
        calls: list[Callable[[], object]] = [
            lambda: node.read("statusword", timeout=wrong),
            lambda: node.events(NodeBooted).receive(timeout=wrong),
            lambda: arm.move([1.0], timeout=wrong),
            lambda: master.in_loop(print, timeout=wrong),
        ]
        for call in calls:
            with pytest.raises(LocalProtocolError, match="^timeout is .*; give seconds, 0 or more"):
                call()


@given(st.floats(0.0, 1e9) | st.integers(0, 10**9) | st.fractions(0, 10**9))
def test_whatever_is_a_number_of_seconds_is_taken(seconds: float) -> None:
    assert check_seconds("x", seconds) == float(seconds)
    assert nanoseconds("x", seconds) == round(float(seconds) * SECOND)


def test_a_number_beyond_all_times_is_refused_by_its_name() -> None:
    with pytest.raises(LocalProtocolError, match="^x is larger than any time; give a finite number of seconds, 0 or more"):
        check_seconds("x", 10**5000)


# ---- what a blocking node is not ----


def test_a_blocking_node_is_no_container_and_says_where_its_objects_are() -> None:
    with open_blocking("virtual:wrong") as master:
        node = master.node(3)
        with pytest.raises(TypeError, match="'statusword' in node.dictionary"):
            "statusword" in node  # noqa: B015
        with pytest.raises(TypeError, match="for each in node.dictionary"):
            list(node)
        assert "statusword" in node.dictionary
        assert next(iter(node.dictionary)).index >= 0x1000


# ---- a node's dictionary, and what a drive is ----


@virtual_time
async def test_a_node_in_use_with_another_dictionary_says_with_which_and_what_to_do() -> None:
    async with open_master(BUS) as master:
        node = master.node(6)
        with pytest.raises(LocalProtocolError) as refused:
            master.node(6, "sample_io.eds")
        assert str(refused.value) == (
            f"node 6 on {BUS} is in use with another dictionary: installed indices.csv; "
            "give sample_io.eds at the first call of `node`, and none at later ones"
        )
        assert master.node(6) is node


@virtual_time
async def test_a_node_that_is_no_drive_is_refused_as_one_in_words() -> None:
    async with open_master(BUS) as master:
        node = master.node(6, "sample_io.eds", pdos=False)
        with pytest.raises(LocalProtocolError, match="^node 6 is no drive by sample_io.eds: that has no 0x6040:00; a drive"):
            master.device(node)
        with pytest.raises(LocalProtocolError, match="has no axis 1"):
            master.device(node, axis=1)
        for wrong in NO_NODES:
            with pytest.raises(LocalProtocolError, match="is no node of this master; give one, as master.node"):
                master.device(wrong)
        for no_dictionary in NO_DICTIONARIES:
            with pytest.raises(LocalProtocolError, match="give the path of a file, or an ObjectDictionary"):
                master.node(7, no_dictionary)
        assert not master.devices
        assert len(master._nodes) == 1


@virtual_time
async def test_a_file_that_nobody_named_is_asked_for() -> None:
    async with open_master(BUS) as master:
        with pytest.raises(LocalProtocolError, match="load_chains: chains of which file"):
            master.load_chains()
        for load in (load_description, lambda path: master.node(6, path), read_chain_file):
            with pytest.raises(DataError, match="CO330: '' is no path of a file"):
                load("")


@pytest.mark.parametrize("wrong", [None, 5, ["x"]])
def test_what_is_no_path_is_no_type_error(wrong: Any) -> None:
    for load in (load_description, read_chain_file):
        with pytest.raises(DataError, match="CO330: .* is no path of a file"):
            load(wrong)


# ---- kinds of arguments that Python alone would meet deep inside ----


@virtual_time
async def test_whatever_is_given_as_a_key_or_as_bytes_the_call_names_it_and_sends_nothing() -> None:
    async with simulated(3), open_master(BUS) as master:
        node = master.node(3)
        sent: list[Event] = []
        master.watch((SdoUploaded, SdoDownloaded), sent.append)
        keys: list[Any] = [None, 5.5, b"x", (0x1018,), (1, 2, 3), (None, 1), ("a", 1), (0x1018, "1")]
        for key in keys:
            calls: list[Callable[[], Awaitable[object]]] = [
                lambda key=key: node.read(key),  # type: ignore[misc]
                lambda key=key: node.read_message(key),  # type: ignore[misc]
                lambda key=key: node.read_int(key),  # type: ignore[misc]
                lambda key=key: node.read_bytes(key),  # type: ignore[misc]
                lambda key=key: node.write(key, 5),  # type: ignore[misc]
                lambda key=key: node.matches(key, "x"),  # type: ignore[misc]
            ]
            for call in calls:
                with pytest.raises(LocalProtocolError, match="(names no object; give a name, an index)|(give an index of)"):
                    await call()
        places: list[tuple[Any, Any]] = [("1017", 0), (None, 0), (0x1017, None), (1.5, 0), (-1, 0), (0x1017, 256), (0x10000, 0)]
        for index, subindex in places:
            with pytest.raises(LocalProtocolError, match="give an index of 0..0xFFFF and a subindex of 0..0xFF"):
                await node.write_bytes(index, subindex, b"ab")
            with pytest.raises(LocalProtocolError, match="give an index of 0..0xFFFF"):
                await node.write_stream(index, subindex, [b"ab"])
        texts: list[Any] = ["ab", None, 5, [1, 2]]
        for data in texts:
            with pytest.raises(LocalProtocolError, match="data .* is no bytes; give bytes"):
                await node.write_bytes(0x1017, 0, data)
        assert not sent
        await node.write_bytes(0x1017, 0, bytes(2))
        assert sent


@virtual_time
async def test_what_is_no_procedure_is_refused_and_a_coroutine_is_not_run_as_one() -> None:
    async with simulated(3), open_master(BUS) as master:
        asked = master.node(3).read("statusword")
        nothing: list[Any] = [None, print, asked, 5]
        for wrong in nothing:
            with pytest.raises(LocalProtocolError, match="procedure .* is none; give one of canopen_proto.procedures"):
                await master.run(wrong)
        await asked


@virtual_time
async def test_what_is_no_path_and_no_function_of_torques_never_moves_a_joint() -> None:
    async with simulated(3), open_master(BUS) as master:
        arm = arm_of(master, 3)
        await arm.initialise()
        await arm.home()
        stood = arm.positions
        paths: list[Any] = [5, "x", [1]]
        for path in paths:
            with pytest.raises(LocalProtocolError, match="path .* is none; give a path, as `cubic`"):
                await arm.follow(path)
            with pytest.raises(LocalProtocolError, match="torques .* is none; give a function"):
                await arm.follow(torques=path)
            with pytest.raises(LocalProtocolError, match="torques .* is none; give a function"):
                await arm.move([1.0], torques=path)
        made: Any = lambda start: None  # noqa: E731
        with pytest.raises(LocalProtocolError, match="the function that was given as a path returned None"):
            await arm.follow(made)
        assert arm.positions == stood
        await arm.move([1.0])


@pytest.mark.parametrize(
    ("arguments", "options", "words"),
    [
        ((None,), {}, "the locator of bus0 is None; give one as"),
        ((5,), {}, "the locator of bus0 is 5"),
        ((b"virtual:a",), {}, "the locator of bus0 is b'virtual:a'"),
        (((["virtual:a"]),), {}, "the locator of bus0 is"),
        ((), {"buses": {"left": 5}}, "the locator of left is 5"),
        ((), {"buses": 5}, "buses is 5; give locators by name"),
        ((), {"machine": 5}, "machine is 5; give the path of a machine file"),
        (("virtual:a",), {"dictionary": "sample_io.eds"}, "dictionary is 'sample_io.eds'; give ObjectDictionary"),
        (("virtual:a",), {"watchdog": 5}, "watchdog is 5; give Watchdog"),
        (("virtual:a",), {"realtime": 5}, "realtime is 5; give Realtime"),
    ],
)
def test_open_master_refuses_what_it_cannot_open_at_the_call(arguments: Any, options: Any, words: str) -> None:
    for opens in (open_master, open_blocking):
        with pytest.raises(LocalProtocolError, match=words):
            opens(*arguments, **options)
