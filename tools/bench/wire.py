"""The wire: its load with a fleet at work, its speed, its response times against their bounds."""

import asyncio
import threading
from collections import Counter
from collections.abc import Iterator
from heapq import heappop, heappush
from random import Random
from statistics import median
from time import process_time

import can

from agent.interface.config import beat_of
from protocol.frames.codec import Malformed, decode, encode
from protocol.frames.fleet_frames import Heartbeat, LeaderElectionVote, Pose
from protocol.frames.frame import Frame
from protocol.frames.messages import GROUP_OF, Message
from protocol.frames.safety_frames import AllImplementsStop, EmergencyStop
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from sim.can.can_wire import Wire
from sim.can.frame_timing import BIT_US, worst_bits
from sim.can.simulated_bus import FieldBus, forget
from sim.fleet.virtual_clock import run_virtual
from tools.bench.drill import ProtocolFleet
from tools.bench.figure import Figure
from tools.bench.response_time import Stream, bound_us

LOADS = ((20, 0.30), (50, 0.38), (108, 0.42))
RECEIVERS = 50
FULL_BUS = 1840  # frames of 8 random bytes that 250 kbit/s carry in a second
FRAME_US = worst_bits(8) * BIT_US


def figures(quick: bool, seed: int = 1) -> Iterator[Figure]:
    """Load of the bus, bytes of a claim, speed of the simulated wire, and response times of frames."""
    for robots, target in LOADS:
        yield load(robots, target, seed, 3.0 if quick else 60.0)
    claim = encode(TaskClaim(7, 1, 1, 3, 99, 5), 128)
    yield Figure("bytes on the wire per claim", len(claim.data), "B", "8", len(claim.data) == 8,
                 "", "one frame")  # fmt: skip
    yield from deliveries(2 if quick else 7)
    for robots, _ in LOADS:
        yield from response_times(robots, seed, 10_000 if quick else 100_000)
    yield decoding(5 if quick else 15)


# -------------------------------------------------------------------- load


def load(robots: int, target: float, seed: int, seconds: float) -> Figure:
    """Share of the bus at worst-case stuffing, all robots at work, after a common boot. `target` is
    the greatest share wanted."""
    share, working = run_virtual(_load(robots, seed, seconds))
    beat = beat_of(robots)
    scope = (
        f"whole peers, {seconds:g} s, all at work: {working}; pose {beat.pose_period_us // 1000} ms, "
        f"heartbeat {beat.heartbeat_period_us // 1000} ms"
    )
    holds = share <= target and working
    return Figure(f"bus load, {robots} peers", share, "share", f"<= {target}", holds, "", scope)


async def _load(robots: int, seed: int, seconds: float) -> tuple[float, bool]:
    fleet = ProtocolFleet(robots, seed)
    try:
        working = await fleet.until_working()
        before_us = fleet.segment.wire.worst_for_us
        await asyncio.sleep(seconds)
        working &= all(s.peer.state.name in ("WORKING", "IDLE") for s in fleet.runners)
        return (fleet.segment.wire.worst_for_us - before_us) / (seconds * 1e6), working
    finally:
        await fleet.close()


# -------------------------------------------------------------------- deliveries


def deliveries(rounds: int) -> Iterator[Figure]:
    """One sender, fifty receivers, A B A B, CPU time of the whole process."""
    ours, theirs, threads = [], [], []
    for _ in range(rounds):
        ours.append(_fieldbus(4000))
        theirs.append(_virtual(150))
        threads.append(_virtual_threads(100))
    best = max(median(theirs), median(threads))
    ratio, rate = median(ours) / best, median(ours)
    against = f"python-can {can.__version__} virtual with Notifier, the better of loop and threads"
    scope = (
        "1 sender, 50 receivers with a callback each, CPU time; ours with arbitration and bit times"
    )
    yield Figure("frames delivered to 50 receivers, ratio", ratio, "ratio", ">= 10", ratio >= 10,
                 against, scope)  # fmt: skip
    yield Figure("frames delivered to 50 receivers", rate, "frames/s", f">= {FULL_BUS}",
                 rate >= FULL_BUS, "a full bus of 250 kbit/s", scope)  # fmt: skip
    yield Figure("frames delivered to 50 receivers by python-can virtual", best, "frames/s", "", None,
                 against, scope)  # fmt: skip


