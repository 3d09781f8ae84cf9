"""The machine as a ROS 2 node: `python -m canopen_ros.ros2`. Only these modules import rclpy, from the user's own ROS 2."""
