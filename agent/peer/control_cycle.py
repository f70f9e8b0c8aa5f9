"""What a control period does: decide, claim, work, drive. Sensing came before; the gate is last."""

from collections.abc import Callable, Mapping
from math import hypot
from typing import Any, Final

from agent.interface.config import ACTUATOR_TTL_US, CONTROL_PERIOD_US, IMPLEMENT_FOLLOWS_US
from agent.interface.effects import HALT, Drive, Send, Trace
from agent.interface.lifecycle import ABLE, IDLE, WORKING
from agent.interface.mission import NOTHING_COVERED, STILL, FleetView, Mission, MotionRequest
from agent.interface.motion_controller import MotionController
from agent.interface.observation import Observation
from agent.peer import notices
from agent.peer.fleet_views import FleetViews
from agent.peer.obstacle_hold import ObstacleHold
from agent.peer.operator_directive import OperatorDirective
from agent.peer.part import NOTHING, DirectListener, Outputs, Part, StepContext
from agent.peer.section_work import SectionWork
from agent.peer.sense_freshness import Senses
from agent.peer.stall_watchdog import Advice, Stall
from protocol.frames.operator_frames import OperatorReport, ReportKind

NEAR_M: Final = 1.8  # between two hulls; we do not wait for a robot that is further away


