"""Raw readings to calibrated ones: the sensor model and what estimates it."""
