"""Answers, reports and a flight at rest for the tests of the referee."""

import numpy as np

from swift_sim_bridge.referee.simulator.flight import LOOP_S, PASSES, Truth
from swift_sim_bridge.referee.simulator.plant import GRAVITY


def hanging(count: int) -> Truth:
    """Return `count` samples of a vehicle that hangs in the air."""
    t, zeros = np.arange(count) * LOOP_S, np.zeros((count, 3))
    shake = 0.01 * np.random.default_rng(0).standard_normal((count, 3))
    four = np.hstack([shake, shake])[:, :4]
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    numbers = {
        "p": zeros + shake,
        "q": upright,
        "v": shake,
        "w": shake,
        "rotor_speed": 1000.0 + four,
        "charge": t,
        "rc": 0 * t,
        "memory": zeros[:, :0],
        "specific_force": shake + [0, 0, GRAVITY],
        "angular_acceleration": zeros,
        "voltage": 16.0 - 0.01 * t,
        "current": 15.0 + 0.01 * t,
        "u": 0.3 + 0.01 * four,
        "gyro": shake,
    }
    return Truth(t=t, t_command=t[::PASSES], rates=shake[::PASSES], thrust=10.0 + shake[::PASSES, 0], **numbers)


def finding(effect, verdict="confirmed", layer="force", parameters=None, alternatives=(), manoeuvre=None):
    """Return a finding; manoeuvre: {"id", "seconds"} or None."""
    others = [{"effect": other, "weight": 0.5} for other in alternatives]
    return {
        "verdict": verdict,
        "effect": effect,
        "layer": layer,
        "significance_sigma": 9.0,
        "alternatives": others,
        "parameters": parameters or {},
        "manoeuvre": manoeuvre,
    }


def equation(*terms, layer="force"):
    """Return a finding of an equation with terms "channel: quantity"."""
    parameters = {}
    for term in terms:
        channel, quantity = term.split(": ")
        parameters[term] = {"value": 1.0, "interval95": [0.9, 1.1], "channel": channel, "quantity": quantity}
    return finding(None, "unknown", layer, parameters)


def report(*findings):
    """Return a report with these findings."""
    verdict = findings[0]["verdict"] if findings else "nothing_left_out"
    return {"verdict": verdict, "findings": list(findings), "minimum_detectable": {}}


def answer(*effects, family="single", multiple=4.0, removed=(), parameters=None):
    """Return the sealed answer of a case with these hidden effects."""
    hidden = [
        {
            "effect": name,
            "size": 1.0,
            "multiple": multiple,
            "nominal": {},
            "parameters": parameters or {f"terms.{name}.c[0]": 1.0, f"terms.{name}.c[1]": 0.5},
        }
        for name in effects
    ]
    return {"family": family, "hidden": hidden, "removed": list(removed), "lacking": ""}
