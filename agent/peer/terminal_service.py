"""The fleet's screen on a virtual terminal of the bus (ISO 11783-6): the elected leader shows it.

Every robot hears the terminal, so that it can take over at once. A robot shows the screen only while it
is the leader of its term, and takes it down when it is not; after a pause of its own process it waits
until the votes are in again. STOP is an emergency stop at this robot. In a fleet with keys RELEASE only
asks for a release: the operator's keys are not on the terminal, and a code that is typed there could be
read by everybody on the bus. A person with a key confirms it by `headland release`.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from random import Random
from typing import Any, Final, NamedTuple

from agent.interface.config import MS, S
from agent.interface.effects import Send, Trace
from agent.interface.identity import Identity
from agent.interface.instants import FOREVER_US
from agent.interface.lifecycle import State
from agent.interface.mission import Mission
from agent.peer import inputs, notices
from agent.peer.fleet_views import FleetViews
from agent.peer.leader_votes import LeaderVotes
from agent.peer.member_reports import MemberReports
from agent.peer.membership import Membership
from agent.peer.part import NOTHING, Handler, Header, Listener, Outputs, Part, StepContext
from agent.peer.pgn_responder import PgnResponder
from agent.peer.stop_release import KEYLESS_OPERATOR
from agent.safety.stop_cause import Severity, cause_of
from agent.safety.stop_controller import StopController
from protocol.extended_transport import (
    LONG_SIZE_MIN,
    ExtendedControl,
    ExtendedTransport,
    refused,
)
from protocol.fleet_tags import QUESTION_BITS
from protocol.frames.fleet_frames import NOWHERE_M
from protocol.frames.identifier import GLOBAL_ADDRESS, NULL_ADDRESS
from protocol.frames.network_frames import ExtendedTransportData, ExtendedTransportManagement
from protocol.frames.operator_frames import OperatorReport, ReportKind
from protocol.frames.safety_frames import EVERYBODY, Command, OperatorCommand, Reason
from protocol.frames.task_frames import WorkingSetMaster
from protocol.frames.terminal_frames import ECU_TO_VT, TerminalMessage, TerminalRequest
from protocol.terminal_client import (
    JoinTerminal,
    KeyPressed,
    PoolWanted,
    ShownScreen,
    TerminalClient,
    TerminalData,
    TerminalKey,
    TerminalOutput,
    TerminalState,
)
from protocol.terminal_pool import (
    ROWS_MAX,
    ScreenPicture,
    field_picture,
    picture_object,
    screen_pool,
)

LOOK_US: Final = 500 * MS  # between two looks at what the screen should show
PAUSED_US: Final = 250 * MS  # shorter than the silence after which others elect another leader
DOUBTS_US: Final = 1500 * MS  # until a later term is heard, if there is one
# Between two pictures that differ: each takes 280 frames, so that they take 0.5 % of the bus.
PICTURE_US: Final = 30 * S
RELEASE_GAP_US: Final = 100 * MS  # between the steps of a release
ASK_FOR_US: Final = 120 * S  # time for a person with a key to come and look
ASK_EVERY_US: Final = 500 * MS  # `headland release` listens for 0.7 s before it begins
# Alarms of the screen, at most 48 characters.
CONFIRM: Final = "RELEASE asked; key holder: headland release"
NOT_CONFIRMED: Final = "RELEASE was not confirmed within 2 minutes"
NEW_STOP: Final = "RELEASE is void: there is another stop"
NOTHING_HELD: Final = "RELEASE: no robot is latched"


class TerminalService(Part):
    """The part that shows the fleet on a virtual terminal, and obeys its keys."""

    def __init__(
        self,
        identity: Identity,
        safety: StopController,
        votes: LeaderVotes,
        letters: PgnResponder,
        membership: Membership,
        reports: MemberReports,
        views: FleetViews,
        mission: Mission | None,
        rng: Random,
    ) -> None:
        """`mission`: what is drawn of the field. `rng`: draws questions of releases."""
        self.safety, self.votes, self.letters = safety, votes, letters
        self.membership, self.reports, self.views = membership, reports, views
        self.mission = mission
        self.client, self.long, self._rng = TerminalClient(), ExtendedTransport(), rng
        self._identity = identity
        self._alarms = _Alarms()
        self._look_at_us = self._drawn_at_us = 0
        self._picture: ScreenPicture | None = None  # that the terminal has
        self._turn_at_us: int | None = None  # of our newest turn
        self._doubts_end_at_us = 0  # after a pause of our own: another robot may lead by now
        self._steps: deque[tuple[int, list[Any]]] = deque()  # of a release, with their times
        self._asked: _AskedRelease | None = None  # waits for a person with a key

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {
            TerminalMessage: self._message,
            ExtendedTransportManagement: self._packets,
            ExtendedTransportData: self._packets,
        }

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {notices.AddressLost: self._away, notices.BusLost: self._away}

    @property
    def due_at_us(self) -> int:
        due_at_us = FOREVER_US
        if self.letters.joining.joined:  # what is due without an address waits for the next one
            if self._steps:
                due_at_us = self._steps[0][0]
            if self._asked is not None:
                due_at_us = min(due_at_us, self._asked.tell_at_us)
            if self.long.due_at_us is not None:
                due_at_us = min(due_at_us, self.long.due_at_us)
        if self.client.due_at_us is not None:
            due_at_us = min(due_at_us, self.client.due_at_us)
        if self.client.state is TerminalState.SHOWN and self._look_at_us < due_at_us:
            due_at_us = self._look_at_us
        return due_at_us

    def on_timer(self, ctx: StepContext) -> Outputs:
        if not self._identity.diagnostics:
            return NOTHING
        now_us = ctx.now_us
        paused = self._turn_at_us is not None and now_us - self._turn_at_us > PAUSED_US
        self._turn_at_us = now_us
        if paused:
            self._doubts_end_at_us = now_us + DOUBTS_US
            self.votes.election.repeat()
        wanted = ctx.joined and now_us >= self._doubts_end_at_us and self.votes.leader == ctx.slot
        if wanted == self.client.serves and now_us < self.due_at_us:
            return NOTHING
        outputs = self._told(ctx, self.client.serve(wanted, now_us))
        if not ctx.joined:
            return outputs
        if self._steps and now_us >= self._steps[0][0]:
            outputs += self._steps.popleft()[1]
        if self._asked is not None and now_us >= self._asked.tell_at_us:
            outputs += self._ask(ctx, self._asked)
        for message, destination in self.long.on_tick(now_us):
            outputs.append(Send(message, destination))
        outputs += self._told(ctx, self.client.on_timer(now_us))
        if self.client.state is TerminalState.SHOWN and now_us >= self._look_at_us:
            self._look_at_us = now_us + LOOK_US
            self.client.show(self._screen(ctx), now_us)
            if now_us >= self._drawn_at_us + PICTURE_US and self.client.redrawable:
                outputs += self._told(ctx, self._redraw(ctx))
        return outputs

    def _message(self, ctx: StepContext, header: Header, m: TerminalMessage) -> Outputs:
        if not ctx.joined or not self._identity.diagnostics:
            return NOTHING
        return self._told(ctx, self.client.on_message(header.source, m.body, ctx.now_us))

    def _packets(
        self, ctx: StepContext, header: Header,
        m: ExtendedTransportManagement | ExtendedTransportData,
    ) -> Outputs:  # fmt: skip
        """Grants for our pool. Long messages to a robot are refused: no one has a use for them."""
        alone = header.destination != GLOBAL_ADDRESS  # no long message is for all
        if not ctx.joined or not alone or header.source >= NULL_ADDRESS:
            return NOTHING
        if isinstance(m, ExtendedTransportManagement) and m.control == ExtendedControl.RTS:
            return [Send(*answer) for answer in refused(m, header.source)]
        if header.source != self.client.server:
            return NOTHING
        before = self.long.counts["delivered"]
        answers, _ = self.long.on_message(header.source, m, ctx.now_us)
        outputs: list[Any] = [Send(*answer) for answer in answers]
        if self.long.counts["delivered"] > before:
            outputs += self._told(ctx, self.client.uploaded())
        return outputs

    def _away(self, ctx: StepContext, notice: Any) -> Outputs:
        self.client.reset()
        self.long.close_all()  # what stays due while we are away would keep the computer busy
        self._steps.clear()
        self._end_asked()
        return NOTHING

    # ---------------------------------------------------------------- what it shows

    def _told(self, ctx: StepContext, said: Sequence[TerminalOutput]) -> list[Any]:
        outputs: list[Any] = []
        server = self.client.server
        for each in said:
            match each:
                case JoinTerminal():
                    outputs += [Send(WorkingSetMaster(1)),
                                Trace("terminal", "", "LOG_IN", "", f"address {server}")]  # fmt: skip
                case PoolWanted(dots):
                    outputs += self._told(ctx, self._draw(ctx, dots))
                case KeyPressed(key):
                    outputs += self._key(ctx, key)
                case TerminalData(data) if server is not None and len(data) == ECU_TO_VT.length:
                    outputs.append(Send(TerminalRequest(data), server))
                case TerminalData(data) if server is not None and len(data) >= LONG_SIZE_MIN:
                    self.long.forget(server)
                    first = self.long.send(ECU_TO_VT.pgn, data, server, ctx.now_us) or ()
                    outputs += [Send(*each_) for each_ in first]
                case TerminalData(data) if server is not None:
                    outputs += self.letters.sends(ECU_TO_VT.pgn, data, server, ctx.now_us)
        return outputs

    def _draw(self, ctx: StepContext, dots: int) -> list[TerminalOutput]:
        screen = self._screen(ctx)._replace(alarm="")
        self._picture, self._drawn_at_us = self._field(ctx), ctx.now_us
        name = f"fleet, shown by {ctx.slot}"
        pool = screen_pool(name, screen.rows, screen.covered_percent, self._picture, dots)
        self._look_at_us = ctx.now_us
        return self.client.upload(pool, screen, ctx.now_us)

    def _redraw(self, ctx: StepContext) -> list[TerminalOutput]:
        """The picture again, if it is another one."""
        before, self._picture, self._drawn_at_us = self._picture, self._field(ctx), ctx.now_us
        if self._picture == before:
            return []
        return self.client.redraw(picture_object(self._picture), ctx.now_us)

    def _field(self, ctx: StepContext) -> ScreenPicture:
        """The field as it is now, with every robot that knows or knew its place."""
        poses = [seen.pose for seen in self.membership.neighbours.values()]
        robots = [(p.x_m, p.y_m) for p in poses if p.x_m != NOWHERE_M]
        if ctx.here is not None:
            robots.append((ctx.here.x_m, ctx.here.y_m))
        if self.mission is None:
            return field_picture((), (), robots)
        worked = self.mission.worked_lines(self.views.progress)
        return field_picture(self.mission.outline, worked, robots)

    def _screen(self, ctx: StepContext) -> ShownScreen:
        rows: list[tuple[bool, str]] = []  # whether nothing holds it, and its line
        standing: list[str] = []
        for slot in sorted({ctx.slot, *self.membership.standing}):  # without those revoked
            causes = self._causes(slot, ctx, Severity.PAUSE)
            state = self._state(slot, ctx)
            rows.append((not causes, f"{slot} {causes[0] if causes else state}"))
            alarms = self._causes(slot, ctx, Severity.PROTECTIVE)
            standing += [f"{slot}: {cause}" for cause in alarms]
        if len(rows) > ROWS_MAX:
            rows = sorted(rows, key=lambda row: row[0])[:ROWS_MAX]  # what stands is shown first
        covered = min(100, int(100 * self.views.progress.fraction()))
        return ShownScreen(
            tuple(line for _, line in rows), covered, self._alarms.text(frozenset(standing))
        )

    def _state(self, slot: int, ctx: StepContext) -> str:
        if slot == ctx.slot:
            return ctx.state.name
        seen = self.membership.neighbours.get(slot)
        status = self.membership.standing[slot].name
        return status if seen is None or status != "LIVE" else State(seen.pose.state).name

    def _causes(self, slot: int, ctx: StepContext, worse: Severity) -> list[str]:
        """Names of the causes of a robot that are at least so bad, the worst first."""
        if slot == ctx.slot:
            causes = sorted(self.safety.causes, key=lambda each: -each[0].severity)
            return [cause.name for cause, _ in causes if cause.severity >= worse]
        told = self.reports.standstills.get(slot)
        found = [] if told is None else [cause_of(m.cause) for m in told.fresh(ctx.now_us)]
        return [c.name for c in found if c is not None and c.severity >= worse]

    # ---------------------------------------------------------------- keys

    def _key(self, ctx: StepContext, key: TerminalKey) -> list[Any]:
        told = Trace("terminal", "", key.name, "", f"address {self.client.server}")
        if key is TerminalKey.STOP:
            return [inputs.Press(Reason.OPERATOR_INTERVENTION), told]
        if key is TerminalKey.ACKNOWLEDGE:
            self._alarms.acknowledge()
            self.client.show(self._screen(ctx), ctx.now_us)
            return [told]
        if self.safety.keyed:
            return [*self._begin_asking(ctx), told._replace(target="ASKED")]
        # Each robot clears its stops, is then reset, and this one last: a reset gives up its address.
        release = inputs.ReleaseStops(None, self._rng.getrandbits(QUESTION_BITS))
        reset = Send(OperatorCommand(Command.MANUAL_RESET, EVERYBODY, KEYLESS_OPERATOR))
        at_us = ctx.now_us
        self._steps = deque((
            (at_us + RELEASE_GAP_US, [release]), (at_us + 2 * RELEASE_GAP_US, [reset]),
            (at_us + 3 * RELEASE_GAP_US, [inputs.EndRelease(), inputs.ManualReset()]),
        ))  # fmt: skip
        return [release, told]

    # ---------------------------------------------------------------- a release that is asked for

    def _begin_asking(self, ctx: StepContext) -> list[Any]:
        """RELEASE in a fleet with keys: say so on the bus until a person with a key confirms it."""
        if not self._latched:
            self._say(ctx, NOTHING_HELD)
            return []
        if self._asked is not None:  # pressed again: no frame more than the rhythm
            self._say(ctx, CONFIRM)
            return []
        held = self.safety.held_stops
        self._asked = _AskedRelease(ctx.now_us + ASK_FOR_US, ctx.now_us, held.stops, held.digest)
        self._say(ctx, CONFIRM)
        return self._ask(ctx, self._asked)

    def _ask(self, ctx: StepContext, asked: "_AskedRelease") -> list[Any]:
        held = self.safety.held_stops
        if not ctx.joined or not self.client.serves or not self._latched:
            self._end_asked()
            return []
        if held.stops >= asked.stops and held.digest != asked.digest:  # not one that was cleared
            self._asked = None
            self._say(ctx, NEW_STOP)
            return []
        if ctx.now_us >= asked.ends_at_us:
            self._asked = None
            self._say(ctx, NOT_CONFIRMED)
            return []
        self._asked = asked._replace(tell_at_us=ctx.now_us + ASK_EVERY_US)
        x_m, y_m = (0.0, 0.0) if ctx.here is None else (ctx.here.x_m, ctx.here.y_m)
        return [Send(OperatorReport(ctx.slot, 0, ReportKind.RELEASE_ASKED, x_m, y_m))]

    def _end_asked(self) -> None:
        if self._asked is not None:
            self._asked = None
            self._alarms.say("")

    def _say(self, ctx: StepContext, text: str) -> None:
        self._alarms.say(text)
        self.client.show(self._screen(ctx), ctx.now_us)

    @property
    def _latched(self) -> bool:
        """Whether this robot or another one that is heard is latched."""
        return self.safety.latched or any(
            seen.pose.stopped
            for slot, seen in self.membership.neighbours.items()
            if slot in self.membership.live
        )


class _AskedRelease(NamedTuple):
    """A release that was asked for at the terminal."""

    ends_at_us: int
    tell_at_us: int  # when it is said again
    stops: int  # that held this robot then, and their digest
    digest: int


class _Alarms:
    """Which alarm is on the screen, and which ones a person has acknowledged."""

    def __init__(self) -> None:
        self._said = ""  # something that no robot stands for
        self._standing: frozenset[str] = frozenset()
        self._known: frozenset[str] = frozenset()

    def say(self, text: str) -> None:
        """Show this until it is acknowledged."""
        self._said = text

    def acknowledge(self) -> None:
        """A person has seen all that is shown."""
        self._said, self._known = "", self._standing

    def text(self, standing: frozenset[str]) -> str:
        """The alarm to show; "" without one. `standing`: robots with their causes."""
        self._standing = standing
        self._known &= standing  # a cause that comes back is news
        new = sorted(standing - self._known)
        return self._said or (f"{len(new)} stopped; {new[0]}" if new else "")
