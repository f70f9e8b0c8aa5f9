"""The fleet and the places against which the phrases of `phrases.toml` are weighed."""

from tools.language.fleet_now import FleetNow, RobotNow, SectionNow
from tools.language.places import Places

PLACES = Places(
    {"shelf": (10.0, 0.0), "loading dock": (-20.0, 8.0), "dock": (0.0, 30.0), "gate": (50.0, 50.0)},
    {"S3": (70.0, 5.0), "S7": (-60.0, 40.0)},
)
FLEET = FleetNow(
    {
        0: RobotNow(0, "IDLE", 40.0, 40.0),
        1: RobotNow(1, "WORKING", 12.0, 3.0, 2.0, sections=("S7",)),
        2: RobotNow(2, "WORKING", -30.0, 0.0, 1.5, sections=("S3",)),
        3: RobotNow(3, "WORKING", 5.0, 5.0, asking=2),
        4: RobotNow(4, "IDLE", 0.0, 10.0),
        5: RobotNow(5, "EMERGENCY_STOP", -5.0, -5.0, stopped=True),
    },
    {3: SectionNow("STARTED", 2), 7: SectionNow("STARTED", 1)},
)
