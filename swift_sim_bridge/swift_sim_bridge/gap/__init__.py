"""What did the simulation leave out? Recordings against a vehicle file, by the simulator's own physics.

check       channels of a recording on common times; what they lack, and what contradicts what (`contradiction`)
command     which commands the rate loop heard (`rate_pid`), against those that were sent
firmware_loop
            what Betaflight's rate loop asked of the motors by its own log, against the file's settings
replay      the physics under measured inputs, for many variants of the vehicle at once
sightings   gates in images, each with the one on the map that it must be
residuals   measured less replayed, by layer: motor, force, moment, imu, camera, vio, command; without what sensors
            are known to do wrong (`correction`), both sides alike low-passed (`filters`); `kinematics`: what pose
            and gyro tell by themselves
effect      a hypothesis: a `patch` of the vehicle file (`effects`, `camera_effects`: the catalogue; `explain`: for
            a pilot)
footprints  what each effect would do to all residuals, as sums over seconds of flight
twins       nominal flights along the recording's own path, measured by the same instruments (`bench`: of motors and
            pack alone, without a pose; `spun`: rotor speeds that nobody measured)
nulls       what the pipeline makes of twins, in which nothing was left out: floors and thresholds (`surrogates`:
            of what no twin flies, as `odometry` and commands that have their `arrivals`; `detector`: of gates in
            images)
select      which effects the flights call for, and which they cannot tell apart
estimate    the sizes of effects together, through the simulator
air         what moves and has no footprint of its own: a `draught` and a `gust`
payload     a load that is fixed to the vehicle, told by its parts first
unknown     an equation of known quantities (`features`, `units`) for what no name explains
doubt       names against equations: which are worth more
manoeuvres  what to fly to tell look-alikes apart
locate      when, between which gates and in what sort of flight each finding shows (`mismatch`: by layer and time)
prove       errors on parts of the flights that no fit has seen, flown on from recorded states (`rollout`), against
            black boxes
report      report.json, beside it a page, its `figures` and the repaired vehicle file (`page`, `repair`)
gather      recordings beside their twins: the `evidence`
search      the names that it calls for, one after the other
diagnose    all of it in order, then the repaired vehicle again (`several`: recordings of one vehicle together)
parallel    several of these at once
self_test   the same on flights of the simulator's own, to prove an installation
"""
