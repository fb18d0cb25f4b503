"""What another effect may hide of an effect's size: intervals over all explanations; no flight is simulated."""

from dataclasses import replace

import numpy as np
import pytest
from linear_flight import problem_of
from scipy import stats

from swift_sim_bridge.effects import Effect, scalar_parameter
from swift_sim_bridge.gap.attribution.evidence import SelectedEffect
from swift_sim_bridge.gap.inference import stepwise
from swift_sim_bridge.gap.inference.marginal import Rival, mixture_quantile, rivals_beside

SECONDS = 10_000  # so many that Student's distribution is the normal one
SMALLEST = 0.1  # physical value of the drag
DRAG = Effect(
    id="drag",
    layer="force",
    parameters=(scalar_parameter("c", "1/s", "drag", step=0.1, low=SMALLEST),),
    equation="",
    sentence="",
    manoeuvre="",
    channels=(),
)
CHANGE = {"drag": np.array([2.0])}  # from the value of the file, 3


def interval(**more) -> list[float]:
    """Return the interval of a value of 5 with a standard error of 0.1, where the file has 3."""
    one = SelectedEffect(DRAG, np.array([5.0]), 0.01 * np.eye(1), 9.0, changes=CHANGE, **more)
    return one.interval95(SECONDS)[:, 0].tolist()


def test_without_another_explanation_the_interval_is_that_of_the_fit():
    assert interval() == pytest.approx([4.804, 5.196], abs=1e-3)


def test_of_a_strong_effect_the_interval_is_no_smaller_than_the_error_of_the_simulation():
    gain = (replace(DRAG.parameters[0], name=f"gain[{i}]", low=-1.0, unit="") for i in range(2))
    gains = replace(DRAG, id="gains", parameters=(*gain, replace(DRAG.parameters[0], name="lag", low=-1.0, unit="s")))
    change = np.array([2.0, 0.0, 0.0])  # one of two gains, and no lag
    one = SelectedEffect(gains, change, 1e-10 * np.eye(3), 900.0, changes={"gains": change})
    low, high = one.interval95(SECONDS)
    assert 0.5 * (high - low) == pytest.approx(1.96 * np.array([0.004, 0.004, 1e-5]), rel=0.01)


def test_where_another_effect_may_act_in_its_place_the_interval_reaches_the_value_of_the_file():
    assert interval(confounders={"drag": 0.6, "lift": 0.4}) == pytest.approx([3.0, 5.173], abs=1e-3)


def test_where_another_effect_is_by_far_likelier_the_interval_still_holds_the_value_that_is_reported():
    unlikely = {"drag": 1e-6, "lift": 1.0 - 1e-6}
    assert interval(confounders=unlikely) == pytest.approx([3.0, 5.0], abs=1e-3)


def test_after_another_fit_the_interval_reaches_the_same_value_of_the_file():
    one = SelectedEffect(DRAG, np.array([5.0]), 0.01 * np.eye(1), 9.0, {"drag": 0.6, "lift": 0.4}, CHANGE)
    low, high = one.fitted_again(np.array([4.0]), 0.01 * np.eye(1)).interval95(SECONDS)[:, 0]
    assert (low, high) == pytest.approx((3.0, 4.173), abs=1e-3)


def test_the_value_of_the_file_may_be_the_true_one_where_another_effect_explains_as_much():
    one = SelectedEffect(DRAG, np.array([5.0]), 0.01 * np.eye(1), 9.0, changes=CHANGE)
    assert one.excludes_file(SECONDS).tolist() == [True]
    beside = (Rival(0.2, np.array([-2.0]), np.array([0.2])),)
    assert replace(one, beside=beside).excludes_file(SECONDS).tolist() == [False]


@pytest.mark.parametrize(("weight", "low"), [(0.2, 3.793), (1e-3, 4.804)])
def test_a_likely_effect_beside_it_widens_the_interval_and_an_unlikely_one_does_not(weight, low):
    beside = (Rival(weight, np.array([-1.0]), np.array([0.2])),)
    assert interval(beside=beside)[0] == pytest.approx(low, abs=0.02)


def test_an_interval_ends_at_the_physical_bounds():
    low, high = interval(beside=(Rival(1.0, np.array([-4.0]), np.array([3.0])),))
    assert low == SMALLEST and high > 5.1


def test_quantiles_of_a_mixture_agree_with_drawn_numbers():
    rng, weights, means, errors = np.random.default_rng(1), [0.7, 0.2, 0.1], [0.0, 4.0, -3.0], [1.0, 0.5, 0.0]
    kind = rng.choice(3, 400_000, p=weights)
    drawn = rng.normal(np.take(means, kind), np.take(errors, kind))
    columns = np.array(means)[:, None], np.array(errors)[:, None]
    for share in (0.025, 0.5, 0.975):
        assert mixture_quantile(share, np.array(weights), *columns) == pytest.approx(
            np.quantile(drawn, share), abs=0.03
        )


def test_a_similar_effect_that_is_too_small_to_be_selected_is_allowed_for():
    """A drag of 0.5 acts with a similar one of 0.7, which is not selected beside it."""
    problem, steps = problem_of((0.5, 0.0, 0.0, 0.7, 0.0), similarity=0.85), np.ones(1)
    assert not stepwise.accepts(problem, ["drag"], "similar drag")[0]
    alone = stepwise.fit(problem.equations, problem.rows(["drag"]))
    (error,) = np.sqrt(np.diag(alone.covariance))
    assert alone.estimate[0] > 0.5 + stats.norm.ppf(0.975) * error
    rivals = rivals_beside(problem, ["drag"], "drag", (), steps)
    effect = SelectedEffect(DRAG, alone.estimate, alone.covariance, 9.0, beside=rivals)
    low, high = effect.interval95(SECONDS)[:, 0]
    assert low < 0.5 and high == pytest.approx(alone.estimate[0] + 1.64 * error, abs=0.02)
