"""Statistical inference on linearised residuals.

sensitivity: change of every residual per step of every parameter
normal_equations: weighted least squares, summed over seconds of flight
null_distribution: statistics of reference flights: noise, bias, thresholds, minimum detectable magnitudes
stepwise: selection of effects on the normal equations
confounders: effects that explain the same residuals as a selected one
local_wind_search: wind at one place of the path
gust_correlation: gusts, by the correlation of the wind over time
"""
