"""A fleet on a bus as topics of ROS 2: `ros2_feed` publishes what is heard, `command` joins both."""
