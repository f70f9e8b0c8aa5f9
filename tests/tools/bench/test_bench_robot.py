"""`headland bench robot`: what it says of trials that were, and of those that were not."""

from tools.bench.robot import FAULTS, NO_FAULT, LostPlaceTrial, trial_figures


def test_a_fault_without_a_trial_is_not_left_out() -> None:
    """On a busy computer no machine drove in the 35 s of a quick run: its rows were missing, and all the
    others held."""
    stood = LostPlaceTrial("muted", 0.0, 0.0, 0.0, 0.0, 0.0, False, True, NO_FAULT)
    late = LostPlaceTrial("late", 0.2, 0.2, 1.5, 1.5, 0.0, True, True, "late 0.5 3")
    rows = list(trial_figures([stood, late], "scope"))
    missing = {row.figure: row.holds for row in rows if "not measured" in row.scope}
    assert missing == {f"{fault}: trials": None for fault in FAULTS if fault != "late"}
    assert all(row.holds for row in rows if row.figure.startswith("late"))
