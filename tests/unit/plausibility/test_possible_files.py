"""Files that cannot describe what flies are refused by a sentence each; odd but possible ones are used.

A case is a change of a shipped file: keys joined by dots, and the new value.
"""

import functools

import numpy as np
import pytest
import yaml
from changed_files import CONFIG, LEVEL, changed, gates, rotors
from dotted_keys import set_value

from swift_ros import cli, configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.plausibility import of_propulsion
from swift_ros.plausibility.finding import ODD
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.rate_loop import mixer

KINDS = {"drone": Vehicle, "track": Track, "camera": Camera}
ROTORS = [[-0.0775, -0.1, -1], [0.0775, -0.1, 1], [-0.0775, 0.1, 1], [0.0775, 0.1, -1]]
IMPOSSIBLE = [
    ("drone", {"inertia": [2.9e-3, 2.4e-3, 9.0e-3]}, "belongs to no body"),
    ("drone", {"inertia": [1.0e-2, 2.4e-3, 5.0e-3]}, "belongs to no body"),
    ("drone", {"inertia": [[3e-3, 1e-3, 0], [0, 3e-3, 0], [0, 0, 5e-3]]}, "not symmetric"),
    ("drone", {"inertia": [2.9e-3, -2.4e-3, 4.9e-3]}, "positive"),
    ("drone", {"inertia": [0.0, 0.0, 0.0]}, "positive"),
    ("drone", {"mass": 870.0}, "'mass' is 870 kg, and its rotors lift 3.57 kg, .*; if 'mass' is in g, it is 0.87 kg;"),
    ("drone", {"thrust_coefficient": 1.224e-8}, "if 'thrust_coefficient' is in N/RPM.2, it is 1.116e-06 N"),
    ("drone", {"mass": -0.87}, "positive"),
    ("drone", {"mass": 0.0}, "positive"),
    ("drone", {"mass": 3.6}, "cannot hover"),
    ("drone", {"rotors": rotors(*([x, y, 1] for x, y, _ in ROTORS))}, "all rotors turn in one direction"),
    ("drone", {"rotors": rotors(*([x, y, -s] for x, y, s in ROTORS))}, "against the firmware's yaw"),
    ("drone", {"controller.yaw_motors_reversed": True}, "against the firmware's yaw"),
    (
        "drone",
        {"rotors": rotors(*([x, y, 1 if y > 0 else -1] for x, y, _ in ROTORS))},
        "one diagonal do not turn alike, .* the spins -1, 1, 1, -1 in their order",
    ),
    (
        "drone",
        {"rotors": rotors(*([x, y, 1 if x > 0 else -1] for x, y, _ in ROTORS)), "controller.yaw_motors_reversed": True},
        "one diagonal do not turn alike, .* the spins 1, -1, -1, 1 in their order",
    ),
    (
        "drone",
        {"rotors": [{"position": [x, y, 20.0], "spin": s} for x, y, s in ROTORS]},
        "a hub is 20 m above or below",
    ),
    ("drone", {"terms.rotor_gyroscopic.inertia": 8.0e-3}, "is that of 2 kg at the tips of each propeller"),
    ("drone", {"terms.rotor_gyroscopic.inertia": 9.0e-4}, "at the tips of each propeller, and the vehicle of 0.87 kg"),
    ("drone", {"motor.time_constant_down": 3.3e-5}, "motors need 0.02 to 0.1 s"),
    ("drone", {"sensors.accel_m_s2": 70.0}, "a sensor with more than 50 measures nothing"),
    ("drone", {"rotors": rotors(ROTORS[1], ROTORS[0], ROTORS[2], ROTORS[3])}, "listed as front right, rear right"),
    ("drone", {"rotors": rotors(ROTORS[3], ROTORS[1], ROTORS[2], ROTORS[0])}, "would tumble"),
    ("drone", {"rotors": rotors(*([-x, y, s] for x, y, s in ROTORS))}, "would tumble"),
    ("drone", {"rotors": rotors(*([x, -y, s] for x, y, s in ROTORS))}, "would tumble"),
    ("drone", {"rotors": rotors(ROTORS[0], ROTORS[0], ROTORS[2], ROTORS[3])}, "at one place"),
    ("drone", {"rotors": rotors(*ROTORS[:3])}, "3 rotors cannot control"),
    ("drone", {"rotors": rotors(*([x + 0.3, y, s] for x, y, s in ROTORS))}, "in front of the centre of mass"),
    (
        "drone",
        {"rotors": rotors(*([x - 0.1, y + 0.12, s] for x, y, s in ROTORS))},
        "all rotors are behind and to the left of the centre of mass",
    ),
    ("drone", {"rotors": rotors(*([x + 0.077, y, s] for x, y, s in ROTORS))}, "hold this vehicle level"),
    ("drone", {"rotors": rotors(*([1e3 * x, 1e3 * y, s] for x, y, s in ROTORS))}, "'position' in m"),
    ("drone", {"mass": 0.01, "inertia": [5e-5, 5e-5, 8e-5]}, "times the weight, of the best racers 15"),
    ("drone", {"inertia": [29000.0, 24400.0, 49900.0]}, "radii of gyration of .* give 'inertia' in kg m"),
    ("drone", {"inertia": [2.9e-6, 2.44e-6, 4.99e-6]}, "radii of gyration"),
    (
        "drone",
        {"torque_coefficient": 3.0e-9},
        "'torque_coefficient' 3e-09 is too small, or 'thrust_coefficient' 1.116e-06",
    ),
    ("drone", {"torque_coefficient": 1.1e-6}, "more drag than lift"),
    ("drone", {"rotor_radius": 0.11}, "propellers of rotors 1 and 2 strike each other"),
    ("drone", {"rotor_radius": 0.00635}, "17% of the power of ideal ones: 'rotor_radius' 0.00635 m or"),
    ("drone", {"rates.max": [600.0, 600.0, 286.0]}, "give rad/s, not deg/s"),
    ("drone", {"motor.time_constant_up": 33.0}, "give s, not ms"),
    ("drone", {"motor.map.coefficients": [0.0, 0.0, 2387.0, 955.0, 1472.0]}, "not rpm"),
    ("drone", {"motor.map.coefficients": [1900.0, 0.0, 250.0, 100.0, 40.0]}, "never comes down"),
    ("drone", {"controller.motor_idle": 95.0}, "never comes down; check 'controller.motor_idle'"),
    ("drone", {"hull_radius": 0.05}, "smaller than the distance of a rotor's hub"),
    ("drone", {"hull_radius": 180.0}, "do not fit a vehicle"),
    ("drone", {"terms.com_offset": {"position": [0.3, 0.0, 0.0]}}, "with 'terms.com_offset' no rotor speeds"),
    ("drone", {"terms.payload": {"mass": 4.0}}, "with 'terms.payload' no rotor speeds"),
    ("drone", {"sensors.gyro_rad_s": 20.0}, "a sensor with more than 3 measures nothing"),
    ("drone", {"battery.cells": 6}, "2.80 V for each of 6"),
    ("drone", {"battery.capacity": 1.55}, "1 Ah is 3,600 A s"),
    ("drone", {"battery.capacity": 5.58e6}, "1 Ah is 3,600 A s"),
    ("drone", {"battery.resistance": 12.0}, "ohm, not milliohm"),
    ("drone", {"battery.resistance": 0.5}, "hover needs 151 W, .* the battery gives 140 W at most"),
    ("drone", {"inertia": [2.9e-5, 2.44e-5, 4.99e-5]}, "less than the 0.00015 of a solid ball of osmium"),
    (
        "drone",
        {"motor.map.coefficients": [0.0, 0.0, 5550.0, -5714.0, 154.1], "controller.motor_idle": 1.0},
        "fall from 2.* rad/s at 49% throttle to 2286 rad/s at 100%, .* give c0 to c4 of a map that rises",
    ),
    (
        "drone",
        {"motor.map.coefficients": [1500.0, 0.0, -4500.0, 5500.0, 0.0], "controller.motor_idle": 1.0},
        "fall from 1105 rad/s at 1% throttle to 580 rad/s at 17%",
    ),
    ("drone", {"battery.reference_voltage": 25.0}, "exceeds the full pack's 'open_circuit_full'"),
    ("drone", {"battery.reference_voltage": 3.9, "motor.map.coefficients": [0, 0, 250, 100, 628]}, "not of a cell"),
    ("drone", {"battery.open_circuit_curve": [12.8, 16.8]}, "must fall"),
    ("drone", {"battery.energy": 26.0}, "1 Wh is 3,600 J"),
    ("drone", {"battery.temperature": 298.0}, "degrees Celsius"),
    ("drone", {"battery.rc_time": 0.0}, "'battery.rc_time' must be positive"),
    ("drone", {"rotor_speed_range": [150.0, 1e200]}, "too large or too small"),
    ("drone", {"rotors": rotors(*([x, y, s] for x, y, s in ROTORS[:3]), [0.0775, 0.1, 2])}, "must be 1 or -1"),
    ("drone", {"thrust_coefficient": -1.1e-6}, "'thrust_coefficient' must be positive"),
    ("drone", {"thrust_coefficient": 1.1e-8}, "cannot hover"),
    ("drone", {"torque_coefficient": -1.1e-8}, "'torque_coefficient' must be positive"),
    ("drone", {"rotor_radius": 0.0}, "'rotor_radius' must be positive"),
    ("drone", {"rotor_radius": 63.5}, "strike each other"),
    ("drone", {"rotor_speed_range": [150.0, 26700.0]}, "faster than sound"),
    ("drone", {"rotor_speed_range": [2800.0, 150.0]}, "'rotor_speed_range' must rise .*; exchange them"),
    ("drone", {"rotor_speed_range": [-150.0, 2800.0]}, "must rise"),
    ("drone", {"motor.map.coefficients": [0.0, 0.0, 50.0, 10.0, 5.0]}, "below the 1383 of hover|of hover"),
    ("drone", {"motor.time_constant_up": 0.0}, "must be positive"),
    ("drone", {"rates.max": [10.0, 0.0, 4.0]}, "'rates.max' must be positive"),
    ("drone", {"hull_radius": -0.1}, "'hull_radius' must be positive"),
    ("drone", {"terms.rotor_drag.k_d": -4.0e-5}, "would drive the vehicle"),
    ("drone", {"terms.body_drag.c": [0.004, -0.004, 0.008]}, "would drive the vehicle"),
    ("drone", {"battery.efficiency": 85.0}, "a share of 0 to 1"),
    ("drone", {"battery.efficiency": 0.0}, "a share of 0 to 1"),
    ("drone", {"battery.resistance": -0.012}, "'battery.resistance' must be 0 or more"),
    ("drone", {"battery.capacity": 0.0}, "'battery.capacity' must be positive"),
    ("drone", {"battery.cells": 8}, "for each of 8 'cells'"),
    ("drone", {"battery.open_circuit_slope": 17.0}, "leaves an empty pack no voltage"),
    ("drone", {"battery.reference_voltage": -15.9}, "positive|below the"),
    ("track", {"gates": gates((0.0, 0.0, 0.5, 0.0))}, "gate 1 reaches 0.25 m into the ground"),
    ("track", {"gates": gates((0.0, 0.0, -3.0, 0.0))}, "into the ground"),
    ("track", {"gates": gates((14.9, 0.0, 2.0, 0.0), (40.0, 0.0, 2.0, 0.0))}, "gate 2 is not within the flight volume"),
    ("track", {"gates": gates((0.0, 0.0, 7.6, 0.0))}, "frame of gate 1 reaches 0.65 m into the ceiling"),
    ("track", {"gates": gates((0.0, 0.0, 7.2, 0.0), LEVEL)}, "frame of gate 1 reaches 0.25 m into the ceiling"),
    ("track", {"gates": gates((0.0, 14.5, 2.0, 0.0))}, "frame of gate 1 reaches 0.55 m into a wall"),
    (
        "track",
        {"gates": gates((0.0, 14.1, 2.0, 0.0), (0.0, -14.2, 2.0, 0.0))},
        "frames of gates 1 and 2 reach up to 0.25 m into a wall",
    ),
    (
        "track",
        {"gates": gates(LEVEL, (40.0, 0.0, 2.0, 0.0), (0.0, 40.0, 2.0, 0.0))},
        "gates 2 and 3 are not within the flight volume",
    ),
    (
        "track",
        {"gates": gates((0.0, 0.0, 1.2, 0.0, {"roll_deg": 45.0}))},
        "frame of gate 1 reaches 0.07 m into the ground",
    ),
    ("track", {"gates": gates(LEVEL, (0.0, 0.0, 2.0, 3.0))}, "the frames of gates 1 and 2 overlap"),
    ("track", {"gates": gates(LEVEL, (0.0, 0.0, 2.0, 0.0, {"roll_deg": 30.0}))}, "the frames of gates 1 and 2 overlap"),
    (
        "track",
        {"gates": gates(LEVEL, (5.0, 0.0, 2.0, 0.0), (0.0, 0.0, 2.0, 0.0, {"inner_side": 0.8, "outer_side": 1.0}))},
        "the frames of gates 1 and 3 overlap",
    ),
    ("track", {"gates": gates(LEVEL, LEVEL, (5.0, 0.0, 2.0, 0.0))}, "gates 1 and 2 follow each other at one place"),
    ("track", {"gates": gates(LEVEL, (0.3, 0.0, 2.0, 45.0))}, "the frames of gates 1 and 2 overlap"),
    ("track", {"gates": gates(LEVEL, (0.0, 0.0, 2.0, 90.0))}, "the frames of gates 1 and 2 overlap"),
    ("track", {"gates": []}, "no gates"),
    ("track", {"inner_side": 2.2}, "track.yaml: 'inner_side' 2.2 m must be .* less than 'outer_side' 2.1 m; exchange"),
    ("track", {"inner_side": -1.5}, "positive"),
    ("track", {"inner_side": 1500.0, "outer_side": 2100.0}, "a frame is 2100 m large; give 'inner_side'"),
    (
        "track",
        {"gates": gates((500.0, 0.0, 2.0, 0.0), (900.0, 0.0, 2.0, 0.0))},
        "all gates are outside of the flight volume",
    ),
    ("track", {"gates": gates(LEVEL, (0.0, 0.8, 2.0, 0.0))}, "0.80 m apart, and a bar of one is in the opening"),
    ("track", {"gates": gates(LEVEL, (0.0, 1.9, 2.0, 0.0))}, "1.90 m apart; correct .* or let them share a bar"),
    (
        "track",
        {"gates": gates(LEVEL, (0.6, 0.0, 2.5, 0.0, {"pitch_deg": 90.0}))},
        "the frames of gates 1 and 2 overlap",
    ),
    ("track", {"gates": gates(LEVEL, (0.0, 1.6, 2.0, 0.0, {"roll_deg": 45.0}))}, "the frames of gates 1 and 2 overlap"),
    (
        "track",
        {"gates": gates(LEVEL, (0.0, 2.5, 2.0, 0.0, {"inner_side": 3.0, "outer_side": 3.4}))},
        "the frames of gates 1 and 2 overlap",
    ),
    ("track", {"start": [0.0, 0.9, 2.0], "gates": gates(LEVEL)}, "'start' is within the frame of gate 1"),
    ("track", {"gates": gates((0.0, 0.0, 0.1, 0.0, {"pitch_deg": 90.0}))}, "no room: the ground"),
    ("track", {"gates": gates((14.8, 0.0, 2.0, 0.0))}, "no room: a wall"),
    (
        "track",
        {"gates": gates((0.0, 0.0, 2.0, 0.1), (5.0, 5.0, 2.0, 1.57), (0.0, 10.0, 2.0, 3.1), (-5.0, 5.0, 2.0, -1.57))},
        "as radians",
    ),
    (
        "track",
        {"gates": gates((*LEVEL, {"inner_side": 3.0}))},
        "gate 1: 'inner_side' 3 m must be .* 'outer_side' 2.1 m; give this gate both",
    ),
    ("track", {"gates": gates((0.0, 0.0, 0.8, 0.0, {"roll_deg": 45.0}))}, "into the ground"),
    (
        "track",
        {"gates": gates((0.0, 0.0, -3.6, 0.0), (5.0, 0.0, -1.0, 0.0))},
        "all gates are below the ground, the highest at z -1 m, and z is up; change the sign of each z",
    ),
    (
        "track",
        {"start": [-5.0, 4.5, -1.2], "gates": gates((0.0, 0.0, -30.0, 0.0), (5.0, 0.0, -20.0, 0.0))},
        "all gates are below the ground, .*; raise each 'position', or correct 'bounds_min'",
    ),
    ("track", {"gates": gates(LEVEL, (0.0, 0.0, 3.5, 0.0))}, "1.50 m apart, and a bar of one is in the opening"),
    ("track", {"depth": 0.0}, "'depth' must be positive"),
    ("track", {"start": [-5.0, 45.0, 1.2]}, "'start' is outside"),
    ("track", {"start": [-5.0, 4.5, -1.2]}, "'start' is outside"),
    ("track", {"laps": 0}, "at least 1"),
    ("track", {"bounds_min": [15.0, -15.0, 0.0]}, "'bounds_min' .15.0, -15.0, 0.0. must be less than .*; give the low"),
    ("track", {"bounds_min": [15.0, 15.0, 8.0], "bounds_max": [-15.0, -15.0, 0.0]}, "along each axis; exchange them"),
    ("camera", {"cx": 424.0}, "principal point .*; give 'cx' and 'cy' in pixels of this image$"),
    (
        "camera",
        {"fx": 286.0, "fy": 286.0, "cx": 399.5, "cy": 399.5},
        "the calibration is of a larger image, about 800 x 800 px: scale 'fx', 'fy', 'cx' and 'cy'",
    ),
    ("camera", {"cx": 399.5, "cy": 399.5, "fx": 28.6, "fy": 28.6}, "'cx' and 'cy' in pixels of this image$"),
    ("camera", {"fx": -137.3}, "must be positive"),
    ("camera", {"width": 0}, "must be positive"),
    ("camera", {"image_circle_deg": 400.0}, "no field of view"),
    ("camera", {"distortion": [-0.4, 0.037, -0.036, 0.006]}, "two directions"),
    ("camera", {"distortion": [-0.9, 0.0, 0.0, 0.0], "model": "pinhole", "image_circle_deg": None}, "less than half"),
    ("camera", {"exposure_s": 6.0}, "'exposure_s' 6 s is not between 0 and the 0.0333 s .* have 0.0005 to 0.01"),
    ("camera", {"exposure_s": -0.006}, "'exposure_s'"),
    ("camera", {"rate_hz": 0.0}, "must be positive"),
    (
        "camera",
        {"processing_latency": 40.0},
        "'processing_latency' 40 s .* from an image's stamp until .* 0.01 to 0.1",
    ),
    ("camera", {"processing_latency": -0.04}, "'processing_latency'"),
    ("camera", {"position": [60.0, 0.0, 20.0]}, "'position' is 63.2 m"),
    ("camera", {"pitch_deg": 120.0}, "beyond the vertical"),
    ("camera", {"pitch_deg": 90.0}, "looks at the sky"),
    ("camera", {"pitch_deg": -90.0}, "looks at the ground"),
    ("camera", {"yaw_deg": 180.0}, "looks backwards"),
    ("camera", {"fx": 286.0, "fy": 286.0}, "radius of 385 px"),
    ("camera", {"fx": 13.7, "fy": 13.7}, "focal length in pixels of this image"),
    ("camera", {"cx": 0.4987}, "principal point .0.4987, 191.5. .* in pixels of this image, not as shares"),
    ("camera", {"cy": 382.4}, "principal point"),
    ("camera", {"cx": 90.0}, "the image circle lies outside of the image with 2.% of its diameter"),
    ("camera", {"fx": 200.0, "fy": 200.0}, "the image circle lies outside of the image with 29% of its diameter"),
    ("camera", {"fx": 286.0}, "'fx' 286 and 'fy' 137.3 differ by a factor of 2.1"),
    ("camera", {"image_circle_deg": 2.845}, "'image_circle_deg' 2.845 .* give degrees, not radians"),
    ("camera", {"fy": 1373.0}, "differ by a factor of 10"),
    ("camera", {"model": "pinhole"}, "'model' is pinhole"),
    ("camera", {"model": "pinhole", "image_circle_deg": None}, "third and fourth value of 'distortion'"),
    ("camera", {"model": "double_sphere", "distortion": [-0.17, 1.5]}, "alpha in 0 to 1"),
    ("camera", {"rate_hz": 0.033}, "not the time between two"),
    ("camera", {"width": 38400}, "are no image"),
    ("camera", {"model": "fisheye"}, "must be one of"),
    ("camera", {"distortion": [0.1]}, "has 4 values, not 1; give k1 k2 k3 k4$"),
    (
        "camera",
        {"model": "double_sphere"},
        "2 values, not 4; give xi alpha, or correct 'model': kannala_brandt has k1 k2 k3 k4, pinhole has k1 k2 p1 p2$",
    ),
    (
        "camera",
        {"model": "pinhole", "distortion": [0.1, 0.2]},
        "give none or k1 k2 p1 p2 or .* double_sphere has xi alpha",
    ),
]
POSSIBLE = [
    ("drone", {"mass": 0.25, "inertia": [5e-4, 5e-4, 8e-4]}),
    ("drone", {"mass": 2.6}),
    ("drone", {"inertia": [[2.9e-3, 1e-5, 0], [1e-5, 2.44e-3, 0], [0, 0, 4.99e-3]]}),
    ("drone", {"rotors": rotors(*([x, y, -s] for x, y, s in ROTORS)), "controller.yaw_motors_reversed": True}),
    ("drone", {"rotors": rotors(*([x + 0.01, y, s] for x, y, s in ROTORS))}),
    ("drone", {"rotors": rotors(*([1.6 * x, 0.8 * y, s] for x, y, s in ROTORS))}),
    ("drone", {"rotor_speed_range": [0.0, 2800.0]}),
    ("drone", {"terms.rotor_drag.k_d": 0.0}),
    ("drone", {"terms": {}}),
    ("drone", {"battery.cells": 0}),
    ("drone", {"battery.resistance": 0.0}),
    ("drone", {"battery.resistance": 0.35}),
    ("drone", {"motor.map.coefficients": [0.0, 0.0, 900.0, -1150.0, 180.0]}),
    ("drone", {"hull_radius": 0.13}),
    ("drone", {"rotor_radius": 0.0755}),
    ("drone", {"battery.open_circuit_full": 13.6, "battery.reference_voltage": 13.2}),
    ("drone", {"terms.payload": {"mass": 0.4, "position": [0.0, 0.0, -0.05]}}),
    ("drone", {"rates.max": [30.0, 30.0, 15.0]}),
    ("track", {"gates": gates(LEVEL, (0.0, 1.8, 2.0, 0.0))}),
    ("track", {"gates": gates(LEVEL, (0.0, 0.0, 4.1, 0.0))}),
    ("track", {"gates": gates((0.0, 0.0, 1.05, 0.0), (0.0, 0.0, 2.85, 180.0), (5.0, 0.0, 2.0, 0.0))}),
    ("track", {"gates": gates((0.0, 0.0, 0.76, 0.0), (0.0, 0.0, 2.87, 180.0), (5.0, 0.0, 2.0, 0.0))}),
    ("track", {"gates": gates(LEVEL, (0.0, 0.0, 2.0, 180.0))}),
    ("track", {"gates": gates((0.0, 13.95, 6.95, 0.0))}),
    ("track", {"gates": gates(LEVEL, (0.9, 0.9, 2.0, 90.0))}),
    ("track", {"gates": gates(LEVEL, (8.0, 0.0, 2.0, 2.0), (10.0, 0.3, 2.0, 1.5))}),
    ("track", {"gates": gates((0.0, 0.0, 0.75, 0.0))}),
    ("track", {"gates": gates(LEVEL)}),
    ("track", {"gates": gates(LEVEL, (5.0, 0.0, 2.0, 0.0), (0.0, 0.0, 2.0, 180.0), (5.0, 0.0, 2.0, 180.0))}),
    ("track", {"gates": gates(LEVEL, (5.0, 0.0, 2.0, 0.0), LEVEL, (0.0, 6.0, 2.0, 0.0))}),
    ("track", {"gates": gates((0.0, 0.0, 3.0, 0.0, {"pitch_deg": 90.0}), (5.0, 0.0, 2.0, 0.0))}),
    ("track", {"gates": gates((*LEVEL, {"inner_side": 0.8, "outer_side": 1.0}), (5.0, 0.0, 2.0, 0.0))}),
    ("track", {"start_yaw_deg": 140.0}),
    ("track", {"laps": 50}),
    ("camera", {"pitch_deg": 45.0, "roll_deg": 90.0}),
    ("camera", {"height": 216, "cy": 107.5}),
    ("camera", {"fx": 240.0, "image_circle_deg": None}),
    ("camera", {"pitch_deg": -30.0}),
    ("camera", {"exposure_s": 0.0}),
    ("camera", {"model": "pinhole", "distortion": [], "image_circle_deg": None}),
    ("camera", {"model": "double_sphere", "distortion": [-0.18, 0.59], "image_circle_deg": None}),
]


