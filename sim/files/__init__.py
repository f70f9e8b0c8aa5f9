"""Files that runs write and tools read: logs, grid maps and coverage plans.

`can_log` opens a log by its suffix, `candump` has our own format, `log_parts` keeps the newest parts
of a log, and `recording_end` ends a log on a full disk. `whole_file` writes files that are no logs.
`grid_map` reads maps, `coverage_plan_file` the plans on them. Files that people give to a robot are
read by `agent/runtime/files`.
"""
