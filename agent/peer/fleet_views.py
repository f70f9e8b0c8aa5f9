"""Makes the view of the fleet that a mission decides by."""

from agent.interface.mission import FleetView
from agent.peer.membership import Membership
from agent.peer.obstacle_hold import ObstacleHold
from agent.peer.sense_freshness import Senses
from agent.safety.stop_controller import StopController
from crdt import FieldAllocationCRDT, Progress


class FleetViews:
    """Collects what a mission may know from the parts that know it."""

    def __init__(
        self,
        senses: Senses,
        allocation: FieldAllocationCRDT,
        progress: Progress,
        membership: Membership,
        obstacle: ObstacleHold,
        safety: StopController,
    ) -> None:
        self.senses, self.allocation, self.progress = senses, allocation, progress
        self.membership, self.obstacle, self.safety = membership, obstacle, safety

    def view(self, now_us: int) -> FleetView:
        """What the mission may know now. The robot must have sensed before."""
        here, members = self.senses.here, self.membership
        assert here is not None
        things, leave_out = self.obstacle.round
        return FleetView(
            members.slot, now_us, here, self.allocation, self.progress,
            members.live, members.fell_silent_at_us, members.neighbours, things, leave_out,
            self.safety.may_move, self.senses.current, self.obstacle.under_bar,
        )  # fmt: skip