@pytest.mark.parametrize(("kind", "changes", "sentence"), IMPOSSIBLE)
def test_an_impossible_file_is_refused_by_one_sentence(tmp_path, kind, changes, sentence):
    path = changed(tmp_path, kind, changes)
    with pytest.raises(UsageError, match=sentence) as caught:
        configuration.load(KINDS[kind], path)
    text = str(caught.value)
    assert text.startswith(str(path)) and "\n" not in text and len(text) < 400


@pytest.mark.parametrize(("kind", "changes"), POSSIBLE)
def test_an_odd_file_is_accepted(tmp_path, kind, changes):
    record = configuration.load(KINDS[kind], changed(tmp_path, kind, changes))
    assert all(finding.level == ODD for finding in record.findings())


@pytest.mark.parametrize(
    ("kind", "changes", "sentence"),
    [
        (
            "drone",
            {"mass": 0.11, "inertia": [4e-4, 4e-4, 7e-4], "controller.motor_idle": 3.0},
            "times the weight; check 'mass' in kg",
        ),
        ("drone", {"inertia": [2.9e-4, 2.44e-4, 4.99e-4]}, "radii of gyration"),
        ("drone", {"motor.time_constant_up": 0.33}, "give s, not ms"),
        ("drone", {"terms.rotor_gyroscopic.inertia": 2.0e-4}, "needs 23% of the vehicle's mass at the tips"),
        ("drone", {"battery.capacity": 900.0}, "3,600 A s"),
        ("drone", {"torque_coefficient": 4.0e-8}, "drag torque over thrust"),
        ("drone", {"hull_radius": 0.13}, "does not cover the propellers"),
        ("drone", {"battery.cells": 5}, "check 'battery.cells'"),
        ("drone", {"terms.payload": {"mass": 1.5}}, "'terms.payload.mass' is 1.5 kg"),
        ("track", {"gates": gates((*LEVEL, {"roll_deg": 45.0}))}, "the detector confuses its corners"),
        ("track", {"gates": gates((*LEVEL, {"pitch_deg": 80.0}))}, "rarely finds it"),
        ("track", {"start_yaw_deg": 140.0}, "away from gate 1"),
        (
            "track",
            {"inner_side": 0.39},
            "the opening of gates 1, 2, 3, 4, 5, 6 and 7 is 0.39 m wide; gates have 0.4 to 4 m",
        ),
        ("track", {"gates": gates(LEVEL, (0.0, 0.0, 2.0, 180.0))}, "gates 1 and 2 are one frame that is flown there"),
        ("camera", {"fx": 3000.0, "fy": 3000.0, "image_circle_deg": None}, "field of view is 10 degrees"),
        ("camera", {"fx": 165.0}, "differ by a factor of 1.2"),
        ("camera", {"yaw_deg": 90.0}, "90 degrees to the side"),
        ("camera", {"pitch_deg": -50.0}, "50 degrees downwards"),
        ("camera", {"rate_hz": 5.0}, "some 30 images a second"),
        ("camera", {"exposure_s": 0.03}, "blurred"),
        ("camera", {"cx": 120.0}, "off the middle of the image"),
    ],
)
def test_what_is_odd_is_said(tmp_path, capsys, kind, changes, sentence):
    path = changed(tmp_path, kind, changes)
    assert cli.main(["check", str(path)]) == 0
    assert sentence in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"rotors": rotors(*ROTORS[:2], ROTORS[3], ROTORS[3])}, "rotors 3 and 4 are at one place"),
        ({"rotor_speed_range": [1432.0, 26738.0]}, "faster than sound"),
        ({"mass": 0.01, "inertia": [5e-5, 5e-5, 8e-5]}, "times the weight, of the best racers 15"),
        ({"motor.map.coefficients": [0.0, 0.0, 250.0, 100.0, -154.1]}, "a map that rises"),
    ],
)
def test_what_follows_from_a_wrong_value_is_not_said(tmp_path, changes, sentence):
    vehicle = configuration.load_unchecked(Vehicle, changed(tmp_path, "drone", changes))
    [found] = vehicle.findings()
    assert sentence in found.sentence


