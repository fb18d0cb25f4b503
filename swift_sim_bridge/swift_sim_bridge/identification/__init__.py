"""A vehicle's coefficients from its flights, each with its standard error, or with what to fly to find it.

`identify` goes through three problems of one kind (`regression`): forces and moments behind measured rotor speeds
(`wrenches`), the pack (`pack`), and the motors (`motor_replay`).
"""
