"""Equations for physics that the catalogue lacks.

features: quantities of physical dimension, from each recording
feature_library: the features of all recordings, with their statistics on reference flights
equation_search: sparse regression of the residuals on features
equation_text: equations as text
equation_products: products of quantities that the simulator flies, in a recording
half_regression: regression by halves of the flight, each of which judges the coefficients of the other
polynomial_search: the equation of a repaired vehicle file, of these products
"""
