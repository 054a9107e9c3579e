"""Sensor frames to the rig's frame: where each IMU sits, and how."""
