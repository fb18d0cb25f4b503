"""An example of a gap report with one finding, with the residuals and rollouts that its figures show."""

import numpy as np

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.report import effect_help
from swift_sim_bridge.gap.residuals.channels import Channel, vector
from swift_sim_bridge.gap.residuals.rollout import Trajectories
from swift_sim_bridge.gap.validation.black_boxes import MODELS
from swift_sim_bridge.gap.validation.holdout import HoldoutResult
from swift_sim_bridge.gap.validation.mismatch import Mismatch

CHANNELS = (
    Channel("motor", "rotor_speed", "1", "rotor 1 speed", "rad/s"),
    Channel("motor", "voltage", "", "voltage", "V"),
    *vector("force", "specific_force", "specific force", "m/s^2"),
    *vector("imu", "gyro", "gyro vs pose,", "rad/s"),
)
ROLLOUT = {"before": 0.21, "after": 0.01, "with_remainder": 0.009, "knn": 0.08, "gp": 0.07}
FORCES = {"before": 1.3, "after": 0.41, "with_remainder": 0.32, "knn": 0.62, "gp": 0.53}
FINDING = {
    "verdict": "ambiguous",
    "effect": "rotor_drag",
    "variant": "",
    "layer": "force",
    "channels": ["specific_force_x"],
    "where": {"time": [[0.0, 20.0]], "segments": [], "regime": ""},
    "significance_sigma": 21.0,
    "parameters": {
        "k_d": {
            "value": 6e-5,
            "unit": "N/(rad/s m/s)",
            "interval95": [5.9e-5, 6.1e-5],
            "was": 4e-5,
            "key": "terms.rotor_drag.k_d",
        }
    },
    "removes": 0.2,
    "most_improved": {"channel": "specific_force_x", "without": 0.62, "with": 0.31},
    "caution": "",
    "equation": "F_i,xy = -k_d Omega_i v_i,xy",
    "sentence": "The rotors drag.",
    "alternatives": [
        {"effect": "rotor_drag", "variant": "", "weight": 0.7},
        {"effect": "damaged_propeller", "variant": "2", "weight": 0.3},
    ],
    "separating_manoeuvre": "one speed at two thrusts",
    "manoeuvre": None,
}
REPORT = {
    "verdict": "ambiguous",
    "findings": [FINDING],
    "flights": [[0.0, 20.0]],
    "channels": {channel.id: channel.as_json() for channel in CHANNELS},
    "improvement": {
        "held_out": {
            "one_step_rmse": {"before": 1.3, "after": 0.4},
            "one_step_rmse_by_channel": {
                "rotor_speed_1": {"before": 40.0, "after": 39.0},
                "voltage": {"before": 0.31, "after": 0.02},
            },
            "rollout_rmse_m": {
                horizon: {name: share * value for name, value in ROLLOUT.items()}
                for horizon, share in (("0.1", 0.1), ("0.5", 1.0), ("1.0", 3.0))
            },
        },
        "left": {"verdict": "tentative", "findings": [{**FINDING, "effect": "mass", "verdict": "tentative"}]},
    },
    "unseen_flights": [
        {
            "recording": "later flight.csv",
            "one_step_rmse": FORCES,
            "one_step_rmse_by_axis": dict.fromkeys("xyz", FORCES),
            "one_step_rmse_with_level_by_axis": dict.fromkeys("xyz", FORCES),
            "one_step_rmse_by_channel": {"voltage": {"before": 0.29, "after": 0.03}},
        }
    ],
    "minimum_detectable": {"mass": {"mass": 0.004}},
    "not_testable": {"wind": "nothing <to> blow at"},
    "rejected_data": [{"recording": "flight.csv", "time": [3.0, 3.5], "channel": "gyro", "reason": "stood still"}],
}
PARAMETERS = effect_help.parameters(load(Vehicle, configuration_folder() / "drone.yaml"))

T = np.arange(0.0, 20.0, 0.02)
DRAWN_CHANNELS = (
    Channel("motor", "rotor_speed", "1", "rotor 1 speed", "rad/s"),
    Channel("motor", "voltage", "", "voltage", "V"),
    Channel("force", "specific_force", "x", "specific force x", "m/s^2"),
    Channel("imu", "gyro", "x", "gyro vs pose, x", "rad/s"),
)
NOISE = np.array([5.0, 0.02, 0.3, 0.02])
TIMES = 12.0  # the noise, by which the force is off in the middle of the flight


def mismatch(repaired: bool = True, p_world: bool = True) -> Mismatch:
    """A flight round a circle whose force is off from 8 s to 12 s, and whose motion capture paused at 3 s."""
    rng = np.random.default_rng(4)
    after, before = (NOISE * rng.standard_normal((len(T), len(DRAWN_CHANNELS))) for _ in range(2))
    before[(T > 8.0) & (T < 12.0), 2] += TIMES * NOISE[2]
    for residual in (before, after):
        residual[(T > 3.0) & (T < 3.4)] = np.nan
    path = np.stack([np.cos(T), np.sin(T), 1.0 + 0.0 * T], axis=1) if p_world else None
    return Mismatch("flight.csv", T, path, DRAWN_CHANNELS, NOISE, before, after if repaired else None)


def holdout() -> HoldoutResult:
    """Eight rollouts straight ahead, each model off by its share."""
    steps = np.linspace(0.0, 1.0, 11)[:, None, None] * np.ones((8, 3)) + np.arange(8)[:, None]
    flown = np.stack([steps * (1.0 + ROLLOUT[name]) for name in MODELS])
    return HoldoutResult(REPORT["improvement"]["held_out"], (Trajectories(np.stack([steps] * len(MODELS)), flown),))


def term(channel: str, quantity: str, value: float, unit: str, removes: float) -> dict:
    """The entry of a term of an equation, with an error of a tenth."""
    return {
        f"{channel}: {quantity}": {
            "value": value,
            "unit": unit,
            "interval95": [0.9 * value, 1.1 * value],
            "channel": channel,
            "quantity": quantity,
            "removes": removes,
        }
    }


def equation(*terms: dict) -> dict:
    """A finding without a name, with these terms."""
    parameters = {key: entry for one in terms for key, entry in one.items()}
    channels = list(dict.fromkeys(entry["channel"] for entry in parameters.values()))
    return FINDING | {
        "verdict": "unknown",
        "effect": None,
        "parameters": parameters,
        "channels": channels,
        "alternatives": [],
    }
