"""Time limit for replicas to become equal after the last work is done."""

from agent.interface.config import S
from sim.scenarios.scenario import BusTable

QUIET_US = 2 * S  # on a bus without loss
# On a bus with loss: a lost question is repeated after 38 s at the latest
# (`protocol.sync.synchronizer`).
LOSSY_QUIET_US = 40 * S


def quiet_for_us(bus: BusTable) -> int:
    """The limit after the last section or goal, microseconds."""
    return LOSSY_QUIET_US if bus.loss or bus.omission else QUIET_US
