"""The catalogue of effects: what a simulation may leave out (`effect`); of the camera and the map: `camera_effects`."""

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect, Parameter, vector
from swift_sim_bridge.gap.effects import camera

MOTION = ("gyro_body", "p_world", "q_world_body")
HOVERS = 1.05  # thrust-to-weight that no effect may take away
REACH_M = 0.2  # from the centre of mass, within which a load is fixed
LEAST, MOST = 0.6, 1.7  # times what the file says of mass and thrust: with more the file is of another vehicle
FORCE = (*MOTION, "specific_force_body")
MOMENT = (*MOTION, "rotor_speed", "single_rotor_speeds")


def catalogue(vehicle: Vehicle, gates: int = 0) -> tuple[Effect, ...]:
    """Return the effects that a vehicle can have, and the map of so many gates."""
    propulsion = (*_rotors(vehicle), *_drive(vehicle), *_moving_rotors())
    return (
        *_airframe(vehicle),
        *propulsion,
        *_air(vehicle),
        *_sensors(),
        *_odometry(),
        *_commands(),
        *_rate_loop(vehicle),
        *camera.camera(),
        *camera.track(gates),
    )


def _airframe(vehicle: Vehicle) -> tuple[Effect, ...]:
    mass, light = vehicle.mass, vehicle.thrust_to_weight / HOVERS
    square = np.ndim(vehicle.inertia) == 2
    inertia = tuple(
        Parameter(
            f"inertia[{i}]",
            "kg m^2",
            ("inertia", i, i) if square else ("inertia", i),
            0.02 * value,
            0.4 * value,
            2.5 * value,
            inverse=True,
        )
        for i, value in enumerate(np.diag(vehicle.inertia_matrix))
    )
    return (
        Effect(
            "mass",
            "force",
            (Parameter("mass", "kg", ("mass",), 0.005 * mass, LEAST * mass, min(MOST, light) * mass, inverse=True),),
            "a = (T + F) / m",
            "the vehicle weighs {mass:.4g} kg",
            "weigh it; or throttle punches with roll and pitch doublets",
            (*FORCE, "rotor_speed"),
        ),
        Effect(
            "inertia",
            "moment",
            inertia,
            "J domega/dt = tau - omega x J omega",
            "the moments of inertia are {values} kg m^2",
            "roll, pitch and yaw doublets above 3 Hz",
            MOMENT,
        ),
        Effect(
            "com_offset",
            "moment",
            vector("position", "m", ("terms", "com_offset", "position"), 1e-4, 0.05),
            "tau += -c x T e_z",
            "the centre of mass is off by {values} m",
            "throttle punches in level flight",
            MOMENT,
            {"com_offset": {"position": [0.0, 0.0, 0.0]}},
        ),
        Effect(
            "thrust_axis_tilt",
            "force",
            vector("tilt", "rad", ("terms", "thrust_axis_tilt", "tilt"), 1e-3, 0.2, 2),
            "F += T (e_y, -e_x, 0)",
            "the rotors' axes are tilted by {values} rad",
            "throttle punches, level",
            (*FORCE, "rotor_speed"),
            {"thrust_axis_tilt": {"tilt": [0.0, 0.0]}},
        ),
    )


def _rotors(vehicle: Vehicle) -> tuple[Effect, ...]:
    lift, torque, weak = vehicle.thrust_coefficient, vehicle.torque_coefficient, HOVERS / vehicle.thrust_to_weight
    return (
        Effect(
            "thrust_coefficient",
            "force",
            (
                Parameter(
                    "thrust_coefficient",
                    "N s^2/rad^2",
                    ("thrust_coefficient",),
                    0.005 * lift,
                    max(LEAST, weak) * lift,
                    MOST * lift,
                ),
            ),
            "T = c_l Omega^2",
            "each rotor gives {thrust_coefficient:.4g} Omega^2 N of thrust",
            "roll and pitch doublets at several thrusts",
            (*FORCE, "rotor_speed"),
        ),
        Effect(
            "torque_coefficient",
            "moment",
            (
                Parameter(
                    "torque_coefficient",
                    "N m s^2/rad^2",
                    ("torque_coefficient",),
                    0.01 * torque,
                    0.3 * torque,
                    3.0 * torque,
                ),
            ),
            "tau_z = -sum s_i c_d Omega_i^2",
            "the rotors' drag torque is {torque_coefficient:.4g} Omega^2 N m",
            "yaw steps at constant thrust",
            MOMENT,
        ),
    )


