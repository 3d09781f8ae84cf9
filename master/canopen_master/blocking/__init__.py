"""A CANopen master for scripts, notebooks and threads."""
