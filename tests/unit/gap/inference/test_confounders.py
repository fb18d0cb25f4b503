"""Replacements and confounders among effects whose true parameters are known; no flight is simulated."""

from dataclasses import replace

import numpy as np
import pytest
from linear_flight import RATE, SECONDS, SLICES, flight, null_of, problem_of

from swift_sim_bridge.gap.inference.confounders import (
    better_replacement,
    find_confounders,
    is_large,
    simpler_replacement,
)
from swift_sim_bridge.gap.inference.normal_equations import accumulate
from swift_sim_bridge.gap.inference.stepwise import SelectionProblem, accepts


@pytest.mark.parametrize(("similarity", "confounders"), [(0.999, {"drag", "similar drag"}), (0.3, {"drag"})])
def test_effects_that_a_flight_cannot_distinguish_are_confounders(similarity, confounders):
    problem = problem_of((0.5, 0.0, 0.0, 0.0, 0.0), similarity=similarity)
    assert set(find_confounders(problem, ["drag"], "drag")) == confounders


def test_a_strong_effect_is_not_replaced_for_a_difference_within_the_simulators_error():
    strong = problem_of((30.0, 0.0, 0.0, 0.0, 0.0), similarity=0.98)
    lost = 1.0 - strong.gain(["similar drag"]) / strong.gain(["drag"])
    assert 1e-4 < lost < 1e-3 and lost * strong.gain(["drag"]) > 100.0
    assert better_replacement(strong, [], "similar drag") == (None, 0.0)
    assert better_replacement(problem_of((30.0, 0.0, 0.0, 0.0, 0.0), similarity=0.9), [], "similar drag")[0] == "drag"


@pytest.mark.parametrize(("bias", "confounders"), [(1.0, {"drag", "similar drag"}), (0.2, {"drag"})])
def test_a_difference_that_the_bias_of_the_pipeline_may_explain_distinguishes_no_two_effects(bias, confounders):
    parameters = (0.5, 0.0, 0.0, 0.0, 0.0)
    problem, line = problem_of(parameters, similarity=0.9), flight(100, parameters, similarity=0.9)
    unbiased = replace(problem, uncorrected=problem.equations)
    assert set(find_confounders(unbiased, ["drag"], "drag")) == {"drag"}
    difference = line.sensitivity[0] - line.sensitivity[3]
    uncorrected = accumulate(replace(line, residual=line.residual - bias * difference), problem.null_distribution.sigma)
    biased = replace(problem, uncorrected=uncorrected)
    assert set(find_confounders(biased, ["drag"], "drag")) == confounders


