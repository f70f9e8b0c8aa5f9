"""Files of runs: logs, recordings' ends, grid maps and coverage plans.

What people give to a robot is read by `agent/runtime/files`.
"""
