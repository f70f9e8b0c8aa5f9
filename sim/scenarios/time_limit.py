"""The default time limit of a run, from its field and its fleet."""

from typing import Final

from agent.field.field_map import Field

# Multiple of the time that the swaths alone take at full speed. Measured over 70 runs on fields of
# 0.01 to 20 ha: 1.4 to 3.8, the most if a few short sections make robots wait; bodies that steer up
# to 3.3.
WAYS_FACTOR: Final = 5.0
START_S: Final = 600.0  # to boot, to drive from the gate, and to wait for a lease or an operator


def time_limit_s(
    field: Field, robots: int, speed_m_s: float, last_fault_at_s: float = 0.0
) -> float:
    """Simulated seconds. `robots`: those that work to the end; `last_fault_at_s`: when the faults
    end."""
    workers = max(1, min(robots, len(field.sections)))
    return START_S + last_fault_at_s + WAYS_FACTOR * field.work_m / (workers * speed_m_s)
