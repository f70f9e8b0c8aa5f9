"""How long a fleet may take for a field: what a run is given where nobody says a limit."""

from typing import Final

from agent.field.field_map import Field

# Of the time that the swaths alone take at full speed. Measured over 70 runs on fields of 0.01 to 20 ha:
# 1.4 to 3.8, the most where a few short sections keep a fleet waiting; bodies that steer up to 3.3.
WAYS_FACTOR: Final = 5.0
START_S: Final = 600.0  # to boot, to drive from the gate, to wait for a lease or an operator


def time_limit_s(field: Field, robots: int, speed_m_s: float, last_fault_s: float = 0.0) -> float:
    """Simulated seconds. `robots`: those that work to the end; `last_fault_s`: when trouble ends."""
    workers = max(1, min(robots, len(field.sections)))
    return START_S + last_fault_s + WAYS_FACTOR * field.work_m / (workers * speed_m_s)
