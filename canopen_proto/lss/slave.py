"""`LssSlave`: the device's side of the layer setting services (CiA 305).

A device has node-ID and bit rate three times: `persistent` (stored, as at power-on), `pending` (what the master has set) and
`active` (in use).

    0x11, 0x13          set pending, in every NMT state; what is in use stays
    0x17                pending becomes persistent: the host stores it (LssStoreRequested, `complete_store`)
    0x15                the pending bit rate becomes the active one, after a delay; see below
    NMT reset           the pending node-ID becomes the active one (`reset`); after a reset of the node, and at power-on, pending
                        is what is stored

A device without a node-ID is in the NMT state Initialisation and has nothing but LSS. Once it leaves the state "configuration"
with a pending node-ID it resets its communication by itself (LssResetNeeded), and boots with the new node-ID. (Lely's devices
wait for an NMT command instead. Masters know both.)

Selection by address, and identification, take their numbers in the order of the command specifiers; a number that does not match
starts them over. `STATES` says which service is taken in which state: in the other one the slave is silent, as the standard
wants it, also for unknown command specifiers. A frame that has not eight bytes is ignored (FrameIgnored).

**A change of the bit rate** has two delays of the same length. In the first one the device finishes what it sends, and sends
nothing new (LssSilenceBegan). At its end the host switches its CAN controller (LssBitRateSwitched). In the second one it is
silent, too, so that the slowest device has switched before anybody speaks (LssSilenceEnded). The slave does not answer meanwhile.

Left out: tables of bit timings other than CiA's; automatic detection of the bit rate.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Final

from canopen_proto import indices
from canopen_proto.compiling import mypyc_attr
from canopen_proto.dictionary.values import Values
from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.lss.messages import (
    BIT_RATES,
    CIA_TABLE,
    CONFIRM,
    FROM_MASTER,
    FROM_SLAVE,
    LENGTH,
    MAX_BIT_CHECK,
    OK,
    SERVICE_OF_BYTE,
    STATES,
    UNCONFIGURED,
    LssAddress,
    LssConfiguration,
    LssService,
    LssState,
    is_node_id,
    message,
    number_message,
    number_of,
)
from canopen_proto.machine import MILLISECOND, NEVER, Event, FrameIgnored, LocalProtocolError, Machine, Outbox, Time
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtCommand

STORE_TIMEOUT: Final = 900 * MILLISECOND
"""For the host to store. Masters wait 1 s at most: CANOpenNode's does, Lely's waits 100 ms."""
NOT_SUPPORTED: Final = 1
"""Error of 0x13 and 0x17, and of 0x11 for a node-ID out of range."""
STORAGE_FAILED: Final = 2
IDENTIFY_FRAMES: Final = 6


class LssNodeIdSet(Event):
    """A master has set the pending node-ID of our slave. pending: 1..127, or UNCONFIGURED."""

    __match_args__ = ("node_id", "pending")

    def __init__(self, node_id: int, pending: int) -> None:
        self.node_id = node_id
        self.pending = pending


class LssStoreRequested(Event):
    """The host has to store node-ID and bit rate for the next power-on, then to call `LssSlave.complete_store`. configuration:
    what is to be stored."""

    __match_args__ = ("node_id", "configuration")

    def __init__(self, node_id: int, configuration: LssConfiguration) -> None:
        self.node_id = node_id
        self.configuration = configuration


class LssResetNeeded(Event):
    """Our device has got its first node-ID and leaves LSS: it has to reset its communication by itself, then to boot."""


class LssSilenceBegan(Event):
    """The bit rate changes: the device sends nothing from now on.

    bit_rate: the new one, kbit/s. delay: ns, until the controller switches, and once more until the device may speak.
    """

    __match_args__ = ("node_id", "bit_rate", "delay")

    def __init__(self, node_id: int, bit_rate: int, delay: Time) -> None:
        self.node_id = node_id
        self.bit_rate = bit_rate
        self.delay = delay


class LssBitRateSwitched(Event):
    """The host has to switch its CAN controller now. bit_rate: kbit/s."""

    __match_args__ = ("node_id", "bit_rate")

    def __init__(self, node_id: int, bit_rate: int) -> None:
        self.node_id = node_id
        self.bit_rate = bit_rate


class LssSilenceEnded(Event):
    """The change of the bit rate is done: the device may speak again."""


def address_of(values: Values) -> LssAddress:
    """Return the LSS address of a device: 0x1018:01 to :04."""
    numbers = [values.store.get(mux(indices.IDENTITY_OBJECT, subindex)) for subindex in (1, 2, 3, 4)]
    return LssAddress(*(number & 0xFFFF_FFFF if isinstance(number, int) else 0 for number in numbers))


@mypyc_attr(allow_interpreted_subclasses=True)
class LssSlave(Machine):
    """The device's side of LSS; see this module's text. Read-only outside: state, persistent, pending, active, is_silent.

    node_id of its events: the active one, 0 while there is none.
    """

    def __init__(
        self,
        out: Outbox,
        address: LssAddress,
        configuration: LssConfiguration = LssConfiguration(),  # noqa: B008 - a tuple
        *,
        bit_rates: Collection[int] = tuple(BIT_RATES.values()),
        can_store: bool = True,
    ) -> None:
        """Power on. configuration: what is stored. bit_rates: kbit/s, those that the device can have. can_store: whether a host
        answers LssStoreRequested; else 0x17 gets "not supported". Raises LocalProtocolError for an impossible node-ID. address:
        vendor-ID, product code, revision and serial number, UNSIGNED32 each."""
        super().__init__(out)
        if not is_node_id(configuration.node_id):
            raise LocalProtocolError(f"node-ID {configuration.node_id} is outside 1..127, and not {UNCONFIGURED} (none yet)")
        self.address = address
        self.bit_rates = frozenset(bit_rates)
        self.can_store = can_store
        self.state = LssState.WAITING
        self.persistent = self.pending = self.active = configuration
        self.is_silent = False
        self.is_storing = False
        self._delay: Time = 0  # of the change of the bit rate under way
        self._has_switched = False  # the first of its two delays is over
        self._selected = 0  # how many numbers of 0x40..0x43 matched so far
        self._identified = 0  # the same of 0x46..0x4B
        self._position = 0  # of the fastscan: 0 vendor-ID .. 3 serial number

    def can_ids(self) -> Iterable[RoutingKey]:
        return (FROM_MASTER,)

    @property
    def node_id(self) -> int:
        """The active node-ID as events carry it: 0 for none."""
        return 0 if self.active.node_id == UNCONFIGURED else self.active.node_id

    @property
    def is_configured(self) -> bool:
        """Whether the device has a node-ID in use."""
        return self.active.node_id != UNCONFIGURED

    def load(self, stored: LssConfiguration) -> None:
        """Take what the host has kept, before the device boots: power-on with other stored values."""
        if not is_node_id(stored.node_id):
            raise LocalProtocolError(f"node-ID {stored.node_id} is outside 1..127, and not {UNCONFIGURED} (none yet)")
        self.persistent = self.pending = self.active = stored

    def reset(self, command: NmtCommand, now: Time) -> None:
        """Follow an NMT reset: the pending node-ID becomes the active one. After RESET_NODE, pending is what is stored. command:
        RESET_NODE or RESET_COMMUNICATION."""
        if command is NmtCommand.RESET_NODE:
            self.pending = self.persistent
        self.active = LssConfiguration(self.pending.node_id, self.active.bit_rate)
        self._enter(LssState.WAITING)
        if self.is_storing:
            self.is_storing = False
            self._arm(NEVER)

    def complete_store(self, error: int, now: Time, specific: int = 0) -> None:
        """Give the host's answer to LssStoreRequested: 0 stored, 2 failed, 0xFF an error of its own. Late: does nothing.
        specific: the maker's own code, 0..255, with 0xFF."""
        if not self.is_storing:
            return
        self.is_storing = False
        self._arm(NEVER)
        if error == OK:
            self.persistent = self.pending
        self._answer_error(LssService.STORE, error, specific)

    def receive(self, frame: Frame, now: Time) -> None:
        """Serve a request, if the state allows it."""
        data = frame.data
        if len(data) != LENGTH:
            self.out.events.append(FrameIgnored(self.node_id, frame, f"an LSS frame has {LENGTH} bytes, not {len(data)}"))
            return
        service = SERVICE_OF_BYTE.get(data[0])
        if service is None or self.is_silent or self.is_storing or self.state not in STATES.get(service, ()):
            return
        if LssService.SELECT_VENDOR <= service <= LssService.SELECT_SERIAL:
            self._select(service - LssService.SELECT_VENDOR, number_of(data))
        elif LssService.IDENTIFY_VENDOR <= service <= LssService.IDENTIFY_SERIAL_HIGH:
            self._identify(service - LssService.IDENTIFY_VENDOR, number_of(data))
        elif LssService.INQUIRE_VENDOR <= service <= LssService.INQUIRE_SERIAL:
            self._send(number_message(service, self.address[service - LssService.INQUIRE_VENDOR]))
        else:
            self._serve(service, data, now)

    def _serve(self, service: LssService, data: bytes, now: Time) -> None:
        match service:
            case LssService.SWITCH_GLOBAL:
                self._switch(data[1])
            case LssService.CONFIGURE_NODE_ID:
                self._configure_node_id(data[1])
            case LssService.CONFIGURE_BIT_TIMING:
                self._configure_bit_timing(data[1], data[2])
            case LssService.ACTIVATE_BIT_TIMING:
                self._activate(int.from_bytes(data[1:3], "little") * MILLISECOND, now)
            case LssService.STORE:
                self._store(now)
            case LssService.IDENTIFY_NON_CONFIGURED:
                if not self.is_configured:
                    self._send(message(LssService.NON_CONFIGURED))
            case LssService.FASTSCAN:
                self._fastscan(number_of(data), data[5], data[6], data[7])
            case LssService.INQUIRE_NODE_ID:
                self._send(message(service, bytes((self.active.node_id,))))
            case _:
                pass  # `STATES` has no others

    def handle_timeout(self, now: Time) -> None:
        """The host did not store in time, or a delay of a change of the bit rate is over."""
        if now < self.deadline:
            return
        if self.is_storing:
            self.complete_store(STORAGE_FAILED, now)
        elif not self._has_switched:
            self._has_switched = True
            self.active = LssConfiguration(self.active.node_id, self.pending.bit_rate)
            self.out.events.append(LssBitRateSwitched(self.node_id, self.active.bit_rate))
            self._arm(self.deadline + self._delay)  # however late the driver came
        else:
            self.is_silent = False
            self._arm(NEVER)
            self.out.events.append(LssSilenceEnded(self.node_id))

    # ---- the services ----

    def _enter(self, state: LssState) -> None:
        self.state = state
        self._selected = self._identified = self._position = 0

    def _switch(self, number: int) -> None:
        if number == LssState.CONFIGURATION:
            self.state = LssState.CONFIGURATION
        elif number == LssState.WAITING:
            leaves = self.state is LssState.CONFIGURATION
            self._enter(LssState.WAITING)
            if leaves and not self.is_configured and self.pending.node_id != UNCONFIGURED:
                self.out.events.append(LssResetNeeded(0))

    def _select(self, place: int, number: int) -> None:
        matches = place == 0 or place == self._selected  # the first number may come at any time
        self._selected = place + 1 if matches and number == self.address[place] else 0
        if self._selected == len(self.address):
            self._enter(LssState.CONFIGURATION)
            self._send(message(LssService.SELECTED))

    def _identify(self, place: int, number: int) -> None:
        if place < 2:
            fits = number == self.address[place]
        else:  # the lowest and the highest revision, then the same of the serial number
            own = self.address[1 + place // 2]
            fits = number >= own if place % 2 else number <= own
        self._identified = place + 1 if fits and (place == 0 or place == self._identified) else 0
        if self._identified == IDENTIFY_FRAMES:
            self._identified = 0
            self._send(message(LssService.IDENTIFIED))

    def _fastscan(self, number: int, bit_check: int, sub: int, following: int) -> None:
        if self.is_configured or self.pending.node_id != UNCONFIGURED:
            return
        if bit_check == CONFIRM:
            self._position = 0
            self._send(message(LssService.IDENTIFIED))
            return
        if bit_check > MAX_BIT_CHECK or sub != self._position or sub >= len(self.address):
            return
        if number >> bit_check != self.address[sub] >> bit_check:
            return
        self._position = following
        if bit_check == 0 and following < sub:
            self._enter(LssState.CONFIGURATION)
        self._send(message(LssService.IDENTIFIED))

    def _configure_node_id(self, number: int) -> None:
        if not is_node_id(number):
            self._answer_error(LssService.CONFIGURE_NODE_ID, NOT_SUPPORTED)
            return
        self.pending = LssConfiguration(number, self.pending.bit_rate)
        self._answer_error(LssService.CONFIGURE_NODE_ID, OK)
        self.out.events.append(LssNodeIdSet(self.node_id, number))

    def _configure_bit_timing(self, table: int, index: int) -> None:
        bit_rate = BIT_RATES.get(index, 0) if table == CIA_TABLE else 0
        if bit_rate not in self.bit_rates:
            self._answer_error(LssService.CONFIGURE_BIT_TIMING, NOT_SUPPORTED)
            return
        self.pending = LssConfiguration(self.pending.node_id, bit_rate)
        self._answer_error(LssService.CONFIGURE_BIT_TIMING, OK)

    def _store(self, now: Time) -> None:
        if not self.can_store:
            self._answer_error(LssService.STORE, NOT_SUPPORTED)
            return
        self.is_storing = True
        self._arm(now + STORE_TIMEOUT)
        self.out.events.append(LssStoreRequested(self.node_id, self.pending))

    def _activate(self, delay: Time, now: Time) -> None:
        self.is_silent = True
        self._has_switched = False
        self._delay = delay
        self.out.events.append(LssSilenceBegan(self.node_id, self.pending.bit_rate, delay))
        self._arm(now + delay)

    def _answer_error(self, service: LssService, error: int, specific: int = 0) -> None:
        self._send(message(service, bytes((error, specific))))

    def _send(self, data: bytes) -> None:
        self.out.frames.append(Frame(FROM_SLAVE, data))
