"""The lease for clients that speak JSON: who moves the machine, and what a message of anybody does. In virtual time."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st

from canopen_gateway import GatewayError, LeaseError, QueryRefusedError
from canopen_gateway.fleet.leading import INTENTS, RemoteLead
from canopen_gateway.lease import LEASE_TIME
from canopen_master import ChainState, UnknownChainError
from tests.examples import examples
from tests.gateway.gateway_world import gateway
from tests.gateway.test_lease import is_moving, machine
from tests.master.world import assert_all_halted, virtual_time

ONE, OTHER = "1" * 32, "2" * 32


class Client:
    """One client, with its proof and its numbers."""

    def __init__(self, lead: RemoteLead, proof: str = ONE) -> None:
        self.lead = lead
        self.proof = proof
        self.number = 0
        self.term: object = ""
        self.said: list[bytes] = []

    def say(self, do: str, **what: Any) -> dict[str, object]:
        self.number += 1
        message = {"client": self.proof, "term": self.term, "sequence": self.number, "do": do, **what}
        self.said.append(json.dumps(message).encode())
        told = self.lead.say(self.said[-1])
        self.term = told["term"]
        return told

    async def hold(self, seconds: float, *again: Any, **what: Any) -> None:
        """Renew the lease for so long, or say something again."""
        end = trio.current_time() + seconds
        while trio.current_time() < end:
            self.say(*(again or ("renew",)), **what)
            await trio.sleep(0.1)

    async def ready(self, chain: str) -> None:
        """Take the lease, and give a chain power."""
        self.say("take")
        told = self.say("enable", chain=chain)
        while told["doing"]:
            await trio.sleep(0.1)
            told = self.say("renew")
        assert not told["problem"]


@virtual_time
async def test_a_jog_ends_when_its_client_is_no_longer_heard() -> None:
    async with machine() as (host, service, arm):
        client = Client(RemoteLead(service.lease))
        await client.ready(arm.name)
        await client.hold(0.5, "jog", chain=arm.name, velocities=[0.2, 0.0])
        assert is_moving(host)
        await trio.sleep(LEASE_TIME + 3)
        assert service.lease.owner is None
        assert arm.state is ChainState.HALTED
        assert_all_halted(host)


@virtual_time
async def test_a_move_and_what_ends_it() -> None:
    async with machine() as (host, service, arm):
        client = Client(RemoteLead(service.lease))
        await client.ready(arm.name)
        client.say("move", chain=arm.name, targets=[1.0, 0.5], speed=0.5)
        await client.hold(0.5)
        assert is_moving(host)
        client.say("stop")
        await client.hold(2.0)
        assert not is_moving(host)
        told = client.say("disable", chain=arm.name)
        assert told["doing"] == "disable"
        await client.hold(2.0)
        client.say("leave")
        await trio.sleep(1)
        assert service.lease.owner is None
        assert arm.state is ChainState.OFF


@virtual_time
async def test_another_proof_is_another_client_and_an_old_number_moves_nothing() -> None:
    async with machine() as (_, service, _arm):
        lead = RemoteLead(service.lease)
        one, other = Client(lead), Client(lead, OTHER)
        one.say("take")
        with pytest.raises(LeaseError, match="moves this machine"):
            other.say("take")
        for do in INTENTS[1:]:
            with pytest.raises(LeaseError, match="does not have the lease"):
                other.say(do, chain="arm", velocities=[0, 0], targets=[0, 0])
        one.say("renew")
        one.number -= 1
        with pytest.raises(LeaseError, match="an old message"):
            one.say("renew")


@virtual_time
async def test_after_the_end_of_a_lease_its_numbers_begin_anew_for_who_takes_it() -> None:
    async with machine() as (_, service, _arm):
        lead = RemoteLead(service.lease)
        one, other = Client(lead), Client(lead, OTHER)
        one.say("take")
        await trio.sleep(LEASE_TIME + 1)
        with pytest.raises(LeaseError, match="does not have the lease"):
            one.say("renew")
        other.say("take")
        other.say("renew")


@virtual_time
async def test_a_message_of_an_earlier_lease_moves_nothing_though_its_client_has_the_lease_again() -> None:
    """What was recorded, or came late over a network, is sent once more: with the proof, and with numbers above the first."""
    async with machine() as (host, service, arm):
        lead = RemoteLead(service.lease)
        one = Client(lead)
        await one.ready(arm.name)
        await one.hold(0.3, "jog", chain=arm.name, velocities=[0.2, 0.0])
        recorded = [each for each in one.said if b"take" not in each]
        await trio.sleep(LEASE_TIME + 3)
        again = Client(lead)  # the same proof, and numbers from 1 on
        await again.ready(arm.name)
        for message in recorded:
            with pytest.raises(LeaseError, match="another lease"):
                lead.say(message)
        assert service.lease.doing == ""
        assert not is_moving(host)
        again.say("renew")  # and whoever has it goes on


@virtual_time
async def test_a_whole_lease_that_is_said_once_more_moves_nothing() -> None:
    async with machine() as (host, service, arm):
        lead = RemoteLead(service.lease)
        one = Client(lead)
        await one.ready(arm.name)
        await one.hold(0.3, "jog", chain=arm.name, velocities=[0.2, 0.0])
        await trio.sleep(LEASE_TIME + 3)
        for message in one.said:
            if b'"take"' in message:
                lead.say(message)  # holds the lease for its time, and no longer
                continue
            with pytest.raises(LeaseError):
                lead.say(message)
        assert not is_moving(host)
        await trio.sleep(LEASE_TIME + 3)
        assert service.lease.owner is None


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=True) | st.text(max_size=20) | st.just(ONE),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=10), inner, max_size=3),
    max_leaves=5,
)
messages = st.fixed_dictionaries(
    {},
    optional={
        "client": st.just(ONE) | anything,
        "sequence": st.integers(0, 10) | anything,
        "do": st.sampled_from(INTENTS) | anything,
        "chain": st.just("arm") | anything,
        "velocities": st.lists(st.floats(), max_size=3) | anything,
        "targets": st.lists(st.floats(), max_size=3) | anything,
        "speed": st.floats() | anything,
    },
).map(lambda said: json.dumps(said).encode()) | st.binary(max_size=40)


def is_take(message: bytes) -> bool:
    """Whether a message takes the lease, with a proof that is long enough."""
    try:
        said = json.loads(message)
    except ValueError:
        return False
    return (
        isinstance(said, dict) and said.get("do") == "take" and isinstance(said.get("client"), str) and len(said["client"]) >= 16
    )


@examples(100)
@given(st.lists(messages, max_size=6))
def test_no_message_of_anybody_is_more_than_refused(said: list[bytes]) -> None:
    """Whatever is said, a client is answered, or refused by one of our own errors; and without the proof nobody has the lease."""

    async def run() -> None:
        async with gateway(allow="motion") as (_, service):
            lead = RemoteLead(service.lease)
            has_taken = False
            for each in said:
                with contextlib.suppress(GatewayError, UnknownChainError):
                    lead.say(each)
                has_taken = has_taken or is_take(each)
                assert service.lease.owner is None or has_taken

    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0))


@virtual_time
async def test_what_is_wrong_in_a_message_is_named() -> None:
    async with machine() as (_, service, _arm):
        client = Client(RemoteLead(service.lease))
        client.say("take")
        with pytest.raises(QueryRefusedError, match='"velocities" is a list of numbers'):
            client.say("jog", chain="arm")
        for number in (float("nan"), float("inf"), 10**400, True):
            with pytest.raises(QueryRefusedError, match="is no number"):
                client.say("jog", chain="arm", velocities=[number, 0.0])
        with pytest.raises(LeaseError, match="no chain 'nobody'"):
            client.say("enable", chain="nobody")
