"""Commands that listen and never change anything: what each robot is, holds and says.

Read `inspector` first: all that a listener knows. `causality` keeps why a section has its owner,
`bus_load` how full the bus is. `frame_feed` gives frames of a log at a speed. `inspection` is the
command, `screen` its terminal, `table_widget` and `lifecycle_picture` parts of that.
"""