def _drive(vehicle: Vehicle) -> tuple[Effect, ...]:
    count, drive = len(vehicle.rotors), ("rotor_speed", "motor_command")
    up, down, lag = ("motor", "time_constant_up"), ("motor", "time_constant_down"), vehicle.motor.time_constant_up
    speed, volts, battery = vehicle.rotor_speed_range[1], vehicle.battery.reference_voltage, vehicle.battery
    shape = tuple(
        Parameter(f"coefficients[{i}]", unit, ("motor", "map", "coefficients", i), 0.005 * size)
        for i, unit, size in ((2, "rad/s", speed), (3, "rad/s", speed), (4, "rad/s/V", speed / volts))
    )
    gains = vector("gain", "", ("terms", "rotor_gain", "gain"), 0.002, 0.3, count)
    damaged = tuple(
        Effect(
            "damaged_propeller",
            "force",
            (Parameter("loss", "", ("terms", "damaged_propeller", "loss"), 0.005, 0.0, 0.6),),
            "T_i (1 - loss)",
            f"propeller {i + 1} gives {{loss:.2%}} less thrust",
            "throttle punches with yaw steps",
            (*FORCE, *MOMENT[3:]),
            {"damaged_propeller": {"rotor": i + 1, "loss": 0.0}},
            "rotor",
            str(i + 1),
        )
        for i in range(count)
    )
    return (
        Effect(
            "motor_time_constant",
            "motor",
            (Parameter("time_constant_up", "s", up, 0.01 * lag, 0.2 * lag, 5 * lag, (down,)),),
            "tau dOmega/dt = Omega_ss - Omega",
            "the motors lag by {time_constant_up:.4g} s",
            "steps or a chirp of the throttle",
            drive,
        ),
        Effect(
            "motor_asymmetry",
            "motor",
            (Parameter("time_constant_down", "s", down, 0.01 * lag, 0.2 * lag, 5 * lag),),
            "tau_down dOmega/dt = Omega_ss - Omega where Omega > Omega_ss",
            "the motors slow down with a lag of {time_constant_down:.4g} s, another than speeding up",
            "throttle steps up and down",
            drive,
        ),
        Effect(
            "motor_map",
            "motor",
            shape,
            "Omega_ss = c0 + c1 U + c2 sqrt(u) + c3 u + c4 U sqrt(u)",
            "the motors' steady speed is another function of command and voltage",
            "a slow ramp of the throttle with a full and with a nearly empty pack",
            drive,
        ),
        Effect(
            "rotor_gain",
            "motor",
            gains,
            "Omega_ss,i (1 + gain_i)",
            "the motors' speeds are off by {values} (shares)",
            "hover and throttle punches",
            drive,
            {"rotor_gain": {"gain": [0.0] * count}},
        ),
        *damaged,
        Effect(
            "battery_sag",
            "motor",
            (
                Parameter("resistance", "ohm", ("battery", "resistance"), 0.05 * battery.resistance + 1e-4, 0.0, 1.0),
                Parameter("open_circuit_slope", "V", ("battery", "open_circuit_slope"), 0.05, 0.0, 50.0),
            ),
            "U = U_oc - slope charge / capacity - R I - U_rc",
            "the pack has {resistance:.4g} ohm and loses {open_circuit_slope:.3g} V over a discharge",
            "load steps, and the same manoeuvre with a full and a nearly empty pack",
            ("voltage", "rotor_speed"),
        ),
    )


