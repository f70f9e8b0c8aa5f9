"""`--metrics`: what a listener knows of a fleet, for Prometheus, by the package prometheus-client.

Figures are read in the loop of the program, when they are asked for: between two scrapes nothing is
computed but counters. docs/use/monitoring.md lists them.
"""

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from typing import Any

from prometheus_client import (
    CollectorRegistry,
    Histogram,
    PlatformCollector,
    ProcessCollector,
    make_wsgi_app,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from agent.interface.lifecycle import State
from agent.safety.stop_cause import cause_of
from tools.inspect.inspector import SILENT_S, Seen
from tools.inspect.measured_inspector import MeasuredInspector
from tools.inspect.metrics_address import MetricsAddress, MetricsError
from tools.inspect.scrape_server import ScrapeServer

REPLICAS = ("in step", "before the last change", "differs")
ANSWER_S = 5.0  # Prometheus gives up after 10 s
# Seconds. The bound of an echo on a quiet bus is 20 ms; a robot needs up to 3 s to come to a stand.
ECHO_BUCKETS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
STAND_BUCKETS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0)
ROBOT = "headland_robot"
Pids = Callable[[], Mapping[int, int]]


class FleetCollector(Collector):
    """The figures of a fleet from its inspector, each time that they are asked for."""

    def __init__(
        self, inspector: MeasuredInspector, clock: Callable[[], float], registry: CollectorRegistry
    ) -> None:
        """`clock`: seconds, on the clock of the frames that the inspector hears."""
        self.inspector, self.clock = inspector, clock
        echo = Histogram(
            "headland_stop_echo_seconds",
            "From the first frame of a stop to the echo of each robot that was heard.",
            buckets=ECHO_BUCKETS, registry=registry,
        )  # fmt: skip
        stand = Histogram(
            "headland_stop_standstill_seconds",
            "From the first frame of a stop to the first pose that stands, of robots that moved.",
            buckets=STAND_BUCKETS, registry=registry,
        )  # fmt: skip
        inspector.on_echo, inspector.on_stand = echo.observe, stand.observe
        registry.register(self)

    def describe(self) -> Iterable[Metric]:
        """None: names do not depend on what was heard, and are not asked for at registration."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """All families, with a row for each robot that was heard."""
        yield from self._robots()
        yield from self._work()
        yield from self._bus()

    def _robots(self) -> Iterator[Metric]:
        seen, now_s = self.inspector, self.clock()
        robots = [seen.robots[slot] for slot in sorted(seen.robots)]
        yield _gauge("headland_robots", "Robots that were heard and have not left.", sum(
            not robot.left for robot in robots
        ))  # fmt: skip
        yield _by_robot(
            "silence_seconds", "Since its last frame.", robots, lambda r: now_s - r.last_s
        )
        yield _by_robot("left", "1: it has said that it leaves.", robots, lambda r: r.left)
        yield _by_robot(
            "health_ratio", "What it says of itself; 1: sound.", robots, lambda r: r.health
        )
        yield _by_robot("held", "1: something keeps it from moving.", robots, lambda r: r.held)
        yield _by_robot(
            "placed", "1: it knows where it is.", robots, lambda r: r.placed and r.has_place
        )
        # Its last speed would be drawn on for ever, and count in sums.
        heard = [r for r in robots if not r.left and now_s - r.last_s <= SILENT_S]
        yield _by_robot(
            "speed_metres_per_second", "Its speed, while it is heard.", heard, lambda r: r.speed_m_s
        )
        yield _by_robot(
            "asking", "1: it waits for an operator's answer.", robots, lambda r: r.question > 0
        )
        charged = [robot for robot in robots if robot.battery is not None]
        yield _by_robot(
            "battery_ratio", "Charge of its battery.", charged, lambda r: r.battery or 0.0
        )
        yield _by_robot(
            "leads", "1: it answers for the fleet.", robots, lambda r: r.slot == seen.leader
        )
        yield _by_robot(
            "keyed", "1: it says that its fleet has keys; 0: any device may release it.",
            [robot for robot in robots if robot.keyed is not None], lambda r: bool(r.keyed),
        )  # fmt: skip
        state = GaugeMetricFamily(
            f"{ROBOT}_state", "1: it is in this state.", labels=["robot", "state"]
        )
        replica = GaugeMetricFamily(
            f"{ROBOT}_replica",
            "1: what its last digest says of its copy of the shared state.",
            labels=["robot", "replica"],
        )
        cause = GaugeMetricFamily(
            f"{ROBOT}_cause", "1: it stands or creeps for this cause.", labels=["robot", "cause"]
        )
        for robot in robots:
            slot = str(robot.slot)
            for name in State.__members__:
                state.add_metric([slot, name], robot.state == name)
            for name in REPLICAS:
                replica.add_metric([slot, name.replace(" ", "_")], seen.replica_of(robot) == name)
            for name in sorted({_cause(m.cause) for m in robot.causes.fresh(round(now_s * 1e6))}):
                cause.add_metric([slot, name], 1.0)
        yield from (state, replica, cause)
        entered = CounterMetricFamily(
            f"{ROBOT}_transitions", "How often it entered a state.", labels=["robot", "state"]
        )
        for (number, name), count in sorted(seen.entered.items()):
            entered.add_metric([str(number), name], count)
        yield entered

    def _work(self) -> Iterator[Metric]:
        seen = self.inspector
        phases = dict(seen.phases())
        sections = GaugeMetricFamily(
            "headland_sections", "Sections, or transports, by phase.", labels=["phase"]
        )
        for phase, count in phases.items():
            sections.add_metric([phase], count)
        yield sections
        total = sum(phases.values())
        yield _gauge(
            "headland_work_done_ratio",
            "Share of the sections that are done; of those heard of, where the field is not known.",
            phases["DONE"] / total if total else 0.0,
        )
        yield _gauge(
            "headland_worked_units", "Units of work that are covered.", seen.worked_units()
        )
        yield _gauge(
            "headland_stops_latched",
            "Stops that are not cleared.",
            len(seen.latched) + seen.latched_more,
        )
        yield _gauge(
            "headland_implements_stop", "1: an ISO 11783-7 button stops all implements.",
            seen.implements_stop is not None,
        )  # fmt: skip

    def _bus(self) -> Iterator[Metric]:
        seen, now_s = self.inspector, self.clock()
        yield _gauge(
            "headland_bus_load_ratio",
            "Of the last second, at worst-case stuffing.",
            seen.load_at(now_s),
        )
        yield _counter("headland_frames", "Frames by kind.", "kind", seen.frames_by_kind)
        yield _counter(
            "headland_bus_busy_seconds", "Bus time of the frames of a kind, at worst-case stuffing.",
            "kind", {kind: bits / seen.load.bitrate for kind, bits in seen.bits_by_kind.items()},
        )  # fmt: skip
        yield _counter(
            "headland_malformed_frames", "Frames that cannot be read.", "reason", seen.malformed
        )
        yield CounterMetricFamily(
            "headland_foreign_frames", "Frames of other makers, and of groups that are not ours.",
            sum(seen.unknown.values()) + sum(seen.makers.refused.values()),
        )  # fmt: skip


class RobotProcesses(Collector):
    """Processor time, memory and open files of the processes of a launch, by robot."""

    def __init__(
        self, robots: Callable[[], Iterable[int]], pids: Pids, registry: CollectorRegistry
    ) -> None:
        """`robots`: all of the launch. `pids`: process ids of those whose process runs."""
        self.robots, self.pids = robots, pids
        registry.register(self)

    def describe(self) -> Iterable[Metric]:
        """None, as for the fleet."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """`headland_robot_process_up`, and what prometheus-client reads of each process."""
        pids = dict(self.pids())
        up = GaugeMetricFamily(f"{ROBOT}_process_up", "1: its process runs.", labels=["robot"])
        for slot in self.robots():
            up.add_metric([str(slot)], slot in pids)
        families: dict[str, Metric] = {}
        for slot, pid in pids.items():
            for metric in ProcessCollector(ROBOT, _constant(pid), registry=None).collect():
                kept = families.setdefault(
                    metric.name, Metric(metric.name, metric.documentation, metric.type)
                )
                for sample in metric.samples:
                    kept.add_sample(sample.name, {"robot": str(slot)}, sample.value)
        yield up
        yield from families.values()


class GatewayCollector(Collector):
    """What a gateway says of itself."""

    def __init__(
        self, status: Callable[[], Mapping[str, Any]], registry: CollectorRegistry
    ) -> None:
        """`status`: as `headland bridge --json` prints it."""
        self.status = status
        registry.register(self)

    def describe(self) -> Iterable[Metric]:
        """None, as for the fleet."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Whether it leads, whether its bus works, and how many segments it reaches."""
        status = self.status()
        yield _gauge("headland_gateway_leads", "1: it leads on its segment.", status["leads"])
        yield _gauge("headland_gateway_bus_up", "1: its bus works.", status["bus"] == "ACTIVE")
        yield _gauge(
            "headland_gateway_segments_reached",
            "Other segments that it hears.",
            len(status["reached"]),
        )


