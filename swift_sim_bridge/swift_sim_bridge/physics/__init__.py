"""Physics of a quadrotor as a sum of named terms. Pure JAX, any leading batch dimensions, SI, body forward-left-up.

    p' = v                         q' = q * (0, omega/2)
    v' = q.(sum of forces)/m + g   omega' = J^-1 (sum of moments - omega x J omega)     (Methods, eqs 1-3)
    Omega' = (Omega_ss(U, u) - Omega) / time_constant                                    (Methods, eqs 4-6)
    U = E(charge) - R I - U_rc,  I = (sum c_d Omega^3 / efficiency + avionics) / U

`state` holds what moves and what describes the vehicle; `motors`, `rotors`, `aerodynamics`, `battery`, `contact` hold
one function an effect; `terms` lists the effects that a vehicle file switches on by its `terms`; `rigid_body` adds the
wrenches up; `integrators` moves the state by one step.
"""
