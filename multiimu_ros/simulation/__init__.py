"""Truth to bytes: motions, IMU errors, placements, recordings and an emulated board."""
