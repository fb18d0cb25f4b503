"""The physical limit: the time-optimal lap and race of a track and a vehicle.

symbolic     the simulator's physics as expressions of CasADi
models       the vehicle as a control problem: full thrust, as flown
course       the gates in their order, and the room of their openings
collocation  the nonlinear program of a course, and its solution by IPOPT
first_guess  a point mass through the gates, and attitudes from its thrust
line         a solution as states over time, and as a flight table
solve        lap and race of both models
race_rules   the rules of a race applied to a line
picture, tables
"""
