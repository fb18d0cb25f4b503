"""The gap tool's choice among effects, on sums whose truth is known: no flight is needed to test the algebra."""

from dataclasses import replace

import numpy as np
import pytest

from swift_sim_bridge.gap.inference.normal_equations import accumulate, fit_gain
from swift_sim_bridge.gap.inference.null_distribution import population, scaled_to_recording
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.inference.stepwise import (
    SelectionProblem,
    backward,
    better,
    find_confounders,
    fit,
    forward,
    passes_cross_validation,
    restricted_to,
    simpler,
    step,
    told,
    without,
)

SECONDS, RATE = 20, 50
SLICES = {"drag": slice(0, 1), "lift": slice(1, 3), "twin of drag": slice(3, 4), "idle": slice(4, 5)}


def columns(rng, alike=1.0):
    """Footprints (5, m, 2) of the effects: the fourth is the first but for a share."""
    found = rng.standard_normal((5, SECONDS * RATE, 2))
    found[3] = alike * found[0] + (1.0 - alike) * found[3]
    found[4] = 0.0
    return found


def flight(seed, sizes=(0.0,) * 5, alike=1.0):
    """A recording's linearisation with effects of these sizes in unit noise: residual = noise - columns sizes."""
    rng = np.random.default_rng([seed, 7])
    x = columns(np.random.default_rng(3), alike)
    residual = rng.standard_normal(x.shape[1:]) - np.einsum("p,pmc->mc", np.array(sizes), x)
    return Linearisation(np.arange(SECONDS * RATE) / RATE, residual, x, np.ones(SECONDS * RATE, bool))


def scene(sizes, alike=1.0):
    nulls = population([flight(seed, confounders=alike) for seed in range(24)], SLICES)
    return SelectionProblem(accumulate(flight(100, sizes, alike), nulls.sigma), SLICES, nulls)


@pytest.mark.parametrize(("moving", "share"), [(1.0, 0.25), (0.5, 1.0), (3.0, 0.25)])
def test_of_a_flight_that_is_partly_refused_or_calmer_than_its_twins_only_larger_effects_can_be_told(moving, share):
    """A quarter of the samples, or half the motion, tells sizes half as well; more motion than the twins' does not
    count."""
    nulls, own = population([flight(seed, confounders=0.3) for seed in range(24)], SLICES), flight(50, confounders=0.3)
    told = np.isfinite(nulls.detectable)
    recorded = replace(own, sensitivity=moving * own.sensitivity)
    once = nulls.detectable[told] / scaled_to_recording(nulls, recorded, share).detectable[told]
    assert max(once) <= 1.0 and np.median(once) == pytest.approx(0.5, rel=0.05)


def test_nothing_is_taken_in_where_nothing_was_left_out():
    assert forward(scene((0.0,) * 5), []) == (None, 0.0)


def test_planted_effects_are_taken_in_one_after_the_other_and_then_no_more():
    there = scene((0.5, 0.4, 0.0, 0.0, 0.0), confounders=0.3)
    first, sigma = forward(there, [])
    second, _ = forward(there, [first])
    assert {first, second} == {"drag", "lift"} and sigma > 5
    assert forward(there, [first, second])[0] is None
    found = fit(there.sums, there.rows(["drag", "lift"]))
    assert found.sizes == pytest.approx([0.5, 0.4, 0.0], abs=4 * np.sqrt(np.diag(found.covariance)).max())


def test_an_effect_that_others_make_superfluous_is_dropped_again():
    there = scene((0.5, 0.0, 0.0, 0.0, 0.0), confounders=0.3)
    assert backward(there, ["twin of drag", "drag"]) == ["drag"]


def test_effects_that_a_flight_cannot_tell_apart_are_named_together():
    assert set(find_confounders(scene((0.5, 0.0, 0.0, 0.0, 0.0), confounders=0.999), ["drag"], "drag")) == {
        "drag",
        "twin of drag",
    }
    assert set(find_confounders(scene((0.5, 0.0, 0.0, 0.0, 0.0), confounders=0.3), ["drag"], "drag")) == {"drag"}


def test_a_strong_effect_does_not_give_its_place_for_what_may_be_the_simulators_own_error():
    strong = scene((30.0, 0.0, 0.0, 0.0, 0.0), confounders=0.98)
    lost = 1.0 - strong.gain(["twin of drag"]) / strong.gain(["drag"])
    assert 1e-4 < lost < 1e-3 and lost * strong.gain(["drag"]) > 100.0
    assert better(strong, [], "twin of drag") == (None, 0.0)
    assert better(scene((30.0, 0.0, 0.0, 0.0, 0.0), confounders=0.9), [], "twin of drag")[0] == "drag"