def _moving_rotors() -> tuple[Effect, ...]:
    return (
        Effect(
            "axial_inflow",
            "force",
            (Parameter("k_z", "N/(rad/s m/s)", ("terms", "axial_inflow", "k_z"), 2e-6, 0.0, 1e-3),),
            "F_i,z = -k_z Omega_i v_i,z",
            "a climb takes thrust from the rotors: {k_z:.3g} N/(rad/s m/s) each",
            "level climbs and descents at 2, 4 and 8 m/s",
            (*FORCE, "rotor_speed"),
            {"axial_inflow": {"k_z": 0.0}},
        ),
        Effect(
            "translational_lift",
            "force",
            (Parameter("k_h", "N/(m/s)^2", ("terms", "translational_lift", "k_h"), 2e-4, 0.0, 0.1),),
            "F_i,z = k_h v_i,xy^2",
            "flow across the rotors adds thrust: {k_h:.3g} N/(m/s)^2 each",
            "level passes at high speed, both ways",
            (*FORCE, "rotor_speed"),
            {"translational_lift": {"k_h": 0.0}},
        ),
        Effect(
            "rotor_gyroscopic",
            "moment",
            (Parameter("inertia", "kg m^2", ("terms", "rotor_gyroscopic", "inertia"), 5e-7, 0.0, 1e-3),),
            "tau = -dh/dt - omega x h, h = J_p sum s_i Omega_i e_z",
            "each rotor has an inertia of {inertia:.3g} kg m^2",
            "fast rolls and pitches during yaw turns",
            MOMENT,
            {"rotor_gyroscopic": {"inertia": 0.0}},
        ),
    )


def _air(vehicle: Vehicle) -> tuple[Effect, ...]:
    air = (*FORCE, "rotor_speed")
    drag = {"body_drag": {"c": [0.0, 0.0, 0.0]}}
    cross = tuple(Parameter(name, "N/(m/s)^2", ("terms", "lift_cross", name), 5e-4, -0.2, 0.2) for name in "ab")
    found = (
        Effect(
            "rotor_drag",
            "force",
            (Parameter("k_d", "N/(rad/s m/s)", ("terms", "rotor_drag", "k_d"), 1e-6, 0.0, 1e-3),),
            "F_i,xy = -k_d Omega_i v_i,xy",
            "the rotors drag by {k_d:.3g} N/(rad/s m/s) each",
            "one speed at two thrusts: straight and in a tight turn",
            air,
            {"rotor_drag": {"k_d": 0.0}},
        ),
        Effect(
            "linear_drag",
            "force",
            vector("c", "N/(m/s)", ("terms", "linear_drag", "c"), 2e-3, 3.0, low=0.0),
            "F = -c v",
            "the body drags by {values} N/(m/s)",
            "straight passes both ways at three speeds",
            air,
            {"linear_drag": {"c": [0.0, 0.0, 0.0]}},
        ),
        Effect(
            "body_drag",
            "force",
            vector("c", "N/(m/s)^2", ("terms", "body_drag", "c"), 3e-4, 0.3, low=0.0),
            "F = -c |v| v",
            "the body drags by {values} N/(m/s)^2",
            "straight passes at three speeds",
            air,
            drag,
        ),
        Effect(
            "lift_cross",
            "force",
            cross,
            "F_x,y = a v_x,y v_z, F_z = b |v_xy| v_z",
            "oblique flow lifts the body: a = {a:.3g}, b = {b:.3g} N/(m/s)^2",
            "dives and pull-ups, both ways",
            air,
            {"lift_cross": {"a": 0.0, "b": 0.0}},
        ),
        Effect(
            "flapping_moment",
            "moment",
            (Parameter("k_f", "N m/(rad/s m/s)", ("terms", "flapping_moment", "k_f"), 5e-8, -1e-4, 1e-4),),
            "tau_i = k_f Omega_i (v_i,y, -v_i,x, 0)",
            "flapping blades turn it by {k_f:.3g} N m/(rad/s m/s)",
            "passes forwards, backwards and sideways",
            air,
            {"flapping_moment": {"k_f": 0.0}},
        ),
        Effect(
            "ground_effect",
            "force",
            (Parameter("k", "", ("terms", "ground_effect", "k"), 0.1, 0.0, 10.0),),
            "T_i / (1 - k (R/4h_i)^2)",
            "the ground adds thrust, k = {k:.3g}",
            "low passes at 0.1, 0.2, 0.4 and 1 m",
            air,
            {"ground_effect": {"k": 0.0}},
        ),
        Effect(
            "vortex_ring",
            "force",
            (Parameter("loss", "", ("terms", "vortex_ring", "loss"), 0.01, 0.0, 0.9),),
            "T_i (1 - loss b(v_i,z / v_h))",
            "a descent into the own wake takes {loss:.1%} of the thrust",
            "straight descents at 2 to 12 m/s",
            air,
            {"vortex_ring": {"loss": 0.0}},
        ),
    )
    if {"linear_drag", "body_drag"} & set(vehicle.terms):
        found += (
            Effect(
                "drag_center",
                "moment",
                vector("position", "m", ("terms", "drag_center", "position"), 1e-3, 0.2),
                "tau = r x F_drag",
                "the body's drag acts at {values} m",
                "straight passes at three speeds",
                air,
                {"drag_center": {"position": [0.0, 0.0, 0.0]}},
            ),
        )
    if {"linear_drag", "body_drag", "rotor_drag", "axial_inflow"} & set(vehicle.terms):
        found += (
            Effect(
                "wind",
                "force",
                vector("velocity", "m/s", ("terms", "wind", "velocity"), 0.05, 30.0),
                "v_b = R^T (v - w)",
                "a steady wind of {values} m/s blows",
                "the same laps in both directions",
                air,
                {"wind": {"velocity": [0.0, 0.0, 0.0]}},
            ),
        )
    return found


