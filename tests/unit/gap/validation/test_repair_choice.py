"""The equation of a repair: of summands that resemble each other, one stays."""

from types import SimpleNamespace

from swift_sim_bridge.gap.attribution.evidence import SearchResult
from swift_sim_bridge.gap.validation import repair_choice

SHARES = {"force_z: v_xy^2": 0.29, "force_z: thrust v_xy^2": 0.11, "moment_y: v_x": 0.44}


class OfTwinSummands(repair_choice._Judge):
    """Judges summands of which the first two resemble each other: their coefficients differ while both are there."""

    def disagreeing(self, trial, share):
        twins = {name for name in (one.name for one in trial.found) if name.startswith("force_z")}
        return twins if len(twins) > 1 else set()

    def _without(self, trial, item):
        return trial_of([one for one in trial.found if one.name != item])


def trial_of(found) -> repair_choice._Trial:
    effect = SimpleNamespace(key="equation_of_force", id="equation_of_force")
    return repair_choice._Trial((), (effect,), tuple(found), {effect.key: [1.0] * len(found)}, 0.0)


def test_of_two_summands_that_are_unstable_together_the_one_that_removes_more_stays(monkeypatch):
    def fit(evidence, vehicle, effects, values):
        return values, dict.fromkeys(values)

    monkeypatch.setattr(repair_choice, "gauss_newton_fit", fit)
    monkeypatch.setattr(repair_choice, "with_effects", lambda vehicle, effects, values: vehicle)
    found = [SimpleNamespace(name=name, removed_share=share) for name, share in SHARES.items()]
    chosen = OfTwinSummands(None, None, SearchResult()).on_whole_flights(trial_of(found), (), ())
    assert chosen.shares == {"force_z: v_xy^2": 0.29, "moment_y: v_x": 0.44}
