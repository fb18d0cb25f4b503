"""An example of a gap report with one finding."""

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.report import effect_help
from swift_sim_bridge.gap.residuals.channels import Channel, vector

CHANNELS = (
    Channel("motor", "rotor_speed", "1", "rotor 1 speed", "rad/s"),
    Channel("motor", "voltage", "", "voltage", "V"),
    *vector("force", "specific_force", "specific force", "m/s^2"),
    *vector("imu", "gyro", "gyro vs pose,", "rad/s"),
)
ROLLOUT = {"before": 0.21, "after": 0.01, "knn": 0.08, "gp": 0.07}
FINDING = {
    "verdict": "ambiguous",
    "effect": "rotor_drag",
    "variant": "",
    "layer": "force",
    "channels": ["specific_force_x"],
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
    "minimum_detectable": {"mass": {"mass": 0.004}},
    "not_testable": {"wind": "nothing <to> blow at"},
    "rejected_data": [{"recording": "flight.csv", "time": [3.0, 3.5], "channel": "gyro", "reason": "stood still"}],
}
PARAMETERS = effect_help.parameters(load(Vehicle, configuration_folder() / "drone.yaml"))
