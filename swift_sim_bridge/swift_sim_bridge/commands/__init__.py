"""Commands of `swiftros` that need a workstation; `swift_ros.commands.command_table` lists all commands.

sim, race           the simulator alone, and whole races
train               the policy or the gate detector
evaluate, bench     accuracy of the models, and speed of the software
identify            coefficients of a vehicle
gap, gap_referee    the gap tool, and its evaluation
"""
