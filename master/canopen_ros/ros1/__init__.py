"""The ROS 1 node: rospy around the bridge. Only `python -m canopen_ros.ros1` and what it imports need ROS."""
