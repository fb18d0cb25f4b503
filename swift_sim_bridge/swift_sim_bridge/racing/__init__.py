"""Races in simulation: the graph's processes from the podium to the end.

listener   follows a race as a node of the graph
race       one race in processes of its own
tables     results as text
picture    the picture of a race
"""
