"""Maps of obstacles: occupancy from rays, obstacles that come and go, buildings.

`occupancy_grid` is updated with `ray_evidence`; `local_and_fleet_map` joins a robot's own map with
the fleet's. `dynamic_obstacles` keeps what the plan of a `building` does not show. `inflation`
grows obstacles by a body.
"""
