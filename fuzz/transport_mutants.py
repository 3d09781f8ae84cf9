"""Planted bugs of transports. No fuzz target knows them; tests find them."""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

QUEUE: Final = ("tests/transports/test_python_can_options.py",)
SERVER: Final = ("tests/transports/test_tcp_server.py", "tests/transports/test_tcp.py")
FRAMING: Final = ("tests/transports/test_tcp_framing.py",)
PYTHON_CAN: Final = ("tests/transports/test_python_can.py",)
READERS: Final = ("tests/transports/test_readers.py",)
PCAN: Final = ("tests/pcan/test_pcan.py",)
CLIENT: Final = ("tests/transports/test_tcp.py",)
WIRE: Final = ("tests/transports/test_wire_machine.py", "tests/transports/test_wire_confinement.py")
ARBITRATION: Final = ("tests/transports/test_wire_arbitration.py",)

_QUEUE: Final = "canopen_transports/receive_queue.py"
_OUTGOING: Final = "canopen_transports/tcp/server.py"
_SERVER: Final = "canopen_transports/tcp/server.py"
_PYTHON_CAN: Final = "canopen_transports/python_can.py"
_WIRE: Final = "canopen_transports/wire/wire.py"

TRANSPORT_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        (
            "lost_frames_uncounted",
            _QUEUE,
            "                last.count += 1",
            "                last.count += 0",
            "frames that a full queue drops are counted as one",
            QUEUE,
        ),
        (
            "overruns_do_not_add_up",
            _QUEUE,
            "self._locator, last.lost + report.lost, report.seen",
            "self._locator, report.lost, report.seen",
            "of several overruns that nobody has taken, the last one is told",
            QUEUE,
        ),
        (
            "lost_lines_uncounted",
            _OUTGOING,
            "            self._lost += 1\n            return",
            "            self._lost = 1\n            return",
            "a slow client hears of one lost frame, however many there were",
            FRAMING,
        ),
        (
            "lost_at_the_wrong_place",
            _OUTGOING,
            "        if self._lost and not lines:",
            "        if False:",
            "a slow client does not hear where frames are missing",
            FRAMING,
        ),
        (
            "anybody_is_a_member",
            _SERVER,
            'elif b"\\n" in chunk or member.deadline == math.inf:',
            "elif True:",
            "a client that never ends its line stays connected",
            SERVER,
        ),
        (
            "any_number_of_connections",
            _SERVER,
            "if len(self._connections) >= 2 * MAX_CONNECTIONS:",
            "if False:",
            "clients that say nothing take all descriptors of the server",
            SERVER,
        ),
        (
            "half_a_line",
            "canopen_transports/tcp/client.py",
            "(shield=True, deadline=self._loop.current_time() + ROOM_TIME) as limit:\n            while rest:",
            "(deadline=self._loop.current_time() + ROOM_TIME) as limit:\n            while rest:",
            "a cancelled sender leaves half a frame on the line",
            CLIENT,
        ),
        (
            "one_byte_too_long",
            "canopen_transports/tcp/framing.py",
            "            if len(line) > MAX_LINE:\n                self._rest = line",
            "            if len(line) > MAX_LINE + 1:\n                self._rest = line",
            "lines behind one that is too long still count",
            FRAMING,
        ),
        (
            "busy_reader",
            _PYTHON_CAN,
            "            elif time.monotonic() - began < timeout / 2:\n                time.sleep(IDLE_PAUSE)",
            "            elif False:\n                pass",
            "a backend that does not wait takes a whole processor",
            READERS,
        ),
        (
            "nonsense_adds_up",
            _PYTHON_CAN,
            "                self._nonsense = 0\n",
            "                pass\n",
            "a bus is given up for the nonsense of a week",
            PYTHON_CAN,
        ),
        (
            "standing_status",
            _PYTHON_CAN,
            "status & ~self._status, status",
            "status, status",
            "an overrun that the adapter goes on telling is counted at each look",
            PCAN,
        ),
        (
            "sent_though_bus_off",
            _WIRE,
            "            self._destroy(segment, FaultKind.CORRUPTION)\n        self._confinement.count",
            "            pass\n        self._confinement.count",
            "a member that is taken off the bus in the middle of its frame has sent it",
            WIRE,
        ),
        (
            "unheard_since_ever",
            _WIRE,
            "            if segment.unheard_since is not None:\n                segment.unheard_since = now",
            "            pass",
            "a wire that nobody heard for an hour has an hour to catch up",
            ARBITRATION,
        ),
        (
            "lost_adapter_goes_on",
            _PYTHON_CAN,
            "        if peak.is_lost(status):\n            self._end(",
            "        if False:\n            self._end(",
            "an adapter that was pulled out is waited for without end",
            PCAN,
        ),
    )
)
