"""A CANopen machine as a ROS node: a bridge that knows no ROS, and two thin adapters, for rospy and for rclpy."""
