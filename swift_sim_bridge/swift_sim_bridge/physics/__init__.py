"""Physics of a quadrotor as a sum of named terms: JAX functions for any leading batch dimensions, SI units, FLU body.

    p' = v                         q' = q * (0, omega/2)
    v' = q.(sum of forces)/m + g   omega' = J^-1 (sum of moments - omega x J omega)     (Methods, eqs 1-3)
    Omega' = (Omega_ss(U, u) - Omega) / time_constant                                    (Methods, eqs 4-6)
    U = E(charge) - R I - U_rc,  I = (sum c_d Omega^3 / efficiency + avionics) / U

Modules, in the order of a step:
    state: `State` and `Parameters`, and both from a vehicle file.
    battery: voltage and current under the rotors' load.
    motors: steady speed and lag of the rotors.
    terms: one module for each group of optional effects, and `terms.registry`, which sums them.
    rigid_body: accelerations by forces and moments.
    integrators: one step of the whole vehicle.
    contact: contact of the hull with ground, podium and gates.
    trace: the record of a simulated flight.

Beside the function that simulates it stands the specification of each effect (see `swift_sim_bridge.effects`): in
`rigid_body`, `motors`, `battery` and the modules of `terms`.
"""
