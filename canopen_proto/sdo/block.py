"""Block transfer: the frames, and what both of its sides share.

In a block transfer up to 127 segments of seven bytes go one behind the other, a *sub-block*, before the receiver acknowledges
them all with one frame, in which it also says how long the next sub-block may be. So 1 MiB takes 149 797 segments and 1180
acknowledgements; a segmented transfer takes twice as many frames, each waiting for the one before.
CiA 301 v4.2.0, 7.2.4.3.8 to 7.2.4.3.16.

                          download (client to server)           upload (server to client)         bytes 1..7
    initiate              C 110x xcs0    S 101x xs00            C 101x xc00    S 110x xcs0        index (2), subindex, then below
    start                                                       C 1010 0011
    segment               C fqqq qqqq                           S fqqq qqqq                       7 of data
    acknowledgement       S 1010 0010                           C 1010 0010                       ackseq, block size
    end                   C 110n nn01                           S 110n nn01                       CRC (2)
    end response          S 1010 0001                           C 1010 0001

    c CRC is supported   s size is indicated   f final segment   q sequence number, 1..127   n unused bytes of the final segment

    initiate: byte 4 is the block size where the receiver sends it, bytes 4..7 are the size where the sender does; an upload's
    request has the protocol switch threshold (pst) in byte 5. Each side says what it can; there is a CRC if both can.

After the initiation both directions are alike: `BlockSender` (block_sender.py) is the side that has the data, `BlockReceiver`
(block_receiver.py) the other. block_client.py and block_server.py say how each role begins and ends them.

Loss. The receiver takes segments in order only. If one is missing, it acknowledges those before the gap at the end of the
sub-block, and the sender goes on with the one that is missing. Segments that are sent again are numbered from 1 again.

Pauses. A silence inside a sub-block may be a loss, or a sender that pauses: senders put a whole sub-block into a queue, and an
acknowledgement that comes while the rest of it waits there confuses both sides. So a silence counts as a pause for
`silence_limit`: 1 s, or the time-out if that is longer. Only then does the receiver acknowledge what came, once; after a second
silence of that length it gives up. The sender waits twice as long for an acknowledgement, so that it hears the answer to a loss.

Copies. CAN can deliver a frame twice, immediately. The second copy of a segment does not have the number that is due. (With a
block size of 1 it would have, so a receiver never asks for that.) The second copy of an acknowledgement comes before anything of
the next sub-block was sent. That is why an acknowledgement sends nothing by itself: the sub-block goes out in the turn after, or
`copy_guard` later.

Bursts. 127 segments at once overflow a transmit queue (a SocketCAN interface has room for ten frames by default). In one turn at
most `max_burst` segments go into the outbox. The deadline for the rest is `burst_interval` later; with 0, the default, that is as
soon as the driver has sent what it drained. So a driver whose sending waits for room is never ahead of the bus by more than
`max_burst` frames; one that queues without bound holds a sub-block at most, 127 frames; one that can do neither sets
`burst_interval` to the time that a burst takes on its bus (8 frames: 1 ms at 1 Mbit/s, 9 ms at 125 kbit/s).

The CRC is that of CCITT: polynomial 0x1021, initial value 0, over the data without what is unused of the last segment.
"""

from __future__ import annotations

import struct
from typing import Final

from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.sdo.codec import (
    BLOCK_SIZE_BIT,
    BLOCK_UPLOAD,
    CRC_BIT,
    END_RESPONSE,
    FINAL,
    LEAST_INITIATE,
    SEQUENCE,
    pack_initiate,
)

END_RESPONSE_PAYLOAD: Final = bytes((END_RESPONSE,)).ljust(8, b"\x00")
MAX_BLOCK_SIZE: Final = 127
"""Segments in a sub-block: their numbers have seven bits."""
SEGMENT_SIZE: Final = 7
"""Bytes of data in a segment."""
FRAME_SIZE: Final = 1 + SEGMENT_SIZE
"""Bytes of a segment's frame: its number, and the data."""
MAX_SIZE: Final = 0xFFFFFFFF
"""Bytes: what the size field of an initiate frame can say."""
SUB_BLOCK_SIZE: Final = MAX_BLOCK_SIZE * SEGMENT_SIZE
"""Bytes of data in the longest sub-block: what has to be held for repetition, and the largest piece of a stream."""

MAX_BURST: Final = 8
"""Segments that go out in one turn: a SocketCAN interface queues ten frames by default, and others want to send too."""
LEAST_SILENCE: Final = 1 * SECOND
"""A silence inside a block transfer that is shorter counts as a pause. A well-known C stack repairs a loss after 0.7 s."""
COPY_TIME: Final = 100 * MILLISECOND
"""How long after an initiate request the same bytes are its second copy, and not a client that asks again."""
STREAM_TIMEOUT: Final = 5 * SECOND
"""How long the caller that feeds or takes a stream may need for each piece: reading and writing files takes less."""
MAX_STALLS: Final = 10
"""How many sub-blocks in a row may arrive without their first segment before the transfer is aborted."""

MOST_LOST: Final = 2
"""How many segments may be missing in a run that comes out of place: the one after the gap is still recognised."""

ACKNOWLEDGE: Final = struct.Struct("<BBB5x")
"""Command, ackseq, block size."""
END_FRAME: Final = struct.Struct("<BH5x")
"""Command, CRC."""
INITIATE_BY_RECEIVER: Final = struct.Struct("<BHBB3x")
"""Command, index, subindex, block size."""


def silence_limit(timeout: Time) -> Time:
    """Return the longest pause that a side with this time-out survives inside a block transfer, in ns. timeout: its own, ns."""
    return max(timeout, LEAST_SILENCE)


def is_next(command: int, due: int) -> bool:
    """Return whether a frame that comes out of place continues a run of segments whose next number is `due`, or begins one.
    command: its command byte."""
    sequence = command & SEQUENCE
    return 0 < sequence < LEAST_INITIATE or due <= sequence <= due + MOST_LOST


def next_number(command: int) -> int:
    """Return the number after that segment in its sub-block; above MAX_BLOCK_SIZE if it is the last. command: its command
    byte."""
    return MAX_BLOCK_SIZE + 1 if command & FINAL else (command & SEQUENCE) + 1


def sender_initiate(specifier: int, index: int, subindex: int, size: int | None, crc: bool) -> bytes:
    """Make the initiate frame of the side that has the data: a client's for a download, a server's for an upload. .9, .13
    specifier: 0xC0 for either. size: of the whole, bytes; None: not known. crc: this side has it."""
    command = specifier | (CRC_BIT if crc else 0) | (0 if size is None else BLOCK_SIZE_BIT)
    return pack_initiate(command, index, subindex, size or 0)


def receiver_initiate(index: int, subindex: int, block_size: int, crc: bool) -> bytes:
    """Make the initiate frame of the other side: a server's for a download, a client's for an upload (with pst = 0). .9, .13
    block_size: segments in the first sub-block, 1 to 127. crc: this side has it."""
    return INITIATE_BY_RECEIVER.pack(BLOCK_UPLOAD | (CRC_BIT if crc else 0), index, subindex, block_size)


def chosen_block_size(block_size: int) -> int:
    """Return the block size that a receiver asks for: 2..127; see "Copies"."""
    return max(2, min(block_size, MAX_BLOCK_SIZE))
