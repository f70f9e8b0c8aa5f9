"""What an order and a release say to a person where there is little to say."""

import pytest

from tools.operate import order
from tools.operate.operator_device import KnownRobot


@pytest.mark.parametrize(
    ("obeyed", "line"),
    [(True, "robot 0: obeys start"), (False, "robot 0: DOES NOT OBEY start; it has not answered")],
)
def test_a_robot_that_says_nothing_is_not_quoted(
    obeyed: bool, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """`obeys start; it says: nothing` sounded as if something were wrong."""
    order._tell(KnownRobot(0, 128, 0.0), "start", False, obeyed, True, False)
    assert capsys.readouterr().out == f"{line}\n"
