"""Where the numbers of the error-state filter stand in the arrays that its kernels take.

Where a field has several numbers, the next field's name ends it: `memory[RATE:FORCE]`.
"""

# Settings, those of `ErrorStateConfig`; WALKS are six, of gyro and accel bias.
GRAVITY, STANCE_SIGMA, STANCE_TIME, RESTING_SIGMA, RESTING_WALK = range(5)
MOTION_RATE, MOTION_FORCE, RATE_SCALE, FORCE_SCALE, WALKS = range(5, 10)
ROLLING_ARM, LEARNING_STRIDES, ROLLING_HEIGHT, SETTLING_TIME, STANCES_TEACH = range(15, 20)
SETTINGS = 20

# Memory: the newest reading, three numbers each; whether it rested; how long it has been still.
RATE, FORCE, RESTED, STOOD = 0, 3, 6, 7
# The reading before, three numbers each, and the time between the two.
RATE_BEFORE, FORCE_BEFORE, DT_BEFORE = 8, 11, 14
# Logarithm of what a swing adds to the velocity's variance, as far as learnt; by how much the
# present stance has corrected the velocity (three), and was expected to.
LEARNT, CORRECTED, EXPECTED = 15, 16, 19
# Fastest square of the speed since the last stance, -1 in a stance; how long it has been moving;
# square of the rate that counts against the present stance.
FASTEST, MOVED, TURNED = 20, 21, 22
MEMORY = 23