def _sensors() -> tuple[Effect, ...]:
    imu = ("specific_force_body", *MOTION)

    def three(name, key, unit, step, bound, equation, sentence, manoeuvre, channels):
        return Effect(
            name,
            "imu",
            vector(key, unit, ("terms", name, key), step, bound),
            equation,
            sentence,
            manoeuvre,
            channels,
            {name: {key: [0.0, 0.0, 0.0]}},
        )

    return (
        three(
            "gyro_bias",
            "bias",
            "rad/s",
            1e-3,
            1.0,
            "gyro = omega + b",
            "the gyro is off by {values} rad/s",
            "hover for 60 s",
            MOTION,
        ),
        three(
            "gyro_scale",
            "scale",
            "",
            1e-3,
            0.3,
            "gyro = (1 + s) omega",
            "the gyro reads {values} (shares) too much",
            "spins about each axis",
            MOTION,
        ),
        three(
            "imu_lever_arm",
            "position",
            "m",
            1e-3,
            0.3,
            "f_m = f + omega' x r + omega x (omega x r)",
            "the IMU sits {values} m from the centre of mass",
            "yaw spins and flips",
            imu,
        ),
        three(
            "marker_offset",
            "position",
            "m",
            2e-3,
            0.3,
            "p_m = p + R r",
            "the markers' origin is {values} m from the centre of mass",
            "fast rolls, pitches and yaws",
            imu,
        ),
        three(
            "accel_bias",
            "bias",
            "m/s^2",
            0.02,
            5.0,
            "f_m = f + b",
            "the accelerometer is off by {values} m/s^2",
            "rolls and pitches to 60 degrees",
            imu,
        ),
        three(
            "accel_scale",
            "scale",
            "",
            1e-3,
            0.3,
            "f_m = (1 + s) f",
            "the accelerometer reads {values} (shares) too much",
            "rolls and pitches to 60 degrees",
            imu,
        ),
        Effect(
            "time_offset",
            "imu",
            (Parameter("delay", "s", ("terms", "time_offset", "delay"), 5e-4, -0.3, 0.3),),
            "pose(t) = truth(t - d)",
            "the pose is {delay:~.4g} s {delay:late|early} against the IMU",
            "fast yaw to and fro",
            MOTION,
            {"time_offset": {"delay": 0.0}},
            retimes=True,
        ),
        Effect(
            "clock_drift",
            "imu",
            (Parameter("ppm", "ppm", ("terms", "clock_drift", "ppm"), 20.0, -5e3, 5e3),),
            "pose(t) = truth(t - e t)",
            "the pose's clock runs {ppm:~.3g} ppm {ppm:fast|slow}",
            "a long flight",
            MOTION,
            {"clock_drift": {"ppm": 0.0}},
            retimes=True,
        ),
        three(
            "frame_misalignment",
            "rotation",
            "rad",
            1e-3,
            0.5,
            "R_m = R dR",
            "the markers' frame is turned by {values} rad against the IMU's",
            "all attitudes, slowly",
            imu,
        ),
        Effect(
            "map_tilt",
            "imu",
            vector("rotation", "rad", ("terms", "map_tilt", "rotation"), 1e-3, 0.2, 2),
            "p_m = R_t p, R_m = R_t R",
            "the pose's world is turned by {values} rad about x and y: it is not level",
            "turn by 180 degrees in hover: a bias turns as well, the world does not",
            imu,
            {"map_tilt": {"rotation": [0.0, 0.0]}},
        ),
    )


