"""Turn 1-16 cheap IMUs on one rigid body into one good IMU and an odometry."""

__version__ = '0.1.0'
