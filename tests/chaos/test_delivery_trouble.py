"""Parcels through loss, a split, a death, a restart and boxes: seeds that once failed."""

import pytest

from sim.runs.delivery_run import DeliveryRun
from sim.scenarios.delivery_setup import DeliverySetup
from tools.bench.delivery_trouble import bad_luck, troubled


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", [11, 18])
def test_every_parcel_arrives(seed: int) -> None:
    """11: a node too near to a body. 18: a robot that drove on in a split and died unheard. In both,
    and in one run of three, a body that a restarted robot did not know of."""
    outcome = DeliveryRun(DeliverySetup(bad_luck(seed))).run()
    print(f"seed {seed}", outcome)
    assert outcome.finished and not outcome.flawed


def test_who_is_deaf_to_another_for_good_keeps_nobody_from_delivering() -> None:
    """Found: rounds of agreement never ended, and five of ten parcels lay for good."""
    outcome = troubled("deaf", 0).run()
    print(outcome)
    assert outcome.finished and not outcome.flawed