def test_what_the_pipeline_itself_makes_of_the_difference_tells_no_two_effects_apart():
    sizes = (0.5, 0.0, 0.0, 0.0, 0.0)
    there, line = scene(sizes, confounders=0.9), flight(100, sizes, confounders=0.9)
    assert set(find_confounders(replace(there, whole=there.sums), ["drag"], "drag")) == {"drag"}
    apart = line.sensitivity[0] - line.sensitivity[3]
    whole = accumulate(replace(line, residual=line.residual - 0.5 * apart), there.null_distribution.sigma)
    assert set(find_confounders(replace(there, whole=whole), ["drag"], "drag")) == {"drag", "twin of drag"}


def test_what_the_flight_leaves_unexplained_hides_the_difference_between_two_effects():
    there, twin = (
        scene((0.5, 0.0, 0.0, 0.0, 0.0), confounders=0.8),
        flight(100, (0.5, 0.0, 0.0, 0.0, 0.0), confounders=0.8),
    )
    assert set(find_confounders(there, ["drag"], "drag")) == {"drag"}
    wandering = np.tile([2.0, -2.0], SECONDS // 2).repeat(RATE)[:, None]
    apart = twin.sensitivity[0] - twin.sensitivity[3]  # now one explains more, a second later the other
    rough = accumulate(replace(twin, residual=twin.residual + wandering * apart), there.null_distribution.sigma)
    assert set(find_confounders(replace(there, sums=rough), ["drag"], "drag")) == {"drag", "twin of drag"}


def test_what_came_first_gives_its_place_to_what_explains_more():
    there = scene((0.0, 0.0, 0.0, 0.5, 0.0), confounders=0.8)
    assert better(there, [], "drag")[0] == "twin of drag"
    assert better(there, [], "twin of drag") == (None, 0.0)


@pytest.mark.parametrize(("lift", "told"), [(0.5, (["drag", "lift"], "idle")), (0.8, ([], None))])
def test_one_effect_takes_the_place_of_two_that_are_its_parts_and_no_more(lift, told):
    """The last effect does what drag and lift do together, in one proportion."""

    def joined(seed, sizes=(0.0,) * 5):
        line = flight(seed, sizes, confounders=0.3)
        line.sensitivity[4] = line.sensitivity[0] + line.sensitivity[1]
        return line

    nulls = population([joined(seed) for seed in range(24)], SLICES)
    there = SelectionProblem(accumulate(joined(100, (0.5, lift, 0.0, 0.0, 0.0)), nulls.sigma), SLICES, nulls)
    assert simpler(there, ["drag", "lift"], lambda others: set()) == told


def test_a_size_that_cannot_be_true_is_not_taken_in_but_one_at_the_bound_is():
    there = scene((0.5, 0.4, 0.0, 0.0, 0.0), confounders=0.3)
    low, high = np.full(5, -5.0), np.full(5, 5.0)
    assert forward(replace(there, low=low, high=high), [])[0] == forward(there, [])[0]
    assert forward(replace(there, low=low, high=np.array([0.5, 0.4, 0.0, 5.0, 5.0])), ["drag"])[0] == "lift"
    assert forward(replace(there, low=low, high=np.array([0.5, 0.2, 0.0, 5.0, 5.0])), ["drag"])[0] != "lift"


def test_a_parameter_that_nothing_shows_has_no_size():
    there = scene((0.5, 0.4, 0.0, 0.0, 0.0), confounders=0.3)
    wide, narrow = np.full(5, 9.0), np.array([9.0, 9.0, 0.01, 9.0, np.inf])
    assert list(told(there.sums, -wide, wide)) == [True, True, True, True, False]
    kept = told(there.sums, -narrow, narrow)
    assert list(kept) == [True, True, False, True, True]  # of what has no bounds nobody knows
    size = fit(restricted_to(there.sums, kept), there.rows(["lift"])).sizes
    assert size[1] == 0.0 and size[0] == pytest.approx(fit(there.sums, np.array([1])).sizes[0])


def test_what_is_taken_out_again_leaves_what_would_be_there_without_it():
    nulls = population([flight(seed, confounders=0.3) for seed in range(24)], SLICES)
    with_it, unplanted = (accumulate(flight(5, sizes, 0.3), nulls.sigma) for sizes in ((0.7, 0, 0, 0, 0), (0.0,) * 5))
    shifted = without(unplanted, np.array([0]), np.array([0.7]))
    for one, other in zip(vars(with_it).values(), vars(shifted).values(), strict=True):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-9)


