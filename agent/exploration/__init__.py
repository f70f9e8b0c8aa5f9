"""Robots that map an unknown building.

`exploration_mission` is the mission: it chooses a `frontier`, drives a `frontier_path` to it and
shares the map. `exploration_task` and `exploration_report` tell people what the fleet does.
"""
