"""A thousand failures of the odometry: none is believed but slow ramps, and the true odometry is rejoined.

A ramp of the position without velocity, of 1 to 1.5 m/s, is within the drift of good odometry at racing speed: a limit
that refused all of them at 5 sigma would refuse good odometry in every fiftieth lap.
"""

import pytest
from bad_odometry import bad_flight, checked, drift_m
from synthetic_flight import settings

from swift_ros.estimation.odometry_check.vio_guard import VioGuard, VioSettings

BEGIN, END, PER_TEST = 1000, 2000, 50  # seeds
OFF_M, OFF_SIGMA, REJOINED_S = 0.5, 5.0, 0.5
SLOW_RAMP, RAMP_M = "a ramp of the position", 1.0


@pytest.mark.parametrize("first", range(BEGIN, END, PER_TEST))
def test_no_failure_is_believed_but_slow_ramps_and_the_true_odometry_is_rejoined(first):
    wrong = {}
    for seed in range(first, first + PER_TEST):
        flown = bad_flight(seed)
        check = checked(flown, VioGuard(settings("vio", VioSettings)))
        far = {tick: off_m for tick, off_m in check.off_m.items() if off_m > OFF_M}
        sigmas = max((off_m / drift_m(flown.begin - 1, tick) for tick, off_m in far.items()), default=0.0)
        if sigmas > OFF_SIGMA:
            found = f"{flown.kind}, seed {seed}: {max(far.values()):.2f} m, {sigmas:.1f} sigma believed"
            print(found)  # pytest -rP shows it
            if flown.kind != SLOW_RAMP or max(far.values()) > RAMP_M:
                wrong[seed] = found
        if check.rejoined_s > REJOINED_S or check.refused_good:
            wrong[seed] = (
                f"{flown.kind}: rejoined after {check.rejoined_s:.2f} s, {check.refused_good} good ones refused"
            )
    assert not wrong
