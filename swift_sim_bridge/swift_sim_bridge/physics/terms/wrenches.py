"""The effects that push and turn the vehicle, and those of its motors: one row each."""

from swift_sim_bridge.physics.terms import aerodynamics, inflow, rotors, slung_load
from swift_sim_bridge.physics.terms.term import Term

WRENCHES = {
    "rotor_drag": Term(aerodynamics.RotorDrag, hubs=aerodynamics.rotor_drag),
    "linear_drag": Term(aerodynamics.LinearDrag, wrench=aerodynamics.linear_drag),
    "body_drag": Term(aerodynamics.BodyDrag, wrench=aerodynamics.body_drag),
    "drag_center": Term(aerodynamics.DragCenter, wrench=aerodynamics.drag_center, check=aerodynamics.has_drag),
    "lift_cross": Term(aerodynamics.LiftCross, wrench=aerodynamics.lift_cross),
    "flapping_moment": Term(aerodynamics.FlappingMoment, wrench=aerodynamics.flapping_moment),
    "aerodynamic_polynomial": Term(aerodynamics.AerodynamicPolynomial, wrench=aerodynamics.aerodynamic_polynomial),
    "axial_inflow": Term(inflow.AxialInflow, hubs=inflow.axial_inflow),
    "translational_lift": Term(inflow.TranslationalLift, hubs=inflow.translational_lift),
    "ground_effect": Term(inflow.GroundEffect, hubs=inflow.ground_effect),
    "vortex_ring": Term(
        inflow.VortexRing, hubs=inflow.vortex_ring, start=inflow.calm, advance=inflow.buffeted, randoms=lambda n: n
    ),
    "thrust_axis_tilt": Term(rotors.ThrustAxisTilt, hubs=rotors.thrust_axis_tilt),
    "rotor_gyroscopic": Term(rotors.RotorGyroscopic, wrench=rotors.gyroscopic),
    "rotor_gain": Term(rotors.RotorGain, motor=rotors.rotor_gain, check=rotors.one_gain_a_rotor),
    "motor_heat": Term(rotors.MotorHeat, motor=rotors.motor_heat, start=rotors.cool_motors, advance=rotors.warm_motors),
    "slung_load": Term(
        slung_load.SlungLoad,
        tow=slung_load.pull,
        start=slung_load.start,
        advance=slung_load.advance,
        check=slung_load.hangs,
    ),
}
