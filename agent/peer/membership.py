"""The live members of the fleet as this peer receives them: a failure detector over signs of life.

Any frame of a member is a sign of life, except an address claim of a member that may move. Such a
member has been off the bus and can send nothing else for a quarter of a second, not even that it was
stopped. A member that stops sending without a farewell is *silent* after `beat.silence_for_us`. The
farewell of a member that moves is not believed, since a robot stands before it leaves. The reaction
to silence is decided elsewhere (safety brakes, allocation waits for the lease). There is no
suspicion level and no vote: on one bus segment every node receives every other, so a second opinion
would carry no information.

Where the policy lets silence go on to limit the motion (`SilencePolicy.STOP`, `SLOW`), a robot keeps over
a restart which members were silent. So a restart replaces no word of an operator.

The oldest sign of life is searched only when it may have become silence, a few times a second. So a
beat, which arrives a thousand times a second, costs only the write of its sender's newest pose.
"""

from collections.abc import Mapping
from enum import Enum, auto
from typing import Any

from agent.interface.config import FAREWELL_SPEED_M_S, GONE_QUIET_US, LEAVES_WITHIN_US
from agent.interface.effects import Persist, Trace
from agent.interface.identity import Identity, SilencePolicy
from agent.interface.instants import FOREVER_US, NEVER_US
from agent.interface.observation import Neighbour
from agent.peer import notices
from agent.peer.frame_origin import Origins
from agent.peer.part import (
    NOTHING,
    DirectHandler,
    Handler,
    Header,
    Listener,
    Outputs,
    Part,
    StepContext,
)
from agent.safety.stop_controller import StopController
from protocol.frames.fleet_frames import (
    NOWHERE_M,
    PLACE_UNKNOWN_M_S,
    Heartbeat,
    Member,
    Pose,
)

# After a farewell: frames queued before it have arrived by then.
FAREWELL_US = 250_000
# A member that keeps sending after a farewell did not send that farewell itself. Further farewells
# in its name are ignored for this long.
DISBELIEVED_US = 10_000_000
SILENT_KEY = "silent"  # of durable memory: the slots of silent members, ascending, a byte each


class MemberStatus(Enum):
    """What this robot knows of a configured member."""

    ABSENT = auto()  # configured, but not received since we booted
    LIVE = auto()
    SILENT = auto()  # was live and stopped sending without leaving
    LEFT = auto()  # announced that it leaves
    WAIVED = auto()  # silent, and an operator ordered by name to go on without it


