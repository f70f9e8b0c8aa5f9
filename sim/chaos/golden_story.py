"""The golden text of a story: what happened in it, small enough for people to read and to compare.

The first line is the trace hash, which changes if any robot does anything else at any time. The
other lines show what changed: faults, states, stops, claims, leaders and what robots told their
operators, with the time in milliseconds and the robots. Every `CHECK_US` a line has the hash of the
trace so far, so that a difference in frames alone is found too, to ten seconds. A table at the end
counts the frames.
"""

from collections import Counter, defaultdict
from collections.abc import Callable
from difflib import unified_diff
from pathlib import Path

from agent.interface.config import MS, S
from agent.interface.effects import Effect, Send, Trace
from protocol.frames.messages import GROUP_OF
from sim.chaos.scenario_judge import ScenarioJudge
from sim.chaos.verdict import Verdict, verdict_of
from sim.scenarios.scenario import Fault, Scenario

CHECK_US = 10 * S
DIGITS = 8  # of the hash of the trace so far
LEFT_OUT = ("sync", "health", "membership")  # they are two thirds of all events


class StoryText:
    """Collects the events of one run; `lines` are the text without the hash."""

    def __init__(self, scenario: Scenario, digest: Callable[[], str]) -> None:
        """`digest`: the hash of the trace so far."""
        self._robots, self._digest = scenario.fleet.robots, digest
        self._faults = sorted(scenario.fault, key=lambda fault: fault.at_s)
        # Millisecond -> robot -> its events, in order.
        self._events: defaultdict[int, dict[int, list[str]]] = defaultdict(dict)
        self._digests: dict[int, str] = {}
        self._sent: dict[int, Counter[str]] = {slot: Counter() for slot in range(self._robots)}
        self._check_at_us = CHECK_US

    def add(self, slot: int, now_us: int, effect: Effect) -> None:
        """Take an effect of a robot, which was performed at `now_us` of the simulation."""
        while now_us >= self._check_at_us:
            self._digests[self._check_at_us // MS] = self._digest()[:DIGITS]
            self._check_at_us += CHECK_US
        if isinstance(effect, Send):
            self._sent[slot][GROUP_OF[type(effect.message)].name] += 1
        elif isinstance(effect, Trace) and effect.machine not in LEFT_OUT:
            self._events[now_us // MS].setdefault(slot, []).append(_event(effect))

    def lines(self) -> list[str]:
        """All lines in order of time; then the counts of frames."""
        rows = [(round(f.at_s * 1000), 0, f"{'':8}fault {_fault(f)}") for f in self._faults]
        rows += [(t_ms, 1, f"{'':8}trace {digest}") for t_ms, digest in self._digests.items()]
        for t_ms, by_robot in self._events.items():
            robots: defaultdict[str, list[int]] = defaultdict(list)
            for slot, events in sorted(by_robot.items()):
                robots["; ".join(events)].append(slot)
            rows += [(t_ms, 2, f"{self._named(slots):8}{what}") for what, slots in robots.items()]
        rows.sort(key=lambda row: row[:2])
        return [*(f"{t_ms:>7} {text}" for t_ms, _, text in rows), "", *self._counts()]

    def _counts(self) -> list[str]:
        """A table of the frames that each robot has sent."""
        names = sorted(set().union(*self._sent.values()))
        head = f"{'frames sent by':24}" + "".join(f"{f'robot {slot}':>9}" for slot in self._sent)
        table = [
            f"{n:24}" + "".join(f"{sent[n]:>9}" for sent in self._sent.values()) for n in names
        ]
        return [head, *table]

    def _named(self, slots: list[int]) -> str:
        return "all" if len(slots) == self._robots > 1 else ",".join(map(str, slots))


def _event(trace: Trace) -> str:
    """One event: `state IDLE -> WORKING: CLAIMED (holds S6)`."""
    machine = "state" if trace.machine == "lifecycle" else trace.machine
    change = " -> ".join(part for part in (trace.source, trace.target) if part)
    why = f" ({trace.why})" if trace.why else ""
    return f"{machine} {change}: {trace.event}{why}" if change else f"{machine}: {trace.event}{why}"


def _fault(fault: Fault) -> str:
    values = fault.model_dump(mode="json", exclude={"at_s", "kind"}, exclude_unset=True)
    return " ".join([fault.kind, *(f"{key}={value}" for key, value in values.items())])


def tell(scenario: Scenario) -> tuple[Verdict, str]:
    """Play a scenario under all checkers: whether it kept the rules, and its golden text."""
    play = ScenarioJudge(scenario)
    text = StoryText(scenario, lambda: play.witness.digest)
    play.on_effect = text.add
    verdict = verdict_of(play.run())
    return verdict, "\n".join([verdict.trace_hash, "", *text.lines()]) + "\n"


def difference(kept: str, played: str, name: str) -> str:
    """What is different, as a unified diff; empty if nothing is. `name`: of the kept file."""
    both = kept.splitlines(), played.splitlines()
    return "\n".join(unified_diff(*both, f"{name} (kept)", f"{name} (played)", "", "", 2, ""))


def golden_path(story: Path) -> Path:
    """The file of the golden text, beside the story."""
    return story.with_suffix(".trace")
