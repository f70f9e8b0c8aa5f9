"""A virtual terminal of another maker, and a fleet whose screen it shows; the serving robot is killed.

The terminal is written from the tables of ISO 11783-6 and -3, byte by byte, without a line of our own
client: it reads the pool, checks every reference in it, keeps working sets while they are maintained, and
sends keys.
"""

from collections.abc import Callable, Iterator, Sequence
from random import Random
from struct import pack, unpack_from
from typing import NamedTuple

from agent.interface.config import MS, S
from agent.interface.effects import Effect, Persist
from agent.interface.identity import Identity, SilencePolicy
from agent.interface.observation import Observation
from agent.peer.inputs import BusState, Received, Sensed, Timer
from agent.runtime.peer_factory import NO_MISSION, MissionParts, keyring_of, make_peer
from agent.safety.stop_cause import StopCause
from protocol.authentication import KEY_SIZE, Keys
from protocol.controller_health import Health
from protocol.frames.frame import Frame
from protocol.name import fleet_name
from sim.can.frame_timing import frame_bits
from sim.rigs.implements_rig import RigBus, frames_of

TERMINAL = 38  # address (ISO 11783-1: virtual terminal)
GLOBAL = 255
KEPT_US = 3 * S  # a working set that is not maintained is removed
DOTS = 240
# Bytes after the head of each object: fixed part; then what the counts in it add.
LISTED = {0: (7, 4, 5, 6), 1: (5, 3, 4, None), 2: (7, 5, 6, None), 5: (4, 2, 3, None)}


class PoolError(ValueError):
    """The pool cannot be shown: where, and why."""


