"""Inputs and outputs of a peer: observations, effects, the mission interface, identity, limits.

Start with `effects` (what comes out), `observation` (what a body senses) and `mission` (what a mission
answers each control period). `lifecycle` is the total table of a robot's states, on the machine in
`protocol/state_machine.py`. `config` holds every limit of the core with its unit and its reason.
"""

from agent.interface.effects import HALT, Drive, Effect, Persist, Send, Trace
from agent.interface.identity import Identity, SilencePolicy
from agent.interface.lifecycle import Event, State
from agent.interface.mission import (
    STILL,
    ClaimRequest,
    CoveredUnits,
    FleetView,
    Mission,
    MotionRequest,
)
from agent.interface.motion_controller import BodyLimits, MotionController
from agent.interface.observation import Neighbour, Observation
from agent.interface.ports import Body, Bus, Journal
from agent.interface.vehicle import DriveTrain, Vehicle

__all__ = [
    "HALT", "STILL", "Body", "BodyLimits", "Bus", "ClaimRequest", "CoveredUnits", "Drive",
    "DriveTrain", "Effect", "Event", "FleetView", "Identity", "Journal", "Mission", "MotionController",
    "MotionRequest", "Neighbour", "Observation", "Persist", "Send", "SilencePolicy", "State", "Trace",
    "Vehicle",
]  # fmt: skip
