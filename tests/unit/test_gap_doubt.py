"""Is a name worth more than an equation? On accounts whose truth is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from swift_sim_bridge.gap import doubt, unknown
from swift_sim_bridge.gap.doubt import Account
from swift_sim_bridge.gap.residuals import Channel

NOISE = np.random.default_rng(1).standard_normal((500, 1))
NAMED = Account(("body_drag",), {}, (), 500.0 + 31.0, 31.0, 3, [NOISE])
WAVE = 0.3 * np.sin(np.arange(500))[:, None]
NAMES = ("com_offset", "drag_center", "thrust_coefficient")


def test_a_name_is_open_where_an_equation_as_short_explains_as_much_and_says_something_else():
    other = replace(NAMED, keys=(), loss=498.0 + 63.0, cost=63.0, rest=[NOISE + WAVE])
    assert doubt._open(NAMED, other)
    assert not doubt._open(NAMED, replace(other, rest=[NOISE]))  # the same in other words
    assert not doubt._open(NAMED, replace(other, numbers=4))
    assert not doubt._open(NAMED, replace(other, loss=520.0 + 63.0))
    assert doubt._open(NAMED, replace(other, loss=520.0, numbers=4))  # whatever it says, it costs less


def test_a_name_gives_way_to_an_equation_that_costs_less_or_is_no_longer_and_explains_more():
    other = replace(NAMED, keys=(), loss=480.0 + 63.0, cost=63.0)
    assert other.loss > NAMED.loss and doubt._clearly(other, NAMED, 0.0)
    assert not doubt._clearly(other, NAMED, 10.0)  # of so much the simulator is not sure
    assert not doubt._clearly(replace(other, numbers=4), NAMED, 0.0)
    assert doubt._clearly(replace(other, numbers=4, loss=440.0 + 47.0, cost=47.0), NAMED, 0.0)


@pytest.mark.parametrize(("explains", "kept"), [(60.0, ()), (20.0, NAMES)])
def test_many_names_for_what_one_short_equation_explains_are_neighbours_of_a_cause_without_a_name(
        explains, kept, monkeypatch):  # fmt: skip
    def account(evidence, vehicle, keys, values, nothing):
        loss = 1e5 if 0 < len(keys) < len(NAMES) else 1000.0 if keys else 1000.0 - explains
        return Account(tuple(keys), {}, (), loss, 50.0, 9 if keys else 3, [NOISE])

    monkeypatch.setattr(doubt, "account", account)
    monkeypatch.setattr(doubt, "squares", lambda evidence, lines: 1e5)
    monkeypatch.setattr(doubt, "possible", lambda evidence, effect, values: True)
    monkeypatch.setattr(doubt.estimate, "residuals_at", lambda evidence, vehicle: [])
    evidence = SimpleNamespace(effects=[SimpleNamespace(key=key) for key in NAMES])
    assert doubt.best_account(evidence, None, list(NAMES), {}, lambda text: None).keys == kept


@pytest.mark.parametrize(("channel", "name", "kind"), [
    ("specific force y", "|v| v_y", "|v| v_*"), ("angular acceleration x", "modelled turn x", "modelled turn *"),
    ("specific force z", "v_xy^2", "v_xy^2"), ("specific force x", "v_y", "v_y"), ("rotor 1 speed", "Omega", "Omega"),
    ("angular acceleration z", "omega_x omega_z", "omega_x omega_*"),
])  # fmt: skip
def test_a_quantity_along_each_channels_own_axis_is_one(channel, name, kind):
    term = unknown.Term(Channel("force", channel, "m/s^2"), name, "", 1.0, 0.1, "", 0.0, 1.0, 90.0, 90.0)
    assert unknown.along_own(term) == kind
