"""What a robot with keys believes of its own records after a restart."""

from collections.abc import Sequence
from random import Random

from agent.interface.effects import Effect, Persist
from agent.peer.durable_records import U64, DurableRecords
from agent.peer.journal_recovery import senseless
from crdt import FieldAllocationCRDT, Phase, Progress
from crdt.claim_register import pack
from protocol.frames.work_frames import WorkProgress
from protocol.sync.replica import Replica
from protocol.sync.vouchers import Revocation, Vouched, Vouchers
from sim.rigs.keyed_rig import KeyedRig

US, THIEF, UNITS = 0, 1, 40
OWN, FOREIGN = 0b0011, 0b1100
END = pack(0, Phase.DONE, 0, 7, US)
VOID = Revocation(THIEF, None, frozenset())


def written(generation: int = 0) -> dict[str, bytes]:
    """Two units of ours and two that the thief told, and the end of the section."""
    ours = Replica(FieldAllocationCRDT(), Progress({0: 4}))
    ours.vouchers = Vouchers(US, generation)
    ours.on_message(WorkProgress(0, 0, FOREIGN), THIEF, 1)
    ours.progress.apply(0, 0, OWN)
    ours.changed_here(0, 0, OWN, 2)
    records = [DurableRecords.progress(0, 0, ours.progress.bits(0, 0), ours.vouchers)]
    records += DurableRecords.operation(3, 0, END, ours.vouchers)
    assert not senseless(dict(records))
    return dict(records)


def restarted(recalled: dict[str, bytes], generation: int = 0) -> Replica:
    allocation, progress = FieldAllocationCRDT(), Progress({0: 4})
    vouchers = Vouchers(US, generation)
    records = DurableRecords(recalled, False, Random(1))
    ends = records.restore(allocation, progress, vouchers)
    ours = Replica(allocation, progress)
    ours.vouchers = vouchers
    for section, key in ends.items():
        ours.await_units(section, key, {US: [Vouched(key, 0)]})
    return ours


def test_what_a_thief_said_before_a_restart_is_taken_out_too() -> None:
    ours = restarted(written())
    assert ours.progress.bits(0, 0) == OWN | FOREIGN
    assert ours.allocation.phase_of(0) is Phase.DONE, "a fleet that loses power loses no work"
    ours.void(VOID)
    assert ours.progress.bits(0, 0) == OWN and ours.allocation.phase_of(0) is Phase.FREE


def test_records_of_before_a_revocation_bring_nothing_back() -> None:
    """A robot that was off at the revocation, or lost power in the middle of it."""
    ours = restarted(written(3), generation=4)
    assert ours.progress.bits(0, 0) == OWN and ours.allocation.phase_of(0) is Phase.FREE
    ours.on_message(WorkProgress(0, 0, FOREIGN), 2, 1)  # it is true after all
    assert ours.allocation.key(0) == END


def test_records_of_older_versions_are_read_and_count_as_told_by_nobody_known() -> None:
    """They may hold units of a thief, and do not say which are our own."""
    old = {"progress/0/0": U64.pack(OWN | FOREIGN), "register/0": U64.pack(END)}
    ours = restarted(old)
    assert ours.progress.bits(0, 0) == OWN | FOREIGN and ours.allocation.key(0) == END
    ours.void(VOID)
    assert ours.progress.bits(0, 0) == 0 and ours.allocation.phase_of(0) is Phase.FREE


def test_a_fleet_whose_keys_were_taken_away_reads_all_units() -> None:
    allocation, progress = FieldAllocationCRDT(), Progress({0: 4})
    DurableRecords(written(3), False, Random(1)).restore(allocation, progress)
    assert progress.bits(0, 0) == OWN | FOREIGN and allocation.key(0) == END


def test_without_keys_records_are_what_they_were() -> None:
    assert DurableRecords.progress(2, 1, 5) == ("progress/2/1", U64.pack(5))
    assert DurableRecords.operation(1, 2, END)[0] == ("register/2", U64.pack(END))


class Disks(KeyedRig):
    """Robots with keys, and the names of the records that they write."""

    def __init__(self, seed: int) -> None:
        self.written: list[tuple[int, str]] = []
        super().__init__(seed)

    def send(self, slot: int, effects: Sequence[Effect]) -> None:
        for effect in effects:
            if isinstance(effect, Persist):
                self.written.append((slot, effect.key))
        super().send(slot, effects)


def test_a_robot_that_lost_its_memory_writes_down_what_it_is_told_of_itself() -> None:
    """It is its own word from then on, and has to outlive the next restart."""
    rig = Disks(1)
    rig.work(1, 0)
    rig.written.clear()
    rig.boot(1, lost=True)
    rig.run_for(5_000_000)
    assert rig.peers[1].allocation.owner_of(0) == 1
    assert (1, "register/0") in rig.written
    vouchers = rig.peers[1].sync.replica.vouchers
    assert vouchers is not None and vouchers.said_by(0, 1) == rig.peers[1].allocation.key(0)


def test_a_register_with_a_phase_of_other_software_makes_no_sense() -> None:
    """A robot with it ended with a traceback at each start."""
    for phase in range(8):
        end = pack(1, phase, 0, 7, US)
        told = senseless(dict([DurableRecords.register(3, end, None)]))
        assert bool(told) is (phase not in list(Phase))
