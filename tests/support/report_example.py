"""An example of a gap report with one finding."""

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.report import effect_help

ROLLOUT = {"before": 0.21, "after": 0.01, "knn": 0.08, "gp": 0.07}
FINDING = {
    "verdict": "ambiguous",
    "effect": "rotor_drag",
    "variant": "",
    "layer": "force",
    "channels": ["specific force x"],
    "where": {"time": [[0.0, 20.0]], "segments": [], "regime": ""},
    "significance_sigma": 21.0,
    "parameters": {"k_d": {"value": 6e-5, "unit": "N/(rad/s m/s)", "interval95": [5.9e-5, 6.1e-5]}},
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
    "improvement": {
        "held_out": {
            "one_step_rmse": {"before": 1.3, "after": 0.4},
            "one_step_rmse_by_channel": {
                "rotor 1 speed": {"before": 40.0, "after": 39.0, "unit": "rad/s"},
                "voltage": {"before": 0.31, "after": 0.02, "unit": "V"},
            },
            "rollout_rmse_m": {
                horizon: {name: share * value for name, value in ROLLOUT.items()}
                for horizon, share in (("0.1", 0.1), ("0.5", 1.0), ("1.0", 3.0))
            },
        },
        "left": {"verdict": "tentative", "findings": [{**FINDING, "effect": "mass", "verdict": "tentative"}]},
    },
    "minimum_detectable": {"mass": {"mass": 0.004}},
    "not_testable": {"wind": "nothing <to> blow at"},
    "rejected_data": [{"recording": "flight.csv", "time": [3.0, 3.5], "channel": "gyro", "reason": "stood still"}],
}
PARAMETERS = effect_help.parameters(load(Vehicle, configuration_folder() / "drone.yaml"))
