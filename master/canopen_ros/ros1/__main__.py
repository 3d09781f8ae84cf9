"""`python -m canopen_ros.ros1`: the ROS 1 node."""

import sys

from canopen_ros.ros1.node import main

if __name__ == "__main__":
    sys.exit(main())