class MetricsServer:
    """Serves the figures over HTTP in a thread; they are read in the loop that makes it."""

    def __init__(self, address: MetricsAddress) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        PlatformCollector(registry=self.registry)
        self.address, self.port = address, address.port
        self._loop = asyncio.get_running_loop()

    def start(self) -> str:
        """Open the port; the URL of the figures. Raises MetricsError where it is taken."""
        try:
            # The registry is not given itself: it is read where nothing changes meanwhile.
            app = make_wsgi_app(_InLoop(self.registry, self._loop))
            self._server = ScrapeServer(self.address.host, self.address.port, app)
        except OSError as problem:
            raise MetricsError(f"--metrics {self.address}: {problem.strerror}") from None
        self.port = self._server.server_port
        return f"http://{self.address.host}:{self.port}/metrics"

    def close(self) -> None:
        """Close the port."""
        self._server.shutdown()
        self._server.server_close()


class _InLoop:
    """A registry that is read in the thread of a loop."""

    def __init__(self, registry: CollectorRegistry, loop: asyncio.AbstractEventLoop) -> None:
        self.registry, self.loop = registry, loop

    def restricted_registry(self, names: Iterable[str]) -> "_InLoop":
        """All of it, also where a client asks for some names: it is small."""
        return self

    def collect(self) -> list[Metric]:
        async def all_of_it() -> list[Metric]:
            return list(self.registry.collect())

        try:
            return asyncio.run_coroutine_threadsafe(all_of_it(), self.loop).result(ANSWER_S)
        except (RuntimeError, TimeoutError, CancelledError):
            return []  # the program ends, or stands: a scrape without figures is not "all is well"


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(name, text, float(value))


def _counter(name: str, text: str, label: str, counts: Mapping[str, float]) -> Metric:
    family = CounterMetricFamily(name, text, labels=[label])
    for value, count in sorted(counts.items()):
        family.add_metric([value], count)
    return family


def _by_robot(
    name: str, text: str, robots: Iterable[Seen], value: Callable[[Seen], float]
) -> Metric:
    family = GaugeMetricFamily(f"{ROBOT}_{name}", text, labels=["robot"])
    for robot in robots:
        family.add_metric([str(robot.slot)], float(value(robot)))
    return family


def _cause(number: int) -> str:
    cause = cause_of(number)
    return "OTHER" if cause is None else cause.name


def _constant(pid: int) -> Callable[[], int]:
    return lambda: pid
