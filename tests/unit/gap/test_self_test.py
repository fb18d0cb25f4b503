"""The self-test of the gap tool accepts what is right, and nothing else."""

import numpy as np
import pytest

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap import self_test
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.effects.injection import file_values

SHIPPED = load(Vehicle, configuration_folder() / "drone.yaml")
DAMAGED = next(one for one in catalogue(SHIPPED) if one.key == "damaged_propeller[2]")


def found(verdict="confirmed", variant="2", by=1.0, doubt=0.02, *others) -> self_test.Case:
    """Return the judgement of a report that names a planted damaged propeller, off by a factor and with an interval."""
    before = file_values(DAMAGED, SHIPPED)
    planted = before + [10.0 * parameter.step for parameter in DAMAGED.parameters]
    moved = np.abs(planted - before)
    parameters = {
        parameter.name: {"value": at, "interval95": [at - doubt * wide, at + doubt * wide]}
        for parameter, at, wide in zip(DAMAGED.parameters, before + by * (planted - before), moved, strict=True)
    }
    findings = [{"effect": DAMAGED.id, "variant": variant, "verdict": verdict, "parameters": parameters}, *others]
    return self_test.judged({"verdict": verdict, "findings": findings}, DAMAGED, planted, before)


def test_the_right_name_with_the_right_size_is_understood():
    assert found().good and found("tentative", by=1.05).good and found(by=1.12, doubt=0.1).good


@pytest.mark.parametrize(
    "wrong, note",
    [
        (found("ambiguous"), "called damaged_propeller"),
        (found(variant="0"), "called damaged_propeller"),
        (found(by=1.5), "more than its interval allows"),
        (found(by=1.5, doubt=0.5), "hardly told"),
        (
            found("confirmed", "2", 1.0, 0.02, {"effect": None, "variant": "", "verdict": "unknown"}),
            "also unknown physics",
        ),
    ],
)
def test_another_propeller_a_guess_a_wrong_size_or_more_beside_it_is_not(wrong, note):
    assert not wrong.good and note in wrong.note
