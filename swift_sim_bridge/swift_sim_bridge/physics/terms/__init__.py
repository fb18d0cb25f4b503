"""Optional terms of the physics: forces, moments, air, motors, airframe and command errors that a vehicle file enables.

Terms, each module with its table `TERMS`:
    rotors, aerodynamics, inflow, propeller: forces and moments of rotors and body.
    air, gust: motion of the air.
    airframe, slung_load: changes of the airframe and attached loads.
    command_path: errors of the commands on their way to the rate loop.

Common to all:
    term: what a term consists of.
    registry: the collected terms, and the sums of what they do.
    motion: the motion of the vehicle as the terms use it.
    vectors, noise: vectors by components, and random numbers.
"""
