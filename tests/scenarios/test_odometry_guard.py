"""A thousand failures of the odometry: none is believed, and the true odometry is rejoined."""

import json

import pytest
from bad_odometry import bad_flight, checked, drift_m
from synthetic_flight import settings

from swift_ros.estimation.vio_guard import VioGuard, VioSettings

BEGIN, END, PER_TEST = 1000, 2000, 50  # seeds
OFF_M, OFF_SIGMA, REJOINED_S = 0.5, 5.0, 0.5


@pytest.mark.parametrize("first", range(BEGIN, END, PER_TEST))
def test_no_failure_is_believed_and_the_true_odometry_is_rejoined(first):
    believed, late, refused = {}, {}, {}
    for seed in range(first, first + PER_TEST):
        flown = bad_flight(seed)
        check = checked(flown, VioGuard(settings("vio", VioSettings)))
        far = {tick: off_m for tick, off_m in check.off_m.items() if off_m > OFF_M}
        sigmas = max((off_m / drift_m(flown.begin - 1, tick) for tick, off_m in far.items()), default=0.0)
        if sigmas > OFF_SIGMA:
            believed[seed] = f"{flown.kind}: {max(far.values()):.2f} m, {sigmas:.1f} sigma"
        if check.rejoined_s > REJOINED_S:
            late[seed] = f"{flown.kind}: {check.rejoined_s:.2f} s"
        if check.refused_good:
            refused[seed] = check.refused_good
    found = json.dumps({"believed": believed, "late": late, "refused": refused}, indent=1)
    assert not (believed or late or refused), found
