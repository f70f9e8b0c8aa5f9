"""Segments as processes with gateways between them: started, commanded, cut and healed from here.

No process stays behind: `close` ends every process that was started, whatever happened.
"""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random
from typing import Any

BOOT_S = 30.0  # a process needs two seconds to import its modules, on a busy machine ten
LOOK_S = 0.02
SPACING_S = 0.11  # a second press at one machine within 100 ms counts as the same press
HOME, SHARED, ROBOTS = 20, 4, 2

Prefix = Sequence[str]  # of a command line: enters a network namespace


class Program:
    """A process that reads and writes lines of JSON."""

    def __init__(self, command: Sequence[str]) -> None:
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[__name__.count(".")])},
        )  # fmt: skip

    def ask(self, order: dict[str, Any]) -> dict[str, Any]:
        """Send one line and return the answer to it."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(order) + "\n")
        return self.answer()

    def answer(self) -> dict[str, Any]:
        """Wait for the next line. AssertionError if the process has ended."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, f"it has ended with {self.process.poll()}"
        answer: dict[str, Any] = json.loads(line)
        return answer

    def kill(self) -> None:
        """Kill the process, wait for its end, and close its pipes."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError, ValueError):
                if pipe is not None:
                    pipe.close()


class BridgedSegments:
    """`segments` servers, each with robots and gateways."""

    def __init__(
        self, segments: int, seed: int = 1, prefix: Callable[[int], Prefix] = lambda k: ()
    ):
        self.prefix, self.seed = prefix, seed
        self.rng = Random(f"{seed}/bridged segments")
        self.hosts: dict[int, Program] = {}
        self.gateways: dict[int, list[Program]] = {}
        self.ports: dict[int, int] = {}
        self.count = segments

    def start_hosts(self, robots: int = ROBOTS) -> None:
        """Start a server with so many robots for each segment, and note the port of each."""
        for number in range(1, self.count + 1):
            self._start_host(number, robots, 0)
        for number, host in self.hosts.items():
            self.ports[number] = int(host.answer()["port"])
            self.gateways[number] = []

    def _start_host(self, number: int, robots: int, port: int) -> None:
        command = [*self.prefix(number), sys.executable, "-m", f"{__package__}.segment_process"]
        host = self.hosts[number] = Program(command)
        assert host.process.stdin is not None
        order = {"segment": number, "segments": self.count, "home": HOME, "shared": SHARED,
                 "robots": robots, "seed": self.seed, "port": port}  # fmt: skip
        host.process.stdin.write(json.dumps(order) + "\n")

    def restart_host(self, number: int, robots: int = ROBOTS) -> None:
        """Kill a server and its robots, and start them again without memory, on the same port."""
        self.hosts[number].kill()
        self._start_host(number, robots, self.ports[number])
        assert self.hosts[number].answer()["port"] == self.ports[number]

    def start_gateway(self, number: int, *options: str, area: Path | None = None) -> Program:
        """Start `headland bridge` on the segment with this number, with these further options."""
        borders = () if area is None else ("--area", str(area))
        command = [
            *self.prefix(number), sys.executable, "-m", "headland", "bridge",
            "--segment", str(number), "--port", str(self.ports[number]), "--json", *borders, *options,
        ]  # fmt: skip
        gateway = Program(command)
        self.gateways[number].append(gateway)
        return gateway

    def state(self, number: int) -> dict[str, Any]:
        """What the robots of a segment report now, see `SegmentHost.state`."""
        return self.hosts[number].ask({"do": "state"})

    def wait(self, what: str, holds: Callable[[], bool], limit_for_s: float = BOOT_S) -> float:
        """Wait until `holds` is true, and return how long that took, in seconds. AssertionError
        with the state of all segments if it was not within `limit_for_s`."""
        begun_at_s = time.monotonic()
        while not holds():
            waited_s = time.monotonic() - begun_at_s
            states = {k: self.state(k) for k in self.hosts} if waited_s > limit_for_s else {}
            assert waited_s <= limit_for_s, f"{what}: not within {limit_for_s} s; {states}"
            time.sleep(LOOK_S)
        return time.monotonic() - begun_at_s

    def wait_reached(self, others: int, limit_for_s: float = BOOT_S) -> float:
        """Wait until all robots of all segments know that this many other segments are reached;
        returns seconds."""

        def reached() -> bool:
            states = [self.state(number) for number in self.hosts]
            return all(s["joined"] and s["reached"] == others for s in states)

        return self.wait(f"{others} segments reached", reached, limit_for_s)

    def press_and_wait(self, number: int, slot: int = 0, limit_for_s: float = 10.0) -> float:
        """Arm all, press; milliseconds until the last robot of all segments had its zero
        command."""
        for host in self.hosts.values():
            host.ask({"do": "arm"})
        time.sleep(self.rng.uniform(SPACING_S, 2 * SPACING_S))  # at a random moment of the beats
        pressed_at_us = self.hosts[number].ask({"do": "press", "slot": slot})["pressed_us"]
        last_at_us = 0.0

        def all_halted() -> bool:
            nonlocal last_at_us
            halts = [host.ask({"do": "halts"})["halts"] for host in self.hosts.values()]
            last_at_us = max((t for h in halts for t in h.values()), default=0)
            return all(len(h) == ROBOTS for h in halts)

        self.wait("everybody stands", all_halted, limit_for_s)
        return (last_at_us - float(pressed_at_us)) / 1e3

    def close(self) -> None:
        """Kill all processes, gateways first."""
        for program in (*(g for gs in self.gateways.values() for g in gs), *self.hosts.values()):
            program.kill()


def write_area(folder: Path, number: int, segments: int) -> Path:
    """Write the borders of a ring as the file that `headland bridge --area` reads."""
    from sim.rigs.segments_rig import ring_area

    area = ring_area(number, segments, HOME, SHARED)
    lent = [f"{{ section = {s}, to = {sorted(to)} }}" for s, to in sorted(area.lent.items())]
    borrowed = [
        f"{{ section = {s}, of = {place.segment}, there = {place.section} }}"
        for s, place in sorted(area.borrowed.items())
    ]
    path = folder / f"area{number}.toml"
    path.write_text(
        f"home = {area.home}\nlent = [{', '.join(lent)}]\nborrowed = [{', '.join(borrowed)}]\n"
    )
    return path
