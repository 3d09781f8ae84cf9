"""`python -m canopen_ros.ros2`."""

import sys

from canopen_ros.ros2.node import main

sys.exit(main(sys.argv))