def _frames(count: int) -> list[Frame]:
    rng = Random(count)
    return [Frame(0x0CFF1080, rng.randbytes(8)) for _ in range(count)]


def _fieldbus(count: int) -> float:
    heard = [0] * RECEIVERS

    async def main() -> None:
        sender = FieldBus("bench")
        buses = [FieldBus("bench") for _ in range(RECEIVERS)]
        for k, bus in enumerate(buses):
            bus.subscribe(lambda frame, k=k: heard.__setitem__(k, heard[k] + 1))  # type: ignore[misc]
        for frame in _frames(count):
            while not sender.submit(frame):
                await asyncio.sleep(0.05)
        while min(heard) < count:
            await asyncio.sleep(0.05)
        for bus in (sender, *buses):
            bus.shutdown()
        forget("bench")

    begun_s = process_time()
    run_virtual(main())
    return count / (process_time() - begun_s)


def _virtual(count: int) -> float:
    heard = [0] * RECEIVERS

    async def main() -> None:
        loop, all_heard = asyncio.get_running_loop(), asyncio.Event()

        def listener(k: int):  # type: ignore[no-untyped-def]
            def on(message: can.Message) -> None:
                heard[k] += 1
                if heard[k] == count and min(heard) == count:
                    all_heard.set()

            return on

        sender = can.Bus(interface="virtual", channel="bench")
        buses = [can.Bus(interface="virtual", channel="bench") for _ in range(RECEIVERS)]
        notifiers = [
            can.Notifier(b, [listener(k)], timeout=0.05, loop=loop) for k, b in enumerate(buses)
        ]
        for frame in _frames(count):
            sender.send(can.Message(arbitration_id=frame.identifier, data=frame.data))
        await all_heard.wait()
        for notifier in notifiers:
            notifier.stop()
        for bus in (sender, *buses):
            bus.shutdown()

    begun_s = process_time()
    asyncio.run(main())
    return count / (process_time() - begun_s)


def _virtual_threads(count: int) -> float:
    heard: Counter[int] = Counter()
    done = threading.Semaphore(0)

    def listener(k: int):  # type: ignore[no-untyped-def]
        def on(message: can.Message) -> None:
            heard[k] += 1
            if heard[k] == count:
                done.release()

        return on

    begun_s = process_time()
    sender = can.Bus(interface="virtual", channel="bench threads")
    buses = [can.Bus(interface="virtual", channel="bench threads") for _ in range(RECEIVERS)]
    notifiers = [can.Notifier(b, [listener(k)], timeout=0.05) for k, b in enumerate(buses)]
    for frame in _frames(count):
        sender.send(can.Message(arbitration_id=frame.identifier, data=frame.data))
    for _ in range(RECEIVERS):
        done.acquire()
    used_s = process_time() - begun_s
    for notifier in notifiers:
        notifier.stop()
    for bus in (sender, *buses):
        bus.shutdown()
    return count / used_s


# -------------------------------------------------------------------- response times


def streams(robots: int) -> list[tuple[str, Stream]]:
    """Every frame class of a fleet at the design's beats, one stream a sender."""
    beat = beat_of(robots)
    each: tuple[tuple[Message, int], ...] = (
        (TaskClaim(1, 1, 1, 1, 1, 1), 5_000_000),
        (Pose(0, 0, 0, 0, 1, False, 0), beat.pose_period_us),
        (Heartbeat(0, 1, False, False, True, False, 1, 1, 1), beat.heartbeat_period_us),
        (WorkProgress(1, 1, 1), 8_000_000),
        (LeaderElectionVote(1, 1, 1), 30_000_000),
    )
    stop, implements = encode(EmergencyStop(1, 1, 1, 1), 128), encode(AllImplementsStop(1, 0), 38)
    found = [
        ("EMERGENCY_STOP", Stream(stop.identifier, 5_000, FRAME_US)),
        ("ALL_IMPLEMENTS_STOP", Stream(implements.identifier, 1_000_000, FRAME_US)),
    ]
    for message, period_us in each:
        for slot in range(robots):
            identifier = encode(message, 128 + slot).identifier
            name = GROUP_OF[type(message)].name
            found.append((name, Stream(identifier, period_us, FRAME_US)))
    return found


