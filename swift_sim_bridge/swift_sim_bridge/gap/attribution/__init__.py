"""Attribution of the residuals to effects of the catalogue.

evidence: what a search works on, and its result
gauss_newton: joint estimation of effects by iterative least squares
far_start: numbers that are wrong by a large factor, on a log scale before the search
process_noise: random forces and moments beyond those of the reference flights
wind: local winds and gusts
payload: a load, of which mass, centre of mass and inertia are parts
model_comparison: effects against equations
stepwise_search: additions, replacements and removals of effects
search: the selection of effects, in this order
likeliest: of effects that look alike the likeliest one
"""
