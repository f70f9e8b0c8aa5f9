"""Shortest paths in the plane and on grids, for bodies that turn on the spot and for tractors.

`any_angle_planner` plans round corners of obstacles (`corner_graph`, `corner_cache`); `theta_star`
is Theta* on a grid with `line_of_sight`. `route` is a path inside a field, through narrow ground
over `lane_ways`. Tractors: `dubins` and `hybrid_a_star`, joined in `tractor_route`. `nav_mesh` is
for buildings. Nothing here knows of robots, frames or time.
"""
