"""Which work that is told may be true at all: asked at the door, before anything is joined.

Replicas must become equal, so what is refused for good depends on nothing but the configuration that all
robots of a fleet share: the sections of its field and its members. A register whose epoch is higher than
the hand-overs of the time since boot explain is only put off: a robot that was away is told it again
until it believes it, and a few forged frames are not believed.
"""

from collections import Counter
from collections.abc import Set as AbstractSet

from agent.interface.config import S
from protocol.frames.work_frames import StateSyncResponse, TaskClaim, WorkProgress

# Hand-overs of one section: a fault of the fleet costs one or two, and its lease lasts 20 s.
EPOCH_BURST = 16
EPOCH_EVERY_US = 10 * S
# However long it runs, or its clock says so: an hour would explain all 255. Higher ones are put off.
EPOCH_EXPLAINED_MAX = 64
PERSISTS_US = 3 * S  # told again after this: sync repeats what differs
FORGOTTEN_US = 60 * S  # sync asks at least every 38 s
PUT_OFF_MAX = (
    256  # sections of which an improbable epoch was told; of more the oldest are forgotten
)

Work = TaskClaim | StateSyncResponse | WorkProgress


class Admission:
    def __init__(self, sections: AbstractSet[int], owners: AbstractSet[int], now_us: int) -> None:
        """`sections`: of the field; empty: any. `owners`: slots that may hold a section."""
        self.sections, self.owners = sections, owners
        self.refused: Counter[str] = Counter()  # why -> frames
        self._boot_us = now_us
        self._put_off: dict[int, tuple[int, int, int]] = {}  # section: epoch, first and last told

    def admits(self, message: Work, now_us: int) -> bool:
        """False: counted, and not to be joined."""
        if self.sections and message.section not in self.sections:
            self.refused["section"] += 1
            return False
        if isinstance(message, WorkProgress):
            return True
        if message.owner not in self.owners:
            self.refused["owner"] += 1
            return False
        if message.epoch > message.lamport:  # each hand-over was an operation
            self.refused["epoch"] += 1
            return False
        explained = EPOCH_BURST + (now_us - self._boot_us) // EPOCH_EVERY_US
        explained = min(explained, EPOCH_EXPLAINED_MAX)
        if message.epoch <= explained or self._persists(message.section, message.epoch, now_us):
            return True
        self.refused["epoch"] += 1
        return False

    def _persists(self, section: int, epoch: int, now_us: int) -> bool:
        known, first_us, last_us = self._put_off.pop(section, (epoch, now_us, now_us))
        if known != epoch or now_us - last_us > FORGOTTEN_US:
            first_us = now_us
        if now_us - first_us >= PERSISTS_US:
            return True
        self._put_off[section] = epoch, first_us, now_us
        if len(self._put_off) > PUT_OFF_MAX:
            del self._put_off[next(iter(self._put_off))]
        return False
