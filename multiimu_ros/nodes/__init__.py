"""The rim: ROS 2 nodes around the core, and the only modules that import rclpy."""
