"""The simulated camera: grey fisheye images of gates in a room with random surfaces.

textures       families of procedural textures
scene          gates and other flat objects, the room, exposure; all drawn from a generator
motion         pose and velocity of the body that carries the camera
renderer       images of a scene, by ray casting
image_thread   rendering beside the simulation
"""
