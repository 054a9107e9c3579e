"""From one good IMU to a pose: stillness, attitude, strapdown, error-state filter."""
