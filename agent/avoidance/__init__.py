"""ORCA: the velocity nearest to the wanted one that keeps clear of neighbours, fences and walls.

`orca` is the door; `orca_kernel` solves the linear programs of `linear_program` on `half_planes`.
`obstacle_tree` and `k_nearest` find what is near, `fence_distance` and `stopping_constraint` keep
a body inside its field.
"""
