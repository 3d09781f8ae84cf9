"""Decides, when a frame has won the arbitration, how its transmission will end: by the fault rates and the seed."""

from __future__ import annotations

from random import Random

from canopen_proto.frame import Frame
from canopen_proto.frame_bits import FRAME_TAIL, INTERMISSION, stuff_bits, stuffed_part
from canopen_transports.errors import BusState
from canopen_transports.wire.faults import FaultKind, FaultRates
from canopen_transports.wire.member import WireMember
from canopen_transports.wire.segment import CableSegment, Transmission


def decide(sending: Transmission, segment: CableSegment, rates: FaultRates, random: Random, acknowledge: bool, bits: int) -> int:
    """Set the outcome and the victim of a transmission. Returns the number of bits until that shows. bits: of the frame.

    A frame that nobody acknowledges is a LOSS with its sender as the victim.
    """
    frame, senders = sending.waiting.frame, sending.senders
    if len(senders) > 1:
        others = [member.sending.frame for member in senders if member.sending is not None]
        place = min((first_difference(frame, other) for other in others if other != frame), default=0)
        if place:
            sending.outcome = FaultKind.COLLISION
            return place
    hearing = segment.others(senders)[0]
    if not hearing and acknowledge:
        sending.outcome, sending.victim = FaultKind.LOSS, senders[0]
        return bits - FRAME_TAIL + 2
    total = rates.total
    if total and (draw := random.random()) < total:
        return _hit(sending, hearing, rates, random, draw, bits)
    return bits - INTERMISSION


def _hit(
    sending: Transmission, hearing: tuple[WireMember, ...], rates: FaultRates, random: Random, draw: float, bits: int
) -> int:
    if draw < rates.corruption:
        sending.victim = random.choice([*sending.senders, *hearing])
        if sending.victim in hearing and sending.victim.state is BusState.PASSIVE:
            sending.outcome = FaultKind.LOSS  # its error flag is recessive and disturbs nobody
            return bits - INTERMISSION
        sending.outcome = FaultKind.CORRUPTION
        return random.randint(1, bits - INTERMISSION - 1)
    if draw < rates.corruption + rates.repetition:
        sending.outcome = FaultKind.REPETITION
    elif hearing:
        sending.outcome = FaultKind.LOSS if draw < rates.corruption + rates.repetition + rates.loss else FaultKind.DELAY
        sending.victim = random.choice(hearing)
    return bits - INTERMISSION


def first_difference(one: Frame, other: Frame) -> int:
    """Return the place of the first bit in which two frames with one arbitration field differ, from 1 on; stuff bits count."""
    (first, first_count), (second, second_count) = stuffed_part(one), stuffed_part(other)
    common = min(first_count, second_count)
    first >>= first_count - common
    second >>= second_count - common
    place = common - (first ^ second).bit_length() + 1
    return place + stuff_bits(first >> common - place + 1, place - 1)