class ControlCycle(Part):
    """The part that runs the mission and the motion controller once each control period."""

    def __init__(
        self,
        first_at_us: int,
        mission: Mission | None,
        motion: MotionController | None,
        work: SectionWork,
        directive: OperatorDirective,
        obstacle: ObstacleHold,
        senses: Senses,
        views: FleetViews,
        may_choose: Callable[[int], bool],
    ) -> None:
        """`first_at_us`: the first control period. `may_choose`: whether the state of the fleet is
        known well enough at this time to choose a section."""
        self.mission, self.motion, self.work, self.views = mission, motion, work, views
        self.directive, self.obstacle, self.senses = directive, obstacle, senses
        self.safety, self.lifecycle, self.progress = work.safety, work.lifecycle, work.progress
        self.may_choose = may_choose
        self.next_at_us = first_at_us
        self.wish: MotionRequest = STILL  # of the mission, before right of way and the gate
        self.at_work = False  # as others know
        self.stall = Stall()
        # Whether a task controller wants the implement up; the peer's parts set it.
        self.implement_off: Callable[[], bool] = lambda: False
        self._down = False  # what the body was told of the implement in the last control period
        self._drove_at_us = 0  # time of the newest command to the actuator
        self._raised = False  # a command since the last control period raised the implement
        self._lowered_at_us = 0  # when the body was told to lower it
        self._followed = False  # it was sensed down since then

    @property
    def listens_direct(self) -> Mapping[type[Any], DirectListener]:
        return {notices.ControlDue: self._control}

    @property
    def due_at_us(self) -> int:
        return self.next_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        late_for_us = ctx.now_us - self.next_at_us
        if late_for_us < 0:
            return NOTHING
        self.next_at_us += (late_for_us // CONTROL_PERIOD_US + 1) * CONTROL_PERIOD_US
        return [notices.ControlDue(late_for_us)]

    def _control(self, notice: notices.ControlDue, now_us: int) -> Outputs:
        """From observation to drive, once a control period. The gate is the last step."""
        mission, motion, here = self.mission, self.motion, self.senses.here
        if mission is None or motion is None or here is None:
            return NOTHING
        # If we were late, the command has expired and the implement is raised. One may also arrive late.
        late = now_us > self._drove_at_us + ACTUATOR_TTL_US
        up = self._sensed_up(here, now_us)
        if self._raised or late or up:
            mission.on_implement_raised()
        self._raised, self._drove_at_us = False, now_us
        outputs: list[Any] = []
        view = self.views.view(now_us)
        mission.on_control_period(view, self.lifecycle.state)
        covered = mission.covered_units()
        if covered is not NOTHING_COVERED:
            outputs += self.progress.sweep(covered, now_us)
        self.wish, chosen = self._wish(mission, view)
        outputs += chosen
        off = self.implement_off()
        at_work = self.safety.may_move and mission.at_work and not off
        if at_work != self.at_work:
            self.at_work = at_work
            outputs.append(notices.ImplementMoved(at_work))
        motion.set_state(self.lifecycle.state)
        wanted = motion.drive(here, self.wish, view.neighbours, now_us)
        if self.lifecycle.state not in ABLE:
            wanted = HALT  # it is no member, so nobody knows where it is: it does not even give way
        # Rays say nothing from a place that is not ours, or that are old.
        seen = here if view.placed else here._replace(ranges_m=())
        way = self.wish.vx_m_s, self.wish.vy_m_s
        wanted, asked = self.obstacle.watch(wanted, seen, view.neighbours, now_us, way)
        outputs += asked
        if off and wanted.tool_on:
            wanted = wanted._replace(tool_on=False)
        drive = self.safety.gate(wanted, now_us)
        if drive.tool_on is not self._down:
            self._down, self._lowered_at_us, self._followed = drive.tool_on, now_us, False
            outputs.append(notices.ImplementLowered(drive.tool_on))
        return [drive, *outputs, *self._watch(mission, view)]

    def _sensed_up(self, here: Observation, now_us: int) -> bool:
        """Whether the implement is up, or was for a moment, although it was told to be down.

        The command may be on its way for as long as it lives. Then a slow implement has some time to go
        down. A command that came late raises it again, also within that time, so the time ends when it is
        down."""
        if not self._down or here.implement_down is None:
            return False
        self._followed = self._followed or here.implement_down
        told_for_us = now_us - self._lowered_at_us
        goes_down = ACTUATOR_TTL_US < told_for_us <= IMPLEMENT_FOLLOWS_US and not self._followed
        return not here.implement_down and not goes_down

    def commanded(self, drive: Drive) -> None:
        """A command to the body: ours, or of a part that brakes between two control periods.

        The mission learns in the next period that the implement was up, so a stop waits for no mission.
        The senses learn it too: a body that a brake stopped early has no frozen place.
        """
        self.senses.drove(drive)
        self._raised = self._raised or not drive.tool_on

    def _watch(self, mission: Mission, view: FleetView) -> Outputs:
        """If the robot wants to move and is stuck, the mission replans and people are notified."""
        here, wish = view.here, self.wish
        if not mission.replans or not self.safety.may_move:
            return NOTHING
        if self.obstacle.passing:
            return NOTHING  # it creeps round a confirmed obstacle and asks again by itself

        def crowded() -> bool:
            near_m = NEAR_M + 2 * getattr(getattr(self.motion, "limits", None), "radius_m", 0.0)
            return any(
                hypot(n.pose.x_m - here.x_m, n.pose.y_m - here.y_m) < near_m
                for n in view.neighbours.values()
            )

        wants_m_s = hypot(wish.vx_m_s, wish.vy_m_s)
        advice = self.stall.look((here.x_m, here.y_m), wants_m_s, crowded, view.now_us)
        if advice is None:
            return NOTHING
        mission.on_stalled(view)
        what = f"at {here.x_m:.1f}, {here.y_m:.1f}, plan {self.stall.plans}"
        told = Trace("stall", "", advice.name, "", what)
        if advice is Advice.REPLAN:
            return [told]
        return [Send(OperatorReport(view.slot, 0, ReportKind.STALLED, here.x_m, here.y_m)), told]

    def _wish(self, mission: Mission, view: FleetView) -> tuple[MotionRequest, Outputs]:
        """The motion that the mission or an operator wants, and what claiming and working did."""
        state, claims, now_us = self.lifecycle.state, self.work.claims, view.now_us
        if not (state is WORKING or state is IDLE) or not self.safety.may_move:
            return STILL, NOTHING
        if self.directive.goal is not None:
            return self.directive.wish(view)
        outputs: list[Any] = []
        near_end = claims.current is None or (self.wish.near_end and not self.wish.finished)
        if claims.room and near_end and self.may_choose(now_us):
            outputs += self.work.give_back_forgotten(now_us)
            choice = mission.choose(view)
            if choice is not None:
                outputs += self.work.claim(choice, now_us)
        if state is WORKING and claims.current is not None:
            wish, worked = self._work(mission, view, claims.current)
            return wish, [*outputs, *worked]
        if claims.next is not None:
            return mission.approach(claims.next, view), outputs
        return mission.idle(view), outputs

    def _work(
        self, mission: Mission, view: FleetView, section: int
    ) -> tuple[MotionRequest, Outputs]:
        outputs: list[Any] = []
        wish = mission.work(view)
        if wish.covered:
            outputs += self.progress.cover(section, wish.covered, view.now_us)
        if wish.finished:
            outputs += self.progress.flush(view.now_us)
            outputs += self.work.finish(section, view.now_us)
        elif wish.given_up:
            outputs += self.progress.flush(view.now_us)
            outputs += self.work.release(section, view.now_us, mission.given_up_why)
        return wish, outputs
