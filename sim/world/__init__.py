"""Bodies, walls and the truth about them.

`world` moves each `robot_body` with `drive_trains` by `pymunk_engine`; `contact_free_steps` is the
fast step of campaigns. `lidar` and `walls` are what sensors see. Truth for judges: `ground_truth`,
`contacts`, `coverage_truth`.
"""
