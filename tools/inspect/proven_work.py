"""What robots of a fleet with keys say of work, as far as they have proven it.

A program that tells other systems what was delivered believes no more than a robot does: claims, progress
and answers of a sync count when the PROOF of their sender has covered them. It needs the key of a panel,
and verifies as a gateway does (`agent/segments/gateway_proofs.py`). A member that is stolen is believed
until it is revoked, here as by robots.
"""

from collections.abc import Sequence
from pathlib import Path
from secrets import randbits
from typing import Any, Final

from agent.runtime.files.key_file import FLEET, NAMES, OPERATOR, PANELS, KeyFileError, read
from agent.segments.gateway_proofs import GatewayProofs
from protocol.authentication import OPERATOR_FIRST, Keys
from protocol.frames.fleet_frames import Member
from protocol.frames.messages import GROUP_OF
from protocol.frames.network_frames import AddressClaimed, Request
from protocol.frames.segment_frames import gateway_slot
from protocol.frames.trust_frames import Proof
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress
from protocol.units import S
from tools.common.bus_address import AttachError
from tools.common.panel_keys import PanelKeys

UNPROVEN: Final = (
    "there is no panel.json beside {}: what robots say of work is not verified, so anybody on the bus "
    "can make a transport look delivered here"
)
WORK: Final = (TaskClaim, WorkProgress, StateSyncResponse)
DEVICE: Final = 141  # under whose number it asks for the fleet's time; among those of panels
# Between two questions for the slots of robots, whose answers are proven; doubles while none is new,
# because anybody can send a PROOF that no robot stands for.
ASK_WHO_US: Final = 1 * S
DOUBLINGS_MAX: Final = 5
LOOK_US: Final = 1 * S  # between two looks at the key file


class ProvenWork:
    """Holds what robots say of work until it is proven. It hears a bus, and has questions for it."""

    def __init__(self, keys: Keys, boot: int, now_us: int, file: PanelKeys | None = None) -> None:
        """`boot`: different at each start. `file`: from which the keys are, and new ones come."""
        self.proofs = GatewayProofs(keys, boot, now_us)
        self._file = file
        self._names: dict[int, int] = {}
        self._slot_of: dict[int, int] = {}  # address -> slot, proven
        self._strangers, self._asked = False, 0
        self._asked_at_us = self._looked_at_us = now_us - S

    def hear(self, source: int, message: Any, now_us: int) -> Sequence[Any]:
        """What is proven now of work, oldest first."""
        if isinstance(message, AddressClaimed):
            if self._names.get(source, message.name) != message.name:  # another device
                self._slot_of.pop(source, None)
                self.proofs.checker.forget(source)
            self._names[source] = message.name
            return ()
        slot = self._slot_of.get(source)
        believed = self.proofs.hear(source, slot, message, now_us)
        work = []
        for sender, proven in believed or ():
            if isinstance(proven, Member):
                if slot != sender:
                    self._asked = 0
                self._slot_of = {a: s for a, s in self._slot_of.items() if s != sender}
                self._slot_of[source] = sender
            elif isinstance(proven, WORK):
                work.append(proven)
        known = source in self._slot_of or gateway_slot(source) is not None
        self._strangers |= (
            isinstance(message, Proof) and message.sender < OPERATOR_FIRST and not known
        )
        return work

    def questions(self, now_us: int) -> Sequence[Any]:
        """What is to be sent now: for the fleet's time, and for the slots of robots."""
        if self._file is not None and now_us - self._looked_at_us >= LOOK_US:
            self._looked_at_us = now_us
            keys = self._file.renewed()
            if keys is not None:
                self.proofs.rekey(keys, now_us)
                self._slot_of.clear()
        said: list[Any] = []
        if now_us >= self.proofs.due_at_us:
            said += [effect.message for effect in self.proofs.cover((), DEVICE, 0, now_us)]
        known = self.proofs.checker.time.known
        pause_us = ASK_WHO_US << min(self._asked, DOUBLINGS_MAX)
        if known and self._strangers and now_us - self._asked_at_us >= pause_us:
            self._strangers, self._asked_at_us, self._asked = False, now_us, self._asked + 1
            said.append(Request(GROUP_OF[Member].pgn))
        return said


def proven_work_of(keys: Path | None, now_us: int) -> ProvenWork | None:
    """By the key of a panel: this file, or that in this folder or beside this operator's file. None
    without one: then all counts that the bus says of work. Raises AttachError for a wrong file."""
    if keys is None:
        return None
    try:
        beside = keys.is_dir() or read(keys).kind == OPERATOR
    except KeyFileError as problem:
        raise AttachError(f"--keys {problem}") from None
    if beside:
        folder = keys if keys.is_dir() else keys.parent
        if not any((folder / NAMES[kind]).exists() for kind in (PANELS, FLEET)):
            return None
        keys = folder
    file = PanelKeys(keys)
    return ProvenWork(file.keys, randbits(32), now_us, file)
