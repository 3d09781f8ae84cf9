"""`canopen device`: devices of one's own, written in Python."""
