"""The self-test of the gap tool accepts correct reports and no others."""

import numpy as np
import pytest

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap import self_test
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.effects.injection import file_values

SHIPPED = load(Vehicle, configuration_folder() / "drone.yaml")
DAMAGED = next(one for one in catalogue(SHIPPED) if one.key == "damaged_propeller[2]")


def result(verdict="confirmed", variant="2", factor=1.0, half_interval=0.02, *others) -> self_test.Case:
    """Return the result of a report with a damaged propeller, its change wrong by a factor."""
    before = file_values(DAMAGED, SHIPPED)
    planted = before + [10.0 * parameter.step for parameter in DAMAGED.parameters]
    change = np.abs(planted - before)
    parameters = {
        parameter.name: {"value": at, "interval95": [at - half_interval * size, at + half_interval * size]}
        for parameter, at, size in zip(DAMAGED.parameters, before + factor * (planted - before), change, strict=True)
    }
    findings = [{"effect": DAMAGED.id, "variant": variant, "verdict": verdict, "parameters": parameters}, *others]
    return self_test.judge({"verdict": verdict, "findings": findings}, DAMAGED, planted, before)


def test_the_right_effect_with_the_right_value_passes():
    assert result().good and result("tentative", factor=1.05).good and result(factor=1.12, half_interval=0.1).good


@pytest.mark.parametrize(
    "wrong, note",
    [
        (result("ambiguous"), "reported damaged_propeller"),
        (result(variant="0"), "reported damaged_propeller"),
        (result(factor=1.5), "more than its interval allows"),
        (result(factor=1.5, half_interval=0.5), "the interval is too wide"),
        (
            result("confirmed", "2", 1.0, 0.02, {"effect": None, "variant": "", "verdict": "unknown"}),
            "also unknown physics",
        ),
    ],
)
def test_another_propeller_an_ambiguous_effect_a_wrong_value_or_a_further_finding_fails(wrong, note):
    assert not wrong.good and note in wrong.note
