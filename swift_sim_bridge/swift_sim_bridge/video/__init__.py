"""The video of a recorded flight: a chase view of the hall, the onboard image, and the state of the race.

flight      what a video shows of a bag
chase       the path of the camera behind the vehicle
hall        the room of the race, by the renderer of the simulator
shapes      gates, vehicle and trail as coloured faces
painter     draws faces from far to near
onboard     the recorded image, with detected corners and the gates of the map
dashboard   times, gates, speed, thrust, battery, error of the estimate
film        the frames of a video
mp4         the file
"""