def response_times(robots: int, seed: int, sends: int) -> Iterator[Figure]:
    """Every stream at its highest rate, with random phases and all at once, on a bus never idle."""
    named = streams(robots)
    every = [stream for _, stream in named]
    bounds = {s.identifier: bound_us(s, every, FRAME_US) for s in every}
    worst = Counter(_play(named, seed, sends // 2, together=False))
    worst |= Counter(_play(named, seed, sends - sends // 2, together=True))
    above = 0
    for name in dict.fromkeys(name for name, _ in named):
        rows = [(worst.get(s.identifier, 0), bounds[s.identifier]) for n, s in named if n == name]
        above += sum(bound is not None and measured > bound for measured, bound in rows)
        bound = max((b for _, b in rows if b is not None), default=0)
        measured = max(m for m, _ in rows)
        yield Figure(
            f"longest response, {name}, {robots} peers", measured / 1000, "ms",
            f"<= {bound / 1000:g} (computed)", all(b is not None and m <= b for m, b in rows),
            "Davis et al. 2007", f"saturated bus, {sends} sends in all, every stream below its own bound",
        )  # fmt: skip
    yield Figure(
        f"sends above their bound, {robots} peers", above, "streams", "0", above == 0,
        "Davis et al. 2007", f"{sends} sends on a saturated bus, {len(named)} streams",
    )  # fmt: skip


def _play(named: list[tuple[str, Stream]], seed: int, sends: int, together: bool) -> dict[int, int]:
    """Longest response of each identifier, in microseconds; `together`: all streams begin at once."""
    wire, rng = Wire(seed), Random(f"{seed}/response")
    filler = wire.attach("filler")
    due: list[tuple[int, int, int]] = []
    for k, (_, stream) in enumerate(named):
        phase_us = 1_000 if together else rng.randrange(stream.period_us)
        heappush(due, (phase_us, k, wire.attach()))
    low = encode(StateSyncResponse(1, 1, 1, 1, 1, 1), 250)
    queued_us: dict[int, list[int]] = {stream.identifier: [] for _, stream in named}
    worst: Counter[int] = Counter()
    sent, now_us = 0, 0
    while sent < sends:
        if not wire.nodes[filler].queue:
            wire.submit(filler, Frame(low.identifier, rng.randbytes(8)), now_us)
        next_at_us = wire.next_at_us
        assert next_at_us is not None
        now_us = min(due[0][0], next_at_us)
        for t_us, frame, sender, _ in wire.advance(now_us):
            if sender != filler:
                response_us = t_us - queued_us[frame.identifier].pop(0)
                worst[frame.identifier] = max(worst[frame.identifier], response_us)
                sent += 1
        while due[0][0] <= now_us:
            _, k, node = heappop(due)
            stream = named[k][1]
            queued_us[stream.identifier].append(now_us)
            wire.submit(
                node, Frame(stream.identifier, rng.choice((bytes(8), rng.randbytes(8)))), now_us
            )
            slack_us = rng.choice((0, rng.randrange(stream.period_us)))  # sporadic: never earlier
            heappush(due, (now_us + stream.period_us + slack_us, k, node))
    return dict(worst)


# -------------------------------------------------------------------- decoding


def decoding(rounds: int) -> Figure:
    """A mix as a working fleet sends it, every frame another one."""
    rng = Random(5)
    frames = []
    for k in range(4000):
        source = 128 + k % 100
        draw = rng.random()
        message: Message
        if draw < 0.90:
            message = Pose(rng.uniform(-900, 900), rng.uniform(-900, 900), rng.uniform(0, 6.28),
                           rng.uniform(0, 5), 3, False, k & 0xFF)  # fmt: skip
        elif draw < 0.98:
            message = Heartbeat(k % 251, 3, False, False, True, False, 1.0, k, rng.getrandbits(24))
        elif draw < 0.99:
            message = TaskClaim(k, 1, 2, 5, k, source - 128)
        else:
            message = WorkProgress(k, 1, rng.getrandbits(40))
        frames.append(encode(message, source))
    times = []
    for _ in range(rounds):
        begun_s = process_time()
        for _ in range(10):
            for frame in frames:
                decode(frame)
        times.append((process_time() - begun_s) / (10 * len(frames)))
    assert not any(isinstance(decode(frame)[1], Malformed) for frame in frames)
    rate = 1 / median(times)
    return Figure("decode", rate, "frames/s", ">= 500000", rate >= 500_000, "",
                  "one core, 90 % poses, every frame distinct, no cache")  # fmt: skip