class Membership(Part):
    """The part that tracks which members are received, by slot, and when each was last."""

    def __init__(
        self,
        identity: Identity,
        silence_for_us: int,
        safety: StopController,
        origins: Origins,
        recalled: Mapping[str, bytes],
        now_us: int,
    ) -> None:
        """`silence_for_us`: a member that is not received for longer is silent. `recalled`: durable
        memory as it was before the start; a robot whose policy lets silence hold it stands for the
        members in `SILENT_KEY` as it did."""
        slot = self.slot = identity.slot
        assert slot in identity.members
        self.silence_for_us, self.safety, self.origins = silence_for_us, safety, origins
        self.config_hash, self._members = identity.config_hash, identity.members
        self.standing = {
            member: MemberStatus.ABSENT for member in sorted(identity.members) if member != slot
        }
        self.reflected_at_us = NEVER_US  # when a member last named us as received
        self.incarnation: dict[int, int] = {}
        self.neighbours: dict[int, Neighbour] = {}
        self.fell_silent_at_us: dict[int, int] = {}
        self.changed_at_us = now_us  # when live or silent last changed
        self.live: frozenset[int] = frozenset({slot})
        self.silent: frozenset[int] = frozenset()
        self.slot_of: dict[int, int] = {}  # source address -> slot, from MEMBER frames
        self.strangers = 0  # frames of addresses that have not announced a member slot
        # Live others -> last sign of life, except newer poses.
        self.last_sign_at_us: dict[int, int] = {}
        self.void_farewells = 0  # farewells of members that moved, or that kept sending
        # In a fleet with keys: frames that are not proven are signs of life for this long after a proof.
        self.life_for_us: int | None = None
        self.proven_at_us: dict[int, int] = {}
        self._left_at_us: dict[int, int] = {}
        self._void_at_us: dict[int, int] = {}
        self._oldest_sign_at_us = now_us  # no sign of life in `last_sign_at_us` is older
        self._keeps_silent = identity.silence is not SilencePolicy.CONTINUE
        self._kept_silent = recalled.get(SILENT_KEY, b"")  # as on disk
        if self._keeps_silent:
            for member in self._kept_silent:
                if member in self.standing:
                    self._stand(member, MemberStatus.SILENT, now_us)
            safety.members(self.live, self.silent, now_us)  # it has driven nothing yet: no effects

    @property
    def direct(self) -> Mapping[type[Any], DirectHandler]:
        return {Pose: self.on_pose, Heartbeat: self._heartbeat}

    @property
    def handles(self) -> Mapping[type[Any], Handler]:
        return {Member: self._member}

    @property
    def listens(self) -> Mapping[type[Any], Listener]:
        return {
            notices.AddressGained: self._gained,
            notices.FleetJoined: lambda ctx, n: self.changed(),
            notices.SignOfLife: self._sign_of_life,
            notices.AddressTaken: self._taken,
            notices.StrangerHeard: self._stranger,
            notices.WaiveOrdered: self._waive,
            notices.Left: self._left,
            notices.KeysChanged: self._keys_changed,
        }

    def changed(self) -> Outputs:
        """The live view changed, or is told again to the parts that depend on it."""
        silent = bytes(sorted(self.silent))
        if not self._keeps_silent or silent == self._kept_silent:
            return self._told()
        self._kept_silent = silent
        return [*self._told(), Persist(SILENT_KEY, silent)]

    def _told(self) -> Outputs:
        live, silent = self.live, self.silent
        seen = f"live {sorted(live)} silent {sorted(silent)}"
        changed = notices.MembershipChanged(live, silent)
        return [changed, Trace("membership", "", "VIEW", "", seen)]

    # ---------------------------------------------------------------- received

    def on_pose(self, source: int, slot: int | None, m: Pose, now_us: int) -> Outputs:
        """A beacon. It is nine frames in ten, so it costs little more than its entry."""
        safety = self.safety
        if slot is None:  # a moving stranger does not know the stops that hold us
            told = safety.tell_stops(now_us) if safety.latched and not m.stopped else NOTHING
            return [notices.StrangerHeard(source), *told]
        if self.life_for_us is not None and not self.vouched(slot, now_us):
            return NOTHING
        if m.speed_m_s >= PLACE_UNKNOWN_M_S:
            self._unplaced(slot, m, now_us)
        else:
            self.neighbours[slot] = Neighbour(m, now_us)
        if m.heard == self.slot:
            self.reflected_at_us = now_us
        if m.stopped or safety.latched:
            return safety.beat(slot, m.stopped, now_us)
        return NOTHING

    def _unplaced(self, slot: int, m: Pose, now_us: int) -> None:
        """A member that does not know its position.

        It is alive and brakes. Its newest pose is given up, not extrapolated: it may stand anywhere
        on its way to standstill, as a silent one (`agent/motion/stopping_zone.py`)."""
        seen = self.neighbours.get(slot)
        if seen is None or seen.pose.x_m == NOWHERE_M:
            seen = Neighbour(m._replace(speed_m_s=0.0), now_us)
        pose = seen.pose._replace(state=m.state, stopped=m.stopped, heard=m.heard)
        self.neighbours[slot] = Neighbour(pose, min(seen.heard_at_us, now_us - GONE_QUIET_US))

    def _heartbeat(self, source: int, slot: int | None, m: Heartbeat, now_us: int) -> Outputs:
        if slot is None:
            return NOTHING if m.leaving else [notices.StrangerHeard(source)]
        if m.leaving:
            if self._moves(slot, now_us):
                self.void_farewells += 1
                return NOTHING
            self.leave(slot, now_us)
            return self.changed()
        return [notices.HeartbeatHeard(slot, m)]

    def _member(self, ctx: StepContext, header: Header, m: Member) -> Outputs:
        source, now_us = header.source, ctx.now_us
        if not self.origins.is_robot(source):
            return NOTHING
        if m.config_hash != self.config_hash:
            self.unbind(source)
            return [
                notices.FieldDiffers(source, "it has another field description, or other frames")
            ]
        if m.slot not in self._members:  # we would neither avoid it nor leave it its work
            self.unbind(source)
            why = f"it is robot {m.slot}, and our fleet has {len(self._members)} robots"
            return [notices.FieldDiffers(source, why)]
        announced = notices.MemberAnnounced(source)
        if m.slot == self.slot:
            return [announced, notices.IdentityDoubled(source)]
        outputs: list[Any] = [announced, notices.ConflictSettled(source)]
        if m.slot not in self.standing:
            refused = f"slot {m.slot} at address {source}"
            return [*outputs, Trace("membership", "", "REFUSED", "", refused)]
        live = self.live
        self.returned(m.slot, now_us)
        self.bind(source, m.slot, m.incarnation, now_us)
        return outputs if live == self.live else [*outputs, *self.changed()]

    # ---------------------------------------------------------------- told by other parts

    def _gained(self, ctx: StepContext, notice: notices.AddressGained) -> Outputs:
        self.unbind(notice.address)  # an earlier binding no longer holds: it is ours now
        return NOTHING

    def _taken(self, ctx: StepContext, notice: notices.AddressTaken) -> Outputs:
        self.unbind(notice.address)
        return NOTHING

    def _sign_of_life(self, ctx: StepContext, notice: notices.SignOfLife) -> Outputs:
        return self.changed() if self.heard(notice.slot, ctx.now_us) else NOTHING

    def _stranger(self, ctx: StepContext, notice: notices.StrangerHeard) -> Outputs:
        self.strangers += 1
        return NOTHING

    def _waive(self, ctx: StepContext, notice: notices.WaiveOrdered) -> Outputs:
        if not self.waive(notice.slot, ctx.now_us):
            return NOTHING
        if not self.safety.keyed:
            return self.changed()
        said = f"go on without robot {notice.slot} by {notice.operator}"  # for the release log
        return [*self.changed(), Trace("safety", "", "PERMITTED", "", said)]

    def _left(self, ctx: StepContext, notice: notices.Left) -> Outputs:
        # Not on disk: a farewell before a restart replaces no word of an operator either.
        self.forget_all(ctx.now_us)
        return NOTHING

    def _keys_changed(self, ctx: StepContext, notice: notices.KeysChanged) -> Outputs:
        return self.changed() if self.revoke(notice.revoked, ctx.now_us) else NOTHING

    # ---------------------------------------------------------------- members

    def revoke(self, slot: int, now_us: int) -> bool:
        """A member is none any more, for good. False: it was none."""
        if slot not in self.standing:
            return False
        for address in [a for a, s in self.slot_of.items() if s == slot]:
            del self.slot_of[address]
        self.last_sign_at_us.pop(slot, None)
        self.neighbours.pop(slot, None)
        self.incarnation.pop(slot, None)
        self._stand(slot, MemberStatus.LEFT, now_us)
        del self.standing[slot]
        return True

    def bind(self, source: int, slot: int, incarnation: int, now_us: int) -> bool:
        """A MEMBER frame: this address now belongs to that slot. False: not of this fleet."""
        if slot not in self.standing:
            return False
        for address in [a for a, s in self.slot_of.items() if s == slot and a != source]:
            del self.slot_of[address]  # the member has moved to another address
        self.slot_of[source] = slot
        self.incarnation[slot] = incarnation
        self.heard(slot, now_us)
        return True

    def unbind(self, source: int | None) -> None:
        """Another device has the address now: ignore it until it announces its slot."""
        if source is not None:
            self.slot_of.pop(source, None)

    @property
    def free(self) -> list[int]:
        """Members whose newest pose reports that they are not stopped."""
        return [slot for slot, seen in self.neighbours.items() if not seen.pose.stopped]

    def forget_reflection(self) -> None:
        """Nobody can have received us yet: only later beacons count."""
        self.reflected_at_us = NEVER_US

    def _moves(self, slot: int, now_us: int) -> bool:
        """Whether its newest beacon shows it in motion: a robot says farewell when it stands.

        One that has told for long that it does not know its place stands, whatever its speed was."""
        seen = self.neighbours.get(slot)
        if seen is None or now_us - seen.heard_at_us >= LEAVES_WITHIN_US:
            return False
        return seen.pose.speed_m_s > FAREWELL_SPEED_M_S

    def stands(self, slot: int) -> bool:
        """Whether its newest pose reports that it is stopped."""
        seen = self.neighbours.get(slot)
        return seen is not None and seen.pose.stopped

    def heard(self, slot: int, now_us: int) -> bool:
        """A sign of life. True when this changed the membership."""
        heard = self.last_sign_at_us
        if slot not in self.standing:
            return False  # revoked, or a slot that the fleet does not have
        if self.life_for_us is not None and not self.vouched(slot, now_us):
            return False
        if slot in heard:
            heard[slot] = now_us
            return False
        if self.standing[slot] is MemberStatus.LEFT:
            if now_us - self._left_at_us[slot] <= FAREWELL_US:
                return False  # sent before the farewell; only a new MEMBER frame brings it back
            self.void_farewells += 1
            self._void_at_us[slot] = now_us
        if not heard:
            self._oldest_sign_at_us = now_us
        heard[slot] = now_us
        self._stand(slot, MemberStatus.LIVE, now_us)
        return True

    def prove(self, slot: int, now_us: int) -> None:
        """A proof of this member was verified: what it sends counts as its own for a while."""
        self.proven_at_us[slot] = now_us

    def vouched(self, slot: int, now_us: int) -> bool:
        """Whether it was proven lately that this member lives; always so in a fleet without keys."""
        life_for_us = self.life_for_us
        return life_for_us is None or now_us - self.proven_at_us.get(slot, NEVER_US) <= life_for_us

    def returned(self, slot: int, now_us: int) -> None:
        """A member that had left announces itself again."""
        if self.standing[slot] is MemberStatus.LEFT:
            self.standing[slot] = MemberStatus.ABSENT
            self.heard(slot, now_us)

    def leave(self, slot: int, now_us: int) -> None:
        """A farewell. It is void if the member keeps sending: then another device has sent it."""
        if now_us - self._void_at_us.get(slot, now_us - DISBELIEVED_US) < DISBELIEVED_US:
            return
        if self.standing[slot] is MemberStatus.LEFT:
            return  # a repetition; the time counts from the first farewell
        self._left_at_us[slot] = now_us
        self.last_sign_at_us.pop(slot, None)
        self.neighbours.pop(slot, None)
        self._stand(slot, MemberStatus.LEFT, now_us)

    def waive(self, slot: int, now_us: int) -> bool:
        """An operator waives a silent member by name."""
        if self.standing.get(slot) is not MemberStatus.SILENT:
            return False
        self._stand(slot, MemberStatus.WAIVED, now_us)
        return True

    @property
    def due_at_us(self) -> int:
        """When the oldest sign of life may become silence; `tick` moves this on in good time."""
        return self._oldest_sign_at_us + self.silence_for_us if self.last_sign_at_us else FOREVER_US

    def on_timer(self, ctx: StepContext) -> Outputs:
        return self.changed() if self.tick(ctx.now_us) else NOTHING

    def tick(self, now_us: int) -> list[int]:
        """The members that have just fallen silent."""
        signs, heard_before_at_us = self.last_sign_at_us, now_us - self.silence_for_us
        if not signs or self._oldest_sign_at_us > now_us - self.silence_for_us // 2:
            return []
        neighbours, oldest_at_us = self.neighbours, now_us
        fallen: list[tuple[int, int]] = []
        for slot, us in signs.items():
            seen = neighbours.get(slot)
            if seen is not None and seen.heard_at_us > us:
                us = seen.heard_at_us
            if us <= heard_before_at_us or not self.vouched(slot, now_us):
                fallen.append((us, slot))
            elif us < oldest_at_us:
                oldest_at_us = us
        self._oldest_sign_at_us = oldest_at_us
        for _, slot in sorted(fallen):
            del signs[slot]
            self._stand(slot, MemberStatus.SILENT, now_us)
        return [slot for _, slot in sorted(fallen)]

    def forget_all(self, now_us: int) -> None:
        """We left the fleet ourselves, so the silence of members no longer matters."""
        self.last_sign_at_us.clear()
        for slot in self.standing:
            self._stand(slot, MemberStatus.ABSENT, now_us)

    def _stand(self, slot: int, standing: MemberStatus, now_us: int) -> None:
        self.standing[slot] = standing
        self.changed_at_us = now_us
        if standing is MemberStatus.SILENT:
            self.fell_silent_at_us[slot] = now_us
        elif standing is not MemberStatus.WAIVED:
            self.fell_silent_at_us.pop(slot, None)
        states = self.standing.items()
        self.live = frozenset({self.slot, *(s for s, st in states if st is MemberStatus.LIVE)})
        self.silent = frozenset(s for s, st in states if st is MemberStatus.SILENT)
