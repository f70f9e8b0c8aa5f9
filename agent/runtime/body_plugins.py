"""Bodies that a robot file names: a plug-in of the entry point group `headland.body`, or a factory.

A package of yours adds a plug-in in its `pyproject.toml`:

    [project.entry-points."headland.body"]
    rover = "my_rover:Rover"

Both are called with the slot and with the options of the robot file.
"""

from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import Any, Final

from agent.runtime.robot_body import FactoryError, RobotBody, called

GROUP: Final = "headland.body"
# Those of this package, also where it runs from a tree that is not installed.
OWN: Final = {
    "standing": "agent.runtime.robot_body:StandingBody",
    "nmea": "agent.runtime.bodies.nmea_body:NmeaBody",
    "ros2": "agent.runtime.bodies.ros2_body:Ros2Body",
    "vda5050": "agent.runtime.bodies.vda5050_body:Vda5050Body",
    "isobus": "agent.runtime.bodies.isobus_body:IsobusBody",
    "sim": "sim.record.remote_body:WorldBody",  # in the world of a launch
    "replay": "agent.runtime.bodies.replay_body:ReplayBody",
}


def plugins() -> Mapping[str, str]:
    """The factory of each plug-in that is installed, by its name; ours cannot be replaced."""
    return {point.name: point.value for point in entry_points(group=GROUP)} | OWN


def factory_of(plugin: str) -> str | None:
    """The factory of a plug-in; None: it is not installed. To look for one of others takes long: the
    metadata of every installed package is read."""
    return OWN.get(plugin) or plugins().get(plugin)


def made(
    plugin: str | None, factory: str | None, slot: int, options: Mapping[str, Any]
) -> RobotBody:
    """The body of a robot. Raises FactoryError, one line."""
    if plugin is not None:
        factory = factory_of(plugin)
        if factory is None:
            known = ", ".join(sorted(plugins()))
            raise FactoryError(f"no plug-in {plugin!r}; there are {known}")
    assert factory is not None
    body = called(factory, slot, **options)
    if not isinstance(body, RobotBody):
        raise FactoryError(f"{factory!r} makes no RobotBody")
    return body
