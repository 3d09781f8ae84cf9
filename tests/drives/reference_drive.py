"""A drive of CiA 402 that is written for tests alone, from the standard: it shares no code with the simulated drive.

It takes frames as they are on the wire: SDO of up to four bytes, RPDO 1 with the controlword, NMT, SYNC, the master's heartbeat.
`stream_by` makes it send and take PDOs at SYNCs: RPDO 2 with the controlword and a set-point, TPDO 1 with what it does.
It moves in steps of 1 ms whenever it is looked at, so it always knows the truth: `speed`, `position`, `state`.

Source: IEC 61800-7-201 (CiA 402-2), device control and the modes pp, pv, tq, hm, ip, csp, csv; CiA 301 v4.2.0, 7.2.2, 7.2.4,
7.2.5, 7.2.7, 7.2.8.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Time
from canopen_proto.testing import World

NODE: Final = 5
SOD, RTSO, SO, OE, QSA, FRA, FAULT = "SOD", "RTSO", "SO", "OE", "QSA", "FRA", "FAULT"
BITS: Final = {SOD: 0x40, RTSO: 0x21, SO: 0x23, OE: 0x27, QSA: 0x07, FRA: 0x0F, FAULT: 0x08}
PP, PV, TQ, HM, IP, CSP, CSV = 1, 3, 4, 6, 7, 8, 9
POWER_ON: Final[dict[int, tuple[int, int]]] = {  # mux -> bytes, value
    0x100000: (4, 0x20192), 0x100100: (1, 0), 0x101600: (1, 1), 0x101601: (4, 0), 0x101700: (2, 100),
    0x101800: (1, 4), 0x101801: (4, 0x1234), 0x600700: (2, 1), 0x603F00: (2, 0), 0x604000: (2, 0), 0x604100: (2, 0),
    0x605A00: (2, 2), 0x605D00: (2, 1), 0x606000: (1, 0), 0x606100: (1, 0), 0x606200: (4, 0), 0x606400: (4, 0),
    0x606500: (4, 5000), 0x606700: (4, 10), 0x606C00: (4, 0), 0x607100: (2, 0), 0x607200: (2, 1000), 0x607700: (2, 0),
    0x607A00: (4, 0), 0x607C00: (4, 0), 0x607D01: (4, -200_000), 0x607D02: (4, 200_000), 0x607F00: (4, 30_000),
    0x608100: (4, 20_000), 0x608200: (4, 0), 0x608300: (4, 40_000), 0x608400: (4, 40_000), 0x608500: (4, 80_000),
    0x608600: (2, 0), 0x609800: (1, 17), 0x609901: (4, 5000), 0x609902: (4, 1000), 0x609A00: (4, 40_000),
    0x60A400: (1, 1), 0x60A401: (4, 0), 0x60B000: (4, 0), 0x60B100: (4, 0), 0x60B200: (2, 0),
    0x60C101: (4, 0), 0x60C201: (1, 1), 0x60C202: (1, -3), 0x60C500: (4, 100_000), 0x60FD00: (4, 0), 0x60FF00: (4, 0),
    0x650200: (4, 0x1ED),
}  # fmt: skip
SIGNED: Final = {
    0x606000, 0x606100, 0x606200, 0x606400, 0x606C00, 0x607100, 0x607700, 0x607A00, 0x607C00, 0x607D01, 0x607D02, 0x60B000,
    0x60B100, 0x60B200, 0x60C101, 0x60C202, 0x609800, 0x60FF00, 0x605A00, 0x605D00, 0x600700, 0x608600,
}  # fmt: skip
READ_ONLY: Final = {0x604100, 0x606100, 0x606200, 0x606400, 0x606C00, 0x607700, 0x60FD00, 0x650200, 0x603F00, 0x100000, 0x100100}
HOME_AT: Final = -3000.0
"""Where the home switch is, in counts from where the drive is switched on."""
FRICTION: Final = 15_000.0
"""counts/s², of an axis without power."""
WITHOUT_SYNC: Final = 100 * MILLISECOND
"""So long a drive that follows set-points waits for a SYNC; then it brakes, and its bit 12 is 0 until the next one."""
PUSH: Final = 60.0
"""counts/s² for a thousandth of the rated torque."""


class ReferenceDrive:
    """See this module's text. lag: from a controlword to when it acts. Steps are numbered: `before(number, frame)` is called with
    each frame of a master to this drive, and returns whether the drive hears it; `answers(number, frame)` returns the answers
    that go out instead of the one it has, each with its delay. is_cut: nothing goes in or out. stream_by: the object that RPDO 2
    carries beside the controlword; 0: it has no PDOs at SYNCs. lost_syncs: so many of the next ones do not come.
    """

    def __init__(self, world: World, *, lag: Time = 0) -> None:
        self.world = world
        self.member = world.listener(self.hear, name="reference drive")
        self.lag = lag
        self.before: Callable[[int, Frame], bool] = lambda number, frame: True
        self.answers: Callable[[int, Frame], list[tuple[Time, Frame]]] = lambda number, frame: [(0, frame)]
        self.steps = 0
        self.is_cut = False
        self.stream_by = 0
        self.lost_syncs = 0
        self.place = 0.0  # of the shaft; the position counts from `zero`
        self.zero = 0.0
        self.velocity = 0.0
        self.acceleration = 0.0  # of a profile with limited jerk
        self.furthest = 0.0
        self.enabled_at: list[Time] = []
        self.booted_at: Time = 0
        self._now = world.now
        self._alive = 0
        self.boot()

    # ---- power ----

    def boot(self) -> None:
        """Start again with the values of power-on."""
        self.booted_at = self.world.now
        self.store = {key: value for key, (_, value) in POWER_ON.items()}
        self.state, self.nmt = SOD, 0x7F
        self.word = 0
        self._due: list[tuple[Time, int]] = []
        self.demand = self.place - self.zero
        self.target: float | None = None
        self.has_acknowledged = self.is_reached = self.is_limited = False
        self.homing = "none"  # none, runs, done, failed
        self.master_until = NEVER
        self.torque = 0.0
        self._held = b""
        self._synced_at = -NEVER
        self._alive += 1
        self.send(0x700 + NODE, b"\0")
        self._beat(self._alive)

    def _beat(self, life: int) -> None:
        def beat() -> None:
            if life == self._alive:
                self.look()
                self.send(0x700 + NODE, bytes([self.nmt]))
                self._beat(life)

        self.world.after(100 * MILLISECOND, beat)

    def fault(self, code: int) -> None:
        """Go into Fault by its fault reaction, a ramp, and say so in an EMCY."""
        self.look()
        if self.state not in (FRA, FAULT):
            self.store[0x603F00], self.store[0x100100] = code, 1
            self._enter(FRA if self.state in (OE, QSA) else FAULT)
            self.send(0x80 + NODE, code.to_bytes(2, "little") + b"\1" + bytes(5))

    def send(self, can_id: int, data: bytes) -> None:
        if not self.is_cut:
            self.world.send(self.member, Frame(can_id, data))

    # ---- frames ----

    def hear(self, frame: Frame, now: Time) -> None:
        can_id, data = frame.can_id, frame.data
        if self.is_cut:
            return
        if can_id in (0x600 + NODE, 0x200 + NODE, 0x300 + NODE):
            self.steps += 1
            if not self.before(self.steps, frame) or self.is_cut:
                return
        self.look()
        if can_id == 0x600 + NODE and self.nmt != 4 and len(data) == 8:
            self._sdo(data)
        elif can_id == 0x200 + NODE and self.nmt == 5:
            self.write(0x604000, int.from_bytes(data[:2], "little"))
        elif can_id == 0x300 + NODE and self.nmt == 5 and self.stream_by:
            self._held = data
        elif can_id == 0x80:
            self._sync()
        elif can_id == 0 and len(data) == 2 and data[1] in (0, NODE):
            self._command(data[0])
        elif can_id >> 7 == 0x700 >> 7 and self.store[0x101601] >> 16 & 0xFF == can_id & 0x7F:
            self.master_until = now + (self.store[0x101601] & 0xFFFF) * MILLISECOND

    def _sync(self) -> None:
        """CiA 301 v4.2.0, 7.2.2.3: what was held acts now, and a synchronous TPDO goes out."""
        if self.lost_syncs:
            self.lost_syncs -= 1
            return
        self._synced_at = self._now
        if self.nmt != 5 or not self.stream_by:
            return
        if self._held:
            held, self._held = self._held, b""
            self.store[self.stream_by] = int.from_bytes(held[2:6], "little", signed=True)
            self.write(0x604000, int.from_bytes(held[:2], "little"))
        shown = self.statusword.to_bytes(2, "little") + self.mode.to_bytes(1, "little", signed=True)
        self.send(0x180 + NODE, shown + round(self.position).to_bytes(4, "little", signed=True))

    def _command(self, command: int) -> None:
        if command in (0x81, 0x82):
            self.boot()
        elif command in (1, 2, 0x80):
            self.nmt = {1: 5, 2: 4, 0x80: 0x7F}[command]
            if command == 2:
                self._abort_connection()

    def _abort_connection(self) -> None:
        """0x6007: 1 fault, 2 disable voltage, 3 quick stop."""
        action = self.store[0x600700]
        if action == 1:
            self.fault(0x8130)
        elif action == 2 and self.state in (OE, QSA, SO, RTSO):
            self._enter(SOD)
        elif action == 3 and self.state == OE:
            self._enter(QSA)
            self.word = 2

    def _sdo(self, data: bytes) -> None:
        key = int.from_bytes(data[1:3], "little") << 8 | data[3]
        head = bytes(data[1:4])
        if data[0] & 0xE0 == 0x80:
            return  # an abort
        if data[0] & 0xE0 == 0x40:
            if key not in POWER_ON:
                answer = b"\x80" + head + (0x06020000).to_bytes(4, "little")
            else:
                size = POWER_ON[key][0]
                value = self.read(key) & (1 << 8 * size) - 1
                answer = bytes([0x43 | (4 - size) << 2]) + head + value.to_bytes(4, "little")
        elif data[0] & 0xE3 == 0x23:
            size = 4 - (data[0] >> 2 & 3)
            refusal = 0x06020000 if key not in POWER_ON else 0x06010002 if key in READ_ONLY else 0
            if not refusal and size != POWER_ON[key][0]:
                refusal = 0x06070010
            if refusal:
                answer = b"\x80" + head + refusal.to_bytes(4, "little")
            else:
                self.write(key, int.from_bytes(data[4 : 4 + size], "little", signed=key in SIGNED))
                answer = b"\x60" + head + bytes(4)
        else:
            answer = b"\x80" + head + (0x05040001).to_bytes(4, "little")
        for later, frame in self.answers(self.steps, Frame(0x580 + NODE, answer)):
            if later:
                self.world.after(later, lambda frame=frame: self.send(frame.can_id, frame.data))
            else:
                self.send(frame.can_id, frame.data)

    # ---- objects ----

    @property
    def position(self) -> float:
        return self.place - self.zero

    def read(self, key: int) -> int:
        if key == 0x604100:
            return self.statusword
        if key == 0x606400:
            return round(self.position)
        if key == 0x606200:
            return round(self.demand)
        if key == 0x606C00:
            return round(self.velocity)
        if key == 0x607700:
            return round(self.torque)
        return self.store[key]

    def write(self, key: int, value: int) -> None:
        """Take a value, whoever wrote it."""
        self.look()
        self.store[key] = value
        if key == 0x604000:
            if self.lag:
                self._due.append((self._now + self.lag, value))
            else:
                self._obey(value)
        elif key == 0x606000 and value in (PP, PV, TQ, HM, IP, CSP, CSV, 0):
            if value != self.store[0x606100]:
                self.target, self.homing, self.has_acknowledged = None, "none", False
                self.is_reached = False
            self.store[0x606100] = value

    @property
    def mode(self) -> int:
        return self.store[0x606100]

    @property
    def is_powered(self) -> bool:
        return self.state in (OE, QSA, FRA)

    @property
    def stands(self) -> bool:
        """Whether it stands now, in truth."""
        self.look()
        return abs(self.velocity) < 2

    @property
    def statusword(self) -> int:
        word = BITS[self.state] | 0x200 | (0x10 if self.state != SOD else 0)
        stopped = abs(self.velocity) < 2
        if self.state == OE:
            halted = self.word & 0x100
            reached = stopped if halted else self.is_reached
            if self.mode == PP and self.has_acknowledged:
                word |= 1 << 12
            if self.mode == PV and stopped:
                word |= 1 << 12
            if self.mode == HM:
                reached = stopped if self.homing != "runs" or halted else False
                word |= (1 << 12 if self.homing == "done" else 0) | (1 << 13 if self.homing == "failed" else 0)
            if self.mode in (IP, CSP, CSV) and self._follows:
                word |= 1 << 12
            word |= 0x400 if reached else 0
        return word | (0x800 if self.is_limited else 0)

    @property
    def _follows(self) -> bool:
        """Whether it follows set-points: it gets SYNCs, is not halted, and in ip has the bit for it."""
        is_active = self.mode != IP or bool(self.word & 0x10)
        return is_active and not self.word & 0x100 and self._now - self._synced_at <= WITHOUT_SYNC

    # ---- device control ----

    def _enter(self, state: str) -> None:
        if state == OE and self.state != OE:
            self.enabled_at.append(self._now)
            self.demand = self.position
            self.target = None
            self.has_acknowledged = self.is_reached = False
            if self.homing == "runs":
                self.homing = "none"
        self.state = state

    def _obey(self, word: int) -> None:
        before, self.word = self.word, word
        rising = word & ~before
        if self.state == FAULT:
            if rising & 0x80:
                self.store[0x603F00] = self.store[0x100100] = 0
                self._enter(SOD)
            return
        if self.state == FRA:
            return
        low = word & 0x8F
        if not word & 0x02:  # disable voltage: 7, 9, 10, 12
            if self.state != SOD:
                self._enter(SOD)
        elif not word & 0x04:  # quick stop: 7, 10, 11
            if self.state == OE:
                self._enter(QSA)
            elif self.state in (RTSO, SO):
                self._enter(SOD)
        elif not word & 0x01:  # shutdown: 2, 6, 8
            if self.state != QSA:
                self._enter(RTSO)
        elif low == 0x07:  # switch on, disable operation: 3, 5
            if self.state in (RTSO, OE):
                self._enter(SO)
        elif low == 0x0F and self.state in (RTSO, SO, QSA):  # 4, 16
            if self.state == RTSO:
                self._enter(SO)
            if self.state == SO or self.store[0x605A00] >= 5:
                self._enter(OE)
        if self.state == OE and low == 0x0F:
            self._mode_bits(word, rising)

    def _mode_bits(self, word: int, rising: int) -> None:
        if self.mode == PP:
            if rising & 0x10 and not self.has_acknowledged:
                value = float(self.store[0x607A00])
                if word & 0x40:
                    value += self.demand if self.target is None else self.target
                low, high = self.store[0x607D01], self.store[0x607D02]
                self.is_limited = not low <= value <= high
                self.target = min(max(value, low), high)
                self.has_acknowledged, self.is_reached = True, False
            if not word & 0x10:
                self.has_acknowledged = False
        elif self.mode == HM:
            if rising & 0x10:
                self.homing = "runs"
            elif not word & 0x10 and self.homing == "runs":
                self.homing = "none"

    # ---- motion ----

    def look(self) -> None:
        """Let the time pass that has passed."""
        now = self.world.now
        while self._now < now:
            if self.state not in (OE, QSA, FRA) and not self.velocity and not self._due:
                self._now = now
                break
            step = min(MILLISECOND, now - self._now)
            self._now += step
            while self._due and self._due[0][0] <= self._now:
                self._obey(self._due.pop(0)[1])
            if self._now > self.master_until and self.nmt == 5:
                self.master_until = NEVER
                self._abort_connection()
            self._move(step / SECOND)

    def _move(self, dt: float) -> None:
        store = self.store
        before = self.velocity
        if self.state in (SOD, RTSO, SO, FAULT):
            self._ramp(0.0, FRICTION, dt)
            self.demand = self.position
        elif self.state in (QSA, FRA):
            self._ramp(0.0, store[0x608500], dt)
            self.demand = self.position
            if not self.velocity:
                if self.state == FRA:
                    self._enter(FAULT)
                elif store[0x605A00] < 5:
                    self._enter(SOD)
        elif self.word & 0x100:
            self._ramp(0.0, store[0x608400] or 40_000, dt)
            self.demand = self.position
        elif self.mode == PP:
            self._profile(dt)
        elif self.mode == PV:
            limit = store[0x607F00]
            goal = max(-limit, min(limit, store[0x60FF00]))
            self._ramp(goal, store[0x608300] if abs(goal) > abs(self.velocity) else store[0x608400], dt)
            self.is_reached = self.velocity == goal
            self.demand = self.position
        elif self.mode in (IP, CSP, CSV):
            self._cycle(dt)
        elif self.mode == TQ:
            self.torque = float(store[0x607100])
            pull = self.torque * PUSH
            if self.velocity or abs(pull) > FRICTION / 5:
                drag = FRICTION / 5 * (1 if self.velocity > 0 else -1 if self.velocity < 0 else (1 if pull > 0 else -1))
                after = self.velocity + (pull - drag) * dt
                self.velocity = 0.0 if self.velocity * after < 0 and abs(pull) <= FRICTION / 5 else after
            self.is_reached = True
            self.demand = self.position
        elif self.mode == HM and self.homing == "runs":
            self._ramp(-store[0x609901], store[0x609A00] or 40_000, dt)
            if self.place <= HOME_AT:
                self.velocity, self.homing = 0.0, "done"
                self.zero = self.place - store[0x607C00]
            self.demand = self.position
        else:
            self._ramp(0.0, 40_000, dt)
            self.demand = self.position
        self.place += (before + self.velocity) / 2 * dt
        self.furthest = max(self.furthest, abs(self.place))

    def _ramp(self, goal: float, rate: float, dt: float) -> None:
        jerk = self.store[0x60A401]
        if self.mode == PV and self.state == OE and self.store[0x608600] == 3 and jerk:
            missing = goal - self.velocity
            wanted = min(rate, (2 * jerk * abs(missing)) ** 0.5) * (1 if missing > 0 else -1)
            self.acceleration += max(-jerk * dt, min(jerk * dt, wanted - self.acceleration))
            self.velocity += self.acceleration * dt
            if missing * (goal - self.velocity) <= 0 or abs(goal - self.velocity) < 1:
                self.velocity, self.acceleration = goal, 0.0
            return
        self.acceleration = 0.0
        change = max(1.0, rate) * dt
        self.velocity += max(-change, min(change, goal - self.velocity))

    def _cycle(self, dt: float) -> None:
        """Follow a set-point: be there one period behind the SYNC that brought it."""
        limit = self.store[0x607F00]
        wanted = float(self.store[0x60FF00])
        if self.mode != CSV:
            period = self.store[0x60C201] * 10 ** (9 + self.store[0x60C202])
            target = self.store[0x60C101] if self.mode == IP else self.store[0x607A00] + self.store[0x60B000]
            wanted = (target - self.position) * SECOND / max(MILLISECOND, self._synced_at + period - self._now)
        if not self._follows:
            self._ramp(0.0, 40_000, dt)
        else:
            self.is_limited = abs(wanted) > limit
            self.velocity = max(-limit, min(limit, wanted))
        self.demand = self.position

    def _profile(self, dt: float) -> None:
        if self.target is None:
            self._ramp(0.0, self.store[0x608400] or 40_000, dt)
            self.demand = self.position
            return
        way = self.target - self.position
        brake = self.store[0x608400] or 40_000
        speed = min(self.store[0x608100], self.store[0x607F00])
        if abs(way) < 3 and abs(self.velocity) <= 2 * brake * dt:
            self.place, self.velocity = self.target + self.zero, 0.0
            self.demand, self.is_reached = self.target, True
            return
        self.is_reached = False
        allowed = min(speed, (2 * brake * max(0.0, abs(way) - abs(self.velocity) * dt)) ** 0.5)
        self._ramp(allowed if way > 0 else -allowed, max(brake * 1.5, self.store[0x608300]), dt)
        self.demand = self.position
