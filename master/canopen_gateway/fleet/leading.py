"""`RemoteLead`: the lease of a machine (lease.py), for clients that speak JSON and have no connection of their own.

    {"client": "1f3a...", "term": "9c0e...", "sequence": 7, "do": "jog", "chain": "arm", "velocities": [0.1, 0.0]}

client: a random text that each client makes and keeps for itself: the proof that two messages are of one client.
term: what the answer to `take` said; every other message has it. Each lease has another one, so a message of an earlier lease,
which was delayed or is sent once more, is refused also where its client has taken the lease anew.
sequence: greater in each message. do: take, renew, enable, jog, move (targets, speed), stop, disable, leave. Whoever has the
lease and is not heard for 300 ms by the clock of this computer has it no longer, and what it moved is halted.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from typing import Any, Final

from canopen_gateway.errors import LeaseError, QueryRefusedError
from canopen_gateway.lease import Lease
from canopen_gateway.places import json_said, number_said

LEAST_PROOF: Final = 16
"""The fewest signs by which a client proves itself."""
INTENTS: Final = ("take", "renew", "enable", "jog", "move", "stop", "disable", "leave")


class _Holder:
    """A client that has the lease, or wants it. name: for people; the proof stays here. term: of this lease alone."""

    def __init__(self, proof: str) -> None:
        self.proof = proof
        self.term = secrets.token_hex(8)
        self.name = "a viewer of the fleet"


class RemoteLead:
    """See this module's text."""

    def __init__(self, lease: Lease) -> None:
        self._lease = lease
        self._holder: _Holder | None = None

    def say(self, payload: bytes) -> dict[str, object]:
        """Do what a message says; return what there is to tell of the lease. Raises QueryRefusedError, LeaseError,
        NotAllowedError, UnknownChainError."""
        said = _mapping(payload)
        proof, sequence, do = said.get("client"), said.get("sequence", 0), said.get("do")
        if not isinstance(proof, str) or len(proof) < LEAST_PROOF:
            raise QueryRefusedError(f'"client" is a random text of at least {LEAST_PROOF} signs')
        if not isinstance(sequence, int) or isinstance(sequence, bool):
            raise QueryRefusedError('"sequence" is a whole number')
        if do not in INTENTS:
            raise QueryRefusedError(f'"do" is {", ".join(INTENTS)}')
        lease, holder = self._lease, self._holder
        if holder is None or holder.proof != proof or lease.owner is not holder:
            if do != "take":
                raise LeaseError("this client does not have the lease, or not any more", tries=("take it first",))
            holder = _Holder(proof)
        elif do != "take" and said.get("term") != holder.term:
            raise LeaseError(
                "a message of another lease was refused", seen='its "term" is not the one that the answer to `take` gave'
            )
        chain = str(said.get("chain", ""))
        match do:
            case "take":
                lease.take(holder)
                self._holder = holder
            case "renew":
                lease.renew(holder, sequence)
            case "enable":
                lease.enable(holder, sequence, chain)
            case "disable":
                lease.disable(holder, sequence, chain)
            case "jog":
                lease.jog(holder, sequence, chain, _numbers(said, "velocities"))
            case "move":
                targets, speed = _numbers(said, "targets"), _number(said.get("speed", 1.0), "speed")
                lease.move(holder, sequence, chain, targets, speed=speed)
            case "stop":
                lease.stop(holder, sequence)
            case "leave":
                lease.leave(holder)
        return {"left": lease.left, "doing": lease.doing, "problem": lease.problem, "term": holder.term}


def _mapping(payload: bytes) -> Mapping[str, Any]:
    try:
        said = json_said(payload)
    except ValueError as error:
        raise QueryRefusedError(f"the payload is no JSON that is understood: {error}") from error
    if not isinstance(said, dict):
        raise QueryRefusedError("the payload is no JSON object")
    return said


def _numbers(said: Mapping[str, Any], name: str) -> list[float]:
    values = said.get(name)
    if not isinstance(values, list):
        raise QueryRefusedError(f'"{name}" is a list of numbers')
    return [_number(each, name) for each in values]


def _number(value: object, name: str) -> float:
    number = number_said(value)
    if number is None:
        raise QueryRefusedError(f'"{name}": {str(value)[:40] if isinstance(value, float) else "this"} is no number')
    return number
