"""What a pack that was used before the first row explains of an effect, where no voltage was measured."""

import numpy as np
import pytest

from swift_sim_bridge.gap.attribution.used_pack import is_of_used_pack
from swift_sim_bridge.gap.inference.marginal import Rival

COVARIANCE = np.diag([0.1, 1.0]) ** 2  # of a mass, g, and a position, mm


def used(*shift):
    """Return the explanation in which a pack was used for the whole time before the first row."""
    return (Rival(1.0, np.array(shift), np.sqrt(np.diag(COVARIANCE))[: len(shift)]),)


@pytest.mark.parametrize(
    ("mass", "explained"),
    [(2.0, True), (5.0, True), (5.2, True), (6.0, False), (-2.0, False), (50.0, False)],
    ids=["partly used", "used", "within the error", "too large", "opposite", "far too large"],
)
def test_a_used_pack_explains_more_mass_up_to_what_its_charge_gives(mass, explained):
    """A pack that was used for the whole time takes 5 g off the mass."""
    assert is_of_used_pack(np.array([mass]), COVARIANCE[:1, :1], used(-5.0)) is explained


def test_a_used_pack_does_not_explain_where_a_load_hangs():
    assert is_of_used_pack(np.array([4.0, 2.0]), COVARIANCE, used(-5.0, 0.0))
    assert not is_of_used_pack(np.array([4.0, 20.0]), COVARIANCE, used(-5.0, 0.0))


def test_nothing_is_explained_where_the_voltage_was_measured_or_a_pack_changes_nothing():
    assert not is_of_used_pack(np.array([2.0]), COVARIANCE[:1, :1], ())
    assert not is_of_used_pack(np.array([2.0]), COVARIANCE[:1, :1], used(0.0))
