"""Commands that listen and never change anything: what each robot is, holds and says.

Read `inspector` first: all that a listener knows. `causality` keeps why a section has its owner,
`bus_load` how full the bus is. `log_frames` reads logs, `frame_feed` gives their frames at a speed.
`inspection` is the command, `robot_table` its text, `screen` its terminal, `table_widget` and
`lifecycle_picture` parts of that.
"""
