"""The chassis of a robot; kept here for those that import it from `sim.mecanum`."""

from sim.vehicle import Chassis

__all__ = ["Chassis"]
