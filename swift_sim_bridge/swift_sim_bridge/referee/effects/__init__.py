"""The effects that the referee conceals.

effect      what is known of one: sizes, how it is planted, the terms of its equation
planting    how effects are planted in a vehicle file
quantities  the terms that an equation of an effect must contain
catalogue   the effects that the gap tool knows by name
laws        physics that it does not know
changes     what a pilot may have changed, numbers that are wrong by a large factor
"""
