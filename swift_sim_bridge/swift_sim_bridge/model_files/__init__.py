"""The files of trained models, shared by the trainings of the pilot and of the gate detector.

checkpoint   the whole state of a training in one file
provenance   command, settings, seed and figures by which a model was made
onnx_file    checked ONNX files, and their difference from the trained network
"""
