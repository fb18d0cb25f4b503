"""The referee's own simulator, an implementation that shares no physics with the production simulator.

vehicles            random vehicles
paths, manoeuvres   paths to fly, and the manoeuvres that a report may propose
pilot, plant        control loops, and the equations of motion
vectors             vectors and quaternions
strange, blind      physics that the gap tool has no name for, from the literature and by an author who has not read it
polynomial          the equation of a repaired vehicle file
disturbances        process noise, gusts, late and lost commands
flight              flights of the referee's vehicle
rotorpy_flight      flights of RotorPy
instruments         the recording of a flight
foreign_logger      its recording with slower rows, as other people's loggers write it
"""
