"""A PettingZoo environment of what one peer on a grid hears and may do."""

from tools.run.mapf_environment import MapfEnvironment

__all__ = ["MapfEnvironment"]
