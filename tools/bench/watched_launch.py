"""A launch that says when its bodies moved last: what a bench of stops is judged by.

    python -m tools.bench.watched_launch SCENARIO ROBOTS

It is `headland launch SCENARIO --robots ROBOTS --fresh --no-keys`, and prints a JSON line every
`TELL_S` beside, for `tools.bench.standing_bodies`. Its times are those of `time.monotonic()`, which all
processes of a machine share.
"""

import asyncio
import sys
from typing import Final

from rich.console import Console

from sim.files.strict_json import dumps
from sim.record.remote_body import BodyServer
from sim.scenarios.field_setup import FieldSetup
from sim.world.drive_trains import STEP_US
from tools.build.warmup import warm
from tools.run.fleet_folder import fleet_folder
from tools.run.launch import Launch
from tools.run.launch_bus import LaunchBus
from tools.run.launch_delivery import HaulLaunch
from tools.run.launch_setup import setting_of

TELL_S: Final = 0.05
KEY: Final = "bodies"


async def tell(bodies: BodyServer) -> None:
    """Print, for ever, when each body moved last, when a command to move was last in force, and the
    speed of the body."""
    world, zero_s = bodies.world, bodies.zero_at_us / 1e6
    while True:
        told = [
            (
                zero_s + robot.moved_at_us / 1e6,
                zero_s + (robot.commanded_at_us + STEP_US) / 1e6,
                robot.speed_m_s,
            )
            for robot in world.robots.values()
        ]
        print(dumps({KEY: told, "now_s": zero_s + world.now_us / 1e6}), flush=True)
        await asyncio.sleep(TELL_S)


class WatchedLaunch(Launch):
    """In a field."""

    def _furnish(self, bodies: BodyServer, bus: LaunchBus) -> list["asyncio.Task[None]"]:
        return [*super()._furnish(bodies, bus), asyncio.create_task(tell(bodies))]


class WatchedHaul(HaulLaunch):
    """In a warehouse."""

    def _furnish(self, bodies: BodyServer, bus: LaunchBus) -> list["asyncio.Task[None]"]:
        return [*super()._furnish(bodies, bus), asyncio.create_task(tell(bodies))]


def main(scenario: str, robots: int) -> int:
    """The exit code of the launch."""
    setting = setting_of(scenario, robots, None, None)
    steering = isinstance(setting, FieldSetup) and setting.turn_radius_m > 0.0
    warm(steering, not isinstance(setting, FieldSetup))
    fleet = fleet_folder(None, setting, fresh=True)
    console = Console(highlight=False, soft_wrap=True)
    kind = WatchedLaunch if isinstance(setting, FieldSetup) else WatchedHaul
    return asyncio.run(kind(setting, scenario, fleet, console, None).run(0, None))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2])))
