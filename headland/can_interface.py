"""What python-can loads for `interface="fieldbus"`: a simulated bus in this process."""

from sim.can.simulated_bus import FieldBus

__all__ = ["FieldBus"]
