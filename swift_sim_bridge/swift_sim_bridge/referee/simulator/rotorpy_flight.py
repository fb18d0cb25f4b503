"""Flights of RotorPy (Folk et al. 2023), with its own equations of motion, aerodynamics and integrator.

RotorPy simulates mass, inertia, thrust and torque coefficients, one motor time constant, body and rotor drag, axial
inflow, translational lift, flapping and wind; it has no battery and no motor map: speed is proportional to the command.
Its flapping moment has the opposite sign of the catalogue's. The instruments and their errors are the referee's.
"""

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.errors import UsageError
from swift_sim_bridge.referee.simulator import pilot
from swift_sim_bridge.referee.simulator.flight import LOOP_S, PASSES, Order, Truth
from swift_sim_bridge.referee.simulator.instruments import in_body_frame
from swift_sim_bridge.referee.simulator.plant import GRAVITY, State, plant_of
from swift_sim_bridge.referee.simulator.vectors import parts

EFFECTS_OF_ROTORPY = (
    "body_drag",
    "rotor_drag",
    "axial_inflow",
    "translational_lift",
    "flapping_moment",
    "mass",
    "thrust_coefficient",
    "inertia",
    "motor_time_constant",
    "wind",
    "gyro_bias",
    "accel_bias",
)
VOLTAGE = 15.9  # V, constant; the reference voltage of the referee's vehicles


def package():
    """Return RotorPy's module of vehicles.

    Raises:
        UsageError: RotorPy is not installed.
    """
    try:
        from rotorpy.vehicles import multirotor
    except ImportError as error:
        missing = "RotorPy's flights need the package rotorpy; `pip install rotorpy==3.0.0`, or use --generator own"
        raise UsageError(missing) from error
    return multirotor


def multirotor(parameters: dict):
    """Return RotorPy's vehicle with these parameters (see `parameters_of`).

    Raises:
        UsageError: RotorPy is not installed.
    """
    options = {"control_abstraction": "cmd_motor_speeds", "integrator_kwargs": {"method": "RK23"}}
    vehicle = package().Multirotor(parameters, **options)
    vehicle.g, vehicle.weight = (
        GRAVITY,
        np.array([0.0, 0.0, -parameters["mass"] * GRAVITY]),
    )  # RotorPy's 9.81 is 0.03 % more
    return vehicle


def without_battery(content: dict) -> dict:
    """Return a vehicle file's content for RotorPy: constant voltage, one lag, speed proportional to the command."""
    top, lag = content["rotor_speed_range"][1], content["motor"]["time_constant_up"]
    stiff = {"open_circuit_full": VOLTAGE, "open_circuit_slope": 0.0, "resistance": 1e-6, "rc_resistance": 1e-6}
    linear = {"form": content["motor"]["map"]["form"], "coefficients": [0.0, 0.0, 0.0, top, 0.0]}
    motor = {"time_constant_up": lag, "time_constant_down": lag, "map": linear}
    return content | {"battery": content["battery"] | stiff, "motor": motor, "rotor_speed_range": [1.0, top]}


def parameters_of(content: dict) -> dict:
    """Return RotorPy's parameters of a vehicle file's content."""
    terms = content.get("terms", {})
    drag = terms.get("body_drag", {}).get("c", [0.0] * 3)
    plant = plant_of(content)  # a load changes mass, inertia and the hubs' positions
    inertia = plant["inertia"]
    return {
        "mass": plant["mass"],
        "Ixx": inertia[0, 0],
        "Iyy": inertia[1, 1],
        "Izz": inertia[2, 2],
        "Ixy": inertia[0, 1],
        "Ixz": inertia[0, 2],
        "Iyz": inertia[1, 2],
        "c_Dx": drag[0],
        "c_Dy": drag[1],
        "c_Dz": drag[2],
        "num_rotors": len(content["rotors"]),
        "rotor_pos": {f"r{i}": position for i, position in enumerate(plant["position"])},
        "rotor_directions": np.array([-rotor["spin"] for rotor in content["rotors"]]),  # of the torque on the body
        "rotor_speed_min": content["rotor_speed_range"][0],
        "rotor_speed_max": content["rotor_speed_range"][1],
        "k_eta": content["thrust_coefficient"],
        "k_m": content["torque_coefficient"],
        "k_d": terms.get("rotor_drag", {}).get("k_d", 0.0),
        "k_z": terms.get("axial_inflow", {}).get("k_z", 0.0),
        "k_h": terms.get("translational_lift", {}).get("k_h", 0.0),
        "k_flap": -terms.get("flapping_moment", {}).get("k_f", 0.0),
        "tau_m": content["motor"]["time_constant_up"],
    }


