"""A run with a contact says the time, the robots and the place of the first one."""

from sim.runs.run import first_of
from sim.world.ground_truth import Contact


def test_the_first_contact_is_told_with_its_time_and_place() -> None:
    later = Contact(9_000_000, 0, None, 0.02, "fence", 5.0, 6.0)
    first = Contact(2_400_000, 1, 3, 0.01, "robot 3", 12.04, -3.5)
    assert first_of([later, first]) == "at 2.4 s robot 1 touched robot 3 at 12.0,-3.5"
    assert first_of([]) == ""
