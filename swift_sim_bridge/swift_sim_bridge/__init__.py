"""What runs on a workstation: the simulator, the trainings, the identification, the gap tool and the benchmarks.

Modules that the packages below share:
    effects         specification of the effects that a vehicle may have
    seeds           random generators of a race
    parallel        evaluation in threads
    tcp_ports       free TCP ports

Packages:
    physics, flight_controller, sensors, rendering, simulation, bridge
                    the simulator, and the node in place of the vehicle's hardware
    racing          races through the node graph
    pilot, gate_detector, residual_models, model_files
                    trainings and their files
    identification  coefficients of a vehicle from its flights
    gap, referee    the gap tool, and its evaluation on sealed cases
    benchmarks      measurements of speed, detector and firmware
    plots           plots that several parts share
    commands        the commands
"""
