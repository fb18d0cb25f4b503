"""Identification of a vehicle's coefficients from its flights: values with standard errors, or the missing manoeuvre.

Modules, in the order of their use:
    grid: channels at common times, and the filter for measurements and predictions.
    regression: weighted least squares with refusal of coefficients that the flights do not determine.
    wrench_model, wrenches: forces and moments at the measured rotor speeds.
    pack: the battery pack.
    motor_replay: the motors.
    advice: units, and the manoeuvre that shows each coefficient.
    identify: the three problems one after the other.
    tables, picture, repair: the result as text, as a figure and as a vehicle file.
"""
