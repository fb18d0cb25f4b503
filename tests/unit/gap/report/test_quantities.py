"""Numbers of the report: digits, prefixes, signs and symbols."""

import pytest

from swift_sim_bridge.gap.report import quantities


@pytest.mark.parametrize(
    "was, value, interval, unit, expected",
    [
        (0.033, 0.0403, [0.0398, 0.0408], "s", ("33.00", "40.30", "39.80 … 40.80", "ms")),
        (None, 1.9344e-6, [1.888e-6, 1.981e-6], "N", ("", "1.934e−6", "1.888e−6 … 1.981e−6", "N")),
        (0.0, -0.0285, [-0.0317, -0.0253], "rad", ("0", "−0.0285", "−0.0317 … −0.0253", "rad")),
        (0.87, 0.912, [0.905, 0.919], "kg", ("0.8700", "0.9120", "0.9050 … 0.9190", "kg")),
        (1.0, 1.3, [0.7, 1.9], "", ("1.00", "1.30", "0.70 … 1.90", "")),
        (2.0, 3.0, [3.0, 3.0], "", ("2.00", "3.00", "", "")),
    ],
)
def test_a_change_has_the_digits_that_its_interval_supports(was, value, interval, unit, expected):
    assert quantities.of_interval(was, value, interval, unit) == expected


def test_an_equation_has_greek_letters_indices_and_crosses():
    assert quantities.equation("f_m = f + omega' x r + omega x (omega x r)") == (
        "f<sub>m</sub> = f + ω′ × r + ω × (ω × r)"
    )
    assert quantities.html("F_i,xy = -k_d Omega_i v_i,xy") == (
        "F<sub>i,xy</sub> = −k<sub>d</sub> Ω<sub>i</sub> v<sub>i,xy</sub>"
    )
    assert quantities.html("the IMU's bias in m/s^2 < 1") == "the IMU's bias in m/s<sup>2</sup> &lt; 1"


def test_shares_are_percent():
    assert [quantities.share(value) for value in (0.0002, 0.043, 0.62)] == ["under 0.1 %", "4.3 %", "62 %"]
