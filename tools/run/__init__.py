"""Commands that run a fleet, in virtual time or as processes.

`run_mission` is what `run_field`, `run_navigation`, `run_delivery` and `run_exploration` share. `launch`
starts a process for each robot, `robot_command` one robot on a machine. `declared_fleet` and `notebook`
are runs from Python. `run_recorder` keeps what a run leaves for replays and viewers.
"""
