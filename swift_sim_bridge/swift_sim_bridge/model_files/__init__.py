"""The files of trained models, shared by the trainings of the pilot and of the gate detector.

checkpoint   the whole state of a training in one file
provenance   command, settings, seed and figures by which a model was made
onnx_file    checked ONNX files, and their difference from the trained network
sittings     the runs of a training's command, and which changes they may make
training_log the figures of each trial or validation, as JSON lines
whole_file   files that are replaced at once or not at all
"""