def test_unexplained_residuals_hide_the_difference_between_two_effects():
    parameters = (0.5, 0.0, 0.0, 0.0, 0.0)
    problem, line = problem_of(parameters, similarity=0.8), flight(100, parameters, similarity=0.8)
    assert set(find_confounders(problem, ["drag"], "drag")) == {"drag"}
    alternating = np.tile([2.0, -2.0], SECONDS // 2).repeat(RATE)[:, None]
    difference = line.sensitivity[0] - line.sensitivity[3]  # one effect explains more now, the other a second later
    disturbed = replace(line, residual=line.residual + alternating * difference)
    equations = accumulate(disturbed, problem.null_distribution.sigma)
    assert set(find_confounders(replace(problem, equations=equations), ["drag"], "drag")) == {"drag", "similar drag"}


def problem_with_sum(parameters, whole: int, parts: tuple[int, ...], seed: int = 100) -> SelectionProblem:
    """Return the problem of a flight in which one sensitivity is the sum of others."""

    def with_sum(seed, parameters=(0.0,) * 5):
        line = flight(seed, parameters, similarity=0.3)
        line.sensitivity[whole] = sum(line.sensitivity[part] for part in parts)
        return line

    null = null_of([with_sum(seed) for seed in range(24)])
    return SelectionProblem(accumulate(with_sum(seed, parameters), null.sigma), SLICES, null)


@pytest.mark.parametrize(("change", "confounders"), [(0.2, {"drag", "lift"}), (0.5, {"drag"})])
def test_the_number_of_parameters_does_not_decide_between_small_effects(change, confounders):
    """Drag is lift in one proportion, as the moment of a damaged propeller is that of one centre of mass."""
    problem = problem_with_sum((0.0, change, change, 0.0, 0.0), whole=0, parts=(1, 2))
    assert is_large(problem, [], "drag") and is_large(problem, [], "lift") == (change > 0.2)
    assert set(find_confounders(problem, ["drag"], "drag")) == confounders


def test_a_rival_of_a_significant_effect_need_not_be_significant_by_itself():
    """A second parameter makes the same moment less significant, not less likely."""
    problem = problem_with_sum((0.0, 0.1, 0.1, 0.0, 0.0), whole=0, parts=(1, 2))
    assert accepts(problem, [], "drag")[0] and not accepts(problem, [], "lift")[0]
    assert set(find_confounders(problem, ["drag"], "drag")) == {"drag", "lift"}


def test_of_small_effects_the_one_with_fewer_parameters_is_mostly_likelier_where_it_is_true():
    """The two parameters of lift explain as much as the drag that flies, and some noise."""
    planted = (0.2, 0.0, 0.0, 0.0, 0.0)
    found = [find_confounders(problem_with_sum(planted, 0, (1, 2), seed), ["drag"], "drag") for seed in range(100, 112)]
    assert sum(next(iter(weights)) == "drag" for weights in found) >= 9
    uneven = problem_with_sum((0.0, 0.24, 0.14, 0.0, 0.0), 0, (1, 2))
    assert next(iter(find_confounders(uneven, ["drag"], "drag"))) == "lift"


def test_a_parameter_that_an_effect_does_not_need_makes_it_no_less_likely_where_it_does_not_count():
    """Lift explains a large drag by one of its two parameters, as a pack does whose resistance alone is wrong."""
    problem = problem_with_sum((0.5, 0.0, 0.0, 0.0, 0.0), whole=1, parts=(0,))
    assert is_large(problem, [], "drag") and is_large(problem, [], "lift")
    assert set(find_confounders(problem, ["drag"], "drag")) == {"drag"}
    for key in ("drag", "lift"):
        assert set(find_confounders(problem, [key], key, all_count=False)) == {"drag", "lift"}


@pytest.mark.parametrize(("rest", "confounders"), [(0.2, {"lift", "idle"}), (0.6, {"lift"})])
def test_an_effect_beside_a_small_rest_of_a_vector_is_a_confounder_of_the_vector(rest, confounders):
    """Idle is the first of the two parameters of lift, as a flapping moment is a centre of mass along one axis."""
    problem = problem_with_sum((0.0, 3.0, rest, 0.0, 0.0), whole=4, parts=(1,))
    assert set(find_confounders(problem, ["lift"], "lift", is_vector=True)) == confounders
    assert set(find_confounders(problem, ["lift"], "lift")) == {"lift"}


def test_an_effect_that_was_selected_first_is_replaced_by_one_that_explains_more():
    problem = problem_of((0.0, 0.0, 0.0, 0.5, 0.0), similarity=0.8)
    assert better_replacement(problem, [], "drag")[0] == "similar drag"
    assert better_replacement(problem, [], "similar drag") == (None, 0.0)


@pytest.mark.parametrize(("lift", "expected"), [(0.5, (["drag", "lift"], "idle")), (0.8, ([], None))])
def test_one_effect_replaces_two_that_are_its_parts_in_its_own_proportion(lift, expected):
    """The last effect is the sum of drag and lift, in one proportion."""
    problem = problem_with_sum((0.5, lift, 0.0, 0.0, 0.0), whole=4, parts=(0, 1))
    assert simpler_replacement(problem, ["drag", "lift"], lambda others: set()) == expected
