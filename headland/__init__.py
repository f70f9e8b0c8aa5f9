"""A leaderless robot fleet on a CAN bus: the one name that an installed Headland takes.

`import headland as hl` gives play, sweep and Fleet, which run scenarios in virtual time, and what an
engineer implements: Body and Mission. They are imported at their first use (docs/use/python.md).

`__main__` is the command, `can_interface` what python-can loads for `interface="fieldbus"`. In a wheel
the layers are packages in here (`headland.agent`). In a checkout `checkout` finds them beside this one.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agent.interface.effects import Drive
    from agent.interface.mission import STILL, ClaimRequest, FleetView, Mission, MotionRequest
    from agent.interface.observation import Observation
    from agent.motion.path_tracker import PathTracker
    from agent.runtime.robot_body import DeclaredMachine
    from agent.runtime.robot_body import RobotBody as Body
    from crdt import Phase
    from sim.scenarios.own_mission_setup import Site
    from sim.scenarios.scenario import ScenarioError
    from tools.run.declared_fleet import Fleet
    from tools.run.notebook import Run, play
    from tools.run.parameter_sweep import sweep
    from tools.run.played_robot import PlayedRobot as Robot

if not Path(__file__).with_name("agent").is_dir():
    from headland.checkout import find_layers

    find_layers()

__all__ = [
    "STILL",
    "Body",
    "ClaimRequest",
    "DeclaredMachine",
    "Drive",
    "Fleet",
    "FleetView",
    "Mission",
    "MotionRequest",
    "Observation",
    "PathTracker",
    "Phase",
    "Robot",
    "Run",
    "ScenarioError",
    "Site",
    "play",
    "sweep",
]
# Where each name is; a module that nobody asks for is not imported.
_PLACES = {
    "STILL": ("agent.interface.mission", "STILL"),
    "Body": ("agent.runtime.robot_body", "RobotBody"),
    "ClaimRequest": ("agent.interface.mission", "ClaimRequest"),
    "DeclaredMachine": ("agent.runtime.robot_body", "DeclaredMachine"),
    "Drive": ("agent.interface.effects", "Drive"),
    "Fleet": ("tools.run.declared_fleet", "Fleet"),
    "FleetView": ("agent.interface.mission", "FleetView"),
    "Mission": ("agent.interface.mission", "Mission"),
    "MotionRequest": ("agent.interface.mission", "MotionRequest"),
    "Observation": ("agent.interface.observation", "Observation"),
    "PathTracker": ("agent.motion.path_tracker", "PathTracker"),
    "Phase": ("crdt", "Phase"),
    "Robot": ("tools.run.played_robot", "PlayedRobot"),
    "Run": ("tools.run.notebook", "Run"),
    "ScenarioError": ("sim.scenarios.scenario", "ScenarioError"),
    "Site": ("sim.scenarios.own_mission_setup", "Site"),
    "play": ("tools.run.notebook", "play"),
    "sweep": ("tools.run.parameter_sweep", "sweep"),
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'headland' has no attribute {name!r}")
    module, own = _PLACES[name]
    value = getattr(import_module(f"{__name__}.{module}"), own)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """What Tab shows: the names that are meant for others."""
    return [name for name in globals() if name.startswith("__")] + sorted(__all__)
