"""A displacement as a machine with a GNSS receiver shows it: by its sentences, through the driver."""

import pytest

from agent.field.displacement_detector import DisplacementDetector
from agent.interface.config import S
from agent.runtime.bodies.position_fixes import ReceiverClock

pytest.importorskip("pynmeagps", reason="the extra nmea is not installed")

from agent.runtime.bodies.nmea_body import in_field
from agent.runtime.bodies.nmea_fixes import NmeaFixes
from sim.machines.nmea_machine import Dimensions, NmeaMachine, WheeledBody

ORIGIN = (52.0, 5.0)
LATENCY_US = 20_000
SPEED_M_S, ACCELERATION_M_S2 = 2.5, 1.5
TURN_M_S = 0.4  # of each wheel, on the spot


class Row:
    """A machine that is driven by wheel speeds, and what a detector makes of its sentences."""

    def __init__(self, rate_hz: float, velocity: bool, noise_m: float) -> None:
        self.now_s = 100.0
        size = Dimensions(rate_hz=rate_hz, noise_m=noise_m)
        self.machine = NmeaMachine(
            WheeledBody(size, 0.0, 0.0, 0.0), ORIGIN, clock=lambda: self.now_s
        )
        self.fixes = NmeaFixes(in_field(ORIGIN), (0.0, 0.0), ReceiverClock(LATENCY_US).sensed_at_us)
        self.shove = DisplacementDetector(SPEED_M_S, ACCELERATION_M_S2)
        self.velocity = velocity

    def on(self, for_s: float, left_m_s: float, right_m_s: float, push_m_s: float = 0.0) -> int:
        """Number of fixes in which a displacement shows."""
        seen, body = 0, self.machine.body
        step_s = 1 / body.dimensions.rate_hz
        for _ in range(round(for_s / step_s)):
            radius_m = body.dimensions.wheel_radius_m
            body.tell(
                [left_m_s / radius_m, right_m_s / radius_m], 0.0, True, self.now_s + step_s + 0.1
            )
            self.now_s += step_s
            self.machine.move()
            body.x_m += push_m_s * step_s
            at_us = round(self.now_s * S) + LATENCY_US
            for line in self.machine.fix().splitlines():
                if not self.velocity and b"VTG" in line:
                    continue
                here = self.fixes.take(line, at_us)
                if here is not None:
                    seen += self.shove.observe(here, at_us)
        return seen


@pytest.mark.parametrize(
    ("rate_hz", "velocity", "noise_m"),
    [(20.0, True, 0.02), (10.0, True, 0.01), (20.0, False, 0.01)],
)
def test_rows_and_turns_are_no_displacement(rate_hz: float, velocity: bool, noise_m: float) -> None:
    row = Row(rate_hz, velocity, noise_m)
    assert row.on(3.0, SPEED_M_S, SPEED_M_S) == 0
    assert row.on(1.5, 0.0, 0.0) == 0
    assert row.on(1.0, -TURN_M_S, TURN_M_S) == 0
    assert row.on(1.0, TURN_M_S, TURN_M_S) == 0


def test_a_machine_is_dragged_while_its_velocity_is_that_of_its_wheels() -> None:
    row = Row(10.0, True, 0.01)
    assert row.on(2.0, 1.5, 1.5) == 0
    assert row.on(1.76, 1.5, 1.5, push_m_s=1.0) > 10
    row.on(1.0, 1.5, 1.5)
    assert row.on(2.0, 1.5, 1.5) == 0