def fly(order: Order) -> Truth:
    """Return the flight of an order; its vehicle must be one `without_battery`, its seed is that of the gyro's noise.

    Raises:
        UsageError: RotorPy is not installed.
    """
    vehicle, terms = multirotor(parameters_of(order.content)), order.content.get("terms", {})
    top, rng = order.content["rotor_speed_range"][1], np.random.default_rng([order.seed, 7])
    hover = np.sqrt(order.content["mass"] * GRAVITY / (4 * order.content["thrust_coefficient"]))
    half, wind = 0.5 * order.path.yaw[0], np.array(terms.get("wind", {}).get("velocity", [0.0] * 3))
    state = {
        "x": order.path.p[0].copy(),
        "v": np.zeros(3),
        "q": np.array([0.0, 0.0, np.sin(half), np.cos(half)]),
        "w": np.zeros(3),
        "wind": wind,
        "rotor_speeds": np.full(4, hover),
    }
    bias, memory = np.array(terms.get("gyro_bias", {}).get("bias", [0.0] * 3)), np.zeros(9)
    with jax.enable_x64(True):
        controls = jax.tree.map(jnp.asarray, pilot.controls_of(order.nominal))
        rows, commands = [], []
        for k in range(len(order.path.p)):
            aim = np.concatenate(
                [
                    order.path.p[k],
                    order.path.v[k],
                    order.path.a[k],
                    order.path.shake[k],
                    [order.path.yaw[k], order.path.yaw_rate[k]],
                ]
            )
            given = np.asarray(_commanded(_row(state), aim, controls))
            commands.append(given)
            for _ in range(PASSES):
                gyro = state["w"] + bias + order.gyro_noise * rng.standard_normal(3)
                memory, u = map(np.asarray, _looped(memory, gyro, given, controls))
                control = {"cmd_motor_speeds": top * u}
                slope = vehicle.statedot(state, control, LOOP_S)
                rows.append((_row(state), slope["vdot"], slope["wdot"], u, gyro))
                state = vehicle.step(state, control, LOOP_S)
                state["wind"] = wind
    return _truth(rows, np.array(commands))


def _row(state: dict) -> np.ndarray:
    """Return RotorPy's state as one array (17,)."""
    return np.concatenate([state["x"], state["q"], state["v"], state["w"], state["rotor_speeds"]])


@jax.jit
def _commanded(row, aim, controls):
    """Return the pilot's command (4,): rates and collective thrust."""
    state = State(*(parts(row[a:b]) for a, b in ((0, 3), (3, 7), (7, 10), (10, 13), (13, 17))), 0.0, 0.0)
    p, v, a, shake = (parts(aim[i : i + 3]) for i in (0, 3, 6, 9))
    rates, thrust = pilot.command(state, pilot.Aim(p, v, a, aim[12], aim[13], shake), controls)
    return jnp.stack([*rates, thrust])


@jax.jit
def _looped(memory, gyro, given, controls):
    """Return memory (9,) and motor commands (4,) after one pass of the rate loop."""
    loop = pilot.Loop(*(parts(memory[i : i + 3]) for i in (0, 3, 6)))
    loop, u = pilot.motor_commands(loop, parts(gyro), parts(given[:3]), given[3], controls, LOOP_S)
    return jnp.stack([value for part in loop for value in part]), jnp.stack(u)


def _truth(rows, commands) -> Truth:
    """Return the flight of the recorded rows."""
    states, v_rate, w_rate, u, gyro = (np.array(column) for column in zip(*rows, strict=True))
    p, q, v, w, spin = np.split(states, [3, 7, 10, 13], axis=1)
    t = np.arange(len(states)) * LOOP_S
    force = in_body_frame(q, v_rate + [0.0, 0.0, GRAVITY])
    still = np.zeros(len(t))
    return Truth(
        t=t,
        p=p,
        q=q,
        v=v,
        w=w,
        rotor_speed=spin,
        charge=still,
        rc=still,
        memory=np.zeros((len(t), 0)),
        specific_force=force,
        angular_acceleration=w_rate,
        voltage=still + VOLTAGE,
        current=still,
        u=u,
        gyro=gyro,
        t_command=t[::PASSES],
        rates=commands[:, :3],
        thrust=commands[:, 3],
    )
