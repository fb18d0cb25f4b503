"""The gates that a user gives: frontal pictures, meshes and labelled photographs, ready to be painted."""
