"""What a control period does: decide, claim, work, drive. Sensing came before; the gate is last."""

from collections.abc import Sequence
from math import hypot
from typing import TYPE_CHECKING, Final

from agent.interface.config import ACTUATOR_TTL_US
from agent.interface.effects import Effect, Send, Trace
from agent.interface.lifecycle import IDLE, WORKING, Event
from agent.interface.mission import NOTHING_COVERED, STILL, FleetView, MotionRequest
from agent.peer.stall_watchdog import Advice, Stall
from protocol.frames.operator_frames import OperatorReport, ReportKind

if TYPE_CHECKING:
    from agent.peer.peer import Peer

NEAR_M: Final = 1.8  # between two hulls; we do not wait for a robot that is further away


class ControlCycle:
    def __init__(self, peer: "Peer") -> None:
        self.peer = peer
        self.stall = Stall()
        self._drove_us = 0  # time of the newest command to the actuator

    def start_due(self, now_us: int) -> Sequence[Effect]:
        """A claim whose contention window has passed becomes work."""
        peer = self.peer
        if peer.lifecycle.state is not IDLE or not peer.safety.may_move:
            return ()
        if peer.directive.goal is not None:
            return ()
        if peer.claims.current is not None:  # the section is kept through a stop and its reset
            return peer.fire(Event.CLAIMED, f"resumes S{peer.claims.current}")
        section = peer.claims.start_due(now_us)
        if section is None:
            return ()
        key = peer.claims.start(section)
        if key is None:
            return [Trace("claim", f"S{section}", "LOST", "", "at the start")]
        if peer.mission is not None and peer.here is not None:
            peer.mission.begin(section, peer.view(now_us))
        return [
            *peer.announce(section, key, "start", now_us),
            *peer.fire(Event.CLAIMED, f"holds S{section}"),
        ]

    def control(self, now_us: int) -> Sequence[Effect]:
        """From observation to drive, once a control period. The gate is the last step."""
        peer = self.peer
        if peer.mission is None or peer.motion is None or peer.here is None:
            return ()
        if now_us > self._drove_us + ACTUATOR_TTL_US:
            # We were late, so the command has expired and the implement is raised.
            peer.mission.on_implement_raised()
        self._drove_us = now_us
        effects: list[Effect] = []
        view = peer.view(now_us)
        peer.mission.on_control_period(view, peer.lifecycle.state)
        covered = peer.mission.covered_units()
        if covered is not NOTHING_COVERED:
            effects += peer.voice.sweep(peer, covered, now_us)
        peer.wish = self._wish(view, effects)
        peer.motion.set_state(peer.lifecycle.state)
        wanted = peer.motion.drive(peer.here, peer.wish, peer.membership.neighbours, now_us)
        if peer.pause is not None:
            neighbours, may_move = peer.membership.neighbours, peer.safety.may_move
            asked = peer.pause.asking
            wanted, said = peer.pause.watch(wanted, peer.here, neighbours, may_move, now_us)
            peer.stand_while_asking(asked, now_us)
            effects += said
        drive = peer.safety.gate(wanted, now_us)
        peer.senses.drove(drive)
        if not drive.tool_on:
            peer.mission.on_implement_raised()
        effects += self._watch(view)
        return [drive, *effects]

    def _watch(self, view: FleetView) -> Sequence[Effect]:
        """If the robot wants to move and is stuck, the mission replans and people are notified."""
        peer, here, wish = self.peer, view.here, self.peer.wish
        if peer.mission is None or not peer.mission.replans or not peer.safety.may_move:
            return ()
        if peer.pause is not None and peer.pause.passing:
            return ()  # it creeps round a confirmed obstacle and asks again by itself
        near_m = NEAR_M + 2 * getattr(getattr(peer.motion, "limits", None), "radius_m", 0.0)
        crowded = any(
            hypot(n.pose.x_m - here.x_m, n.pose.y_m - here.y_m) < near_m
            for n in view.neighbours.values()
        )
        wants_m_s = hypot(wish.vx_m_s, wish.vy_m_s)
        advice = self.stall.look((here.x_m, here.y_m), wants_m_s, crowded, view.now_us)
        if advice is None:
            return ()
        peer.mission.on_stalled(view)
        what = f"at {here.x_m:.1f}, {here.y_m:.1f}, plan {self.stall.plans}"
        told = Trace("stall", "", advice.name, "", what)
        if advice is Advice.REPLAN:
            return [told]
        return [Send(OperatorReport(peer.slot, 0, ReportKind.STALLED, here.x_m, here.y_m)), told]

    def _wish(self, view: FleetView, effects: list[Effect]) -> MotionRequest:
        peer, now_us = self.peer, view.now_us
        assert peer.mission is not None
        state, claims = peer.lifecycle.state, peer.claims
        if not (state is WORKING or state is IDLE) or not peer.safety.may_move:
            return STILL
        if peer.directive.goal is not None:
            return peer.directive.wish(view, effects)
        if (
            claims.room
            and (claims.current is None or peer.wish.near_end)
            and peer.sync.ready(now_us)
            and not peer.roll_call.wonders
            and not peer.name_call.wonders
        ):
            effects += self._give_back(now_us)
            choice = peer.mission.choose(view)
            if choice is not None:
                effects += peer.claim(choice.section, choice.bid, now_us, choice.takeover)
        if state is WORKING and claims.current is not None:
            return self._work(view, claims.current, effects)
        if claims.next is not None:
            return peer.mission.approach(claims.next, view)
        return peer.mission.idle(view)

    def _give_back(self, now_us: int) -> list[Effect]:
        """Release sections that we held before a restart, because we have no plan for them now.

        After that they are free for every robot, ours included, and their covered units are known."""
        peer, effects = self.peer, list[Effect]()
        if peer.claims.current is None and peer.claims.next is None:
            for section in peer.allocation.assigned_sections(peer.slot):
                key = peer.claims.drop(section)
                if key is not None:
                    effects += peer.announce(section, key, "release", now_us)
        return effects

    def _work(self, view: FleetView, section: int, effects: list[Effect]) -> MotionRequest:
        peer = self.peer
        assert peer.mission is not None
        wish = peer.mission.work(view)
        if wish.covered:
            effects += peer.voice.cover(peer, section, wish.covered, view.now_us)
        if wish.finished:
            effects += peer.voice.flush(peer, view.now_us)
            effects += peer.finish(section, view.now_us)
        elif wish.given_up:
            effects += peer.voice.flush(peer, view.now_us)
            effects += peer.release(section, view.now_us)
        return wish
