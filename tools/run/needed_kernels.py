"""Kernels without which a robot cannot begin its work: it compiles those that no cache has.

They are those that Python calls at the start of each work. What a kernel calls is compiled with it.
"""

from typing import Final

from agent.interface.vehicle import DriveTrain
from agent.runtime.robot_body import named
from agent.runtime.robot_file import WORKS, RobotFile
from tools.build.kernel_cache import is_kept

MOTION: Final = (
    "agent.avoidance.fence_distance:gather",
    "agent.avoidance.orca_kernel:velocity",
)
PATHS: Final = ("agent.paths.corner_cache:_build", "agent.paths.corner_graph:query")
NEEDED: Final = {
    "field": (
        *MOTION,
        "agent.field.plan_kernels:insert_all",
        "agent.mapf.linear_assignment:assigned_rows",
        "agent.paths.corner_cache:_build",
        "agent.paths.nav_mesh:spread",
        "agent.paths.regions:regions_of",
        "agent.paths.theta_star:sees",
    ),
    "warehouse": (
        *MOTION,
        *PATHS,
        "agent.delivery.routing_kernels:auction",
        "agent.paths.nav_mesh:spread",
    ),
    "navigation": (
        *MOTION,
        *PATHS,
        "agent.mapf.pibt:step",
        "agent.mapf.plan_schedule:hold",
    ),
    "exploration": (
        *MOTION,
        *PATHS,
        "agent.exploration.frontier:_spread",
        "agent.mapping.ray_evidence:weigh_scan",
    ),
    "coverage": (
        "agent.coverage.cell_links:link_straight",
        "agent.coverage.team_step:step",
        "agent.coverage.walk:measure",
        "agent.coverage.walk_shortening:polish",
        "agent.coverage.work_sharing:choose_goals",
    ),
    "mission": MOTION,  # one of a person's own: more is not known
}
# In a field, of a body that does not drive in any direction.
TURNS: Final = (
    "agent.avoidance.fence_distance:gap_m",
    "agent.paths.dubins:step",
    "agent.paths.hybrid_a_star:search",
)


def missing_kernels(declared: RobotFile) -> list[str]:
    """Those that the work of this robot needs and that have not been compiled from these sources."""
    needed = [
        name for work in WORKS if getattr(declared, work) is not None for name in NEEDED[work]
    ]
    if declared.field is not None and declared.fleet.vehicle.drive is not DriveTrain.MECANUM:
        needed += TURNS
    return [name for name in needed if not is_kept(named(name))]
