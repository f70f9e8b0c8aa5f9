"""Every cell of a grid is visited once, by robots that share one walk.

`cell_map` is the grid; `walk`, `walk_cut`, `walk_shortening` and `room_plan` make the walk, `team`
shares it. `coverage_mission` drives it, `plan_agreement` adopts one plan, `proximity_guard` keeps
robots apart.
"""