def test_the_smallest_size_that_can_be_told_is_the_noise_that_twins_show():
    nulls = population([flight(seed, confounders=0.3) for seed in range(24)], SLICES)
    expected = 5.0 / np.sqrt(2 * SECONDS * RATE)
    assert nulls.detectable[0] == pytest.approx(expected, rel=0.5)
    assert nulls.detectable[4] == np.inf


def test_a_footprint_that_is_mostly_noise_tells_less_than_it_seems():
    """As of a time offset in a hover: three quarters of the square of each footprint is the noise of a pose."""

    def shaken(seed, size=0.0):
        line, rng = flight(seed, (size, 0.0, 0.0, 0.0, 0.0), confounders=0.3), np.random.default_rng([seed, 8])
        return replace(line, sensitivity=line.sensitivity + np.sqrt(3.0) * rng.standard_normal(line.sensitivity.shape))

    nulls = population([shaken(seed) for seed in range(24)], SLICES, quiet=flight(0, confounders=0.3))
    seeming = replace(nulls, attenuation=np.zeros(5)).detectable[0]
    assert nulls.detectable[0] == pytest.approx(4.0 * seeming, rel=0.1)
    gains = [fit_gain(accumulate(shaken(100, times * seeming), nulls.sigma), SLICES["drag"]) for times in (1.5, 6.0)]
    assert gains[0] < nulls.threshold("drag") < gains[1]


def test_what_the_pipeline_itself_makes_of_noise_is_no_effect():
    there = scene((0.5, 0.0, 0.0, 0.0, 0.0), confounders=0.3)
    made = 0.8 * there.sums.products.mean(axis=0)
    whole = replace(there.sums, products=there.sums.products - made)
    assert forward(there, [])[0] == "drag"
    assert forward(replace(there, whole=whole), [])[0] is None


def test_what_stops_at_its_bound_leaves_the_rest_to_its_neighbour():
    there = scene(
        (-0.4, 0.0, 0.0, 0.5, 0.0), confounders=0.5
    )  # no drag pushes: the neighbour alone must answer for both
    low, high = np.array([0.0, -9.0]), np.array([9.0, 9.0])
    sums, rows = there.sums, there.rows(["drag", "twin of drag"])
    two = replace(sums, products=sums.products[:, rows], matrix=sums.matrix[:, rows][:, :, rows])
    alone = fit(sums, there.rows(["twin of drag"])).sizes
    assert fit(sums, rows).sizes[0] < -0.05 and step(two, 0.0, -high, high)[0] < -0.05
    assert step(two, 0.0, low, high) == pytest.approx([0.0, *alone])


def test_damping_shortens_a_step_most_where_a_flight_tells_least():
    there = scene((0.5, 0.0, 0.0, 0.5, 0.0), confounders=0.99)
    rows, far = there.rows(["drag", "twin of drag"]), np.full(2, 1e9)
    two = replace(there.sums, products=there.sums.products[:, rows], matrix=there.sums.matrix[:, rows][:, :, rows])
    full, damped = step(two, 0.0, -far, far), step(two, 0.01, -far, far)
    assert damped.sum() == pytest.approx(full.sum(), rel=0.05)  # their sum is well known
    assert abs(damped[0] - damped[1]) < 0.5 * abs(full[0] - full[1])


@pytest.mark.parametrize("passes", [1, 2])
def test_what_acts_at_one_place_is_believed_once_the_flight_has_passed_it_twice(passes):
    line = flight(100)
    here = np.any([(line.t > begin) & (line.t < begin + 2.0) for begin in (5.0, 15.0)[:passes]], axis=0)
    x = line.sensitivity.copy()
    x[0, ~here] = 0.0
    residual = np.random.default_rng(5).standard_normal(line.residual.shape) - 0.5 * x[0]
    nulls = population([replace(flight(seed), sensitivity=x) for seed in range(24)], SLICES)
    there = SelectionProblem(accumulate(replace(line, residual=residual, sensitivity=x), nulls.sigma), SLICES, nulls)
    assert there.gain(["drag"]) > nulls.threshold("drag")
    assert passes_cross_validation(there, [], "drag") == (passes == 2)
