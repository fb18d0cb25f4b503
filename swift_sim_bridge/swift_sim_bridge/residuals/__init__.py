"""Black boxes that learn what a simulation leaves out, without saying what it is.

Each is a table of inputs with rows of weights: a query's answer is a sum over the table's rows.
"""
