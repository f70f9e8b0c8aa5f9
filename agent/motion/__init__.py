"""From a mission's motion request to a drive command; the safety gate comes after it.

`holonomic_motion` and `tractor_motion` are the two motion controllers; `path_tracker` and
`tractor_tracker` follow paths, `tractor_escape` moves a tractor out of the way. `obstacle_detector`
finds what no robot explains (`unexplained_echoes`), `obstacle_stop` stops and asks a person.
`right_of_way` and `deadlock_yield` settle meetings; `stopping_zone` says where a silent robot may
stand. `sensed_walls` replaces fences that are not known. `implement_clearance` keeps robots off
implements.
"""
