"""Records every effect of every robot at its runner: sent frames and lifecycle changes."""

from collections import defaultdict
from collections.abc import Callable

from agent.interface.effects import Drive, Effect, Send, Trace
from agent.interface.lifecycle import TABLE
from protocol.frames.fleet_frames import Pose
from protocol.frames.messages import Message
from protocol.frames.work_frames import TaskClaim, WorkProgress
from sim.chaos.protocol_rules import ProtocolRules, RuleViolation
from sim.fleet.trace_recorder import Recorder

WORK = (TaskClaim, WorkProgress)


class EffectObserver(Recorder):
    """A trace recorder that also judges what robots send and how their lifecycle changes."""

    def __init__(self, robots: int) -> None:
        super().__init__()
        self.words = ProtocolRules(robots)
        self.told: defaultdict[int, list[Message]] = defaultdict(list)
        self.released: set[int] = set()  # reset by a person, and not yet shown in a pose
        # The observer's clock; robots' own clocks may run differently.
        self.clock: Callable[[], int] | None = None
        self._edges_broken: list[RuleViolation] = []
        self._edges = {
            (source.name, event.name.lower(), target.name)
            for (source, event), target in TABLE.items()
        }

    @property
    def broken(self) -> list[RuleViolation]:
        """Every rule that was broken so far, those of the lifecycle first."""
        return self._edges_broken + self.words.broken

    def __call__(self, slot: int, now_us: int, effect: Effect) -> None:
        super().__call__(slot, now_us, effect)
        if type(effect) is Drive:
            return
        if self.clock is not None:
            now_us = self.clock()
        if isinstance(effect, Send):
            message = effect.message
            generation = self.words.speakers[slot].generation
            self.words.said(slot, now_us, message)
            if self.words.speakers[slot].generation > generation:
                # What it heard of a thief is void.
                self.told[slot] = [m for m in self.told[slot] if not isinstance(m, WORK)]
            if isinstance(message, Pose):
                self.released.discard(slot)
                told = self.told[slot]
                if told and isinstance(told[-1], Pose) and told[-1].stopped == message.stopped:
                    return  # no new information that must be remembered
            elif isinstance(message, WorkProgress):
                own_progress = self.words.speakers[slot].own_progress
                own = own_progress.get((message.section, message.block), 0)
                message = message._replace(bits=message.bits & own)
            self.told[slot].append(message)
        elif isinstance(effect, Trace) and effect.machine == "lifecycle":
            if effect.event == "MANUAL_RESET":
                self.released.add(slot)
            edge = (effect.source, effect.event.lower(), effect.target)
            if effect.source != effect.target and edge not in self._edges:
                what = f"robot {slot}: {' '.join(edge)}"
                self._edges_broken.append(RuleViolation("S14", now_us / 1e6, what))

    def forget(self, slot: int) -> None:
        """Its memory is lost, so nothing that it sent before binds it."""
        self.told[slot].clear()
        self.words.forgets(slot)