def _odometry() -> tuple[Effect, ...]:
    needs = ("p_vio", "q_vio_body", *MOTION)
    return (
        Effect(
            "vio_scale",
            "vio",
            (Parameter("scale", "", ("terms", "vio_scale", "scale"), 5e-3, -0.5, 0.5),),
            "v_vio = (1 + s) v",
            "VIO takes ways for {scale:~.2%} {scale:longer|shorter}",
            "straight passes at several speeds",
            needs,
            {"vio_scale": {"scale": 0.0}},
        ),
        Effect(
            "vio_drift",
            "vio",
            vector("share", "", ("terms", "vio_drift", "share"), 2e-3, 0.3),
            "v_vio = v + |v| share, in the heading's frame",
            "VIO drifts by {values} (shares of the speed)",
            "laps in both directions",
            needs,
            {"vio_drift": {"share": [0.0, 0.0, 0.0]}},
        ),
    )


def _commands() -> tuple[Effect, ...]:
    needs = ("omega_command_body", "thrust_command")
    rates = {"rate_scale": {"scale": [1.0, 1.0, 1.0], "offset": [0.0, 0.0, 0.0]}}
    scale = tuple(Parameter(f"scale[{i}]", "", ("terms", "rate_scale", "scale", i), 5e-3, 0.2, 3.0) for i in range(3))
    return (
        Effect(
            "command_latency",
            "command",
            (Parameter("delay", "s", ("terms", "command_latency", "delay"), 2e-3, 0.0, 0.05),),
            "command heard(t) = command sent(t - d)",
            "commands act {delay:.4g} s late",
            "roll and pitch doublets above 3 Hz",
            needs,
            {"command_latency": {"delay": 0.0, "jitter": 0.0}},
        ),
        Effect(
            "command_jitter",
            "command",
            (Parameter("jitter", "s", ("terms", "command_latency", "jitter"), 5e-4, 0.0, 0.01),),
            "command heard(t) = command sent(t - d), d evenly spread by chance",
            "each command is late by another time, which scatters by {jitter:.4g} s",
            "a minute of lively flight",
            needs,
            {"command_latency": {"delay": 0.0, "jitter": 0.0}},
        ),
        Effect(
            "dropped_commands",
            "command",
            (Parameter("share", "", ("terms", "dropped_commands", "share"), 5e-3, 0.0, 0.9),),
            "a lost command leaves the last one in force",
            "{share:.2%} of the commands are lost",
            "a minute of lively flight",
            needs,
            {"dropped_commands": {"share": 0.0}},
        ),
        Effect(
            "rate_scale",
            "command",
            (*scale, *vector("offset", "rad/s", ("terms", "rate_scale", "offset"), 5e-3, 1.0)),
            "omega heard = scale omega sent + offset",
            "commanded rates act by {values} (factors, then rad/s)",
            "spins about each axis",
            needs,
            rates,
        ),
        Effect(
            "throttle_curve",
            "command",
            (
                Parameter("gain", "", ("terms", "throttle_curve", "gain"), 5e-3, -0.5, 1.0),
                Parameter("curve", "", ("terms", "throttle_curve", "curve"), 5e-3, -1.0, 1.0),
            ),
            "throttle heard = (1 + gain) u + curve u (1 - u)",
            "throttle acts by another curve: gain {gain:.3g}, curve {curve:.3g}",
            "a slow ramp of the throttle",
            needs,
            {"throttle_curve": {"gain": 0.0, "curve": 0.0}},
        ),
    )


