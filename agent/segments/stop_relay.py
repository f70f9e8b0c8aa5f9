"""A gateway's part in stopping: repeats every press of the fleet in its segment until all robots
stand.

Every candidate forwards stops, whether it leads or not, so no stop is lost if a gateway dies. The
others wait a moment and send only what the leader has not sent. The relay authenticates nothing,
because it holds no secret. The robots verify, and a reset never prevents the relay from forwarding
a stop.

A stop frame is a press, or a repetition for a segment that may not know it. A press with a dot that
has a reset is forwarded as well while it is sent: robots that know the reset brake and take another
dot.
"""

from collections.abc import Iterable
from typing import NamedTuple

from agent.interface.config import MS, STOP_REPEAT_US, S
from agent.interface.instants import FOREVER_US
from agent.segments.token_bucket import TokenBucket
from crdt.digest import mix
from crdt.stops import RemoteStopDot
from protocol.frames.segment_frames import (
    FLEET_RESET,
    FLEET_STOP,
    GATEWAY_ADDRESS,
    FleetReset,
    FleetStop,
)

DOTS_MAX = 1024  # dots kept; beyond it those with a reset are dropped, oldest first
REPEATS_MAX = 400  # 2 s of repetition, as a robot does; then beats without the stopped bit renew it
TIMES_MIN = 2  # repeats even if all robots stand: some may stand for another cause
# 100 ms of repetition of a stop that is only told and has a reset, in case that reset is forged.
CLEARED_TIMES = 20
TOLD_WAIT_US = (
    50 * MS
)  # a stop that another segment tells waits for its reset, which may come after it
STANDBY_US = 8 * MS  # the leader's frame, and two in its way, are on the bus by then
LIVE_US = 1 * S  # a robot received within this has to stop; the longest silence that is tolerated
NEWS_BURST, NEWS_A_SECOND = 16, 20  # new dots from the backbone; one is enough to stop all robots
USED_US = 50 * MS  # a press with a dot that has a reset is published again this often
AGAIN_US = 500 * MS  # a stop is repeated this often for a robot that beats "not stopped"


class Repetition(NamedTuple):
    """A dot that is being sent: remaining repeats, and time of the next."""

    left: int
    next_at_us: int
    told: bool  # a repetition, not a new press