def test_errors_that_do_not_follow_from_each_other_are_all_said(tmp_path):
    changes = {
        "rotor_speed_range": [1432.0, 26738.0],
        "motor.time_constant_up": 33.0,
        "rates.max": [600.0, 600.0, 286.0],
    }
    vehicle = configuration.load_unchecked(Vehicle, changed(tmp_path, "drone", changes))
    assert len(vehicle.findings()) == 3


def resized(scale: float) -> dict:
    """Return the shipped vehicle with another mass, built alike: with the same materials and speed of the tips."""
    content = yaml.safe_load((CONFIG / "drone.yaml").read_text())
    powers = {  # of the mass
        "mass": 1,
        "inertia": 5 / 3,
        "rotor_radius": 1 / 3,
        "thrust_coefficient": 5 / 3,
        "torque_coefficient": 2,
        "rotor_speed_range": -1 / 3,
        "motor.map.coefficients": -1 / 3,
        "hull_radius": 1 / 3,
        "hull_height": 1 / 3,
        "battery.capacity": 1,
        "battery.avionics_w": 1,
        "battery.resistance": -1,
        "battery.rc_resistance": -1,
        "battery.rc2_resistance": -1,
        "terms.rotor_drag.k_d": 4 / 3,
        "terms.body_drag.c": 1,
        "terms.drag_center.position": 1 / 3,
        "terms.axial_inflow.k_z": 4 / 3,
        "terms.translational_lift.k_h": 1,
        "terms.flapping_moment.k_f": 5 / 3,
        "terms.rotor_gyroscopic.inertia": 5 / 3,
    }
    for key, power in powers.items():
        value = functools.reduce(lambda part, name: part[name], key.split("."), content)
        set_value(content, key, (np.array(value, dtype=float) * scale**power).tolist())
    for rotor in content["rotors"]:
        rotor["position"] = [value * scale ** (1 / 3) for value in rotor["position"]]
    return content


@pytest.mark.parametrize("mass", [0.03, 0.25, 0.87, 3.0, 12.0])
def test_vehicles_of_any_size_are_accepted_and_their_coefficients_measured_by_it(tmp_path, capsys, mass):
    path = tmp_path / "drone.yaml"
    path.write_text(yaml.safe_dump(resized(mass / 0.87)))
    assert cli.main(["check", str(path)]) == 0
    assert "nothing is impossible or odd" in capsys.readouterr().out
    for term, key in (("rotor_drag", "k_d"), ("flapping_moment", "k_f"), ("rotor_gyroscopic", "inertia")):
        wrong = yaml.safe_load(path.read_text())
        wrong["terms"][term][key] *= 1e5
        (tmp_path / "wrong.yaml").write_text(yaml.safe_dump(wrong))
        assert cli.main(["check", str(tmp_path / "wrong.yaml")]) == 1
        assert f"'terms.{term}.{key}'" in capsys.readouterr().out


def test_the_expected_motors_are_those_of_the_simulated_firmware():
    np.testing.assert_array_equal(of_propulsion.MIX, mixer.MIX)  # the checks are below the simulator in the layers