def _rate_loop(vehicle: Vehicle) -> tuple[Effect, ...]:
    """Return the gains of a Betaflight's rate loop, in the firmware's numbers, roll, pitch and yaw."""
    if vehicle.controller.get("type") != "betaflight" or "pid" not in vehicle.controller:
        return ()

    def gains(letter: str, index: int, equation: str, manoeuvre: str):
        rows = tuple(
            Parameter(f"{letter}_{axis}", "", ("controller", "pid", axis, index), 1.0, 0.0, 250.0)
            for axis in ("roll", "pitch", "yaw")
        )
        return Effect(
            f"rate_loop_{letter}",
            "command",
            rows,
            equation,
            f"the rate loop flies with {letter.upper()} = {{values}} (roll, pitch, yaw)",
            manoeuvre,
            ("rate_loop",),
        )

    return (
        gains("p", 0, "P = k_p (setpoint - gyro)", "quick rolls, pitches and yaws, logged by the flight controller"),
        gains("i", 1, "I = k_i integral of (setpoint - gyro)", "a minute of flight with long turns, logged alike"),
        gains("d", 2, "D = -k_d d(filtered gyro)/dt", "flips and stops, logged by the flight controller"),
    )


def gusts() -> Effect:
    """Return air that wanders by chance: it has no footprint, see `gust`."""
    return Effect(
        "gust",
        "force",
        (Parameter("wind_20ft", "m/s", ("terms", "gust", "wind_20ft"), 0.1, 0.0, 60.0),),
        "v_air = Dryden's noise (MIL-F-8785C) at this mean wind",
        "gusts blow as at a mean wind of {wind_20ft:.3g} m/s",
        "hover at one place for a minute",
        (*FORCE, "rotor_speed"),
        {"gust": {"wind_20ft": 0.0}},
    )


def payload(position=(0.0, 0.0, 0.0)) -> Effect:
    """Return a load that is fixed to the vehicle at a place, position (3,) m, where it is sought (see `payload`)."""
    path = ("terms", "payload")
    rows = (
        Parameter("mass", "kg", (*path, "mass"), 2e-3, 0.0, 1.0),
        *vector("position", "m", (*path, "position"), 2e-3, REACH_M),
    )
    return Effect(
        "payload",
        "force",
        rows,
        "m = M + m_p, c = r m_p / m, J = J_0 + (r^2 1 - r r^T) M m_p / m",
        "it carries a load of {mass:.3g} kg at {position_0:.3g}, {position_1:.3g}, {position_2:.3g} m from "
        "the centre of mass that it has without",
        "throttle punches with roll and pitch doublets",
        tuple(dict.fromkeys((*FORCE, *MOMENT))),
        {"payload": {"mass": 0.0, "position": [float(x) for x in position]}},
    )


def draught(center=(0.0, 0.0, 0.0), radius: float = 1.0) -> Effect:
    """Return air that moves around a place, center (3,) m and radius m, where it is sought (see `draught`)."""
    path, rows = ("terms", "local_draught"), []
    for key, unit, reach, middles in (("velocity", "m/s", 30.0, (0.0, 0.0, 0.0)), ("center", "m", 3.0, center)):
        rows += [
            Parameter(f"{key}[{i}]", unit, (*path, key, i), 0.05, middle - reach, middle + reach)
            for i, middle in enumerate(middles)
        ]
    rows.append(Parameter("radius", "m", (*path, "radius"), 0.05, 0.3, 10.0))
    idle = {"velocity": [0.0, 0.0, 0.0], "center": [float(x) for x in center], "radius": float(radius)}
    return Effect(
        "local_draught",
        "force",
        tuple(rows),
        "v_air = w (1 - d^2/r^2)^2 within r of a place",
        "a draught of {velocity_0:.3g}, {velocity_1:.3g}, {velocity_2:.3g} m/s blows within {radius:.3g} m "
        "of {center_0:.3g}, {center_1:.3g}, {center_2:.3g} m",
        "slow passes through the place from several sides",
        (*FORCE, "rotor_speed"),
        {"local_draught": idle},
    )


NOT_COVERED = {  # effects of the project's list without a footprint here, and why
    "slung_load": "a load that swings depends on how it swung before, and moments are compared one by one",
    "motor_saturation": "a simulated flight controller stops at the motors' limits by itself",
    "corner_noise": "chance moves every corner otherwise, and only what comes again can be told",
    "camera_exposure": "told as processing_latency, of the other sign",
}
