"""Robots that drive to goals in a building.

`navigation_mission` is the mission; `path_lookahead` plans the next path while the robot drives,
`replan_policy` says when a path is planned again, `silent_robots` keeps the places of robots that
fell silent.
"""
