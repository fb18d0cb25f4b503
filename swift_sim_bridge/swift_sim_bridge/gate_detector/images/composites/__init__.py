"""Synthetic images of gates whose looks span those of real race gates.

A `Composer` paints flat pictures in space: a scene, gates and what stands around them, through any lens. Motion, light
and sensor follow, then the labels. Everything depends on the settings, the pictures and the random generator alone.
"""