class Terminal:
    """One terminal with the working sets that it shows."""

    def __init__(self) -> None:
        self.kept: dict[int, int] = {}  # source -> its newest maintenance
        self.pools: dict[int, bytes] = {}  # source -> objects that are shown
        self.texts: dict[int, dict[int, bytes]] = {}  # source -> changed texts
        self.numbers: dict[int, int] = {}  # of the active set
        self.mask = 1000
        self.active: int | None = None
        self.shown_at_us: dict[int, int] = {}  # source -> when its newest pool was read
        self.redrawn = 0  # objects of a pool that was shown already
        self.refuses = False  # such objects
        self.twice = 0  # maintenance of two sources within one period
        self.errors: list[str] = []
        self.unknown = 0  # functions of sources that are no working set
        self._last: tuple[int, int] | None = None  # source and time of the newest maintenance
        self._status_at_us = 0
        self._long: dict[int, tuple[int, bytearray, int]] = {}  # source: size, data, offset
        self._short: dict[int, tuple[int, bytearray]] = {}
        self._raw: dict[int, bytes] = {}
        self._keys: list[bytes] = []
        self._claimed = False

    def restart(self) -> None:
        """Lose all memory, as after a loss of power."""
        for kept in (self.kept, self.pools, self.texts, self._long, self._short, self._raw):
            kept.clear()
        self.active, self._claimed, self.mask = None, False, 1000

    def press(self, object_id: int, code: int) -> None:
        """A person presses and releases a soft key of the active mask."""
        for state in (1, 0):
            self._keys.append(pack("<BBHHBB", 0, state, object_id, self.mask, code, 0xFF))

    # ------------------------------------------------------------ frames

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take a frame, as its firmware does."""
        group, data = frame.identifier >> 8 & 0x3FF00, frame.data
        source, destination = frame.identifier & 0xFF, frame.identifier >> 8 & 0xFF
        if destination != TERMINAL:
            return []
        if group == 0xE700:
            return self._function(source, data, now_us)
        if group == 0xEC00 and data[0] == 16:
            self._short[source] = int.from_bytes(data[1:3], "little"), bytearray()
            return [self._frame(0x1CEC0000, bytes((17, data[3], 1, 255, 255)) + data[5:8], source)]
        if group == 0xEB00 and source in self._short:
            return self._short_data(source, data, now_us)
        if group == 0xC800 and data[0] == 20:
            self._long[source] = int.from_bytes(data[1:5], "little"), bytearray(), 0
            return [self._grant(source)]
        if group == 0xC800 and data[0] == 22 and source in self._long:
            size, so_far, _ = self._long[source]
            self._long[source] = size, so_far, int.from_bytes(data[2:5], "little")
        if group == 0xC700 and source in self._long:
            return self._long_data(source, data, now_us)
        return []

    def turns(self, now_us: int) -> list[Frame]:
        """Status, forgotten working sets, and keys that were pressed."""
        frames = []
        if not self._claimed:
            self._claimed = True
            name = 1 << 63 | 2 << 60 | 29 << 40 | 222 << 21 | 5
            frames.append(Frame(0x18EEFF00 | TERMINAL, pack("<Q", name)))
        for source, at_us in list(self.kept.items()):
            if now_us - at_us > KEPT_US:
                self._remove(source)
        if now_us >= self._status_at_us:
            self._status_at_us = now_us + S
            active = 254 if self.active is None else self.active
            frames.append(
                Frame(0x1CE6FF00 | TERMINAL, pack("<BBHHBB", 0xFE, active, self.mask, 2000, 0, 0))
            )
        keys, self._keys = self._keys, []
        if self.active is not None:
            frames += [self._frame(0x1CE60000, key, self.active) for key in keys]
        return frames

    def _grant(self, source: int) -> Frame:
        size, so_far, _ = self._long[source]
        first = len(so_far) // 7 + 1
        count = min(-(-size // 7) - first + 1, 100)
        head = bytes((21, count)) + pack("<I", first)[:3]
        return self._frame(0x1CC80000, head + b"\x00\xe7\x00", source)

    def _long_data(self, source: int, data: bytes, now_us: int) -> list[Frame]:
        size, so_far, offset = self._long[source]
        if offset + data[0] != len(so_far) // 7 + 1:
            self.errors.append(f"packet {offset + data[0]}, not {len(so_far) // 7 + 1}")
            return []
        so_far += data[1:]
        if len(so_far) >= size:
            del self._long[source]
            end = self._frame(0x1CC80000, b"\x17" + pack("<I", size) + b"\x00\xe7\x00", source)
            return [end, *self._function(source, bytes(so_far[:size]), now_us)]
        packets = len(so_far) // 7
        return [self._grant(source)] if packets % 100 == 0 else []

    def _short_data(self, source: int, data: bytes, now_us: int) -> list[Frame]:
        size, so_far = self._short[source]
        so_far += data[1:]
        if len(so_far) < size:
            return []
        del self._short[source]
        end = bytes((19,)) + pack("<HB", size, -(-size // 7)) + b"\xff\x00\xe7\x00"
        return [
            self._frame(0x1CEC0000, end, source),
            *self._function(source, bytes(so_far[:size]), now_us),
        ]

    # ------------------------------------------------------------ functions

    def _function(self, source: int, data: bytes, now_us: int) -> list[Frame]:
        function = data[0]
        if function == 0xFF:
            if self._last is not None and self._last[0] != source and now_us - self._last[1] < S:
                self.twice += 1
            self._last = source, now_us
            if source in self.kept or data[1] & 1:  # a set begins with its first maintenance
                self.kept[source] = now_us
            return []
        if source not in self.kept or (source not in self.pools and function in (0xA8, 0xAD, 0xB3)):
            self.unknown += 1
            return []
        answers = {
            0xC0: b"\xc0\x04\x00", 0xC3: b"\xc3\xff\xff\xff\xff\x7f\x7f\x0f",
            0xC7: b"\xc7\x01\x02\x0f" + pack("<HH", DOTS, DOTS), 0xB2: b"\xb2\x00",
        }  # fmt: skip
        if function in answers:
            if function == 0xB2:
                self._remove(source)
            return [self._frame(0x1CE60000, answers[function].ljust(8, b"\xff"), source)]
        if function == 0x11:
            self._raw[source] = data[1:]
            return []
        if function == 0x12:
            return [self._frame(0x1CE60000, self._read(source, now_us), source)]
        if function == 0x00:
            return []
        if source != self.active:
            self.errors.append(f"{source} changes what {self.active} shows")
            return []
        if function == 0xA8:
            number, value = unpack_from("<HxI", data, 1)
            self.numbers[number] = value
            return [self._frame(0x1CE60000, b"\xa8" + data[1:3] + b"\x00" + data[4:8], source)]
        if function == 0xAD:
            (self.mask,) = unpack_from("<H", data, 3)
            return [self._frame(0x1CE60000, b"\xad" + data[3:5] + b"\x00" + b"\xff" * 4, source)]
        if function == 0xB3:
            number, length = unpack_from("<HH", data, 1)
            self.texts[source][number] = data[5 : 5 + length]
            return [self._frame(0x1CE60000, b"\xb3\xff\xff" + data[1:3] + b"\x00\xff\xff", source)]
        self.errors.append(f"function {function:#x}")
        return []

    def _read(self, source: int, now_us: int) -> bytes:
        raw, known = self._raw.get(source, b""), self.texts.get(source, {})
        again = source in self.pools
        try:
            objects = dict(_texts(raw, whole=not again))
            if again and any(len(known.get(n, b"")) != len(v) for n, v in objects.items()):
                raise PoolError(f"other objects than before: {sorted(objects)}")
            if again and self.refuses:
                raise PoolError("")
        except PoolError as problem:
            if str(problem):
                self.errors.append(str(problem))
            self._remove(source)
            return b"\x12\x01\xff\xff\xff\xff\x02\xff"
        if again:
            self.redrawn += 1
            known.update(objects)
            return b"\x12\x00\xff\xff\xff\xff\x00\xff"
        self.texts[source] = objects
        self.pools[source], self.active, self.mask = self._raw[source], source, 1000
        self.shown_at_us[source] = now_us
        self.numbers.clear()
        return b"\x12\x00\xff\xff\xff\xff\x00\xff"

    def _remove(self, source: int) -> None:
        for kept in (self.kept, self.pools, self.texts):
            kept.pop(source, None)
        if self.active == source:
            self.active = None

    @staticmethod
    def _frame(head: int, data: bytes, destination: int) -> Frame:
        return Frame(head | destination << 8 | TERMINAL, data)


def _texts(pool: bytes, whole: bool) -> Iterator[tuple[int, bytes]]:
    """Check a pool and yield its texts and pictures. Raises PoolError. `whole`: not some objects again.

    Objects are read by the tables of ISO 11783-6, annex B: kinds 0, 1, 2, 4, 5, 11, 12, 20 and 23."""
    at, kinds, wanted = 0, dict[int, int](), list[tuple[int, int]]()
    while at < len(pool):
        number, kind = unpack_from("<HB", pool, at)
        if number in kinds:
            raise PoolError(f"two objects {number}")
        kinds[number], body = kind, at + 3
        if kind in LISTED:
            size, objects, macros, languages = LISTED[kind]
            at = body + size
            for _ in range(pool[body + objects]):
                child, _, _ = unpack_from("<Hhh", pool, at)
                wanted.append((number, child))
                at += 6
            at += 2 * pool[body + macros]
            if languages is not None:
                at += 2 * pool[body + languages]
            if kind == 0:
                wanted.append((number, unpack_from("<H", pool, body + 2)[0]))
            elif kind in (1, 2):
                wanted.append((number, unpack_from("<H", pool, body + 1)[0]))
        elif kind == 4:
            at = body + 3
            for _ in range(pool[body + 1]):
                wanted.append((number, unpack_from("<H", pool, at)[0]))
                at += 2
        elif kind == 11:
            font, _, _, _, length = unpack_from("<HBHBH", pool, body + 5)
            wanted.append((number, font))
            yield number, pool[body + 13 : body + 13 + length]
            at = body + 13 + length + 1
        elif kind == 12:
            wanted.append((number, unpack_from("<H", pool, body + 5)[0]))
            at = body + 26
        elif kind == 20:
            width, actual, height, form, _, _, length = unpack_from("<HHHBBBI", pool, body)
            if form != 1 or length != -(-actual // 2) * height or width < 1:
                raise PoolError(f"picture {number}: {length} bytes")
            yield number, pool[body + 14 : body + 14 + length]
            at = body + 14 + length
        elif kind == 23:
            at = body + 5
        else:
            raise PoolError(f"object {number} has kind {kind}")
    missing = [(number, child) for number, child in wanted if child not in kinds]
    if at != len(pool) or (whole and (missing or kinds.get(0) != 0)):
        raise PoolError(f"{at} of {len(pool)} bytes; not there: {missing}")


# ---------------------------------------------------------------- the fleet


class RobotNode:
    """A robot on the bus that can be killed and started again with its memory."""

    def __init__(
        self, slot: int, robots: int, seed: int, keys: Keys | None = None,
        mission: Callable[[], MissionParts] = lambda: NO_MISSION,
    ) -> None:  # fmt: skip
        """`mission`: its own at each boot."""
        self.slot, self.robots, self.seed, self.keys = slot, robots, seed, keys
        self.mission = mission
        self.place_m: tuple[float, float] | None = (
            None  # that its receiver tells; None: it has none
        )
        self.memory: dict[str, bytes] = {}
        self.boots, self.alive = 0, True
        self.stopped_at_us: int | None = None
        self.start(0)

    def start(self, now_us: int) -> None:
        """Power on."""
        self.boots, self.alive = self.boots + 1, True
        identity = Identity(
            self.slot, frozenset(range(self.robots)), fleet_name("screen", self.slot), 1,
            SilencePolicy.CONTINUE, started=True, first_boot=self.boots == 1, diagnostics=True,
        )  # fmt: skip
        rng = Random(f"{self.seed}/{self.slot}/{self.boots}")
        keyring = keyring_of(self.keys, self.slot, rng.randbytes(KEY_SIZE))
        self.peer = make_peer(
            identity, rng, now_us, dict(self.memory), self.mission(), keyring=keyring
        )

    def hears(self, frame: Frame, now_us: int) -> list[Frame]:
        """Take a frame, if it has power."""
        return self._perform(self.peer.step(Received(frame), now_us), now_us) if self.alive else []

    def turns(self, now_us: int) -> list[Frame]:
        """Its timer."""
        if not self.alive or now_us < self.peer.due_at_us:
            return []
        self.peer.step(BusState(Health.ACTIVE, True, now_us), now_us)
        if self.place_m is not None and self.peer.wants_observation(now_us):
            here = Observation(*self.place_m, 0.0, 0.0, 0.0, sensed_at_us=now_us)
            self.peer.step(Sensed(here), now_us)
        return self._perform(self.peer.step(Timer(), now_us), now_us)

    def _perform(self, effects: Sequence[Effect], now_us: int) -> list[Frame]:
        """Keep what is to be kept; returns what it sends."""
        for effect in effects:
            if isinstance(effect, Persist):
                self.memory[effect.key] = effect.value
        latched = self.peer.safety.holds(StopCause.STOP_DOT)
        if latched and self.stopped_at_us is None:
            self.stopped_at_us = now_us
        elif not latched:
            self.stopped_at_us = None
        return frames_of(self.peer, effects)


class KilledScreens(NamedTuple):
    """What came of killing the robot that shows the screen, again and again."""

    kills: int
    back_for_s: float  # until the next screen was read, the worst
    twice: int  # maintenance of two robots within a second
    stop_for_ms: float  # from the key to the last robot that has latched, the worst
    released: int  # stops that were released by the key
    stops: int
    pool_bytes: int
    load: float  # of the bus by the screen, while nothing is killed
    errors: tuple[str, ...]


class ScreenFleet:
    """A bus with a terminal and robots, in virtual time."""

    def __init__(
        self, robots: int, seed: int, keyed: bool = False, members: int | None = None,
        mission: Callable[[], MissionParts] = lambda: NO_MISSION,
    ) -> None:  # fmt: skip
        """`members`: of the fleet, of which the first `robots` are on the bus; None: all are."""
        rng = Random(f"keys of screens/{seed}")
        self.keys = Keys(rng.randbytes(KEY_SIZE), rng.randbytes(KEY_SIZE)) if keyed else None
        self.bus, self.now_us = RigBus(seed, MS), 0
        self.terminal = Terminal()
        fleet = robots if members is None else members
        self.robots = [RobotNode(slot, fleet, seed, self.keys, mission) for slot in range(robots)]
        self.bus.attach(self.terminal)
        for robot in self.robots:
            self.bus.attach(robot)

    def run(self, for_us: int) -> None:
        """Let time pass."""
        self.bus.run(self.now_us, self.now_us + for_us)
        self.now_us += for_us

    def until_shown(self, since_at_us: int, limit_for_us: int) -> float:
        """Seconds until a screen was read after this time; the limit if none was."""
        end_at_us = self.now_us + limit_for_us
        while self.now_us < end_at_us:
            self.run(10 * MS)
            active = self.terminal.active
            if active is not None and self.terminal.shown_at_us[active] > since_at_us:
                return (self.terminal.shown_at_us[active] - since_at_us) / S
        return (self.now_us - since_at_us) / S

    @property
    def serving(self) -> RobotNode | None:
        """The robot whose screen is shown."""
        for robot in self.robots:
            if robot.alive and robot.peer.address == self.terminal.active:
                return robot
        return None

    def press_stop(self) -> float:
        """Milliseconds from the key until every robot that lives has latched."""
        self.terminal.press(3000, 1)
        pressed_at_us = self.now_us
        self.run(1 * S)
        times = [robot.stopped_at_us for robot in self.robots if robot.alive]
        return max((S if at is None else at - pressed_at_us) / MS for at in times)

    def release(self) -> bool:
        """Press RELEASE; whether no robot is latched after a second."""
        self.terminal.press(3001, 2)
        self.run(1 * S)
        return all(r.stopped_at_us is None for r in self.robots if r.alive)


def _of_terminal(identifier: int) -> bool:
    """Whether a frame is from the terminal or to it."""
    addressed = identifier >> 16 & 0xFF < 0xF0
    return identifier & 0xFF == TERMINAL or (addressed and identifier >> 8 & 0xFF == TERMINAL)


def killed_screens(
    kills: int, robots: int = 4, seed: int = 1, load_for_s: int = 10
) -> KilledScreens:
    """Kill the robot that shows the screen, and start it again 1.5 s after the next screen is there.

    `load_for_s`: seconds before the first kill in which the load of the screen is counted.
    """
    fleet, rng = ScreenFleet(robots, seed), Random(seed)
    fleet.run(6 * S)
    carried, from_at_us = len(fleet.bus.carried), fleet.now_us
    fleet.run(load_for_s * S)
    screen = [frame for frame in fleet.bus.carried[carried:] if _of_terminal(frame.identifier)]
    load = sum(frame_bits(*f) for f in screen) * S / (fleet.now_us - from_at_us) / 250_000
    worst_for_s = stop_for_ms = 0.0
    done = released = stops = 0
    while done < kills:
        victim = fleet.serving
        assert victim is not None, f"no screen after {done} kills with seed {seed}"
        fleet.run(rng.randrange(1000) * MS)
        victim.alive, killed_at_us = False, fleet.now_us
        worst_for_s = max(worst_for_s, fleet.until_shown(killed_at_us, 10 * S))
        done += 1
        fleet.run(1500 * MS)
        victim.start(fleet.now_us)
        fleet.run(3500 * MS)
        if done % 5 == 1:
            stops += 1
            stop_for_ms = max(stop_for_ms, fleet.press_stop())
            released += fleet.release()
    terminal = fleet.terminal
    size = max(map(len, terminal.pools.values()), default=0)
    return KilledScreens(
        done,
        worst_for_s,
        terminal.twice,
        stop_for_ms,
        released,
        stops,
        size,
        load,
        tuple(terminal.errors),
    )
