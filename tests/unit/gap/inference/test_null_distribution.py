"""What the reference flights say of the size of an effect."""

import numpy as np

from swift_sim_bridge.gap.inference.null_distribution import NullDistribution, with_effect

FLIGHTS = 24


def test_an_estimate_that_scatters_among_reference_flights_is_not_large_although_its_gain_is():
    nothing = np.zeros(1)
    known = NullDistribution(
        noise=np.ones(1),
        sigma=np.ones(1),
        spread=np.full(1, 0.1),
        largest=nothing,
        bias=nothing,
        information=np.full(1, 1e4),
        bias_gradient_by_channel=np.zeros((1, 1)),
        gains=np.ones((FLIGHTS, 1)),
        attenuation=nothing,
        slices={"damaged_propeller[2]": slice(0, 1)},
    )
    gain = 1e4 * 0.7**2
    assert gain > 100.0 * known.threshold("damaged_propeller[2]")
    assert not known.is_exceeded("damaged_propeller[2]", np.full(1, -0.7), 2.0)
    assert known.is_exceeded("damaged_propeller[2]", np.full(1, -1.1), 2.0)
    local = with_effect(known, "local_draught", 1, np.ones(FLIGHTS))  # it is searched for in another way
    assert local.is_exceeded("local_draught", np.full(1, 0.01), 2.0)