class StopRelay:
    """The stops and resets of the whole fleet that one gateway holds and repeats."""

    def __init__(self, segment: int, now_us: int) -> None:
        self.segment = segment
        self.leads = False
        # Presses, without the bit `told`. A dot may be said with several tags. The relay does not know
        # the right one, so each is a stop of its own.
        self.stops: dict[FleetStop, None] = {}
        self.resets: dict[RemoteStopDot, dict[int, FleetReset]] = {}
        # Of what is kept now; None: to be computed. Each summary of another segment is compared with it.
        self._digest: int | None = None
        self.refused = 0  # dots beyond the limit of news
        # Stops whose repeats were all sent without any robot here stopping for them.
        self.disbelieved: set[FleetStop] = set()
        self._repeated: dict[FleetStop, Repetition] = {}
        self._robots: dict[int, tuple[int, bool]] = {}  # address -> last beat, stands stopped
        self._echoes: dict[RemoteStopDot, set[int]] = {}
        self._next_at_us = 0  # we send one stop at a time, regardless of their number
        self._again_at_us = 0
        # When a press, not a repetition, was forwarded last.
        self._pressed_at_us: dict[FleetStop, int] = {}
        self._to_reset: list[FleetReset] = []
        self._news = TokenBucket(NEWS_A_SECOND / 1e6, NEWS_BURST, now_us)

    @property
    def digest(self) -> int:
        """32 bits that are equal for equal stops and resets; equal ones need no exchange.

        At the limit each gateway drops what was the oldest to it. So only what is active counts then, or
        gateways would tell each other for good what they drop.
        """
        if self._digest is not None:
            return self._digest
        full = len(self.stops) >= DOTS_MAX or len(self.resets) >= DOTS_MAX
        total = sum(
            mix(int.from_bytes(FLEET_STOP.pack(stop), "little"))
            for stop in self.stops
            if not full or self._active(_dot(stop))
        )
        for halves in () if full else self.resets.values():
            total += sum(
                mix(int.from_bytes(FLEET_RESET.pack(half), "little")) for half in halves.values()
            )
        self._digest = (total & 0xFFFF_FFFF_FFFF_FFFF) >> 32
        return self._digest

    # ---------------------------------------------------------------- from our segment

    def on_pose(self, address: int, stopped: bool, now_us: int) -> None:
        """A robot's pose, from its bus address.

        A robot that drives on under an active stop has not received it, so the stop is sent again.
        """
        self._robots[address] = now_us, stopped
        if stopped or now_us < self._again_at_us or self._repeated:
            return
        active = [s for s in self.stops if self._active(_dot(s)) and s not in self.disbelieved]
        if active:
            self._again_at_us = now_us + AGAIN_US
            self._repeat(active[-1], True, now_us)

    def keys_changed(self) -> None:
        """The robots here have other keys. By these they may know a stop that they disbelieved, so it is
        said again.
        """
        self.disbelieved.clear()

    def halted(self, now_us: int) -> tuple[int, int]:
        """How many robots were received lately, and how many of them are stopped."""
        lately = [s for heard_at_us, s in self._robots.values() if now_us - heard_at_us < LIVE_US]
        return len(lately), sum(lately)

    def on_stop(self, source: int, stop: FleetStop, now_us: int) -> list[FleetStop]:
        """A stop on our bus, from any device. Returns the frames to publish on the backbone.

        `source`: its bus address.
        """
        self._echoes.setdefault(_dot(stop), set()).add(source)
        press = stop._replace(told=False)
        known = press in self.stops
        if not known and not self._keep(press):
            return []
        if known and (not self._is_press(stop, now_us) or not self._news.take(1, now_us)):
            return []
        if not stop.told:
            self._pressed_at_us[press] = now_us
        return [stop]

    def _is_press(self, stop: FleetStop, now_us: int) -> bool:
        """Whether a frame with a known dot is a new press.

        A press counts once. With a dot that has a reset it counts again in intervals while it is
        sent.
        """
        if stop.told or stop not in self._pressed_at_us:
            return not stop.told
        return not self._active(_dot(stop)) and now_us - self._pressed_at_us[stop] >= USED_US

    def on_reset(self, half: FleetReset) -> list[FleetReset]:
        """One half of a reset on our bus. Returns both halves to publish when the second one is
        new.
        """
        dot = _dot(half)
        halves = self.resets.setdefault(dot, {})
        if halves.get(half.part) == half:
            return []
        halves[half.part] = half
        self._trim()
        return list(halves.values()) if len(halves) == 2 else []

    # ---------------------------------------------------------------- from the backbone

    def on_backbone_stops(self, stops: Iterable[FleetStop], now_us: int) -> None:
        """Stops from the backbone, to repeat on our bus if they are news."""
        for stop in stops:
            dot, press = _dot(stop), stop._replace(told=False)
            known = press in self.stops
            if known and not self._is_press(stop, now_us):
                continue
            if not self._news.take(1, now_us):
                self.refused += 1  # its sender repeats it, because our digest still differs
                continue
            if not self._keep(press):
                continue
            if known and not self._active(dot):  # earlier echoes do not count for this press
                self._echoes.pop(dot, None)
            if not stop.told:
                self._pressed_at_us[press] = now_us
            self._repeat(press, stop.told, now_us + (TOLD_WAIT_US if stop.told else 0))

    def on_backbone_resets(self, resets: Iterable[FleetReset], now_us: int) -> None:
        """Halves of resets from the backbone; complete ones are sent on our bus."""
        for half in resets:
            if len(self._to_reset) >= 2 * DOTS_MAX:
                self.refused += 1  # its sender repeats it, because our digest still differs
                continue
            known = self.resets.setdefault(_dot(half), {})
            if known.get(half.part) != half:
                known[half.part] = half
                if len(known) == 2:
                    self._to_reset += known.values()
        self._trim()

    def _repeat(self, press: FleetStop, told: bool, now_us: int) -> None:
        next_at_us = now_us if self.leads else now_us + STANDBY_US
        self._repeated[press] = Repetition(REPEATS_MAX, next_at_us, told)

    def _keep(self, press: FleetStop) -> bool:
        self.stops[press] = None
        self._trim()
        return press in self.stops

    def _trim(self) -> None:
        """Called after each change of stops and resets: keep the limits."""
        self._digest = None
        if len(self.stops) > DOTS_MAX:
            for press in [s for s in self.stops if not self._active(_dot(s))] + list(self.stops):
                if len(self.stops) <= DOTS_MAX:
                    break
                self._forget(press)
        if (
            len(self.resets) > DOTS_MAX
        ):  # a stop that is kept without its reset would be active again
            needed = set(map(_dot, self.stops))
            for dot in [d for d in self.resets if d not in needed][: len(self.resets) - DOTS_MAX]:
                del self.resets[dot]
        while len(self._echoes) > DOTS_MAX:
            del self._echoes[next(iter(self._echoes))]

    def _forget(self, press: FleetStop) -> None:
        """Drop a stop, and the reset of its dot if no other tag of it is left."""
        self.stops.pop(press, None)
        self._repeated.pop(press, None)
        self._pressed_at_us.pop(press, None)
        self.disbelieved.discard(press)
        if all(_dot(kept) != _dot(press) for kept in self.stops):
            self.resets.pop(_dot(press), None)

    def _active(self, dot: RemoteStopDot) -> bool:
        return len(self.resets.get(dot, ())) < 2

    # ---------------------------------------------------------------- on our segment

    @property
    def due_at_us(self) -> int:
        """When `on_tick` has something to send next."""
        if self._to_reset:
            return self._next_at_us
        due_at_us = min((said.next_at_us for said in self._repeated.values()), default=FOREVER_US)
        return max(due_at_us, self._next_at_us) if due_at_us < FOREVER_US else FOREVER_US

    def on_tick(self, now_us: int) -> list[FleetStop | FleetReset]:
        """The frames to send now: at most one stop, or the halves of one reset, twice in case one
        is missed.
        """
        if now_us < self.due_at_us:
            return []
        self._next_at_us = now_us + STOP_REPEAT_US
        for press, said in sorted(self._repeated.items(), key=lambda item: item[1].next_at_us):
            if said.next_at_us > now_us:
                break
            dot = _dot(press)
            cleared = said.told and not self._active(dot)
            enough = said.left <= REPEATS_MAX - TIMES_MIN and self._all_stand(dot, now_us)
            enough = enough or (cleared and said.left <= REPEATS_MAX - CLEARED_TIMES)
            if said.left <= 0 or enough or self._leader_sent(dot):
                del self._repeated[press]
                live, halted = self.halted(now_us)
                if said.left <= 0 and live and not halted:
                    # Without a valid tag it held only while it was sent.
                    self.disbelieved.add(press)
                continue
            self._repeated[press] = Repetition(said.left - 1, now_us + STOP_REPEAT_US, said.told)
            if cleared and said.left == REPEATS_MAX:  # else a robot that knows neither would latch
                halves = list(self.resets[dot].values())
                self._to_reset = [half for half in self._to_reset if half not in halves]
                return [*halves, *halves]
            return [press._replace(told=said.told)]
        halves, self._to_reset = self._to_reset[:2], self._to_reset[2:]
        return [*halves, *halves]

    def _leader_sent(self, dot: RemoteStopDot) -> bool:
        return not self.leads and any(a >= GATEWAY_ADDRESS for a in self._echoes.get(dot, ()))

    def _all_stand(self, dot: RemoteStopDot, now_us: int) -> bool:
        """Whether every robot received lately has echoed this dot or beats with the stopped bit.

        If no robot was received, this is False, so the stop is sent until the repeats are used up.
        """
        echoes = self._echoes.get(dot, set())
        lately = {a: s for a, (t_us, s) in self._robots.items() if now_us - t_us < LIVE_US}
        return bool(lately) and all(s or a in echoes for a, s in lately.items())


def _dot(m: FleetStop | FleetReset) -> RemoteStopDot:
    return RemoteStopDot(m.slot, m.incarnation, m.counter, m.segment)
