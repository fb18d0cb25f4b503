"""Files that a user gives.

yaml_text  the content of a YAML text
images     the images in a folder
"""
