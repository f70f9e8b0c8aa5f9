"""What the setups of all missions have alike: keys, silence policy, limits, chassis, starts, peers.

A setup is made from a scenario, read once, and shared by the peers of one process. What it holds is
immutable, so sharing gives no peer knowledge that it would not have computed equally.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from random import Random

from agent.interface.config import PEERS_MAX
from agent.interface.geometry import Point
from agent.interface.vehicle import Vehicle
from agent.runtime.files.key_file import FLEET, NAMES, OPERATOR, KeyFileError, read
from agent.runtime.peer_factory import NO_MEMORY, MissionParts, keyring_of
from protocol.authentication import KEY_SIZE, Keyring, Keys
from protocol.rekeying import own_key
from sim.scenarios.scenario import Scenario, ScenarioError
from sim.world.drive_trains import Chassis
from sim.world.world import World

DRAWN = "drawn"  # instead of a key file: keys from the seed, which are secret in virtual time only


class FleetSetup(ABC):
    """The base of all setups: a subclass adds the world and the missions."""

    starts: Sequence[Point]  # metres; of each robot

    def __init__(self, scenario: Scenario) -> None:
        """Raises ScenarioError if the key file of the fleet cannot be used."""
        self.scenario = scenario
        self.keys = _keys_of(scenario)
        self.root = _root_of(scenario)  # of the robots' own keys, where the owner's file is there
        self.silence = scenario.fleet.silence_policy

    def use_keys(self, path: Path) -> None:
        """Give the fleet keys after its setup was made, and before anything was made of it.

        Raises ScenarioError if the file cannot be used.
        """
        self.scenario = self.scenario.changed(keys=path)
        self.keys, self.root = _keys_of(self.scenario), _root_of(self.scenario)

    # ---------------------------------------------------------------- what a mission says

    @property
    @abstractmethod
    def config_hash(self) -> int:
        """u24, equal for all robots of one place of work."""

    @property
    @abstractmethod
    def section_count(self) -> int:
        """The number of sections, goals or parcels that the fleet claims."""

    @property
    def reachable_count(self) -> int:
        """The number of those that robots can reach. With them, the work is done."""
        return self.section_count

    @abstractmethod
    def parts(
        self, slot: int, now_us: int = 0, recalled: Mapping[str, bytes] = NO_MEMORY
    ) -> MissionParts:
        """What the mission brings to a peer. `recalled`: the contents of its durable memory."""

    @abstractmethod
    def world(self) -> World:
        """A new world, with every robot at its start."""

    def free_space(self, radius_m: float) -> Callable[[float, float], bool] | None:
        """Tells whether a body's centre can be at a point; None if there is no ground to ask."""
        return None

    # ---------------------------------------------------------------- what all have

    @property
    def time_limit_s(self) -> float:
        """Simulated seconds after which a run ends."""
        return self.scenario.run.time_limit_s

    @cached_property
    def vehicle(self) -> Vehicle:
        """What all robots of the fleet are alike in."""
        return self.scenario.fleet.vehicle

    @cached_property
    def chassis(self) -> Chassis:
        """The body of each robot, as the world moves it."""
        return self.make_chassis()

    def make_chassis(self) -> Chassis:
        """The chassis of a body that drives in any direction, as it is wherever wheels do not matter."""
        fleet = self.scenario.fleet
        return Chassis(
            speed_m_s=fleet.speed_m_s, acceleration_m_s2=fleet.acceleration_m_s2, slip=fleet.slip
        )

    def keyring(self, sender: int, lot: str = "") -> Keyring | None:
        """`lot`: any value that no two starts of this sender share."""
        keys = self.keys
        if keys is not None and self.root is not None and sender < PEERS_MAX:
            keys = keys._replace(own=own_key(self.root, sender))
        return keyring_of(keys, sender, lot.encode())

    def populated(self, world: World) -> World:
        """The world, with every robot put at its start."""
        fleet = self.scenario.fleet
        for slot, at in zip(range(fleet.robots), self.starts, strict=False):
            world.add_robot(slot, at, fleet.radius_m, self.chassis)
        return world


def _root_of(scenario: Scenario) -> bytes | None:
    """Robots in virtual time are in one process, so their own keys are made from the owner's file."""
    name = scenario.fleet.keys
    if name is None:
        return None
    if name == DRAWN:
        return Random(f"{scenario.run.seed}/root").randbytes(KEY_SIZE)
    path = scenario.folder / name
    try:
        owner = read((path if path.is_dir() else path.parent) / NAMES[OPERATOR], OPERATOR)
    except KeyFileError:
        return None
    return owner.root


def _keys_of(scenario: Scenario) -> Keys | None:
    name = scenario.fleet.keys
    if name is None:
        return None
    if name == DRAWN:
        lot = Random(f"{scenario.run.seed}/keys")
        return Keys(lot.randbytes(KEY_SIZE), lot.randbytes(KEY_SIZE))
    try:
        return read(scenario.folder / name, FLEET).keys
    except KeyFileError as problem:
        raise ScenarioError(f"{scenario.name}: fleet.keys: {problem}") from None
